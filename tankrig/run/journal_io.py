"""Reading a run's settings and journal without its pictures, by the json module alone."""

import json
from pathlib import Path
from typing import Any

from tankrig.errors import StoreError
from tankrig.run.damage import JournalText, read_lines

FORMAT = 2
"""Version of the folder's layout; a program refuses layouts newer than its own. Since layout 2 every line of the
journal and every chunk has a checksum."""

JOURNAL = "journal.jsonl"

MARK = "tankrig"
"""Attribute of the group that makes it a run."""


def load_json(path: Path) -> Any:
    """A JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def read_settings(path: Path) -> dict[str, Any]:
    """What the run at `path` was made with.

    Raises
    ------
    StoreError
        When `path` is no run, or one of a newer tankrig, or its settings are damaged.
    """
    return dict(_mark(path)["settings"])


def _mark(path: Path) -> dict[str, Any]:
    not_a_run = f"{path}: is not a run; give a folder that tankrig has recorded"
    if (path / JOURNAL).is_file():
        not_a_run = (
            f"{path}: its zarr.json, which holds the run's settings, is missing or damaged; journal and frames lie "
            "beside it untouched: restore zarr.json from a copy of the run"
        )
    try:
        mark: dict[str, Any] = load_json(path / "zarr.json")["attributes"][MARK]
        layout = mark["format"]
        if not isinstance(layout, int) or not isinstance(mark["settings"], dict):
            raise ValueError("no settings")
    except FileNotFoundError as error:
        missing = f"{path}: does not exist; give the folder of a run"
        raise StoreError(not_a_run if path.exists() else missing) from error
    except (KeyError, TypeError, ValueError, NotADirectoryError) as error:
        raise StoreError(not_a_run) from error
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
    if layout > FORMAT:
        raise StoreError(
            f"{path}: was recorded by tankrig {mark.get('version', '?')} in layout {layout}, and this program reads "
            f"layouts up to {FORMAT}; update tankrig"
        )
    return mark


def read_journal(path: Path) -> JournalText:
    """What the journal of the run at `path` holds.

    Raises
    ------
    StoreError
        When it cannot be read, or `path` is no run.
    """
    checked = _mark(path)["format"] >= 2
    try:
        data = (path / JOURNAL).read_bytes()
    except OSError as error:
        raise StoreError(
            f"{path}: its {JOURNAL} cannot be read ({error.strerror}), so the run cannot be opened; restore that file"
        ) from error
    return read_lines(data, checked)

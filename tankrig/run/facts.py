"""What can be told of a run without its pictures: its settings and its journal, read by the json module alone."""

import json
from pathlib import Path
from typing import Any

from tankrig.errors import StoreError
from tankrig.run.journal import Event, whole_lines

FORMAT = 1
"""Version of the folder's layout; a program refuses layouts newer than its own."""

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
        When `path` is no run, or one of a newer tankrig.
    """
    not_a_run = f"{path}: is not a run; give a folder that tankrig has recorded"
    try:
        mark = load_json(path / "zarr.json")["attributes"][MARK]
        layout, settings = mark["format"], mark["settings"]
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
    return dict(settings)


def read_journal(path: Path) -> tuple[list[Event], int, int]:
    """Whole events of the run at `path`, the bytes they take, and the bytes that the journal has.

    Raises
    ------
    StoreError
        When the journal cannot be read.
    """
    try:
        data = (path / JOURNAL).read_bytes()
    except OSError as error:
        raise StoreError(
            f"{path}: its {JOURNAL} cannot be read ({error.strerror}), so the run cannot be opened; restore that file"
        ) from error
    lines = list(whole_lines(data))
    return [event for event, _ in lines], lines[-1][1] if lines else 0, len(data)

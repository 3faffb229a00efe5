"""Reading a run's settings and journal without its pictures, by the json module alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tankrig import bounded_reading
from tankrig.errors import StoreError
from tankrig.run.damage import JournalText, read_lines

FORMAT = 2
"""Version of the folder's layout; a program refuses layouts newer than its own. Since layout 2 every line of the
journal and every chunk has a checksum."""

JOURNAL = "journal.jsonl"

_KINDS: dict[str, type | tuple[type, ...]] = {
    "name": str, "id": str, "rig": str, "saturation": (int, float), "bench": dict, "sequence": dict, "exposure": dict,
    "calibrations": dict, "measured": list,
}  # fmt: skip
"""Of a run's settings, where it has them."""

MARK = "tankrig"
"""Attribute of the group that makes it a run."""


def load_json(path: Path) -> Any:
    """A JSON file."""
    return bounded_reading.parsed_json(bounded_reading.whole_bytes(path, bounded_reading.MOST_JSON_BYTES))


def read_settings(path: Path) -> "Settings":
    """What the run at `path` was made with.

    Raises
    ------
    StoreError
        When `path` is no run, or one of a newer tankrig, or its settings are damaged.
    """
    return Settings(_mark(path)["settings"], path)


class Settings(dict[str, Any]):
    """A run's settings; a key that they lack raises a StoreError that names it."""

    def __init__(self, table: Mapping[str, Any], path: Path) -> None:
        super().__init__(table)
        self._path = path

    def __missing__(self, key: str) -> Any:
        raise StoreError(
            f'{self._path}: its settings do not say "{key}", so this cannot be told of it; restore its zarr.json from '
            f"a copy of the run"
        )


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
        for key, kind in _KINDS.items():
            if (value := mark["settings"].get(key)) is not None and not isinstance(value, kind):
                raise ValueError(f"{key} is not what it was written as")
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

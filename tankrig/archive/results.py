"""RESULTS: what refits of an archive found, one small file for each run and each way of fitting it.

In `runs/NAME/` of a folder of results there is one `KEY.json` for each key (`tankrig.archive.key.refit_key`) that the
run was fitted under, there whole or not at all and never written over; `failed.json` where the last try failed; and
`lock`, which whoever fits the run holds. `fitted.jsonl` beside them tells of each fit that came to its end: which run,
under which key, when and by whom.
"""

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tankrig.errors import StoreError
from tankrig.files import require_writable
from tankrig.run import disk

FORMAT = 1
"""Version of a result's keys; new ones may be added, and none changes its meaning."""
FAILED, FITTED, LOCK, RUNS = "failed.json", "fitted.jsonl", "lock", "runs"

Row = dict[str, Any]


@dataclass(frozen=True)
class Results:
    """A folder of results.

    Parameters
    ----------
    folder
        Made when something is put into it.
    """

    folder: Path

    def require_place(self) -> None:
        """Refuse a folder that cannot be written, before any work is done for it.

        Raises
        ------
        StoreError
            When it cannot.
        """
        require_writable(self.folder)

    def has(self, name: str, key: str) -> bool:
        """Whether the run called `name` was fitted under this key."""
        return self._file(name, key).is_file()

    def read(self, name: str, key: str) -> Row:
        """What was found.

        Raises
        ------
        StoreError
            When the file is damaged.
        """
        return _read(self._file(name, key))

    @contextmanager
    def claimed(self, name: str, wait: bool = True) -> Iterator[bool]:
        """Have a run for this process alone; whether it could be had.

        A process that ends, however it does, lets go of it. Over NFS this needs locks, which NFS 4 has.

        Parameters
        ----------
        name
            Of the run.
        wait
            Until another process has done with it.
        """
        folder = self.folder / RUNS / name
        handle = -1
        try:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
                fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
                had = True
            except BlockingIOError:
                had = False
            except OSError as error:
                raise StoreError(
                    f"{folder}: results cannot be put there ({error.strerror or error}); give another folder with --out"
                ) from error
            yield had
        finally:
            if handle >= 0:
                os.close(handle)

    def put(self, name: str, key: str, row: Row) -> bool:
        """Keep what was found under a key; False where it is there already, and then nothing is changed.

        Call it while the run is `claimed`.

        Raises
        ------
        StoreError
            When it cannot be written.
        """
        file = self._file(name, key)
        new = not file.exists()
        with _storing(file):
            if new:
                disk.create(file, _text(row))
                disk.sync_folder(file.parent)
                (file.parent / FAILED).unlink(missing_ok=True)
            with (self.folder / FITTED).open("a", encoding="utf-8") as log:
                log.write(json.dumps({"run": name, "key": key, "utc": row["made"]["utc"], "pid": os.getpid()}) + "\n")
        return new

    def put_failed(self, name: str, row: Row) -> None:
        """Keep why a run could not be fitted, in place of an earlier reason.

        Raises
        ------
        StoreError
            When it cannot be written.
        """
        file = self.folder / RUNS / name / FAILED
        with _storing(file):
            file.parent.mkdir(parents=True, exist_ok=True)
            disk.replace(file, _text(row))

    def rows(self) -> Iterator[Row]:
        """The newest result of each run, and each failure that no later try has mended, by the names of the runs.

        A file that is damaged makes a row with its sentence in `failed`.
        """
        top = self.folder / RUNS
        for place, folders, files in os.walk(top):
            folders.sort()
            if LOCK in files:
                newest = _newest(Path(place), files)
                if newest is not None:
                    yield {**newest, "run": str(Path(place).relative_to(top))}

    def _file(self, name: str, key: str) -> Path:
        return self.folder / RUNS / name / f"{key}.json"


def made_now(**more: Any) -> dict[str, Any]:
    """When and by whom a result is made: what may differ between two that say the same."""
    from importlib.metadata import version
    from platform import node, python_version

    versions = {name: version(name) for name in ("tankrig", "numpy", "scipy", "numba")}
    return {
        "utc": datetime.now(UTC).isoformat(timespec="microseconds"), "host": node(), "pid": os.getpid(),
        "python": python_version(), **versions, **more,
    }  # fmt: skip


def _newest(folder: Path, files: list[str]) -> Row | None:
    rows = []
    for name in files:
        if name.endswith(".json"):
            try:
                rows.append(_read(folder / name))
            except StoreError as error:
                rows.append({"failed": str(error), "made": {"utc": ""}})
    return max(rows, key=lambda row: str(row["made"]["utc"]), default=None)


def _read(file: Path) -> Row:
    damaged = f"{file}: is damaged or no result; delete it, and the run is fitted again"
    try:
        row = json.loads(file.read_bytes())
    except (OSError, ValueError) as error:
        raise StoreError(damaged) from error
    if not isinstance(row, dict) or not isinstance(row.get("made"), Mapping) or "utc" not in row["made"]:
        raise StoreError(damaged)
    if row.get("format", FORMAT) > FORMAT:
        raise StoreError(f"{file}: was made by a later tankrig; update tankrig")
    return row


def _text(row: Row) -> bytes:
    return json.dumps(row, ensure_ascii=False, allow_nan=False, default=_plain).encode() + b"\n"


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} cannot stand in a result")


@contextmanager
def _storing(file: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        with suppress(OSError):
            file.with_name(file.name + ".new").unlink()
        raise StoreError(
            f"{file}: cannot be written ({error.strerror or error}); make room, or give another folder with --out"
        ) from error

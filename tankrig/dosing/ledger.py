"""The ledger of a tank: what was to go in and what went in, outside of any run, from filling to filling."""

import fcntl
import json
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tankrig.devices import Delivered
from tankrig.errors import StoreError

from .records import Joint

FORMAT = 1
_FIRST = b'{"number": 1'


@dataclass(frozen=True)
class OpenDose:
    """A dose that was begun and is not known to have ended: the tank before it, its target, and its run."""

    run: str
    tank: Delivered
    total_ul: float


class TankLedger:
    """An append-only file; an entry is on the disk when the call that makes it returns. One program at a time holds it.

    Parameters
    ----------
    path
        Made, with its folder, if it does not exist.

    Attributes
    ----------
    joint
        Where the doser's count and the tank's were last put together; None in a new ledger.
    tank
        What the tank held when it was last known.
    open_dose
        The dose that was begun last, if it is not known to have ended.

    Raises
    ------
    StoreError
        If it cannot be written, is held by another program, or is no ledger.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.joint: Joint | None = None
        self.tank = Delivered(0.0, 0.0, 0.0)
        self.open_dose: OpenDose | None = None
        self._used_ul: dict[str, float] = {}
        self._number = self._length = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise StoreError(f"{path}: cannot open the tank's ledger ({error.strerror}); give another place") from error
        try:
            self._lock()
            self._read()
        except BaseException:
            os.close(self._fd)
            raise

    def used_ul(self, run: str) -> float:
        """Ink that `run` has put into the tank, at most, µl."""
        return self._used_ul.get(run, 0.0)

    def join(self, joint: Joint) -> None:
        """From now on the doser's count and the tank's go up together."""
        self._append("joint", doser=joint.doser, tank=joint.tank, count=joint.count)

    def begin(self, run: str, total_ul: float) -> None:
        """`run` is about to dose until the tank holds `total_ul`."""
        self._append("intent", run=run, total_ul=total_ul)

    def end(self, tank: Delivered) -> None:
        """The dose is over; the tank holds `tank`."""
        self._append("done", tank=tank)

    def close(self) -> None:
        """Let go of the ledger; may be called again."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _lock(self) -> None:
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StoreError(f"{self.path}: another program doses into this tank; end it first") from error

    def _read(self) -> None:
        lines = self.path.read_bytes().splitlines(keepends=True)
        for number, line in enumerate(lines, start=1):
            try:
                self._take(_entry(line, number))
            except (ValueError, KeyError, TypeError) as error:
                begun = line.rstrip(b"\0")[: len(_FIRST)]
                if not line.endswith(b"\n") and (number > 1 or _FIRST.startswith(begun)):
                    os.ftruncate(self._fd, self._length)  # torn by a power cut: it was never acknowledged
                    break
                what = f"line {number} is no entry of a tank's ledger"
                raise StoreError(f"{self.path}: {what}; restore it from a copy or give another file") from error
            self._number, self._length = number, self._length + len(line)
        if not self._number:
            self._append("tank", format=FORMAT)
            self._sync_folder()

    def _take(self, entry: dict[str, Any]) -> None:
        """Bring what is known up to date with an entry."""
        kind = entry.get("kind")
        if (entry["number"] == 1) != (kind == "tank"):
            raise ValueError(kind)
        if kind == "tank" and entry["format"] != FORMAT:
            raise StoreError(f"{self.path}: was written by a newer version of tankrig; use that version")
        if kind == "intent":
            self.open_dose = OpenDose(entry["run"], self.tank, entry["total_ul"])
            return
        if "tank" in entry:
            tank = Delivered(*entry["tank"])
            if self.open_dose:
                run = self.open_dose.run
                self._used_ul[run] = self.used_ul(run) + max(0.0, tank.high_ul - self.open_dose.tank.low_ul)
                self.open_dose = None
            self.tank = tank
        if kind == "joint":
            self.joint = Joint(entry["doser"], self.tank, Delivered(*entry["count"]))

    def _append(self, kind: str, **fields: Any) -> None:
        entry = {"number": self._number + 1, "kind": kind, "utc": datetime.now(UTC).isoformat(timespec="milliseconds")}
        line = json.dumps(entry | fields, ensure_ascii=False).encode() + b"\n"
        try:
            if os.write(self._fd, line) < len(line):
                raise OSError("disk full")
            os.fsync(self._fd)
        except OSError as error:
            self._cut_back()
            raise StoreError(f"{self.path}: cannot write the tank's ledger ({error}); make room on the disk") from error
        self._number, self._length = self._number + 1, self._length + len(line)
        self._take(json.loads(line))

    def _cut_back(self) -> None:
        try:
            os.ftruncate(self._fd, self._length)
            os.fsync(self._fd)
        except OSError:
            self.close()  # what stands there now is read, and judged, at the next opening

    def _sync_folder(self) -> None:
        folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _entry(line: bytes, number: int) -> dict[str, Any]:
    """A line of the ledger; anything but a whole entry with this number raises."""
    entry = json.loads(line) if line.endswith(b"\n") else None
    if not isinstance(entry, dict) or entry["number"] != number:
        raise ValueError(number)
    return entry

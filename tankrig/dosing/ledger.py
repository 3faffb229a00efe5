"""The ledger of a tank: what was to go in and what went in, outside of any run, from filling to filling."""

import fcntl
import json
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tankrig.bounded_reading import parsed_json, whole_bytes
from tankrig.devices import Delivered
from tankrig.errors import StoreError

from .evidence import Account
from .records import JointCount, NotedCount, device_of

FORMAT = 1
MOST_BYTES = 2**28
"""Of a ledger; a million doses."""
_FIRST = b'{"number": 1'


@dataclass(frozen=True)
class OpenDose:
    """A dose that was begun and is not known to have ended: its run, the tank before it, its target, and the count."""

    run: str
    tank: Delivered
    total_ul: float
    noted: NotedCount | None = None


class TankLedger:
    """An append-only file; an entry is on the disk when the call that makes it returns. One program at a time holds it.

    Parameters
    ----------
    path
        Made, with its folder, if it does not exist. It is locked as the file that it is, whatever links lead to it;
        when its name comes to mean another file nothing more is written, and so nothing moves.

    Attributes
    ----------
    joint
        Where the doser's count and the tank's were last put together; None in a new ledger.
    tank
        What the tank held when it was last known.
    open_dose
        The dose that was begun last, if it is not known to have ended.
    aside_ul
        The most of a movement that does not go into the tank, if one was begun and is not known to have ended.
    filled_utc
        When it was begun; names the filling of the tank.

    Raises
    ------
    StoreError
        If it cannot be written, is held by another program, or is no ledger.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.joint: JointCount | None = None
        self.tank = Delivered(0.0, 0.0, 0.0)
        self.open_dose: OpenDose | None = None
        self.aside_ul: float | None = None
        self.filled_utc = ""
        self._used_ul: dict[str, float] = {}
        self._after_run: dict[str, Delivered] = {}
        self._noted: dict[str, NotedCount] = {}
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

    def after_run(self, run: str) -> Delivered | None:
        """What the tank held after the last dose of `run`, or before one that is open; None if it has had none."""
        return self._after_run.get(run)

    def account(self, doser: str) -> Account:
        """What the ledger knows, for comparing with the count of `doser`."""
        dose, joint = self.open_dose, self.joint
        return Account(
            self.tank,
            self._noted.get(device_of(doser)),
            joint,
            dose.total_ul if dose else None,
            joint.doser if dose and joint else None,
            self.aside_ul,
            self.filled_utc,
        )

    def join(self, joint: JointCount, **why: Any) -> None:
        """From now on the doser's count and the tank's go up together; `why` is written beside it.

        Ends what is open: a dose, or a movement that did not go into the tank.
        """
        self._append("joint", doser=joint.doser, tank=joint.tank, count=joint.count, **why)

    def begin(self, run: str, total_ul: float, count: Delivered | None = None) -> None:
        """`run` is about to dose until the tank holds `total_ul`; the doser has counted `count`, if that is known."""
        self._append("intent", run=run, total_ul=total_ul, **_if_known(count))

    def end(self, tank: Delivered, count: Delivered | None = None) -> None:
        """The dose is over; the tank holds `tank`, and the doser has counted `count`, if that is known."""
        self._append("done", tank=tank, **_if_known(count))

    def begin_aside(self, most_ul: float, why: str) -> None:
        """The doser is about to move by `most_ul` at most, and not into the tank; `join` ends it."""
        self._append("aside", most_ul=most_ul, why=why)

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
        self._require_same_file()

    def _require_same_file(self) -> None:
        """Refuse to write where nobody would read: the file was renamed, replaced or deleted while it was held."""
        try:
            same = os.path.samestat(os.stat(self.path), os.fstat(self._fd))  # noqa: PTH116 - a pair with fstat
        except OSError:
            same = False
        if not same:
            raise StoreError(
                f"{self.path}: the tank's ledger was renamed, replaced or deleted while it was in use; put it back, or "
                "end this program and begin again"
            )

    def _read(self) -> None:
        try:
            lines = whole_bytes(self.path, MOST_BYTES).splitlines(keepends=True)
        except OSError as error:
            raise StoreError(f"{self.path}: the tank's ledger cannot be read ({error.strerror}); mend that") from error
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
        if kind == "tank":
            self.filled_utc = str(entry.get("utc", ""))
        elif kind == "intent":
            self._take_intent(entry)
        elif kind == "aside":
            self.aside_ul = _volume(entry["most_ul"])
        if "tank" in entry:
            self._take_tank(entry)

    def _take_intent(self, entry: dict[str, Any]) -> None:
        run = _text(entry["run"])
        noted = self._note(entry)
        self.open_dose = OpenDose(run, self.tank, _volume(entry["total_ul"]), noted)
        self._after_run[run] = self.tank

    def _take_tank(self, entry: dict[str, Any]) -> None:
        """An entry that says what the tank holds; it ends what was open."""
        tank, dose = _volumes(entry["tank"]), self.open_dose
        self.tank, self.open_dose, self.aside_ul = tank, None, None
        if entry["kind"] == "joint":
            self.joint = JointCount(_text(entry["doser"]), tank, _volumes(entry["count"]))
            if "run_used_ul" in entry:  # by the run's journal, where another ledger counted it
                run = _text(entry["run"])
                self._used_ul[run] = max(self.used_ul(run), _volume(entry["run_used_ul"]))
        noted = self._note(entry)
        if dose is None:
            return
        used_ul = tank.high_ul - dose.tank.low_ul
        if entry["kind"] == "done" and dose.noted and "count" in entry and noted:  # sharper: the tank's doubt is older
            used_ul = noted.count.high_ul - dose.noted.count.low_ul
        self._used_ul[dose.run] = self.used_ul(dose.run) + max(0.0, used_ul)
        self._after_run[dose.run] = tank

    def _note(self, entry: dict[str, Any]) -> NotedCount | None:
        """What the doser has counted by now; entries of earlier versions leave it to be worked out from the joint."""
        joint = self.joint
        if joint is None:
            return None
        if "count" in entry:
            count = _volumes(entry["count"])
        else:
            added_ul = self.tank.volume_ul - joint.tank.volume_ul
            count = Delivered(*(value + added_ul for value in joint.count))
        noted = NotedCount(joint.doser, count)
        self._noted[noted.device] = noted
        return noted

    def _append(self, kind: str, **fields: Any) -> None:
        entry = {"number": self._number + 1, "kind": kind, "utc": datetime.now(UTC).isoformat(timespec="microseconds")}
        text = json.dumps(entry | fields, ensure_ascii=False)
        line = text.encode("utf-8", "backslashreplace") + b"\n"  # a name that is no UTF-8 comes back as it was
        if self._fd >= 0:
            self._require_same_file()
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


def _if_known(count: Delivered | None) -> dict[str, Delivered]:
    return {} if count is None else {"count": count}


def _volume(value: Any) -> float:
    """A number of µl of an entry; anything else raises."""
    if type(value) not in (int, float):
        raise TypeError(value)
    return float(value)


def _volumes(value: Any) -> Delivered:
    volume, low, high = value
    return Delivered(_volume(volume), _volume(low), _volume(high))


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(value)
    return value


def _entry(line: bytes, number: int) -> dict[str, Any]:
    """A line of the ledger; anything but a whole entry with this number raises."""
    entry = parsed_json(line) if line.endswith(b"\n") else None
    if not isinstance(entry, dict) or entry["number"] != number:
        raise ValueError(number)
    return entry

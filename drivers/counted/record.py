"""What a doser remembers between programs: what its pump's counter means, and the dose that was begun last."""

import errno
import fcntl
import json
import os
import uuid
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

from drivers.dosing.pump import Count
from tankrig.bounded_reading import parsed_json, whole_bytes
from tankrig.errors import DeviceError

FORMAT = 1
MOST_BYTES = 2**20


@dataclass(frozen=True)
class Begun:
    """Something that was begun and is not known to have ended.

    Parameters
    ----------
    what, to
        A dose that ends at `to` ticks in all, or a renewal.
    end
        What the counter shows when the leg that was set off is complete; None where an earlier version wrote it.
    on_its_own
        Ticks that the pump delivers after it was last heard, until its watchdog stops it.
    """

    what: Literal["dose", "renewal"]
    to: int
    end: int | None = None
    on_its_own: int = 0


@dataclass(frozen=True)
class Record:
    """Ticks since the doser's zero are `base` + the counter.

    Parameters
    ----------
    pump
        Names this count, as the pump itself has no serial number.
    tick_ul
        Nominal volume of a tick; a count in other ticks means nothing.
    base
        Ticks delivered when the counter stood at 0.
    seen
        The counter when it was last read at rest.
    begun
        What was begun since.
    unsure
        Lowest and highest total, when a person has to say which.
    """

    pump: str
    tick_ul: float
    base: Count
    seen: Count
    begun: Begun | None = None
    unsure: tuple[int, int] | None = None

    @property
    def total(self) -> Count:
        """Ticks delivered when the counter was last read."""
        total = self.base + self.seen
        return total._replace(low=max(0, total.low))


class CountFile:
    """The file of a `Record`; what `write` was given is on the disk when it returns.

    One program at a time has it, by whatever path: the file itself is locked, each new version before it takes the
    place of the old one, so that there is no moment and no name at which somebody else could take it. The end of the
    program, however it comes, lets go of it.

    Parameters
    ----------
    path
        Made if it does not exist: a new count, at 0.
    name
        Of the doser, for messages.
    tick_ul
        Of the pump.

    Raises
    ------
    DeviceError
        If it cannot be read, is no count or one of another syringe, or if another doser uses it.
    """

    def __init__(self, path: Path, name: str, tick_ul: float) -> None:
        self._shown = os.fsencode(path).decode("utf-8", "backslashreplace")  # any path may be told
        self._name, self._fd = name, -1
        try:
            self._path = path.resolve()
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._fd = self._locked()
            if not os.fstat(self._fd).st_size:
                zero = Count.exactly(0)  # whatever the counter shows
                self.write(Record(uuid.uuid4().hex[:8], tick_ul, zero, zero, begun=Begun("renewal", 0)))
            self.record = _record(self._path)
            if self.record.tick_ul != tick_ul:
                raise self._refused(
                    f"was begun with {self.record.tick_ul:g} µl a tick and the settings say {tick_ul:g}; name another "
                    "count_file for another syringe"
                )
        except (OSError, ValueError, KeyError, TypeError) as error:
            self.close()
            what = getattr(error, "strerror", None) or "it is no count of a doser"
            raise self._refused(f"{what}; restore it from a copy or name another") from error
        except BaseException:
            self.close()
            raise

    def _locked(self) -> int:
        """The file, made if it is missing, locked; what another program has replaced meanwhile is opened anew."""
        while True:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(file).st_nlink > 1:
                    raise self._refused("has a second name (a hard link), which would keep an old count; remove one")
                if self._stands(file):
                    return file
            except BlockingIOError as error:
                os.close(file)
                raise self._refused("another doser uses it; end that program, or name another for this pump") from error
            except BaseException:
                os.close(file)
                raise
            os.close(file)

    def _stands(self, file: int) -> bool:
        """Whether the path still names that file."""
        try:
            return os.path.samestat(os.fstat(file), os.stat(self._path))  # noqa: PTH116, beside os.fstat
        except FileNotFoundError:
            return False

    def update(self, **changes: object) -> None:
        """Change some of the record."""
        self.write(replace(self.record, **changes))  # type: ignore[arg-type]

    def write(self, record: Record) -> None:
        """Replace the record.

        Raises
        ------
        DeviceError
            If it cannot be written, or was moved or replaced meanwhile; the file is then as it was.
        """
        if not self._stands(self._fd):
            raise self._refused("was moved or replaced while in use; put it back and open the doser again")
        text = json.dumps({"format": FORMAT, **asdict(record)}).encode()
        unfinished = self._path.with_name(f"{self._path.name}.new")
        new = -1
        try:
            new = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
            fcntl.flock(new, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.write(new, text) < len(text):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(new)
            unfinished.replace(self._path)
            self._fd, new = new, self._fd
            self.record = record
            folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as error:
            raise DeviceError(
                f"{self._name}: cannot write {self._shown} ({error.strerror}); make room for it"
            ) from error
        finally:
            if new >= 0:
                os.close(new)

    def close(self) -> None:
        """Let go of the file."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1

    def _refused(self, why: str) -> DeviceError:
        return DeviceError(f"{self._name}: count_file {self._shown}: {why}")


def _record(path: Path) -> Record:
    values = parsed_json(whole_bytes(path, MOST_BYTES))
    if not isinstance(values, dict) or values["format"] != FORMAT:
        raise ValueError("not of this version")
    if not (isinstance(values["pump"], str) and isinstance(values["tick_ul"], float | int)):
        raise TypeError("pump or tick_ul")
    unsure = values["unsure"]
    return Record(
        values["pump"],
        float(values["tick_ul"]),
        Count(*map(_ticks, values["base"])),
        Count(*map(_ticks, values["seen"])),
        _begun(values["begun"]) if values["begun"] else None,
        (_ticks(unsure[0]), _ticks(unsure[1])) if unsure else None,
    )


def _begun(values: dict[str, Any]) -> Begun:
    if values["what"] not in get_args(Begun.__annotations__["what"]):
        raise ValueError(values["what"])
    end = values.get("end")
    return Begun(
        values["what"],
        _ticks(values["to"]),
        None if end is None else _ticks(end),
        _ticks(values.get("on_its_own", 0)),
    )


def _ticks(value: Any) -> int:
    """A whole number of ticks; anything else raises."""
    if type(value) is not int:
        raise TypeError(value)
    return value

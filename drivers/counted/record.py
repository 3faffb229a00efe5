"""What a doser remembers between programs: what its pump's counter means, and the dose that was begun last."""

import json
import os
import uuid
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from tankrig.errors import DeviceError

from .pump import Count

FORMAT = 1


@dataclass(frozen=True)
class Begun:
    """Something that was begun and is not known to have ended: a dose that ends at `to` ticks in all, or a renewal."""

    what: Literal["dose", "renewal"]
    to: int


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

    Parameters
    ----------
    path
        Made if it does not exist: a new count, at 0.
    name
        Of the doser, for messages.
    tick_ul
        Of the pump.
    """

    def __init__(self, path: Path, name: str, tick_ul: float) -> None:
        self._path, self._name = path, name
        try:
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                zero = Count.exactly(0)  # whatever the counter shows
                self.write(Record(uuid.uuid4().hex[:8], tick_ul, zero, zero, begun=Begun("renewal", 0)))
            self.record = _record(path)
        except (OSError, ValueError, KeyError, TypeError) as error:
            what = getattr(error, "strerror", None) or "it is no count of a doser"
            raise DeviceError(f"{name}: count_file {path}: {what}; restore it from a copy or name another") from error
        if self.record.tick_ul != tick_ul:
            raise DeviceError(
                f"{name}: count_file {path}: was begun with {self.record.tick_ul:g} µl a tick and the settings say "
                f"{tick_ul:g}; name another count_file for another syringe"
            )

    def update(self, **changes: object) -> None:
        """Change some of the record."""
        self.write(replace(self.record, **changes))  # type: ignore[arg-type]

    def write(self, record: Record) -> None:
        """Replace the record."""
        unfinished = self._path.with_name(f"{self._path.name}.new")
        try:
            with unfinished.open("w", encoding="utf-8") as file:
                json.dump({"format": FORMAT, **asdict(record)}, file)
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(self._path)
            folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as error:
            raise DeviceError(
                f"{self._name}: cannot write {self._path} ({error.strerror}); make room for it"
            ) from error
        self.record = record


def _record(path: Path) -> Record:
    values = json.loads(path.read_text(encoding="utf-8"))
    if values.pop("format") != FORMAT:
        raise ValueError("written by another version")
    begun, unsure = values.pop("begun"), values.pop("unsure")
    return Record(
        values["pump"],
        values["tick_ul"],
        Count(*values["base"]),
        Count(*values["seen"]),
        Begun(**begun) if begun else None,
        (unsure[0], unsure[1]) if unsure else None,
    )

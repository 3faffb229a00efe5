"""A line about each run in a folder, cheap enough for hundreds of them."""

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.run.journal import Event
from tankrig.run.journal_io import JOURNAL, read_settings
from tankrig.run.notes import PERSON, person_note

_NOTE, _FIT, _FRAME, _DOSE = (f'"kind":"{kind}"'.encode() for kind in ("note", "fit", "frame", "dose_done"))
_BY_PERSON = f'"by":"{PERSON}"'.encode()
_HEAD = 60
"""Letters of a line within which it says its kind."""


@dataclass(frozen=True)
class RunSummary:
    """What a list of runs says.

    Parameters
    ----------
    path
        Of its folder.
    name, rig
        Of the sequence and of the rig.
    began
        UTC, as text.
    ending
        "completed", "aborted", "failed", or "interrupted" where the journal has no end.
    message
        Why, where something went wrong.
    doses, frames
        How many were recorded.
    note
        What a person has noted of it last.
    """

    path: Path
    name: str
    rig: str
    began: str
    ending: str
    message: str
    doses: int = 0
    frames: int = 0
    note: str = ""

    @property
    def began_local(self) -> str:
        """When it began, by the clock on the wall."""
        try:
            began = datetime.fromisoformat(self.began).replace(tzinfo=UTC)
        except ValueError:
            return self.began
        return f"{began.astimezone():%Y-%m-%d %H:%M}"

    @property
    def searched(self) -> str:
        """What a filter looks in."""
        return f"{self.path.name} {self.name} {self.began_local} {self.ending} {self.note}".lower()

    @property
    def resumable(self) -> bool:
        """Whether it can go on."""
        return self.ending != "completed"


def summaries(folder: Path) -> tuple[RunSummary, ...]:
    """The runs in a folder, newest first."""
    found = []
    for mark in folder.glob("*/zarr.json") if folder.is_dir() else ():
        try:
            found.append(_summary(mark.parent))
        except (StoreError, OSError, ValueError):
            continue  # some other Zarr group
    return tuple(sorted(found, key=lambda one: (one.began, one.path.name), reverse=True))


def _summary(path: Path) -> RunSummary:
    settings, journal = read_settings(path), path / JOURNAL
    stamp = journal.stat()
    first, last, doses, frames, note = _told(journal, stamp.st_size, stamp.st_mtime_ns)
    began = first.moment.utc[:19].replace("T", " ") if first else ""
    ended = last is not None and last.kind == "end"
    ending, message = (str(last["reason"]), str(last.get("message", ""))) if ended and last else ("interrupted", "")
    name, rig = str(settings.get("name", path.name)), str(settings.get("rig", ""))
    return RunSummary(path, name, rig, began, ending, message, doses, frames, note)


@lru_cache(2048)
def _told(journal: Path, _size: int, _changed_ns: int) -> tuple[Event | None, Event | None, int, int, str]:
    """The first whole line of a journal, the last that is no note and no fit, doses, frames, and a person's note.

    Lines are counted by what they say of their kind; only the few that are needed are parsed. By size and time
    of its last change a journal that has changed is read anew.
    """
    lines = journal.read_bytes().splitlines(keepends=True)
    of_person = (event for line in lines if _NOTE in line and _BY_PERSON in line and (event := _event(line)))
    return (
        _event(lines[0]) if lines else None,
        next((event for line in reversed(lines) if not _beside(line) and (event := _event(line))), None),
        sum(_DOSE in line for line in lines),
        sum(_FRAME in line for line in lines),
        person_note(of_person),
    )


def _beside(line: bytes) -> bool:
    """Whether a line may stand after a run's end."""
    return _NOTE in line[:_HEAD] or _FIT in line[:_HEAD]


def _event(line: bytes) -> Event | None:
    try:
        return Event.parse(line) if line.endswith(b"\n") else None
    except ValueError:
        return None

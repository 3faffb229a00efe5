"""A line about each run in a folder, cheap enough for hundreds of them."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.run.journal import Event
from tankrig.run.journal_io import JOURNAL, read_settings

TAIL_BYTES = 4096


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
    """

    path: Path
    name: str
    rig: str
    began: str
    ending: str
    message: str

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
        return f"{self.path.name} {self.name} {self.began_local} {self.ending}".lower()

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
    settings = read_settings(path)
    first, last = _ends(path / JOURNAL)
    began = first.moment.utc[:19].replace("T", " ") if first else ""
    ended = last is not None and last.kind == "end"
    ending, message = (str(last["reason"]), str(last.get("message", ""))) if ended and last else ("interrupted", "")
    return RunSummary(path, str(settings.get("name", path.name)), str(settings.get("rig", "")), began, ending, message)


def _ends(journal: Path) -> tuple[Event | None, Event | None]:
    """The first whole line of a journal and the last that is no note and no fit, whatever lies between."""
    with journal.open("rb") as file:
        first = file.readline()
        file.seek(max(0, journal.stat().st_size - TAIL_BYTES))
        tail = file.read().splitlines(keepends=True)
    events = (event for line in reversed(tail) if (event := _event(line)))
    return _event(first), next((event for event in events if event.kind not in ("note", "fit")), None)


def _event(line: bytes) -> Event | None:
    try:
        return Event.parse(line) if line.endswith(b"\n") else None
    except (ValueError, json.JSONDecodeError):
        return None

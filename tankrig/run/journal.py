"""The journal: one JSON line per event, in the order in which things happened. It defines what a run holds."""

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

Kind = Literal["session", "step", "dose_intent", "dose_done", "frame", "gap", "fit", "note", "end"]

KINDS: tuple[str, ...] = get_args(Kind)

_OWN_KEYS = ("seq", "kind", "utc", "mono_ns", "boot")


@cache
def boot_id() -> str:
    """Names this boot of the machine: monotonic times compare only between events of one boot."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return "unknown"


@dataclass(frozen=True)
class Moment:
    """When something happened, by both clocks."""

    utc: str
    mono_ns: int
    boot: str

    @classmethod
    def now(cls) -> "Moment":
        """This moment."""
        return cls(datetime.now(UTC).isoformat(timespec="microseconds"), time.monotonic_ns(), boot_id())


@dataclass(frozen=True)
class Event:
    """One line of the journal.

    Parameters
    ----------
    seq
        Counts the journal's lines from 0, over all sessions of the run.
    kind
        One of `KINDS`.
    moment
        When it happened.
    fields
        What happened; keys as they stand in the line.

    Examples
    --------
    >>> event = Event(7, "note", Moment("2026-11-20T10:00:00.000000+00:00", 12, "b"), {"text": "stirred"})
    >>> event["text"], Event.parse(event.line()) == event
    ('stirred', True)
    """

    seq: int
    kind: str
    moment: Moment
    fields: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:
        return self.fields[key]

    def get(self, key: str, default: Any = None) -> Any:
        """The value of `key`, or `default` where the event has none."""
        return self.fields.get(key, default)

    def line(self) -> bytes:
        """The line that stands for the event, newline included.

        Raises
        ------
        TypeError, ValueError
            When a field is nothing that JSON can say; infinity and NaN are not (None is).
        """
        moment = self.moment
        head = {"seq": self.seq, "kind": self.kind, "utc": moment.utc, "mono_ns": moment.mono_ns, "boot": moment.boot}
        table = head | dict(self.fields)
        text = json.dumps(table, ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=_plain)
        return text.encode("utf-8", "backslashreplace") + b"\n"  # a path that is no UTF-8 comes back as it was

    @classmethod
    def parse(cls, line: bytes) -> "Event":
        """Read a line back.

        Raises
        ------
        ValueError
            When it is not a whole event.
        """
        table = json.loads(line)
        if not isinstance(table, dict) or any(key not in table for key in _OWN_KEYS) or table["kind"] not in KINDS:
            raise ValueError("not an event")
        seq, kind, *moment = (table.pop(key) for key in _OWN_KEYS)
        return cls(seq, kind, Moment(*moment), table)


def _plain(value: Any) -> Any:
    """A NumPy number or array as JSON knows it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} cannot stand in a journal")


def whole_lines(data: bytes) -> Iterator[tuple[Event, int]]:
    """Events of a journal's bytes and the offset behind each, up to the first line that is not whole.

    A power cut can leave a torn line, or pages of zeros, behind what had been acknowledged; nothing that follows the
    first such line was acknowledged either.
    """
    end = 0
    for seq, line in enumerate(data.splitlines(keepends=True)):
        try:
            event = Event.parse(line) if line.endswith(b"\n") else None
        except ValueError:
            event = None
        if event is None or event.seq != seq:
            return
        end += len(line)
        yield event, end

"""The journal: one JSON line per event, in the order in which things happened. It defines what a run holds.

Each line ends in a checksum of itself: its last key is `crc32c`, the CRC-32C (RFC 3720; that of Zarr's codec) of all
bytes of the line before `,"crc32c"`, as eight hexadecimal digits. Lines of runs from before that have none.
"""

import json
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

import google_crc32c

from tankrig.bounded_reading import parsed_json

Kind = Literal["session", "step", "dose_intent", "dose_done", "frame", "gap", "fit", "note", "end"]

KINDS: tuple[str, ...] = get_args(Kind)

_OWN_KEYS = ("seq", "kind", "utc", "mono_ns", "boot")

_NEEDED: dict[str, dict[str, Any]] = {
    "session": {"devices": dict},
    "frame": {"index": int, "step": int, "pattern_hash": str, "exposure_start_ns": int, "sha256": str},
    "dose_intent": {"total_ul": int | float},
    "dose_done": {"delivered_ul": int | float, "delivered_low_ul": int | float, "delivered_high_ul": int | float},
    "step": {"step": int, "state": str},
    "gap": {"missing": int},
    "end": {"reason": str},
}
"""What every line of a kind has always had; where there is no checksum, a line without it is damaged."""

_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,9})?\+00:00")

_SEAL = b',"crc32c":"%08x"}'
_SEAL_BYTES = len(_SEAL % 0)
_REMNANT = 9
"""So many of the 13 bytes that are the same in every seal show that a line had one, whatever became of the others."""


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
        if "crc32c" in self.fields:
            raise ValueError("crc32c is the line's own key; give the field another name")
        table = head | dict(self.fields)
        text = json.dumps(table, ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=_plain)
        return sealed(text.encode("utf-8", "backslashreplace")) + b"\n"  # a path that is no UTF-8 comes back as it was

    @classmethod
    def parse(cls, line: bytes) -> "Event":
        """Read a line back, with or without its newline; a checksum that it has must be right.

        Raises
        ------
        ValueError
            When it is not a whole event.
        """
        line = line.removesuffix(b"\n")
        verified = is_sealed(line)
        if not verified and _had_a_seal(line):
            raise ValueError("its checksum is damaged")
        table = parsed_json(line)
        if not isinstance(table, dict) or any(key not in table for key in _OWN_KEYS) or table["kind"] not in KINDS:
            raise ValueError("not an event")
        table.pop("crc32c", None)
        seq, kind, *moment = (table.pop(key) for key in _OWN_KEYS)
        whole = type(seq) is int and seq >= 0 and [type(one) for one in moment] == [str, int, str]
        if not verified and not (whole and _is_time(moment[0]) and _says_what_it_should(kind, table)):
            raise ValueError("not an event")
        return cls(seq, kind, Moment(*moment), table)


def _is_time(utc: str) -> bool:
    """Whether a text is a time as journals have always had it."""
    try:
        return _TIME.fullmatch(utc) is not None and datetime.fromisoformat(utc).tzinfo is not None
    except ValueError:
        return False


def _says_what_it_should(kind: str, fields: Mapping[str, Any]) -> bool:
    return all(isinstance(fields.get(key), kinds) for key, kinds in _NEEDED.get(kind, {}).items())


def sealed(line: bytes) -> bytes:
    """A line, a JSON object without its newline, with its checksum as its last key."""
    head = line[:-1]
    seal: bytes = _SEAL % google_crc32c.value(head)
    return head + seal


def is_sealed(line: bytes) -> bool:
    """Whether a line, without its newline, carries its right checksum.

    Examples
    --------
    >>> line = sealed(b'{"seq":0}')
    >>> line, is_sealed(line), is_sealed(line.replace(b"0", b"1", 1))
    (b'{"seq":0,"crc32c":"cce4a5f8"}', True, False)
    """
    return line.endswith(_SEAL % google_crc32c.value(line[:-_SEAL_BYTES]))


def _had_a_seal(line: bytes) -> bool:
    end, pattern = line[-_SEAL_BYTES:], _SEAL % 0
    fixed = [i for i in range(_SEAL_BYTES) if not 11 <= i < 19]
    return len(end) == _SEAL_BYTES and sum(end[i] == pattern[i] for i in fixed) >= _REMNANT


def _plain(value: Any) -> Any:
    """A NumPy number or array as JSON knows it."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r} cannot stand in a journal")

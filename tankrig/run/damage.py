"""Reading a journal whose bytes may have been damaged: each line stands alone, and what is lost is named.

A line that carries its right checksum counts, whatever stands around it. In runs from before checksums a line counts
when it is whole JSON with the keys of an event, and its `seq` fits those around it; such lines are *unverified*.
"""

import re
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import NamedTuple

from tankrig.run.journal import KINDS, Event, is_sealed

_DOSE_KINDS = ("session", "dose_intent", "dose_done")
_PLACED_KINDS = ("frame", "gap", "step", "end", *_DOSE_KINDS)
"""Kinds that tell where in the sequence a line stands; fits and notes come at any time."""

_SHORTEST_LINE = 96
"""Bytes; a damaged stretch cannot have held more lines than fit into it."""

_BEGINNING = b'{"seq":'
_HEAD = re.compile(rb'"seq":(\d{1,18}),"kind":"([^"]{3,11})"')
_END = re.compile(rb',"crc32c":"[0-9a-f]{8}"\}')
_FRAME_KEYS = (b'"pattern_hash":', b'"sha256":')


@dataclass(frozen=True)
class Lost:
    """A place of a journal where lines are damaged, or missing.

    Parameters
    ----------
    line, lines
        Number of the first damaged line in the file, from 1, and how many there are; 0 where lines are missing and
        nothing is left of them.
    offset, size
        The damaged bytes: where they begin in the file, and how many.
    seqs
        First and last `seq` of the events that are lost; None where a damaged newline or a repeated line lost none.
    frames
        Numbers of the frames among them, as far as the lines around tell.
    kinds
        Their kinds, where the damaged text still tells each.
    after_seq
        `seq` of the last whole event before, or -1.
    may_be_dose
        Whether one of them may have said something about a dose.
    """

    line: int
    lines: int
    offset: int
    size: int
    seqs: tuple[int, int] | None
    frames: tuple[int, ...]
    kinds: tuple[str, ...]
    after_seq: int
    may_be_dose: bool

    def __str__(self) -> str:
        """What is lost, as one sentence without its full stop.

        Examples
        --------
        >>> print(Lost(5, 1, 1200, 430, (4, 4), (3,), ("frame",), 3, False))
        line 5 of the journal (430 bytes from byte 1200 on) is damaged: event 4 (frame 3) is lost
        """
        where = f"of the journal ({self.size} bytes from byte {self.offset} on)"
        if not self.lines:
            what = f"before line {self.line} of the journal (byte {self.offset}) lines are missing"
        elif self.lines == 1:
            what = f"line {self.line} {where} is damaged"
        else:
            what = f"lines {self.line} to {self.line + self.lines - 1} {where} are damaged"
        if self.seqs is None:
            return f"{what}: no event is lost"
        first, last = self.seqs
        named = f"event {first}" if first == last else f"events {first} to {last}"
        known = f" (frame{'s' * (len(self.frames) > 1)} {', '.join(map(str, self.frames))})" if self.frames else ""
        if not known and self.kinds:
            known = f" ({', '.join(self.kinds)})"
        dose = ", which may have been about a dose" if self.may_be_dose else ""
        return f"{what}: {named}{known} {'is' if first == last else 'are'} lost{dose}"


@dataclass(frozen=True)
class JournalText:
    """What a journal's bytes hold.

    Parameters
    ----------
    events
        Those that count, in their order.
    unverified
        How many of them have no checksum.
    lost
        Damage, in its order.
    good
        Bytes without a torn end, which no acknowledged line can have left.
    size
        All bytes.
    ended
        Whether a newline ends the good bytes, so that a line may be added.
    next_seq
        A number that no line has had.
    """

    events: tuple[Event, ...]
    unverified: int
    lost: tuple[Lost, ...]
    good: int
    size: int
    ended: bool
    next_seq: int


class _Piece(NamedTuple):
    """A stretch of bytes within one line of the file: a whole event, or not."""

    line: int
    offset: int
    data: bytes
    event: Event | None = None
    sealed: bool = False
    repeats: bool = False

    @property
    def counts(self) -> bool:
        """Whether it may be what is left of a lost line; a lone byte is a damaged newline."""
        return self.event is None and not self.repeats and len(self.data) > 1


def read_lines(data: bytes, checked: bool) -> JournalText:
    """Read all that is whole in a journal's bytes.

    Parameters
    ----------
    data
        The file.
    checked
        Whether all its lines were written with checksums; one without is damaged then.
    """
    good = len(data) - _torn_bytes(data)
    pieces = _in_order(list(_pieces(data[:good], checked)))
    whole = [piece for piece in pieces if piece.event is not None]
    events = tuple(piece.event for piece in whole if piece.event is not None)
    lost, possible = _named(pieces)
    highest = max((event.seq for event in events), default=-1)
    return JournalText(
        events,
        sum(not piece.sealed for piece in whole),
        tuple(lost),
        good,
        len(data),
        good == 0 or data[good - 1 : good] == b"\n",
        highest + possible + 1,
    )


def _torn_bytes(data: bytes) -> int:
    """Bytes at the end that cannot be an acknowledged line: they have neither a newline nor a line's end."""
    end = data[data.rfind(b"\n") + 1 :]
    whole = any(piece.event is not None for piece in _split(end, 0, 0, checked=False))
    return 0 if whole or b"}" in end[-2:] else len(end)


def _pieces(data: bytes, checked: bool) -> Iterator[_Piece]:
    offset, lines = 0, data.split(b"\n")
    if not lines[-1]:
        lines.pop()
    for number, line in enumerate(lines, 1):
        yield from _split(line, number, offset, checked)
        offset += len(line) + 1


def _split(line: bytes, number: int, offset: int, checked: bool) -> Iterator[_Piece]:
    """The events in one line of the file; there are several where a newline between them is damaged."""
    if one := _event(line, checked):
        yield _Piece(number, offset, line, one, is_sealed(line))
        return
    starts = [match.start() for match in re.finditer(re.escape(_BEGINNING), line)]
    for start, end in pairwise(sorted({0, *starts, len(line)})) if line else [(0, 0)]:
        part = line[start:end]
        ends = [match.end() for match in _END.finditer(part)]
        bodies = [part[:end] for end in [*ends, part.rfind(b"}") + 1]]
        body = next((body for body in bodies if _event(body, checked)), b"")
        if one := _event(body, checked):
            yield _Piece(number, offset + start, body, one, is_sealed(body))
            part, start = part[len(body) :], start + len(body)
            if not part:
                continue
        yield _Piece(number, offset + start, part)


def _event(line: bytes, checked: bool) -> Event | None:
    if checked and not is_sealed(line):
        return None
    try:
        return Event.parse(line)
    except (ValueError, TypeError, RecursionError):
        return None


def _in_order(pieces: list[_Piece]) -> list[_Piece]:
    """Take the events of lines that repeat another, or whose number cannot be true, for damaged."""
    whole = [piece for piece in pieces if piece.event is not None]
    if all(one.event.seq < two.event.seq for one, two in pairwise(whole) if one.event and two.event):
        return pieces
    seen: dict[int, _Piece] = {}
    refused: dict[int, bool] = {}
    for piece in whole:
        assert piece.event is not None
        seq = piece.event.seq
        before = seen.setdefault(seq, piece)
        if before is piece or (piece.sealed and before.sealed and piece.data != before.data):
            continue
        better = (piece.sealed, -abs(piece.line - 1 - seq)) > (before.sealed, -abs(before.line - 1 - seq))
        refused[id(before if better else piece)] = piece.data == before.data
        seen[seq] = piece if better else before
    left = [piece for piece in whole if id(piece) not in refused]
    rising = _longest_rising([piece.event.seq for piece in left if piece.event])
    refused |= {id(piece): False for i, piece in enumerate(left) if i not in rising and not piece.sealed}
    return [
        piece._replace(event=None, repeats=refused[id(piece)]) if id(piece) in refused else piece for piece in pieces
    ]


def _longest_rising(values: Sequence[int]) -> set[int]:
    """Positions of a longest strictly rising subsequence.

    Examples
    --------
    >>> sorted(_longest_rising([0, 1, 2, 7, 4, 5, 6]))
    [0, 1, 2, 4, 5, 6]
    """
    tails: list[int] = []
    ends: list[int] = []
    before: list[int] = []
    for i, value in enumerate(values):
        place = bisect_left(tails, value)
        before.append(ends[place - 1] if place else -1)
        tails[place : place + 1] = [value]
        ends[place : place + 1] = [i]
    chosen, at = set[int](), ends[-1] if ends else -1
    while at >= 0:
        chosen.add(at)
        at = before[at]
    return chosen


def _named(pieces: Iterable[_Piece]) -> tuple[list[Lost], int]:
    """Each place where something is lost, and how many lines may have followed the last whole event."""
    places: list[tuple[list[_Piece], Event | None, Event | None]] = []
    damaged: list[_Piece] = []
    before: Event | None = None
    events: list[Event] = []
    for piece in pieces:
        if piece.event is None:
            damaged.append(piece)
            continue
        gap = piece.event.seq - (before.seq if before else -1) - 1
        if damaged or gap > 0:
            places.append((damaged or [_Piece(piece.line, piece.offset, b"")], before, piece.event))
        events.append(piece.event)
        before, damaged = piece.event, []
    if damaged:
        places.append((damaged, before, None))
    found = [_lost(*place, events) for place in places]
    likely = [sum(any(key in piece.data for key in _FRAME_KEYS) for piece in place[0]) for place in places]
    return _with_frames(found, likely, events), sum(_most_lines(piece) for piece in damaged)


def _most_lines(piece: _Piece) -> int:
    if not piece.counts:
        return 0
    return 1 if _told(piece) else max(1, len(piece.data) // _SHORTEST_LINE)


def _lost(damaged: list[_Piece], before: Event | None, after: Event | None, events: list[Event]) -> Lost:
    first = damaged[0]
    last_seq = before.seq if before else -1
    left = [piece for piece in damaged if piece.counts]
    told = [_told(piece) for piece in left]
    count = _lines_lost(left, last_seq, after)
    numbered = [(last_seq + 1 + i, one[1]) for i, one in enumerate(told) if one]
    kinds = tuple(kind for _, kind in numbered) if told == numbered and len(told) == count else ()
    missing = not any(piece.data for piece in damaged) and count > 0
    return Lost(
        line=first.line,
        lines=0 if missing else damaged[-1].line - first.line + 1,
        offset=first.offset,
        size=damaged[-1].offset + len(damaged[-1].data) - first.offset,
        seqs=(last_seq + 1, last_seq + count) if count else None,
        frames=(),
        kinds=kinds,
        after_seq=last_seq,
        may_be_dose=count > 0 and _may_be_dose(kinds, count, last_seq, after, events),
    )


def _lines_lost(left: list[_Piece], last_seq: int, after: Event | None) -> int:
    """How many, where a whole line follows; else how many at least."""
    if after is not None:
        return max(0, after.seq - last_seq - 1)
    return len(left) if all(_told(piece) for piece in left) else 1


def _told(piece: _Piece) -> tuple[int, str] | None:
    """Number and kind of a damaged line, where its text still tells them, the kind but for one byte."""
    words = _HEAD.findall(piece.data)
    if len(words) != 1:
        return None
    number, word = int(words[0][0]), words[0][1]
    alike = [kind for kind in KINDS if len(kind) == len(word)]
    kinds = [kind for kind in alike if sum(a != b for a, b in zip(kind.encode(), word, strict=True)) < 2]
    return (number, kinds[0]) if kinds else None


def _may_be_dose(kinds: tuple[str, ...], count: int, last_seq: int, after: Event | None, events: list[Event]) -> bool:
    """Between two lines of one step in which frames were taken nothing is dosed; elsewhere it may have been."""
    if len(kinds) == count:
        return any(kind in _DOSE_KINDS for kind in kinds)
    if after is None:
        return True
    one = next((e for e in reversed(events) if e.seq <= last_seq and e.kind in _PLACED_KINDS), None)
    two = next((e for e in events if e.seq >= after.seq and e.kind in _PLACED_KINDS), None)
    if one is None or two is None or not {one.kind, two.kind} & {"frame", "gap"}:
        return True
    return one.get("step") is None or one.get("step") != two.get("step")


def _with_frames(found: list[Lost], likely: list[int], events: list[Event]) -> list[Lost]:
    """Number the frames that are lost, by those that are not and by what the damaged text still tells."""
    frames = [(event.seq, int(event["index"])) for event in events if event.kind == "frame"]
    named: list[Lost] = []
    for (before, after), group in groupby(zip(found, likely, strict=True), key=lambda one: _between(one[0], frames)):
        places = list(group)
        told = sum(lost.kinds.count("frame") for lost, _ in places)
        untold = None if after is None else max(0, after - before - 1 - told)
        index = before + 1
        for lost, looks in places:
            count = lost.kinds.count("frame")
            if lost.seqs and not lost.kinds:
                count = min(looks if untold is None else untold, lost.seqs[1] - lost.seqs[0] + 1)
                untold = None if untold is None else untold - count
            named.append(replace(lost, frames=tuple(range(index, index + count))))
            index += count
    return named


def _between(lost: Lost, frames: list[tuple[int, int]]) -> tuple[int, int | None]:
    """Numbers of the whole frames before and after."""
    before = max((index for seq, index in frames if seq <= lost.after_seq), default=-1)
    return before, next((index for seq, index in frames if seq > lost.after_seq), None)

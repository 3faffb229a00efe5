"""What the DLPC350 does with its commands: power, modes, source, patterns, triggers; no USB in here."""

import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

STOPPED, PAUSED, RUNNING = 0, 1, 2
VIDEO_PORT, FLASH = 0, 3
VSYNC, TRIGGERED = 0, 1
INTERNAL, RISING, FALLING, CONTINUES = range(4)
SHORTEST_US = {1: 235, 2: 700, 3: 1570, 4: 1700, 5: 2000, 6: 2500, 7: 4500, 8: 8333}
DARK_US = 230
BUSY = 0x80
EXPOSURE, NUMBERS, TRIGGER_OUT, POST_VECTOR, SHORT_GAP = 1, 2, 4, 8, 16


class RefusedError(Exception):
    """The controller refuses a command: its reply has the NACK bit."""


@dataclass(frozen=True)
class Entry:
    """One line of the pattern table, as its three bytes say."""

    trigger: int
    number: int
    bits: int
    leds: int
    inverted: bool
    black: bool
    swap: bool
    shares_trigger: bool

    @classmethod
    def of(cls, word: int) -> "Entry":
        """Take a line apart."""
        flags = [bool(word >> bit & 1) for bit in (16, 17, 18, 19)]
        return cls(word & 3, word >> 2 & 0x3F, word >> 8 & 0xF, word >> 12 & 7, *flags)


@dataclass(frozen=True)
class Shown:
    """A pattern that was really on the mirrors: its line of the table, and when, s."""

    line: int
    entry: Entry
    from_s: float
    until_s: float


@dataclass(frozen=True)
class Habits:
    """Times of the controller, and what it does at its worst.

    Parameters
    ----------
    wake_s, mode_s, validate_s, lock_s
        How long it takes to wake from standby, to change its mode, to validate, and to lock to the video input.
    lost_starts
        How many starts after a change from video to pattern mode are acknowledged and have no effect.
    in_standby
        Whether it is in standby at first.
    frame_s
        Period of the video input; None: no video.
    """

    wake_s: float = 2.0
    mode_s: float = 0.1
    validate_s: float = 0.3
    lock_s: float = 0.3
    lost_starts: int = 1
    in_standby: bool = False
    frame_s: float | None = 1 / 60


class Controller:
    """The controller from power-up on; times are those of the caller's clock, s.

    Parameters
    ----------
    habits
        Its times.
    on_trigger_out
        Called for each pattern with the number of the output (1: every pattern, 2: a sequence's first) and the time.
    """

    def __init__(
        self, habits: Habits | None = None, on_trigger_out: Callable[[int, float], None] = lambda *_: None
    ) -> None:
        self.habits, self._on_trigger_out = habits or Habits(), on_trigger_out
        self.shown: deque[Shown] = deque(maxlen=100_000)
        self.missed_triggers = 0
        self.frame_s = self.habits.frame_s
        self._standby, self._awake_s = self.habits.in_standby, 0.0
        self._pattern_mode, self._mode_wanted, self._mode_due_s = False, False, 0.0
        self._source, self._source_since_s = 1, 0.0
        self._pattern_source, self._trigger_mode = VIDEO_PORT, VSYNC
        self._exposure_us = self._period_us = 16667
        self._configured = (0, 1, 0, 0)
        self._mailbox, self._address = 0, 0
        self._tables = {1: bytearray(64), 2: bytearray(128 * 3)}
        self._validated: int | None = None
        self._validation, self._validation_due_s = 0, 0.0
        self._state, self._starts_left = STOPPED, 0
        self._line, self._next_s, self._aborted = 0, 0.0, False

    # -- what happens by itself ----------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Let modes, validation and patterns go on until `now_s`."""
        if self._pattern_mode != self._mode_wanted and now_s >= self._mode_due_s:
            self._pattern_mode = self._mode_wanted
            self._starts_left = self.habits.lost_starts if self._pattern_mode else 0
            self._aborted = self._pattern_mode and self._from_video and not self.locked(self._mode_due_s)
        if self._validation & BUSY and now_s >= self._validation_due_s:
            self._validation = self._validated = self._complaints()
        while self.displaying and not self._waits_for_trigger and self._next_s <= now_s:
            self._show(self._next_s)

    @property
    def _from_video(self) -> bool:
        return self._pattern_source == VIDEO_PORT

    def locked(self, now_s: float) -> bool:
        """Whether it is locked to its video input."""
        wired = self.frame_s is not None and self._source & 7 in (0, 3)
        return wired and now_s >= self._source_since_s + self.habits.lock_s

    @property
    def displaying(self) -> bool:
        """Whether patterns really come, which a running state alone does not say."""
        return self._state == RUNNING and self._pattern_mode and not self._aborted

    @property
    def _lines(self) -> list[Entry]:
        table, count = self._tables[2], self._configured[0] + 1
        return [Entry.of(int.from_bytes(table[3 * i : 3 * i + 3], "little")) for i in range(count)]

    @property
    def _waits_for_trigger(self) -> bool:
        return self._trigger_mode == TRIGGERED and self._lines[self._line].trigger in (RISING, FALLING)

    def _show(self, at_s: float) -> None:
        """The next pattern, from `at_s`."""
        lines = self._lines
        entry = lines[self._line]
        if self._line == 0:
            self._on_trigger_out(2, at_s)
        if not entry.shares_trigger:
            self._on_trigger_out(1, at_s)
        self.shown.append(Shown(self._line, entry, at_s, at_s + self._exposure_us * 1e-6))
        self._next_s = at_s + self._period_us * 1e-6
        self._line += 1
        if self._line == len(lines):
            self._line = 0
            if self._trigger_mode == VSYNC and self.frame_s:
                first_s = at_s - (len(lines) - 1) * self._period_us * 1e-6
                self._next_s = max(self._next_s, first_s + self.frame_s)
            if not self._configured[1]:
                self._state = STOPPED

    def trigger_in(self, at_s: float, *, rising: bool = True) -> bool:
        """An edge at the trigger input; whether a pattern came of it. Edges during a pattern are missed."""
        self.advance(at_s)
        if not (self.displaying and self._waits_for_trigger):
            return False
        if self._lines[self._line].trigger != (RISING if rising else FALLING):
            return False
        if at_s < self._next_s - 1e-9:
            self.missed_triggers += 1
            return False
        self._show(at_s)
        while self.displaying and self._lines[self._line].trigger == CONTINUES:
            self._show(self._next_s)
        return True

    def _complaints(self) -> int:
        """What validating says: bits 0 and 1 are errors, 2 to 4 warnings."""
        lines, exposure, period = self._lines, self._exposure_us, self._period_us
        found = 0
        groups = [1 + sum(1 for _ in group) for shares, group in itertools.groupby(lines, _shares) if shares] or [1]
        shortest = max((SHORTEST_US.get(line.bits, 0) for line in lines), default=0)
        frame_us = 1e6 * self.frame_s if self.frame_s else 0.0
        too_long = self._trigger_mode == VSYNC and len(lines) * period > frame_us + 1.0
        if exposure > period or exposure < shortest * max(groups) or too_long:
            found |= EXPOSURE
        if any(not _number_exists(line) for line in lines):
            found |= NUMBERS
        if any(line.shares_trigger and (line.black or before.black) for before, line in _pairs(lines)):
            found |= TRIGGER_OUT
        if any(line.trigger in (RISING, FALLING) and not before.black for before, line in _pairs(lines)):
            found |= POST_VECTOR
        if 0 < period - exposure < DARK_US:
            found |= SHORT_GAP
        return found

    # -- commands ------------------------------------------------------------------------------------------------------

    def deaf(self, command: int, now_s: float) -> bool:
        """Whether it does not even reply to this: in standby and while it wakes it knows its power command only."""
        return command != 0x0200 and (self._standby or now_s < self._awake_s)

    def write(self, command: int, data: bytes, now_s: float) -> bool:
        """Obey a command; whether it can acknowledge it.

        Raises
        ------
        RefusedError
            If it cannot be obeyed now, or there is no such command.
        """
        self.advance(now_s)
        handler = getattr(self, f"_write_{command:04x}", None)
        if handler is None or not data:
            raise RefusedError
        if command in _CONFIGURING:
            if self._state != STOPPED:
                raise RefusedError
            self._validated = None
        return handler(data, now_s) is None

    def read(self, command: int, now_s: float) -> bytes:
        """What a command reads back.

        Raises
        ------
        RefusedError
            If there is no such command.
        """
        self.advance(now_s)
        exposures = self._exposure_us.to_bytes(4, "little") + self._period_us.to_bytes(4, "little")
        known: dict[int, Callable[[], bytes]] = {
            0x0200: lambda: bytes([self._standby or now_s < self._awake_s]),
            0x0205: lambda: bytes([0, 0, 1, 4] * 4),
            0x071C: lambda: self._video_status(now_s),
            0x1A00: lambda: bytes([self._source]),
            0x1A0A: lambda: bytes([0x01 | (0x40 if self._aborted else 0)]),
            0x1A0B: lambda: b"\x01",
            0x1A0C: lambda: bytes([(1 if self._standby else 0) | (2 if self.displaying else 0)]),
            0x1A1A: lambda: bytes([self._validation]),
            0x1A1B: lambda: bytes([self._pattern_mode]),
            0x1A22: lambda: bytes([self._pattern_source]),
            0x1A23: lambda: bytes([self._trigger_mode]),
            0x1A24: lambda: bytes([self._state]),
            0x1A29: lambda: exposures,
            0x1A31: lambda: bytes(self._configured),
            0x1A34: self._read_table,
        }
        if command not in known:
            raise RefusedError
        return known[command]()

    def _video_status(self, now_s: float) -> bytes:
        if not self.locked(now_s) or not self.frame_s:
            return bytes(28)
        rate = round(100 / self.frame_s)
        sizes = [(912, 1), (1140, 3), (rate, 14), (912, 20), (1140, 22)]
        status = bytearray(28)
        status[0] = 2
        for value, at in sizes:
            status[at : at + 2] = value.to_bytes(2, "little")
        return bytes(status)

    def _read_table(self) -> bytes:
        if not self._mailbox:
            raise RefusedError
        if self._mailbox == 2:
            return bytes(self._tables[2][3 * self._address : 3 * (self._configured[0] + 1)])
        return bytes(self._tables[1][self._address : self._configured[3] + 1])

    def _write_0200(self, data: bytes, now_s: float) -> bool | None:
        waking = self._standby and not data[0]
        if waking:
            self._awake_s = now_s + self.habits.wake_s
        self._standby = bool(data[0])
        return False if waking else None

    def _write_1a00(self, data: bytes, now_s: float) -> None:
        self._source, self._source_since_s = data[0], now_s

    def _write_1a1b(self, data: bytes, now_s: float) -> None:
        if self._state != STOPPED:
            raise RefusedError
        self._mode_wanted, self._mode_due_s = bool(data[0]), now_s + self.habits.mode_s

    def _write_1a22(self, data: bytes, _now: float) -> None:
        if data[0] not in (VIDEO_PORT, FLASH):
            raise RefusedError
        self._pattern_source = data[0]

    def _write_1a23(self, data: bytes, _now: float) -> None:
        if data[0] not in (VSYNC, TRIGGERED):
            raise RefusedError
        self._trigger_mode = data[0]

    def _write_1a24(self, data: bytes, now_s: float) -> None:
        if data[0] > RUNNING:
            raise RefusedError
        if data[0] != RUNNING:
            if self._state == RUNNING and data[0] == PAUSED:  # a start shows the present pattern again
                self._line = (self._line - 1) % len(self._lines)
            elif data[0] == STOPPED:
                self._line = 0
            self._state = data[0] if self._state != STOPPED else STOPPED
            return
        if self._validated is None or self._validated & (EXPOSURE | NUMBERS) or not self._pattern_mode:
            return
        if self._starts_left:
            self._starts_left -= 1
        elif self._state != RUNNING:
            self._state, self._next_s = RUNNING, now_s

    def _write_1a29(self, data: bytes, _now: float) -> None:
        if len(data) < 8:
            raise RefusedError
        self._exposure_us, self._period_us = int.from_bytes(data[:4], "little"), int.from_bytes(data[4:8], "little")

    def _write_1a31(self, data: bytes, _now: float) -> None:
        if len(data) < 4 or data[0] > 127:
            raise RefusedError
        self._configured = (data[0], data[1], data[2], data[3])

    def _write_1a32(self, data: bytes, _now: float) -> None:
        if not self._mailbox or data[0] > 127:
            raise RefusedError
        self._address = data[0]

    def _write_1a33(self, data: bytes, _now: float) -> None:
        if data[0] > 2:
            raise RefusedError
        self._mailbox, self._address = data[0], 0

    def _write_1a34(self, data: bytes, _now: float) -> None:
        if not self._mailbox:
            raise RefusedError
        table = self._tables[self._mailbox]
        start = self._address * (3 if self._mailbox == 2 else 1)
        if start + len(data) > len(table):
            raise RefusedError
        table[start : start + len(data)] = data

    def _write_1a1a(self, _data: bytes, now_s: float) -> None:
        self._validation, self._validation_due_s = BUSY, now_s + self.habits.validate_s


_CONFIGURING = frozenset({0x1A00, 0x1A1A, 0x1A22, 0x1A23, 0x1A29, 0x1A31, 0x1A32, 0x1A33, 0x1A34})


def _shares(entry: Entry) -> bool:
    return entry.shares_trigger


def _pairs(lines: list[Entry]) -> list[tuple[Entry, Entry]]:
    """Each line with the one before it; the sequence repeats."""
    return list(zip([lines[-1], *lines[:-1]], lines, strict=True))


def _number_exists(entry: Entry) -> bool:
    """Whether there is such a pattern in 24 bit planes; at 1 bit, number 24 is a white fill."""
    if not 1 <= entry.bits <= 8:
        return False
    return entry.number < 24 // entry.bits or (entry.bits == 1 and entry.number == 24)

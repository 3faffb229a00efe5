"""What runs on the doser's board: commands, limits, latches, watchdog, and a count written before each step."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from drivers.emulation.motor import Move

from .frames import DIGITS, Request, framed
from .memory import LOST, MEMORY, MOVING, REACHED, RESET, STALL, STOP, STOPPED, UNSURE, WATCHDOG, Record, StateFile

PROTOCOLS = (1, 2)
WATCHDOG_S = 1.5

E_UNKNOWN, E_MALFORMED, E_BUSY, E_STOPPED, E_UNSURE, E_OLD = range(1, 7)
E_REUSED, E_BEHIND, E_DOSE_CAP, E_LIFE_CAP, E_NEW_STOP, E_NOT_UNSURE = range(7, 13)
_ARGUMENTS = {"I": (), "S": (), "D": (8, 8), "C": (4,), "Z": (8,)}
_ARGUMENTS_02 = {**_ARGUMENTS, "Z": (8, 4)}


class Firmware:
    """The board from one boot to the next.

    Parameters
    ----------
    state
        Its FRAM.
    rate, acceleration
        Of the motor, steps/s and steps/s².
    pulse
        Called for each step pulse after it has been counted. Returns whether the encoder has seen the step; raises to
        end the board's life there.
    protocol
        Version of the protocol that it speaks.
    run
        Called with a number of steps that are due; returns how many of them were made and seen at once.
    """

    def __init__(
        self,
        state: StateFile,
        rate: float,
        acceleration: float,
        pulse: Callable[[], bool],
        protocol: int = 1,
        run: Callable[[int], int] = lambda _: 0,
    ) -> None:
        self._state, self._protocol = state, protocol
        self._arguments = _ARGUMENTS if protocol == 1 else _ARGUMENTS_02
        self._rate, self._acceleration, self._pulse, self._run = rate, acceleration, pulse, run
        self._move: Move | None = None
        self._made = 0
        self._fed_s = 0.0
        self.record = self._boot()

    def _boot(self) -> Record:
        record = self._state.load()
        if record is None:
            life = self._state.commissioning.life_cap
            stops = 0 if self._protocol == 1 else 0xFFFF
            record = Record(LOST, LOST, life, stops=stops, flags=STOPPED | UNSURE, reason=MEMORY)
        record.boots = record.boots + 1 & 0xFFFF
        if record.flags & MOVING:
            record.flags = record.flags & ~MOVING | STOPPED
            record.reason = RESET
            record.stops = self._one_more(record.stops)
            record.doubt = min(record.doubt + 1, record.count)
        self._state.save(record)
        return record

    def _one_more(self, stops: int) -> int:
        """In version 02 whatever latches STOPPED counts as a stop, in 01 only stop bytes do."""
        return stops if self._protocol == 1 else stops + 1 & 0xFFFF

    @property
    def moving(self) -> bool:
        """Whether the motor runs."""
        return self._move is not None

    def believed(self) -> dict[str, Any]:
        """Its record, for the control channel."""
        return asdict(self.record)

    def banner(self) -> bytes:
        """What it says after boot."""
        return framed(f"!TANKRIG-DOSER {self._protocol:02X} {self._state.commissioning.serial} {self.record.boots:04X}")

    def advance(self, now_s: float) -> None:
        """Let the motor and the watchdog run until `now_s`."""
        deadline_s = self._fed_s + WATCHDOG_S
        if move := self._move:
            due = move.made(min(now_s, deadline_s))
            while self._move and self._made < due:
                self._count(self._run(due - self._made), move)
                if self._move and self._made < due:
                    self._step(move)
        if self._move and now_s > deadline_s:
            self._rest(WATCHDOG)

    def _count(self, steps: int, move: Move) -> None:
        """Steps that were made at once."""
        if steps:
            self.record.count += steps
            self.record.life += steps
            self._made += steps
            self._state.save(self.record)
            if self._made == move.steps:
                self._rest(REACHED)

    def _step(self, move: Move) -> None:
        self.record.count += 1
        self.record.life += 1
        self._state.save(self.record)
        self._made += 1
        if not self._pulse():
            self.record.doubt += 1
            self._rest(STALL)
        elif self._made == move.steps:
            self._rest(REACHED)

    def _rest(self, reason: int) -> None:
        self._move = None
        self.record.flags &= ~MOVING
        self.record.reason = reason
        if reason != REACHED:
            self.record.flags |= STOPPED
        if reason in (WATCHDOG, STALL):
            self.record.stops = self._one_more(self.record.stops)
        if reason == STALL:
            self.record.flags |= UNSURE
        self._state.save(self.record)

    def stop(self, now_s: float) -> None:
        """The stop byte."""
        self.advance(now_s)
        self.record.stops = self.record.stops + 1 & 0xFFFF
        self.record.flags |= STOPPED
        if self._move:
            self._rest(STOP)
        self._state.save(self.record)

    def answer(self, request: Request, now_s: float) -> bytes:
        """Carry out a request and answer it."""
        self.advance(now_s)
        if self._protocol == 1 or request.command == "S":
            self._fed_s = now_s
        widths = self._arguments.get(request.command)
        if widths is None:
            return self._error(request, E_UNKNOWN)
        text = request.arguments
        if len(text) != sum(widths) or not set(text) <= DIGITS:
            return self._error(request, E_MALFORMED)
        ends = [sum(widths[: i + 1]) for i in range(len(widths))]
        values = [int(text[end - width : end], 16) for end, width in zip(ends, widths, strict=True)]
        if request.command == "I":
            return framed(f"<{request.sequence}I{self._identity()}")
        error = self._carry_out(request.command, values, now_s)
        return self._error(request, error) if error else framed(f"<{request.sequence}S{self._status()}")

    def _carry_out(self, command: str, values: list[int], now_s: float) -> int | None:
        if command == "D":
            return self._dose(now_s, *values)
        if command == "C":
            return self._clear(*values)
        return self._resolve(*values) if command == "Z" else None

    def _dose(self, now_s: float, dose_id: int, target: int) -> int | None:
        record = self.record
        if dose_id == record.dose_id:
            if target != record.target:
                return E_REUSED
            self._fed_s = now_s
            return None
        steps = target - record.count
        refusals = {
            E_BUSY: self.moving,
            E_STOPPED: record.flags & STOPPED,
            E_UNSURE: record.flags & UNSURE,
            E_OLD: dose_id < record.dose_id,
            E_BEHIND: steps < 0,
            E_DOSE_CAP: steps > self._state.commissioning.dose_cap,
            E_LIFE_CAP: record.life + steps > self._state.commissioning.life_cap,
        }
        if refused := next((code for code, holds in refusals.items() if holds), None):
            return refused
        record.dose_id, record.target, self._fed_s = dose_id, target, now_s
        if steps:
            record.flags |= MOVING
            self._move = Move(now_s, steps, self._rate, self._acceleration)
            self._made = 0
        else:
            record.reason = REACHED
        self._state.save(record)
        return None

    def _clear(self, stops: int) -> int | None:
        if stops != self.record.stops:
            return E_NEW_STOP
        self.record.flags &= ~STOPPED
        self._state.save(self.record)
        return None

    def _resolve(self, count: int, stops: int | None = None) -> int | None:
        """In version 02 only what is unsure, and only as of the stops that the sender knows of, so that no copy of an
        old request can undo a later count.
        """
        if self.moving:
            return E_BUSY
        if stops is not None:
            if stops != self.record.stops:
                return E_NEW_STOP
            if not self.record.flags & UNSURE:
                return None if (count, 0) == (self.record.count, self.record.doubt) else E_NOT_UNSURE
        self.record.count, self.record.doubt = count, 0
        self.record.flags &= ~UNSURE
        self._state.save(self.record)
        return None

    def _identity(self) -> str:
        c = self._state.commissioning
        speed_and_watchdog = f"{round(self._rate):04X}{round(WATCHDOG_S * 1e3):04X}"
        return f"{self._protocol:02X}{c.serial}{c.dose_cap:08X}{c.life_cap:08X}{speed_and_watchdog}"

    def _status(self) -> str:
        r = self.record
        numbers = f"{r.dose_id:08X}{r.target:08X}{r.count:08X}{r.doubt:08X}{r.life:08X}"
        return f"{r.flags:02X}{r.reason:02X}{numbers}{r.boots:04X}{r.stops:04X}"

    def _error(self, request: Request, code: int) -> bytes:
        return framed(f"<{request.sequence}E{code:02X}")

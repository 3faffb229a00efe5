"""A Cavro pump on its line, as `drivers.counted.counter.Counter` (firmware_notes/cavro.md)."""

import itertools
import random
from collections.abc import Callable

from drivers.clock import Clock
from drivers.counted.counter import Reading, Trust
from drivers.dosing.pump import Count
from drivers.serial_line import Line, NoReplyError, NotSentError, PortOpener, open_port
from tankrig.errors import DeviceError

from . import wire
from .settings import CavroSettings

ATTEMPTS = 3
PIECE_S = 1.0
VALVE_S = 2.0
INITIALISE_S = 60.0
TOP = 50
LOST_BY_STOPPING = 16
_BUSY, _NOT_INITIALISED, _OVERLOADS = 15, 7, (1, 9, 10)
_REMEDY = "let it initialise with its tube in a waste vessel (`tankrig calibrate pump --initialise`)"


class CavroPump:
    """An XCalibur or XLP with an input and an output. Ticks are increments; the counter goes up as the plunger does.

    It has no watchdog, so that a dose is made of moves that last a second at most.

    Parameters
    ----------
    settings
        From the rig file.
    name
        For messages.
    clock, opener
        Its time, and how its port is opened.
    """

    margin, order, increment, most_doubt, counter_restarts = 0, 1, 1, 10, False
    rests_after_s = 1.5 * PIECE_S

    def __init__(self, settings: CavroSettings, name: str, clock: Clock, opener: PortOpener = open_port) -> None:
        self._settings, self._name, self.model, self._clock = settings, name, "", clock
        self.tick_ul, self.stroke = settings.increment_ul, settings.stroke
        self.ticks_per_ul = settings.stroke / settings.syringe_ul
        self.lost_by_stopping = LOST_BY_STOPPING * settings.finer
        self._sequence, self._stops = itertools.cycle(range(1, 8)), 0
        self._stops_before = -1
        self._marks = itertools.cycle(random.sample(range(800, 900), 100))  # not those of the last program
        self._line = Line(settings.port, settings.baud, name, wire.replies, lambda _: None, clock, opener)

    # -- who -----------------------------------------------------------------------------------------------------------

    def greet(self) -> None:
        """See who it is. The first commands also end any sequence number left over from another program."""
        if not 5 <= self._settings.half_steps_per_s <= 6000:
            lowest, highest = (n * self._settings.finer * self.tick_ul for n in (5, 6000))
            raise DeviceError(
                f"{self._name}: speed_ul_per_s = {self._settings.speed_ul_per_s:g} is not one it can do; give "
                f"{lowest:.3g} to {highest:.3g}"
            )
        try:
            for _ in range(2):
                self._ask("Q", "".__eq__)
            self.model = self._ask("&", lambda text: len(text) > 1 and not text.isdigit()).data
        except NoReplyError as error:
            raise DeviceError(
                f"{self._name}: no Cavro pump answers there at {self._settings.baud} baud; check port, baud, address "
                f"{self._settings.address}, cable and power"
            ) from error

    # -- counting ------------------------------------------------------------------------------------------------------

    def answers(self) -> bool:
        """Whether it answers a question for its firmware, asked once; `Q` would clear an error that has to be told."""
        try:
            self._ask("&", lambda text: len(text) > 1 and not text.isdigit(), attempts=1)
        except NoReplyError:
            return False
        return True

    def read(self) -> Reading:
        """Bring it to rest if it moves, and read its plunger's position."""
        error: DeviceError | None = None
        for attempt in range(2 * ATTEMPTS):
            try:
                state = self._ask("Q", "".__eq__)
                if not state.ready:
                    if attempt:
                        self._clock.sleep(0.1)
                    self.stop()
                    continue
                if state.error == _NOT_INITIALISED:
                    return Reading(Count.exactly(0), Trust.RESTARTED, f"{state.why}; {_REMEDY}")
                self._mark()
                reading = self._position(state)
            except NoReplyError as missing:
                error = missing
                continue
            if reading:
                return reading
        raise error or NoReplyError(f"{self._name}: does not stop; pull its power")

    def _position(self, state: wire.Reply) -> Reading | None:
        """Its position, and by a move to where it stands whether it has an error that it has told before."""
        self._ask(f"N{int(self._settings.fine)}R", "".__eq__)
        position = int(self._ask("?", str.isdigit).data)
        if position != int(self._ask("?", str.isdigit).data):
            return None  # damaged in a way that the checksum cannot see
        probe = self._ask(f"A{position}R", "".__eq__)
        if probe.error == _BUSY:
            return None
        count, error = Count.exactly(self.stroke - position), state if state.error else probe
        if error.error in _OVERLOADS or probe.error in _OVERLOADS:
            return Reading(count, Trust.STALLED, f"{error.why}; look at syringe and tube, and {_REMEDY}")
        if probe.error == _NOT_INITIALISED:
            return Reading(count, Trust.RESTARTED, f"{probe.why}; {_REMEDY}")
        return Reading(count, stopped=self._stops != self._stops_before)

    def _mark(self) -> None:
        """Set the start speed to another value and have it tell it: replies from before are then past."""
        mark = str(next(self._marks))
        self._ask(f"v{mark}R", "".__eq__)
        self._ask("?1", mark.__eq__, attempts=1)

    def stale(self) -> bool:
        """Nothing in its settings changes what its position means."""
        return False

    def room(self, count: Count) -> int:
        """Increments up to just below the top, but no more than a piece."""
        piece = max(1, round(PIECE_S * self._settings.half_steps_per_s * self._settings.finer))
        return min(self.stroke - TOP * self._settings.finer - count.best, piece)

    def renew(self) -> None:
        """Refill, with the valve turned to the input, and turn it back."""
        self._set_up("i")
        self._move(0, lambda: False)
        self._wait(2.0 * self.stroke / self._settings.half_steps_per_s / self._settings.finer + 2.0, "refill")
        self._set_up("o")

    # -- moving --------------------------------------------------------------------------------------------------------

    def prepare(self, ticks: int, count: Count) -> None:
        """Resolution, speed and valve as they should be."""
        self._target, self._stops_before = count.best + ticks, self._stops
        self._set_up("o")

    def go(self, unless: Callable[[], bool]) -> bool:
        """An absolute move, which repeated would do nothing more."""
        try:
            return self._move(self._target, unless)
        except NoReplyError:
            return True

    def poll(self) -> tuple[bool, Count | None]:
        """Whether it moves, and its plunger's position."""
        state = self._ask("Q", "".__eq__)
        if state.ready or state.error:
            return not state.ready, None
        return True, Count.exactly(self.stroke - int(self._ask("?", str.isdigit).data))

    def duration_s(self, ticks: int) -> float:
        """At the set speed."""
        return ticks / (self._settings.half_steps_per_s * self._settings.finer)

    def initialise(self) -> None:
        """Let it find its zero: pushes out what the syringe holds, through the output."""
        self._ask(f"{self._settings.initialise_with}R", "".__eq__)
        self._wait(INITIALISE_S, "initialise")

    def stop(self) -> None:
        """Terminate, and once more with the repeat bit in case that was lost."""
        self._stops += 1
        sequence = next(self._sequence)
        first, again = (wire.command(self._settings.address, sequence, "T", repeat) for repeat in (False, True))
        self._line.send(first + again)

    def close(self) -> None:
        """Let go of the port."""
        self._line.close()

    # -- asking --------------------------------------------------------------------------------------------------------

    def _set_up(self, valve: str) -> None:
        self._command(f"N{int(self._settings.fine)}R")
        self._command(f"V{self._settings.half_steps_per_s}R")
        if self._valve() != valve:
            self._command(f"{valve.upper()}R")
            self._wait(VALVE_S, "turn its valve")
            if (found := self._valve()) != valve:
                raise DeviceError(f"{self._name}: its valve is at {found!r} and not at {valve!r}; look at the valve")

    def _valve(self) -> str:
        return self._ask("?6", lambda text: len(text) == 1 and text.isalpha()).data

    def _move(self, count: int, unless: Callable[[], bool]) -> bool:
        """Send a move, again with the repeat bit while no reply comes and no stop has been sent since.

        False if it was certainly not begun. An error in the answer to a repeat proves nothing: the first may have been
        obeyed before the power failed.
        """
        sequence, stops = next(self._sequence), self._stops
        for attempt in range(ATTEMPTS):
            request = wire.command(self._settings.address, sequence, f"A{self.stroke - count}R", repeat=attempt > 0)
            try:
                answer = self._once(request, "".__eq__, lambda: self._stops != stops or unless())
                return attempt > 0 or not answer.error
            except NotSentError:
                if attempt == 0:
                    raise
                return True
            except NoReplyError:
                if attempt == ATTEMPTS - 1:
                    raise
        return True

    def _wait(self, timeout_s: float, what: str) -> None:
        deadline = self._clock.monotonic() + timeout_s
        while not (state := self._ask("Q", "".__eq__)).ready:
            if self._clock.monotonic() > deadline:
                raise DeviceError(f"{self._name}: did not {what} within {timeout_s:g} s; look at it")
            self._clock.sleep(0.05)
        if state.error:
            raise DeviceError(f"{self._name}: did not {what}: {state.why}; look at it, and {_REMEDY}")

    def _command(self, data: str) -> None:
        """Give a command that may be given twice."""
        if (answer := self._ask(data, "".__eq__)).error:
            raise DeviceError(f"{self._name}: refused {data}: {answer.why}; look at it, and {_REMEDY}")

    def _ask(self, data: str, accept: Callable[[str], object], attempts: int = ATTEMPTS) -> wire.Reply:
        """Ask what may be asked twice: as a new command, because a repeated one would only be acknowledged."""
        for attempt in range(attempts):
            try:
                return self._once(wire.command(self._settings.address, next(self._sequence), data), accept)
            except NoReplyError:
                if attempt == attempts - 1:
                    raise
        raise AssertionError(attempts)

    def _once(
        self, request: bytes, accept: Callable[[str], object], unless: Callable[[], bool] = lambda: False
    ) -> wire.Reply:
        def answer(text: bytes) -> wire.Reply | None:
            found = wire.reply(text)
            return found if accept(found.data) else None

        return self._line.exchange(request, answer, unless)

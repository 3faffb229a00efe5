"""A Cavro pump on its line, as `drivers.counted.counter.Counter` (firmware_notes/cavro.md)."""

import itertools
import math
import random
from collections.abc import Callable

from drivers.clock import Clock
from drivers.counted.counter import Reading, Trust
from drivers.dosing.pump import Count
from drivers.serial_line import NoReplyError, NotSentError, PortOpener, SerialLine, open_port
from tankrig.errors import DeviceError

from . import wire
from .settings import CavroSettings

ATTEMPTS = 3
GREETINGS = 2
PIECE_S = 1.0
VALVE_S = 2.0
INITIALISE_S = 60.0
TOP = 50
LOST_BY_STOPPING = 16
XCALIBUR_FIRMWARE = "737230"
LOWEST_SPEED, LOWEST_START, TOP_SPEED = 5, 50, 6000
START_SPEED, SLOPE = 900, 14
PULSES_PER_S2_OF_SLOPE = 2500.0
_MOVE_ATTEMPTS, _FEWEST_QUESTIONS, _MOST_QUESTIONS = 2, 3, 12
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

    margin, order, increment, most_doubt, counter_restarts, repeats = 0, 1, 1, 10, False, False
    on_its_own = 0

    def __init__(self, settings: CavroSettings, name: str, clock: Clock, opener: PortOpener = open_port) -> None:
        self._settings, self._name, self.model, self._clock = settings, name, "", clock
        self.tick_ul, self.stroke = settings.increment_ul, settings.stroke
        self.ticks_per_ul = settings.stroke / settings.syringe_ul
        self.lost_by_stopping = LOST_BY_STOPPING * settings.finer
        self._sequence, self._stops = itertools.cycle(range(1, 8)), 0
        self._stops_before = -1
        self._line = SerialLine(settings.port, settings.baud, name, wire.replies, lambda _: None, clock, opener)

    # -- who -----------------------------------------------------------------------------------------------------------

    def greet(self) -> None:
        """See who it is. The first commands also end any sequence number left over from another program."""
        lowest, highest = (pulses * self._settings.ul_per_pulse for pulses in (LOWEST_SPEED, TOP_SPEED))
        if not LOWEST_SPEED <= self._settings.pulses_per_s <= TOP_SPEED:
            raise DeviceError(
                f"{self._name}: speed_ul_per_s = {self._settings.speed_ul_per_s:g} is not one it can do; give "
                f"{lowest:.3g} to {highest:.3g}"
            )
        for attempt in range(GREETINGS):
            try:
                for _ in range(2):
                    self._ask("Q", "".__eq__)
                self.model = self._ask("&", _is_firmware).data.strip()
                break
            except NoReplyError as error:
                if attempt == GREETINGS - 1:
                    raise DeviceError(
                        f"{self._name}: no Cavro pump answers there at {self._settings.baud} baud; check port, baud, "
                        f"address {self._settings.address}, cable and power"
                    ) from error
        if unlike := _unlike_the_rig_file(self.model, self._settings):
            raise DeviceError(f"{self._name}: {unlike}")

    # -- counting ------------------------------------------------------------------------------------------------------

    def answers(self) -> bool:
        """Whether it answers a question for its firmware, asked once; `Q` would clear an error that has to be told."""
        try:
            self._ask("&", _is_firmware, attempts=1)
        except NoReplyError:
            return False
        return True

    def read(self) -> Reading:
        """Bring it to rest if it moves, and read its plunger's position."""
        error: DeviceError | None = None
        for attempt in range(2 * ATTEMPTS):
            try:
                self._prove_order()
                state = self._ask("Q", "".__eq__)
                if not state.ready and not self._line.owed:
                    if attempt:
                        self._clock.sleep(0.1)
                    self.stop()
                    continue
                reading = self._position(state)
            except NoReplyError as missing:
                error = missing
                if not self._line.patient:
                    break
                continue
            if reading and not self._line.owed:  # else one of the answers may have been another's
                return reading
        raise error or NoReplyError(f"{self._name}: does not stop, or its answers get lost; check the cable")

    def _position(self, state: wire.Reply) -> Reading | None:
        """Its position, and by a move to where it stands whether it has an error that it has told before."""
        if state.error == _NOT_INITIALISED:
            return Reading(Count.exactly(0), Trust.RESTARTED, f"{state.why}; {_REMEDY}")
        self._ask(f"N{int(self._settings.fine)}R", "".__eq__)
        position = int(self._ask("?", str.isdigit).data)
        if position != int(self._ask("?", str.isdigit).data):
            return None  # damaged in a way that the checksum cannot see
        if self._line.owed:
            return None  # not sure where it stands: it must not be sent there
        probe = self._ask(f"A{position}R", "".__eq__)
        if probe.error == _BUSY:
            return None
        count, error = Count.exactly(self.stroke - position), state if state.error else probe
        if error.error in _OVERLOADS or probe.error in _OVERLOADS:
            return Reading(count, Trust.STALLED, f"{error.why}; look at syringe and tube, and {_REMEDY}")
        if probe.error == _NOT_INITIALISED:
            return Reading(count, Trust.RESTARTED, f"{probe.why}; {_REMEDY}")
        return Reading(count, stopped=self._stops != self._stops_before)

    def _prove_order(self) -> None:
        """Prove that nothing is owed any more, so that the next answer is that to the next question.

        One kind of question as often as answers are owed, and then another kind: an answer that is late by up to so
        many would be of the first kind where the last is due. Which kind is which is drawn by chance, so that answers
        to an earlier proof do not fit. Neither question changes anything in the pump.

        Raises
        ------
        NoReplyError
            If an answer is missing or of the other kind.
        """
        often, last = random.sample([("?", str.isdigit), ("&", self._is_its_firmware)], 2)
        owed = self._line.owed
        questions = min(max(_FEWEST_QUESTIONS, owed + 1), _MOST_QUESTIONS)
        for question, fits in [often] * (questions - 1) + [last]:
            request = wire.command(self._settings.address, next(self._sequence), question)
            if not fits(self._once(request, lambda _: True).data):
                self._line.unsettle()
                raise NoReplyError(f"{self._name}: answers out of turn; check the cable, and that nobody else uses it")
        self._line.paid(owed)

    def _is_its_firmware(self, text: str) -> bool:
        return text.strip() == self.model

    def stale(self) -> bool:
        """Nothing in its settings changes what its position means."""
        return False

    def set_up(self) -> None:
        """Nothing: resolution, speeds and valve are set before each move, as what moves it by hand changes them."""

    def room(self, count: Count) -> int:
        """Increments up to just below the top, but no more than a piece."""
        return min(self.stroke - TOP * self._settings.finer - count.best, self._piece)

    @property
    def _piece(self) -> int:
        """Increments of the longest move, ramps included."""
        pulses = (PIECE_S - self._ramps_s) * self._settings.pulses_per_s
        return max(1, math.floor(pulses * self._settings.increments_per_pulse))

    @property
    def _ramps_s(self) -> float:
        """What starting and ending below the top speed adds to a move's time."""
        top = self._settings.pulses_per_s
        return (top - self._start_speed) ** 2 / (SLOPE * PULSES_PER_S2_OF_SLOPE * top) if top > START_SPEED else 0.0

    @property
    def _start_speed(self) -> int:
        """Start and cutoff speed; above the top speed the pump would take that instead."""
        return max(LOWEST_START, min(START_SPEED, self._settings.pulses_per_s))

    def renew(self) -> None:
        """Refill, with the valve turned to the input, and turn it back."""
        self._set_up("i")
        self._move(0, lambda: False)
        self._wait(2.0 * self.duration_s(self.stroke) + 3.0, "refill")
        self._set_up("o")

    # -- moving --------------------------------------------------------------------------------------------------------

    def prepare(self, ticks: int, count: Count) -> None:
        """Resolution, speed and valve as they should be."""
        self._target, self._stops_before = count.best + ticks, self._stops
        self._set_up("o")

    def go(self, unless: Callable[[], bool]) -> bool:
        """An absolute move, which repeated would do nothing more. Without an answer it may have begun."""
        return self._move(self._target, unless)

    def poll(self) -> tuple[bool, Count | None]:
        """Whether it moves, and its plunger's position."""
        if self._line.owed:
            self._prove_order()  # only the answer to `Q` tells whether it moves: any other says ready
        state = self._ask("Q", "".__eq__)
        if state.ready or state.error:
            return not state.ready, None
        return True, Count.exactly(self.stroke - int(self._ask("?", str.isdigit).data))

    def duration_s(self, ticks: int) -> float:
        """At the set speeds."""
        return ticks / self._settings.increments_per_pulse / self._settings.pulses_per_s + self._ramps_s

    def initialise(self) -> None:
        """Let it find its zero: pushes out what the syringe holds, through the output."""
        self._ask(f"{self._settings.initialise_with}R", "".__eq__)
        self._wait(INITIALISE_S, "initialise")

    def stop(self) -> None:
        """Terminate, and once more with the repeat bit in case that was lost."""
        self._stops += 1
        sequence = next(self._sequence)
        first, again = (wire.command(self._settings.address, sequence, "T", repeat) for repeat in (False, True))
        self._line.send(first + again, replies=2)

    def leave_alone(self) -> None:
        """Nothing: it has no watchdog."""

    def close(self) -> None:
        """Let go of the port."""
        self._line.close()

    # -- asking --------------------------------------------------------------------------------------------------------

    def _set_up(self, valve: str) -> None:
        top, start = self._settings.pulses_per_s, self._start_speed
        self._command(f"N{int(self._settings.fine)}V{top}v{start}c{start}L{SLOPE}R")
        if self._valve() != valve:
            self._command(f"{valve.upper()}R")
            self._wait(VALVE_S, "turn its valve")
            if (found := self._valve()) != valve:
                raise DeviceError(f"{self._name}: its valve is at {found!r} and not at {valve!r}; look at the valve")

    def _valve(self) -> str:
        """Where its valve is; the answer also tells an error of what was set before."""
        answer = self._ask("?6", lambda text: len(text) == 1 and text.isalpha())
        if answer.error:
            raise DeviceError(f"{self._name}: could not be made ready: {answer.why}; look at it, and {_REMEDY}")
        return answer.data

    def _move(self, count: int, unless: Callable[[], bool]) -> bool:
        """Send a move, again with the repeat bit while no reply comes and no stop has been sent since.

        False if it was certainly not begun. An error in the answer to a repeat proves nothing: the first may have been
        obeyed before the power failed. Nor does one in an answer that may be another's.
        """
        sequence, stops = next(self._sequence), self._stops
        for attempt in range(_MOVE_ATTEMPTS):
            request = wire.command(self._settings.address, sequence, f"A{self.stroke - count}R", repeat=attempt > 0)
            try:
                answer = self._once(request, "".__eq__, lambda: self._stops != stops or unless())
                return attempt > 0 or self._line.owed > 0 or not answer.error
            except NotSentError:
                if attempt == 0:
                    raise
                return True
            except NoReplyError:
                if attempt == _MOVE_ATTEMPTS - 1:
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
        """Give a command that may be given twice; an error may be that of an earlier one, which `Q` takes away."""
        answer = self._ask(data, "".__eq__)
        if answer.error:
            told = self._ask("Q", "".__eq__)
            answer = told if told.error else self._ask(data, "".__eq__)
        if answer.error:
            raise DeviceError(f"{self._name}: refused {data}: {answer.why}; look at it, and {_REMEDY}")

    def _ask(self, data: str, accept: Callable[[str], object], attempts: int = ATTEMPTS) -> wire.Reply:
        """Ask what may be asked twice: as a new command, because a repeated one would only be acknowledged."""
        for attempt in range(attempts):
            try:
                return self._once(wire.command(self._settings.address, next(self._sequence), data), accept)
            except NoReplyError:
                if attempt == attempts - 1 or not self._line.patient:
                    raise
        raise AssertionError(attempts)

    def _once(
        self, request: bytes, accept: Callable[[str], object], unless: Callable[[], bool] = lambda: False
    ) -> wire.Reply:
        def answer(text: bytes) -> wire.Reply | None:
            found = wire.reply(text)
            return found if accept(found.data) else None

        return self._line.exchange(request, answer, unless)


def _is_firmware(text: str) -> bool:
    return len(text) > 1 and not text.isdigit()


def _unlike_the_rig_file(told: str, settings: CavroSettings) -> str | None:
    """Why a pump that tells this firmware may not be driven by this rig file; None if it may.

    An XLP behind an XCalibur's rig file delivers half of what is counted, an XCalibur behind an XLP's the double.
    """
    if settings.firmware is not None:
        if settings.firmware.strip() == told:
            return None
        return (
            f"tells firmware {told!r}, and the rig file says firmware = {settings.firmware!r}; see which pump it is, "
            "and correct the port, or model and firmware"
        )
    is_xcalibur = told.startswith(XCALIBUR_FIRMWARE)
    if is_xcalibur == (settings.model == "xcalibur"):
        return None
    if is_xcalibur:
        return f'tells firmware {told!r}, an XCalibur\'s, and the rig file says model = "xlp"; give model = "xcalibur"'
    return (
        f"tells firmware {told!r}, which is not known as an XCalibur's; read the label on the pump and give "
        f'model = "xlp" if it is an XLP, or firmware = {told!r} if it is an XCalibur'
    )

"""The doser around a pump: absolute totals, hard bounds, and latches that only a person can open."""

import atexit
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import Enum

from drivers.clock import Clock
from drivers.serial_line import LineLostError, NoReplyError
from tankrig.devices import Delivered
from tankrig.errors import DeviceError, UndecidedError

from .calibrated import calibrated
from .pump import Count, Leg, NotSetOffError, Pump, Standing

POLL_S = 0.1
_WAIT_S = 30.0


class State(Enum):
    """What the doser knows of its last dose."""

    AT_REST = "accounted for"
    UNDER_WAY = "set off, and not accounted for yet"
    UNKNOWN = "only the pump, when it answers again, or a person can say how much it was"


class PumpDoser:
    """A pump as a `tankrig.devices.Doser`: every rule about ink that has to hold whichever pump it is.

    ::

                      set off                       nobody can tell
        AT_REST ────────────────▶ UNDER_WAY ────────────────────────▶ UNKNOWN
          ▲ ▲                         │                                  │
          │ └── it rests and tells, ──┘                                  │
          │     or never began                                           │
          └──────────── it answers again and tells, or a person says ────┘

    AT_REST becomes UNKNOWN too, when a pump that is looked at has lost its count, or counts less than it has told.
    Beside it the stop is latched, in any state, from `stop`, or from any fault, until `clear_stop`. Only AT_REST
    without a stop sets off. `dose_to` goes through UNDER_WAY once for each leg of a dose.

    * The bounds hold everything that is known: at rest what the pump counts; under way from what it was last heard to
      have delivered up to the target; after a fault the same, narrowed by what the pump tells when it answers again. It
      is asked again before its unknown state is believed and before a person's word is taken, and a person's word
      outside the bounds is refused.
    * While it doses only the dosing thread talks to the pump, which feeds its watchdog; `delivered` answers from what
      that thread has heard last, so that nobody else keeps a pump running whose program hangs.
    * A leg is set off once. What may have begun counts as begun until the pump has told.

    Opening it reads back who it is and what it has counted, settles a dose that was cut off, and delivers nothing.

    Parameters
    ----------
    pump
        On its open line; closed with the doser.
    clock
        That its waits go by.
    dose_limit_ul
        Most for one dose.
    correction
        True volume of a nominal µl (`tankrig calibrate pump`).

    Attributes
    ----------
    pump
        Whoever speaks to it goes past all of these rules.

    Raises
    ------
    DeviceError
        If what answers is not this pump.
    """

    def __init__(
        self, pump: Pump, clock: Clock, *, dose_limit_ul: float | None = None, correction: float = 1.0
    ) -> None:
        self.pump, self._clock = pump, clock
        self._correction, self._ticks_per_ul = correction, pump.ticks_per_ul / correction
        self._limit_ul = dose_limit_ul or math.inf
        self._dosing = threading.Lock()
        self._using = threading.Lock()
        self._latch = threading.RLock()  # a signal handler may stop while a stop is under way
        self._stop_asked = threading.Event()
        self._stops_asked = 0
        self._state = State.AT_REST
        self._known = Count.exactly(0)
        self._leg: Leg | None = None
        self._closed = False
        try:
            self._adopt(pump.greet())
            self._leave_alone()
        except BaseException:
            pump.close()
            raise
        atexit.register(self.close)

    # -- who and what ------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """For messages."""
        return self.pump.name

    @property
    def identity(self) -> str:
        """Which count this is, wherever the pump is plugged in."""
        return calibrated(self.pump.identity, self._correction)

    @property
    def increment_ul(self) -> float:
        """Smallest dose that makes sense, µl."""
        return self.pump.increment / self._ticks_per_ul

    @property
    def dose_limit_ul(self) -> float:
        """Most for one dose: the device's own cap or the rig file's, µl."""
        cap = self.pump.dose_cap
        return min(self._limit_ul, math.inf if cap is None else cap / self._ticks_per_ul)

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._stop_asked.is_set()

    @property
    def unknown(self) -> bool:
        """Whether the delivered volume is unknown and latched."""
        return not self._accounted and not self.dosing

    @property
    def dosing(self) -> bool:
        """Whether a dose is under way."""
        return self._dosing.locked()

    @property
    def _accounted(self) -> bool:
        return self._state is State.AT_REST

    # -- dosing ------------------------------------------------------------------------------------------------------

    def dose_to(self, total_ul: float) -> Delivered:
        """Deliver until the total since the count's zero is `total_ul` (never more); waits until it is there.

        The calling thread feeds the pump's watchdog: if it hangs or dies, the motor stops.

        Raises
        ------
        UndecidedError
            If what was delivered is, or by a fault becomes, unknown.
        DeviceError
            If it is refused, stopped or interrupted; what was delivered is then known (`delivered`).
        """
        if not self._dosing.acquire(blocking=False):
            raise DeviceError(f"{self.name}: asked to dose to {total_ul:g} µl while it doses; wait for it or stop it")
        try:
            with self._in_use("dose"):
                target = self._ticks(total_ul)
                self._require_ready()
                self._refuse_if_too_much(target, total_ul)
                while self._one_leg(target, total_ul):
                    pass
                return self.last_known
        finally:
            self._dosing.release()

    def _require_ready(self) -> None:
        trouble = self._ask_again() if not self._accounted else None
        if self._accounted and not self.stopped:
            trouble = self._read().trouble
        if not self._accounted:
            raise self._undecided("cannot dose")
        if self.stopped:
            raise DeviceError(f"{self.name}: a stop is latched; clear it first")
        if trouble:
            raise DeviceError(f"{self.name}: {trouble}")

    def _refuse_if_too_much(self, target: int, total_ul: float) -> None:
        asked = f"{self.name}: asked to dose to {total_ul:g} µl, but"
        if target < self._known.best:
            raise DeviceError(f"{asked} {self.last_known.volume_ul:g} µl have been delivered already")
        if (target - self._known.low) / self._ticks_per_ul > self.dose_limit_ul + 1e-9:
            raise DeviceError(f"{asked} one dose may have {self.dose_limit_ul:g} µl at most; dose in smaller steps")
        if refusal := self.pump.refusal(target, self._known):
            raise DeviceError(f"{asked} {refusal}")

    def _one_leg(self, target: int, total_ul: float) -> bool:
        """Deliver the next leg; False if there was none left. After any exception a stop is latched."""
        failed = f"dosing to {total_ul:g} µl failed"
        leg = None
        try:
            if (leg := self.pump.prepare(target)) is None:
                return False
            if self.stopped:
                raise DeviceError(f"{self.name}: stopped before it moved; clear the stop to go on")
            self._set_off(target, leg)
            self._follow(leg)
            standing = self._adopt(self.pump.rest(leg))
        except BaseException as error:
            self.stop()
            self._settle()
            if isinstance(error, DeviceError) and not self._accounted:
                raise self._undecided(f"{failed} ({error})") from error
            raise
        if self._accounted and standing.reached:
            return True
        self.stop()
        if not self._accounted:
            raise self._undecided(f"{failed} ({standing.why})")
        raise DeviceError(
            f"{self.name}: stopped at {self.last_known.volume_ul:g} µl on the way to {total_ul:g} µl: {standing.why}; "
            "clear the stop to go on"
        )

    def _set_off(self, target: int, leg: Leg) -> None:
        before, self._state, self._leg = self._known, State.UNDER_WAY, leg
        self._known = before._replace(high=max(target, before.high))
        try:
            self.pump.set_off(target, leg, self._stop_asked.is_set)
        except NotSetOffError:
            self._known, self._state = before, State.AT_REST
            raise

    def _follow(self, leg: Leg) -> None:
        """Poll, which feeds the watchdog, until the motor rests."""
        longest_s = 2.0 * leg.duration_s + 5.0
        deadline_s = self._clock.monotonic() + longest_s
        moving, certain = True, self._known.low
        while moving:
            if self._clock.wait(self._stop_asked, POLL_S):
                self.pump.stop()
            moving, heard = self.pump.poll()
            if moving and heard and heard.low > self._known.high:
                told_ul, most_ul = (ticks / self._ticks_per_ul for ticks in (heard.low, self._known.high))
                raise DeviceError(f"{self.name}: counts {told_ul:g} µl where {most_ul:g} were asked, and still moves")
            if moving and heard and not self.stopped:  # a stop may cost steps that were counted
                certain = self._hear(heard, certain)
            if moving and self._clock.monotonic() > deadline_s:
                raise DeviceError(f"{self.name}: still moving after {longest_s:g} s; look at motor and syringe")

    def _hear(self, heard: Count, certain: int) -> int:
        """What a moving pump counts; returns what will be certain of it once the pump is heard moving again.

        Its last steps may be those of a stall that it tells of next. More than the dose has is a counter that has lost
        its meaning (a power cut).
        """
        now = self._known
        if heard.best > now.high:
            return certain
        self._known = Count(max(now.best, heard.best), max(now.low, certain), now.high)
        return max(certain, heard.low)

    def _settle(self) -> None:
        """After a fault: learn what was delivered, or leave it unknown at once, until the pump answers again."""
        if self._state is State.UNDER_WAY:
            with suppress(DeviceError):
                self._adopt(self.pump.rest(self._leg))
        if self._state is State.UNDER_WAY:
            self._leave_unknown(self._known)

    # -- what is known -----------------------------------------------------------------------------------------------

    def _adopt(self, standing: Standing) -> Standing:
        """Take over what a pump at rest tells: alone if all was accounted for, else as far as it fits what is known."""
        if standing.stopped:
            self._stop_asked.set()
        told, known = standing.total, self._known
        if self._accounted:  # what moved since was moved by hand
            low, high = max(told.low, known.low), told.high
        else:
            low, high = max(told.low, known.low), min(told.high, known.high)
        if low > high:  # it contradicts itself: neither is proved
            self._leave_unknown(Count(told.best, min(told.low, known.low), max(told.high, known.high)))
        elif standing.known:
            self._known, self._state = Count(min(max(told.best, low), high), low, high), State.AT_REST
        else:
            self._leave_unknown(Count(told.best, low, high))
        return standing

    def _leave_unknown(self, bounds: Count) -> None:
        low, high = max(0, bounds.low), max(0, bounds.high)
        begins = self._state is not State.UNKNOWN
        narrowed = (low, high) != (self._known.low, self._known.high)
        self._known, self._state = Count((low + high) // 2, low, high), State.UNKNOWN
        if begins:
            self._stop_asked.set()
        if begins or narrowed:
            self.pump.remember_unknown(low, high)

    def _read(self) -> Standing:
        leg = None if self._accounted else self._leg
        try:
            with suppress(NoReplyError):
                return self._adopt(self.pump.rest(leg))
            return self._adopt(self.pump.rest(leg))  # a bad line may lose two replies in a row
        except LineLostError:
            self._stop_asked.set()
            raise

    def _ask_again(self) -> str | None:
        """A pump that has been silent may answer again, and know what it has delivered; tells what troubles it."""
        with suppress(DeviceError):
            if self.pump.answers():
                return self._read().trouble
        return None

    def _undecided(self, what: str) -> UndecidedError:
        bounds = self.last_known
        return UndecidedError(
            f"{self.name}: {what}; it has delivered between {bounds.low_ul:g} and {bounds.high_ul:g} µl in all: "
            "open it again, or say how much it was"
        )

    # -- asking and stopping -----------------------------------------------------------------------------------------

    def delivered(self) -> Delivered:
        """What has been delivered, with hard bounds; while it doses, by what the dosing thread has heard last."""
        if not self.dosing and self._using.acquire(blocking=False):
            try:
                if not self._closed and self._accounted:
                    self._read()
                elif not self._closed:
                    self._ask_again()
            finally:
                self._release()
        return self.last_known

    def trouble(self) -> str | None:
        """Why it cannot dose, and what to do; None if it can."""
        with self._in_use("look at it"):
            return self._read().trouble

    def stop(self) -> None:
        """Stop at once, from any thread, without waiting for a reader; latched until `clear_stop`."""
        with self._latch:
            self._stops_asked += 1
            self._stop_asked.set()
        self.pump.stop()

    def clear_stop(self) -> None:
        """Let the doser move again; does not move it. A stop that comes meanwhile wins.

        Raises
        ------
        DeviceError
            If the pump does not answer, or was stopped again meanwhile.
        """
        stops_asked = self._stops_asked
        with self._in_use("clear its stop"):
            self._read()
            self.pump.clear()
            with self._latch:
                if self._stops_asked != stops_asked:
                    raise DeviceError(f"{self.name}: cannot clear its stop: it has been stopped again meanwhile")
                self._stop_asked.clear()

    def resolve(self, volume_ul: float) -> None:
        """A person says what was delivered in all; ends the unknown state.

        The pump is asked first. If it then knows, the person's word only has to agree.

        Raises
        ------
        DeviceError
            If nothing is unknown, if that volume cannot be as it lies outside the bounds, or if the pump is silent.
        """
        with self._in_use("resolve"):
            if self._accounted:
                raise DeviceError(f"{self.name}: knows what it has delivered; nothing to resolve")
            self._read()
            said, slack, bounds = self._ticks(volume_ul), self.pump.increment, self.last_known
            if not self._known.low - slack <= said <= self._known.high + slack:
                raise DeviceError(
                    f"{self.name}: {volume_ul:g} µl cannot have been delivered in all; "
                    f"it was between {bounds.low_ul:g} and {bounds.high_ul:g} µl"
                )
            if not self._accounted:
                self._take_word(volume_ul, said)

    def _take_word(self, volume_ul: float, said: int) -> None:
        low, high = self._known.low, self._known.high
        between = volume_ul * self._ticks_per_ul - said > 1e-6
        word = Count(*(min(max(ticks, low), high) for ticks in (said, said, said + between)))
        self.pump.assign(word)
        self._known, self._state = word, State.AT_REST

    @contextmanager
    def _in_use(self, what: str) -> Iterator[None]:
        """While nobody else uses the pump; waits for a dose that has been stopped, not for one that runs."""
        if self._closed:
            raise DeviceError(f"{self.name}: cannot {what}: it has been closed; open it again")
        timeout_s = _WAIT_S if self.stopped or what == "dose" else _WAIT_S / 30
        if not self._using.acquire(timeout=timeout_s * self._clock.scale):
            raise DeviceError(f"{self.name}: cannot {what} while it doses; stop it first")
        try:
            yield
        finally:
            self._release()

    def _release(self) -> None:
        self._leave_alone()
        self._using.release()

    def _leave_alone(self) -> None:
        """Nobody uses the pump for now. One that may still move keeps its watchdog."""
        if self._accounted:
            with suppress(DeviceError):
                self.pump.leave_alone()

    def close(self) -> None:
        """Stop a dose that runs, and let go of the port."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        if self.dosing:
            self.stop()
        ended = self._using.acquire(timeout=_WAIT_S * self._clock.scale)
        if ended:
            self._leave_alone()
        self.pump.close()
        if ended:
            self._using.release()

    # -- ticks and volumes -------------------------------------------------------------------------------------------

    def _ticks(self, total_ul: float) -> int:
        if not math.isfinite(total_ul) or not 0 <= total_ul * self._ticks_per_ul <= self.pump.most:
            raise DeviceError(f"{self.name}: {total_ul:g} µl is not a volume it can deliver")
        return math.floor(total_ul * self._ticks_per_ul + 1e-6)

    @property
    def last_known(self) -> Delivered:
        """What has been delivered, with hard bounds, by what was heard of the pump last: it is not asked."""
        now, scale = self._known, self._ticks_per_ul
        return Delivered(now.best / scale, now.low / scale, now.high / scale)

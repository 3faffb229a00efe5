"""A doser made of a pump with a counter: absolute totals, hard bounds, and latches that outlive the program."""

import atexit
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.serial_line import LineLostError, NoReplyError, NotSentError
from tankrig.devices import Delivered
from tankrig.errors import DeviceError, UndecidedError

from .calibrated import calibrated
from .pump import Count, Pump, Reading, Trust
from .record import Begun, CountFile

POLL_S = 0.1
MOST_UL = 1e7
_WAIT_S = 30.0


class CountedDoser:
    """A pump with a counter as a `tankrig.devices.Doser`.

    Opening it reads back who it is and what it has counted, settles a dose that was cut off, and delivers nothing.

    Parameters
    ----------
    pump
        On its open line; closed with the doser.
    kind
        Of the driver, for the identity.
    count_file
        Where the meaning of its counter is kept.
    dose_limit_ul
        Most for one dose.
    correction
        True volume of a nominal µl (`tankrig calibrate pump`).
    name
        For messages.
    time_scale
        All waits are multiplied by this.

    Raises
    ------
    DeviceError
        If what answers is not this pump.
    """

    def __init__(
        self,
        pump: Pump,
        kind: str,
        count_file: Path,
        *,
        dose_limit_ul: float | None,
        correction: float,
        name: str,
        time_scale: float,
    ) -> None:
        self._pump, self._kind, self._name, self._scale = pump, kind, name, time_scale
        self._limit_ul = dose_limit_ul or math.inf
        self._dosing, self._using = threading.Lock(), threading.Lock()
        self._stop_asked, self._latch, self._stops_asked = threading.Event(), threading.RLock(), 0
        self._closed = False
        try:
            pump.greet()
            self._tick_ul, self._correction = pump.tick_ul * correction, correction
            self._file = CountFile(count_file, name, pump.tick_ul)
            self._now = self._file.record.total
            begun, unsure = self._file.record.begun, self._file.record.unsure
            if unsure or (begun and begun.what == "dose"):
                self._stop_asked.set()  # it was cut off, and never goes on by itself
            self._take(pump.read())
            if not self.unknown and pump.stale():
                self._renew()
        except BaseException:
            pump.close()
            raise
        atexit.register(self.close)

    # -- who and what ------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """For messages."""
        return self._name

    @property
    def identity(self) -> str:
        """Which count this is; the pump has no serial number, its count file has."""
        return calibrated(f"{self._kind} {self._file.record.pump}", self._correction)

    @property
    def increment_ul(self) -> float:
        """Smallest dose that makes sense, µl."""
        return self._pump.increment * self._tick_ul

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._stop_asked.is_set()

    @property
    def unknown(self) -> bool:
        """Whether the delivered volume is unknown and latched."""
        return self._file.record.unsure is not None and not self._dosing.locked()

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
            raise DeviceError(f"{self._name}: asked to dose to {total_ul:g} µl while it doses; wait for it or stop it")
        try:
            with self._in_use("dose"):
                return self._dose(total_ul)
        finally:
            self._dosing.release()

    def _dose(self, total_ul: float) -> Delivered:
        target = self._ticks(total_ul)
        if self._file.record.unsure is None and not self.stopped:
            self._take(reading := self._pump.read())
            if reading.trust in (Trust.RESTARTED, Trust.STALLED) and not self._pump.counter_restarts:
                raise DeviceError(f"{self._name}: {reading.why}")
        if self._file.record.unsure is not None:
            raise self._undecided("cannot dose")
        if self.stopped:
            raise DeviceError(f"{self._name}: a stop is latched; clear it first")
        self._refuse_if_too_much(target, total_ul)
        while (ticks := self._missing(target)) > 0:
            count = self._file.record.seen
            if (room := self._pump.room(count) // self._pump.order * self._pump.order) <= 0:
                self._renew()
                continue
            self._piece(min(ticks, room), count, target, total_ul)
        return self._volume(self._now)

    def _refuse_if_too_much(self, target: int, total_ul: float) -> None:
        asked = f"{self._name}: asked to dose to {total_ul:g} µl, but"
        if target < self._now.best:
            raise DeviceError(f"{asked} {self._volume(self._now).volume_ul:g} µl have been delivered already")
        if (target - self._now.low) * self._tick_ul > self._limit_ul + 1e-9:
            raise DeviceError(f"{asked} one dose may have {self._limit_ul:g} µl at most; dose in smaller steps")
        if self._missing(target) > 0 and self._now.high - self._now.best > self._pump.most_doubt:
            doubt_ul = (self._now.high - self._now.best) * self._tick_ul
            raise DeviceError(
                f"{asked} roundings have made its count uncertain by {doubt_ul:g} µl; begin a new count_file"
            )

    def _missing(self, target: int) -> int:
        """Ticks to order so that no more than `target` can have been delivered in all."""
        base, seen, order = self._file.record.base, self._file.record.seen, self._pump.order
        return (target - base.high - seen.best - self._pump.margin) // order * order

    def _piece(self, ticks: int, count: Count, target: int, total_ul: float) -> None:
        """Deliver so much; the file says that it was begun before anything moves."""
        expected = count.best + ticks
        try:
            self._pump.prepare(ticks, count)
            if self.stopped:
                raise DeviceError(f"{self._name}: stopped before it moved; clear the stop to go on")
            self._file.update(begun=Begun("dose", target))
            try:
                if self._pump.go(self._stop_asked.is_set):
                    self._follow(ticks, target)
                else:
                    self._file.update(begun=None)
                    raise DeviceError(f"{self._name}: refused to set off; look at its display")
            except NotSentError:
                self._file.update(begun=None)
                raise
            self._take(reading := self._pump.read(), expected)
        except BaseException as error:
            self.stop()
            self._settle(expected)
            if isinstance(error, DeviceError) and self._file.record.unsure is not None:
                raise self._undecided(f"dosing to {total_ul:g} µl failed ({error})") from error
            raise
        if self._file.record.unsure is not None:
            self.stop()
            raise self._undecided(f"dosing to {total_ul:g} µl failed ({reading.why})")
        if reading.count.high < expected:
            self.stop()
            at_ul = self._volume(self._now).volume_ul
            raise DeviceError(
                f"{self._name}: stopped at {at_ul:g} µl on the way to {total_ul:g} µl: {reading.why}; "
                "clear the stop to go on"
            )

    def _follow(self, ticks: int, target: int) -> None:
        """Poll, which feeds the watchdog, until the motor rests."""
        expected_s = 2.0 * self._pump.duration_s(ticks) + 5.0
        deadline = time.monotonic() + expected_s * self._scale
        moving = True
        while moving:
            if self._stop_asked.wait(POLL_S * self._scale):
                self._pump.stop()
            moving, count = self._pump.poll()
            if count and count.best >= self._file.record.seen.best:
                total = self._file.record.base + count
                self._now = self._now._replace(
                    best=max(self._now.best, total.best), low=max(self._now.low, total.low), high=target
                )
            if moving and time.monotonic() > deadline:
                raise DeviceError(f"{self._name}: still moving after {expected_s:g} s; look at motor and syringe")

    def _settle(self, expected: int) -> None:
        """After a fault: learn what was delivered, or leave it unknown. By the last attempt the pump rests."""
        for wait_s in (0.0, self._pump.rests_after_s):
            begun, total = self._file.record.begun, self._file.record.total
            if begun is None or self._file.record.unsure is not None:
                return
            time.sleep(wait_s * self._scale)
            with suppress(NoReplyError):
                try:
                    self._take(self._pump.read(), expected)
                except LineLostError:
                    break
                return
        if begun and begun.what == "dose":
            self._leave_unsure(total.low, max(begun.to, total.high))

    def _renew(self) -> None:
        """Clear the counter, or refill; what has been delivered stays the same."""
        self._file.update(begun=Begun("renewal", self._now.best))
        self._pump.renew()
        self._take(self._pump.read())
        if self._pump.room(self._file.record.seen) < self._pump.order:
            raise DeviceError(f"{self._name}: could not be made ready (cleared or refilled); look at it")

    # -- what the counter means --------------------------------------------------------------------------------------

    def _take(self, reading: Reading, expected: int | None = None) -> None:
        """Take over what a pump at rest has counted; `expected` is where the dose of this program would end."""
        record, count, known = self._file.record, reading.count, self._now.low
        if record.unsure is not None:
            return
        if record.begun is None:
            if reading.trust is not Trust.RESTARTED or self._pump.counter_restarts:
                self._take_at_rest(count)
        elif record.begun.what == "renewal":
            self._file.update(base=record.total - count, seen=count, begun=None)
        else:
            self._take_dosed(reading, record.begun, expected)
        if self._file.record.unsure is None:
            total = self._file.record.total
            lost_steps = self._file.record.base.low < record.base.low
            self._now = total if lost_steps else total._replace(low=max(total.low, known))  # ink never comes back

    def _take_at_rest(self, count: Count) -> None:
        record = self._file.record
        if count == record.seen:
            return
        if count.best >= record.seen.best:  # pushed by hand; the counter has seen it
            self._file.update(seen=count)
        elif self._pump.counter_restarts:
            self._file.update(base=record.total, seen=count)
        else:
            self._leave_unsure(record.total.low, record.total.high + self._pump.stroke)

    def _take_dosed(self, reading: Reading, begun: Begun, expected: int | None) -> None:
        record, count, trust = self._file.record, reading.count, reading.trust
        start, total = record.total, record.base + count
        short = expected is None or count.high < expected
        witnessed = trust is Trust.EXACT
        restarted = self._pump.counter_restarts and count.best == record.seen.best == 0 and not witnessed
        if trust is Trust.RESTARTED or count.best < record.seen.best or restarted:
            self._leave_unsure(start.low, max(begun.to, start.high))
        elif trust is Trust.STALLED or (trust is Trust.UNWITNESSED and short):
            self._leave_unsure(start.low, total.high)
        else:
            stopped = reading.stopped and count.best > record.seen.best
            lost = (self._pump.lost_by_stopping if stopped else 0) + (0 if witnessed else self._pump.order)
            self._file.update(base=record.base._replace(low=record.base.low - lost), seen=count, begun=None)

    def _leave_unsure(self, low: int, high: int) -> None:
        self._stop_asked.set()
        self._file.update(unsure=(max(0, low), high), begun=None)

    def _undecided(self, what: str) -> UndecidedError:
        bounds = self._unsure_volume()
        return UndecidedError(
            f"{self._name}: {what}; it has delivered between {bounds.low_ul:g} and {bounds.high_ul:g} µl in all: "
            "say how much it was"
        )

    # -- asking and stopping -----------------------------------------------------------------------------------------

    def delivered(self) -> Delivered:
        """What has been delivered, with hard bounds; while it doses, up to the target."""
        at_rest = self._file.record.unsure is None and not self._dosing.locked()
        if at_rest and self._using.acquire(blocking=False):
            try:
                if not self._closed:
                    self._take(self._pump.read())
            finally:
                self._using.release()
        return self._unsure_volume() if self.unknown else self._volume(self._now)

    def stop(self) -> None:
        """Stop at once, from any thread, without waiting for a reader; latched until `clear_stop`."""
        with self._latch:
            self._stops_asked += 1
            self._stop_asked.set()
        self._pump.stop()

    def clear_stop(self) -> None:
        """Let the doser move again; does not move it. A stop that comes meanwhile wins.

        Raises
        ------
        DeviceError
            If the pump does not answer, or was stopped again meanwhile.
        """
        stops_asked = self._stops_asked
        with self._in_use("clear its stop"):
            self._take(self._pump.read())
            with self._latch:
                if self._stops_asked != stops_asked:
                    raise DeviceError(f"{self._name}: cannot clear its stop: it has been stopped again meanwhile")
                self._stop_asked.clear()

    def resolve(self, volume_ul: float) -> None:
        """A person says what was delivered in all; ends the unknown state.

        Raises
        ------
        DeviceError
            If nothing is unknown, or if that volume cannot be: it lies outside the bounds.
        """
        with self._in_use("resolve"):
            unsure = self._file.record.unsure
            if unsure is None:
                raise DeviceError(f"{self._name}: knows what it has delivered; nothing to resolve")
            ticks, slack = self._ticks(volume_ul), self._pump.increment
            if not unsure[0] - slack <= ticks <= unsure[1] + slack:
                bounds = self._unsure_volume()
                raise DeviceError(
                    f"{self._name}: {volume_ul:g} µl cannot have been delivered in all; "
                    f"it was between {bounds.low_ul:g} and {bounds.high_ul:g} µl"
                )
            count = self._pump.read().count
            between = volume_ul / self._tick_ul - ticks > 1e-6
            said = Count(ticks, ticks, ticks + between)
            self._file.update(base=said - count, seen=count, unsure=None)
            self._now = self._file.record.total

    @contextmanager
    def _in_use(self, what: str) -> Iterator[None]:
        """While nobody else uses the pump; waits for a dose that has been stopped, not for one that runs."""
        if self._closed:
            raise DeviceError(f"{self._name}: cannot {what}: it has been closed; open it again")
        if not self._using.acquire(timeout=_WAIT_S * self._scale if self.stopped or what == "dose" else _WAIT_S / 30):
            raise DeviceError(f"{self._name}: cannot {what} while it doses; stop it first")
        try:
            yield
        finally:
            self._using.release()

    def close(self) -> None:
        """Stop a dose that runs, and let go of the port."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        if self._dosing.locked():
            self.stop()
        ended = self._using.acquire(timeout=_WAIT_S * self._scale)
        self._pump.close()
        if ended:
            self._using.release()

    # -- ticks and volumes -------------------------------------------------------------------------------------------

    def _ticks(self, total_ul: float) -> int:
        if not math.isfinite(total_ul) or not 0 <= total_ul <= MOST_UL:
            raise DeviceError(f"{self._name}: {total_ul:g} µl is not a volume it can deliver")
        return math.floor(total_ul / self._tick_ul + 1e-6)

    def _volume(self, count: Count) -> Delivered:
        return Delivered(count.best * self._tick_ul, count.low * self._tick_ul, count.high * self._tick_ul)

    def _unsure_volume(self) -> Delivered:
        low, high = self._file.record.unsure or (0, 0)
        return self._volume(Count((low + high) // 2, low, high))

"""A pump with a counter and the file that says what the count means, as `drivers.dosing.pump.Pump`."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drivers.dosing.pump import Count, Leg, NotSetOffError, Standing
from drivers.serial_line import NotSentError
from tankrig.errors import DeviceError

from .counter import Counter, Reading, Trust
from .record import Begun, CountFile

MOST_UL = 1e7


class CountedPump:
    """Totals out of a counter that knows neither absolute targets nor what came before it was cleared or refilled.

    What the file says holds before anything moves: that a dose to so much was begun, or that the counter is renewed.

    Parameters
    ----------
    counter
        On its open line; closed with this.
    kind
        Of the driver, for the identity.
    count_file
        Where the meaning of its counter is kept.
    name
        For messages.
    """

    def __init__(self, counter: Counter, kind: str, count_file: Path, name: str) -> None:
        self._counter, self._kind, self._path, self.name = counter, kind, count_file, name
        self.ticks_per_ul, self.increment = counter.ticks_per_ul, counter.increment
        self.most = round(MOST_UL * counter.ticks_per_ul)
        self._file: CountFile
        self._heard_low = 0
        """Ticks that it has said, while it moved, to have delivered in all."""

    def greet(self) -> Standing:
        """Who it is, what it counts and what that means; settles a dose that was cut off, which never goes on."""
        self._counter.greet()
        self._file = CountFile(self._path, self.name, self._counter.tick_ul)
        begun, unsure = self._file.record.begun, self._file.record.unsure
        cut_off = unsure is not None or (begun is not None and begun.what == "dose")
        standing = self.rest()
        if standing.known and self._counter.stale():
            standing = self._renew()
        if standing.known:
            self._counter.set_up()
        return replace(standing, stopped=cut_off)

    @property
    def identity(self) -> str:
        """Which count this is; the pump has no serial number, its count file has."""
        return f"{self._kind} {self._file.record.pump}"

    @property
    def dose_cap(self) -> int | None:
        """None: the pump has no limit of its own."""
        return None

    def answers(self) -> bool:
        """Whether it answers one question that changes nothing, asked once."""
        return self._counter.answers()

    # -- what the counter means ----------------------------------------------------------------------------------------

    def rest(self, leg: Leg | None = None) -> Standing:
        """Bring it to rest, read its counter and account for it; `leg` is the one it was on."""
        reading = self._counter.read()
        record = self._file.record
        if record.begun is None:
            meaningless = reading.trust is Trust.RESTARTED and not self._counter.counter_restarts
            if record.unsure is None and not meaningless:
                self._take_at_rest(reading.count)
        elif record.begun.what == "renewal":
            self._file.update(base=record.total - reading.count, seen=reading.count, begun=None)
        else:
            self._take_dosed(reading, record.begun, leg)
        return self._standing(reading, leg)

    def _standing(self, reading: Reading, leg: Leg | None) -> Standing:
        record = self._file.record
        low, high = record.unsure or (0, 0)
        cannot = reading.trust in (Trust.RESTARTED, Trust.STALLED) and not self._counter.counter_restarts
        return Standing(
            total=Count((low + high) // 2, low, high) if record.unsure else record.total,
            known=record.unsure is None,
            reached=leg is None or reading.count.high >= leg.end,
            stopped=False,
            why=reading.why,
            trouble=reading.why if cannot else None,
        )

    def _take_at_rest(self, count: Count) -> None:
        record = self._file.record
        if count == record.seen:
            return
        if count.best >= record.seen.best:  # pushed by hand; the counter has seen it
            self._file.update(seen=count)
        elif self._counter.counter_restarts:
            self._file.update(base=record.total, seen=count)
        else:
            self._file.update(unsure=(record.total.low, record.total.high + self._counter.stroke))

    def _take_dosed(self, reading: Reading, begun: Begun, leg: Leg | None) -> None:
        """Settle a dose, or say between what it ended: then the counter has told all it can."""
        record, count, trust = self._file.record, reading.count, reading.trust
        total = record.base + count
        low, high = record.unsure or (record.total.low, max(begun.to, record.total.high))
        if self._counter.repeats:  # how often it has begun anew nobody knows
            self._file.update(unsure=(low, self.most), begun=None)
        elif self._may_have_restarted(reading, begun, leg, max(low, self._heard_low)):
            self._file.update(unsure=(low, high), begun=None)
        elif trust is Trust.STALLED:
            self._file.update(unsure=(min(low, total.high), min(high, total.high)), begun=None)
        else:
            stopped = reading.stopped and count.best > record.seen.best
            unheard = 0 if trust is Trust.EXACT else self._counter.order  # a stall
            lost = (self._counter.lost_by_stopping if stopped else 0) + unheard
            base = record.base._replace(low=record.base.low - lost)
            self._file.update(base=base, seen=count, begun=None, unsure=None)

    def _may_have_restarted(self, reading: Reading, begun: Begun, leg: Leg | None, heard_low: int) -> bool:
        """Whether its power may have failed, heard or not, and its counter lost its meaning."""
        record, count, trust = self._file.record, reading.count, reading.trust
        if trust is Trust.RESTARTED or count.best < record.seen.best:
            return True
        if trust is Trust.EXACT:
            return False
        if self._counter.counter_restarts and count.best == record.seen.best == 0:
            return True
        end = begun.end if leg is None else leg.end
        complete = end is not None and count.high >= end
        moved_on = (record.base + count).high >= heard_low + begun.on_its_own
        return not (complete or trust is Trust.STALLED or (trust is Trust.TIMED_OUT and moved_on))

    def remember_unknown(self, low: int, high: int) -> None:
        """Keep the bounds; a dose whose end the counter has not told yet stays begun, so that it still can."""
        self._file.update(unsure=(low, high))

    def assign(self, total: Count) -> None:
        """From now on the counter as it stands means this."""
        count = self._counter.read().count
        self._file.update(base=total - count, seen=count, begun=None, unsure=None)

    # -- moving --------------------------------------------------------------------------------------------------------

    def refusal(self, target: int, now: Count) -> str | None:
        """Refused when roundings have made the count too uncertain."""
        doubt = now.high - now.best
        if self._missing(target) <= 0 or doubt <= self._counter.most_doubt:
            return None
        return f"roundings have made its count uncertain by {doubt / self.ticks_per_ul:g} µl; begin a new count_file"

    def _missing(self, target: int) -> int:
        """Ticks to order so that no more than `target` can have been delivered in all."""
        base, seen, order = self._file.record.base, self._file.record.seen, self._counter.order
        return (target - base.high - seen.best - self._counter.margin) // order * order

    def prepare(self, target: int) -> Leg | None:
        """As much of what is missing as fits before the counter has to be renewed."""
        while (ticks := self._missing(target)) > 0:
            count, order = self._file.record.seen, self._counter.order
            if (room := self._counter.room(count) // order * order) <= 0:
                self._renew()
                continue
            ticks = min(ticks, room)
            self._counter.prepare(ticks, count)
            return Leg(count.best + ticks, self._counter.duration_s(ticks))
        return None

    def _renew(self) -> Standing:
        """Clear the counter or refill, such that a program cut off in between still finds the total."""
        self._file.update(begun=Begun("renewal", self._file.record.total.best))
        self._counter.renew()
        standing = self.rest()
        if self._counter.room(self._file.record.seen) < self._counter.order:
            raise DeviceError(f"{self.name}: could not be made ready (cleared or refilled); look at it")
        return standing

    def set_off(self, target: int, leg: Leg, unless: Callable[[], bool]) -> None:
        """Write down that it was begun, and begin."""
        self._heard_low = 0
        try:
            self._file.update(begun=Begun("dose", target, leg.end, self._counter.on_its_own))
        except DeviceError as error:
            raise NotSetOffError(str(error)) from error
        try:
            if self._counter.go(unless):
                return
            refused = f"{self.name}: refused to set off; look at its display"
        except NotSentError as error:
            refused = str(error)
        self._file.update(begun=None)
        raise NotSetOffError(refused)

    def poll(self) -> tuple[bool, Count | None]:
        """Whether it moves, and what that makes in all."""
        moving, count = self._counter.poll()
        record = self._file.record
        if count is None or count.best < record.seen.best:
            return moving, None
        total = record.base + count
        if moving:
            self._heard_low = max(self._heard_low, total.low)
        return moving, total

    def stop(self) -> None:
        """Put a stop on the wire now."""
        self._counter.stop()

    def clear(self) -> None:
        """Nothing: the pump has no latch of its own."""

    def leave_alone(self) -> None:
        """It must not miss being asked."""
        self._counter.leave_alone()

    def counter_moved(self) -> None:
        """The counter means something else from now on, though nothing went into the tank (it was initialised)."""
        record = self._file.record
        if record.unsure is None:
            self._file.update(begun=Begun("renewal", record.total.best))
        else:
            self._file.update(begun=None)

    def close(self) -> None:
        """Let go of the pump and of the file."""
        self._counter.close()
        if hasattr(self, "_file"):
            self._file.close()

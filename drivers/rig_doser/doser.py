"""Driver of the rig's own doser (firmware_notes/rig_doser.md)."""

import atexit
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from drivers.counted.calibrated import calibrated, correction
from drivers.serial_line import LineLostError, NoReplyError
from tankrig.devices import Delivered
from tankrig.errors import DeviceError, UndecidedError

from . import wire
from .line import BANNER_S, Line
from .settings import RigDoserSettings

POLL_S = 0.1
ATTEMPTS = 3
_HEX8 = 8


class RigDoser:
    """The rig's own doser on a serial port; implements `tankrig.devices.Doser`.

    Opening it resets its board, reads back who it is, what it may do and what it has delivered, and moves nothing.

    Parameters
    ----------
    settings
        From the rig file.

    Raises
    ------
    DeviceError
        If the port cannot be opened, or what answers there is not this doser.
    """

    def __init__(self, settings: RigDoserSettings) -> None:
        self._settings = settings
        self._name = f"doser on {settings.port}"
        self._correction = correction(settings.calibration, self._name, {"steps_per_ul": settings.steps_per_ul})
        self._steps_per_ul = settings.steps_per_ul / self._correction
        self._dosing = threading.Lock()
        self._latch = threading.RLock()
        self._stop_asked = threading.Event()
        self._stops_asked = 0
        self._unsure: tuple[int, int] | None = None
        self._closed = False
        self._line = Line(settings.port, self._name, settings.time_scale)
        try:
            self._identity = self._identify(self._line.wait_for_banner())
            self._adopt(self._rest())
        except BaseException:
            self._line.close()
            raise
        self._name = f"doser {self._identity.serial} on {settings.port}"
        atexit.register(self.close)

    # -- who and what ------------------------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """For messages."""
        return self._name

    @property
    def identity(self) -> str:
        """Which doser this is, wherever it is plugged in."""
        return calibrated(f"rig-doser {self._identity.serial}", self._correction)

    @property
    def increment_ul(self) -> float:
        """Volume of one step, µl."""
        return 1.0 / self._steps_per_ul

    @property
    def dose_limit_ul(self) -> float:
        """Most for one dose: the firmware's cap or the rig file's, µl."""
        firmware_ul = self._identity.dose_cap * self.increment_ul
        return min(firmware_ul, self._settings.dose_limit_ul or math.inf)

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._stop_asked.is_set()

    @property
    def unknown(self) -> bool:
        """Whether the delivered volume is unknown and latched."""
        return self._unsure is not None and not self._dosing.locked()

    # -- dosing ------------------------------------------------------------------------------------------------------

    def dose_to(self, total_ul: float) -> Delivered:
        """Deliver until the total since the device's zero is `total_ul` (never more); waits until it is there.

        The calling thread feeds the doser's watchdog: if it hangs or dies, the motor stops.

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
            return self._dose(total_ul)
        finally:
            self._dosing.release()

    def _dose(self, total_ul: float) -> Delivered:
        target = self._steps(total_ul)
        before = self._ready()
        self._refuse_if_too_much(before, target, total_ul)
        self._unsure = (before.low, max(target, before.count))
        try:
            after = self._follow(self._start(before.id + 1, target), target)
            known = self._adopt(after)
        except BaseException as error:
            self.stop()
            settled = self._settle()
            if isinstance(error, DeviceError) and self._unsure is not None:
                raise self._undecided(f"dosing to {total_ul:g} µl failed ({error})") from error
            if isinstance(error, NoReplyError) and settled:
                raise self._cut_short(settled, total_ul) from error
            raise
        if not known or after.count != target or after.reason is not wire.Reason.REACHED:
            raise self._cut_short(after, total_ul)
        return self._volume(after)

    def _cut_short(self, after: wire.State, total_ul: float) -> DeviceError:
        why = wire.REASONS[after.reason]
        if self._unsure is not None:
            return self._undecided(f"dosing to {total_ul:g} µl failed ({why})")
        return DeviceError(
            f"{self._name}: stopped at {self._volume(after).volume_ul:g} µl on the way to {total_ul:g} µl: {why}; "
            "clear the stop to go on"
        )

    def _ready(self) -> wire.State:
        """The status before a dose, once no latch forbids it."""
        if self._unsure is None and not self.stopped:
            state = self._rest()
            self._adopt(state)
        if self._unsure is not None:
            raise self._undecided("cannot dose")
        if self.stopped:
            raise DeviceError(f"{self._name}: a stop is latched; clear it first")
        return state

    def _undecided(self, what: str) -> UndecidedError:
        bounds = self._between(*(self._unsure or (0, 0)))
        return UndecidedError(
            f"{self._name}: {what}; it has delivered between {bounds.low_ul:g} and {bounds.high_ul:g} µl in all: "
            "open it again, or say how much it was"
        )

    def _refuse_if_too_much(self, before: wire.State, target: int, total_ul: float) -> None:
        asked = f"{self._name}: asked to dose to {total_ul:g} µl, but"
        if target < before.count:
            raise DeviceError(f"{asked} {self._volume(before).volume_ul:g} µl have been delivered already")
        if (target - before.low) * self.increment_ul > self.dose_limit_ul + 1e-9:
            raise DeviceError(f"{asked} one dose may have {self.dose_limit_ul:g} µl at most; dose in smaller steps")
        left_ul = (self._identity.life_cap - before.life) * self.increment_ul
        if (target - before.count) * self.increment_ul > left_ul + 1e-9:
            raise DeviceError(f"{asked} {left_ul:g} µl of its lifetime are left; refill it and commission it anew")

    def _start(self, dose_id: int, target: int) -> wire.State:
        """Have the dose taken; sent again only after a status has shown that it was not, with the same id."""
        for _ in range(ATTEMPTS):
            try:
                reply = self._line.ask("D", (dose_id, _HEX8), (target, _HEX8))
            except NoReplyError:
                reply = self._status()
            if isinstance(reply, wire.Refusal):
                raise DeviceError(f"{self._name}: refused a dose: {reply.why}")
            if isinstance(reply, wire.State) and reply.id == dose_id:
                return reply
        raise NoReplyError(f"{self._name}: did not take a dose in {ATTEMPTS} attempts; check the cable")

    def _follow(self, state: wire.State, target: int) -> wire.State:
        """Ask for the status, which feeds the watchdog, until the motor rests."""
        expected_s = 2.0 * (target - state.count) / self._identity.rate + 5.0
        deadline = time.monotonic() + expected_s * self._settings.time_scale
        while state.moving:
            if self._stop_asked.wait(POLL_S * self._settings.time_scale):
                self._line.stop()
            state = self._status()
            if state.moving and time.monotonic() > deadline:
                raise DeviceError(f"{self._name}: still moving after {expected_s:g} s; look at motor and syringe")
        return state

    def _settle(self) -> wire.State | None:
        """After a fault: learn what was delivered, or leave it unknown. By the last attempt the watchdog has acted."""
        for wait_ms in (0.0, 1.5 * self._identity.watchdog_ms):
            time.sleep(1e-3 * wait_ms * self._settings.time_scale)
            with suppress(NoReplyError):
                try:
                    state = self._rest()
                except LineLostError:
                    break
                self._adopt(state)
                return state
        return None

    def _rest(self) -> wire.State:
        """The status once the motor rests; stops it if it runs."""
        state = self._status()
        for _ in range(ATTEMPTS):
            if not state.moving:
                return state
            self._line.stop()
            state = self._status()
        raise NoReplyError(f"{self._name}: does not stop; pull its power")

    def _adopt(self, state: wire.State) -> bool:
        """Take over the latches of a doser that rests; what it delivered is then known unless it says it is not."""
        if wire.Flag.STOPPED in state.flags:
            self._stop_asked.set()
        known = wire.Flag.UNSURE not in state.flags
        self._unsure = None if known else (state.low, state.count)
        return known

    # -- asking and stopping -----------------------------------------------------------------------------------------

    def delivered(self) -> Delivered:
        """What has been delivered, with hard bounds; while it doses, up to the target."""
        bounds = self._unsure
        if bounds is not None and not self._dosing.locked():
            return self._between(*bounds)
        state = self._status()
        return self._between(state.low, bounds[1] if bounds else state.count, state.count)

    def stop(self) -> None:
        """Stop at once, from any thread, without waiting for a reader; latched until `clear_stop`."""
        with self._latch:
            self._stops_asked += 1
            self._stop_asked.set()
        self._line.stop()

    def clear_stop(self) -> None:
        """Let the doser move again; does not move it. A stop that comes meanwhile wins.

        Raises
        ------
        DeviceError
            If the doser cannot be asked, or was stopped again meanwhile.
        """
        stops_asked = self._stops_asked
        with self._no_dose("clear its stop"):
            reply = self._again("C", (self._rest().stops, 4))
            if isinstance(reply, wire.Refusal):
                raise DeviceError(f"{self._name}: cannot clear its stop: {reply.why}")
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
        with self._no_dose("resolve"):
            self._resolve(volume_ul)

    def _resolve(self, volume_ul: float) -> None:
        if self._unsure is None:
            raise DeviceError(f"{self._name}: knows what it has delivered; nothing to resolve")
        low, high = self._unsure
        count = self._steps(volume_ul)
        if not low - 1 <= count <= high + 1:
            bounds = self._between(low, high)
            raise DeviceError(
                f"{self._name}: {volume_ul:g} µl cannot have been delivered in all; "
                f"it was between {bounds.low_ul:g} and {bounds.high_ul:g} µl"
            )
        self._rest()
        reply = self._again("Z", (count, _HEX8))
        if isinstance(reply, wire.Refusal):
            raise DeviceError(f"{self._name}: cannot take over {volume_ul:g} µl: {reply.why}")
        self._unsure = None

    @contextmanager
    def _no_dose(self, what: str) -> Iterator[None]:
        """While no dose runs; waits for one that has been stopped, not for one that runs."""
        settled_s = 10.0 * BANNER_S * self._settings.time_scale
        if not self._dosing.acquire(timeout=settled_s if self.stopped else 0.0):
            raise DeviceError(f"{self._name}: cannot {what} while it doses; stop it first")
        try:
            yield
        finally:
            self._dosing.release()

    def close(self) -> None:
        """Stop a dose that runs, and let go of the port."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        if self._dosing.locked():
            self.stop()
        ended = self._dosing.acquire(timeout=10.0 * BANNER_S * self._settings.time_scale)
        self._line.close()
        if ended:
            self._dosing.release()

    # -- the line ----------------------------------------------------------------------------------------------------

    def _identify(self, banner: wire.Banner | None) -> wire.Identity:
        if banner and banner.protocol != wire.PROTOCOL:
            raise self._other_version(banner.protocol)
        try:
            identity = self._again("I")
        except NoReplyError as error:
            raise DeviceError(f"{self._name}: no tankrig doser answers there; check the port and the board") from error
        if not isinstance(identity, wire.Identity) or identity.protocol != wire.PROTOCOL:
            raise self._other_version(getattr(identity, "protocol", 0))
        wanted = self._settings.serial
        if wanted is not None and wanted != identity.serial:
            raise DeviceError(f"{self._name}: is doser {identity.serial}, the rig file wants {wanted}; check the port")
        return identity

    def _other_version(self, version: int) -> DeviceError:
        return DeviceError(f"{self._name}: speaks protocol {version}, not {wire.PROTOCOL}; update its firmware")

    def _status(self) -> wire.State:
        reply = self._again("S")
        if not isinstance(reply, wire.State):
            raise DeviceError(f"{self._name}: refused to tell its status; reset it")
        return reply

    def _again(self, command: str, *arguments: tuple[int, int]) -> wire.Reply:
        """Ask what may be asked twice, until a reply comes."""
        try:
            for _ in range(ATTEMPTS - 1):
                with suppress(NoReplyError):
                    return self._line.ask(command, *arguments)
            return self._line.ask(command, *arguments)
        except LineLostError:
            self._stop_asked.set()
            raise

    # -- steps and volumes -------------------------------------------------------------------------------------------

    def _steps(self, total_ul: float) -> int:
        if not math.isfinite(total_ul) or not 0 <= total_ul * self._steps_per_ul < 0xFFFFFFFF:
            raise DeviceError(f"{self._name}: {total_ul:g} µl is not a volume it can deliver")
        return math.floor(total_ul * self._steps_per_ul + 1e-6)

    def _volume(self, state: wire.State) -> Delivered:
        return self._between(state.low, state.count, state.count)

    def _between(self, low: int, high: int, best: int | None = None) -> Delivered:
        best = (low + high) // 2 if best is None else best
        scale = self._steps_per_ul
        return Delivered(best / scale, low / scale, high / scale)

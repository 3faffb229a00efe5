"""The rig doser's board on its line, as `drivers.dosing.pump.Pump` (firmware_notes/rig_doser.md).

Absolute targets, dose numbers, latches, caps and the count are kept by its firmware.
"""

from collections.abc import Callable
from contextlib import suppress

from drivers.clock import Clock
from drivers.dosing.pump import Count, Leg, NotSetOffError, Standing
from drivers.serial_line import NoReplyError, PortOpener, open_port
from tankrig.errors import DeviceError

from . import wire
from .line import RigDoserLine
from .settings import RigDoserSettings

ATTEMPTS = 3
_HEX4, _HEX8 = 4, 8


class RigPump:
    """A board that speaks the rig doser's protocol. Ticks are motor steps.

    Parameters
    ----------
    settings
        From the rig file.
    name
        For messages, until its serial number is known.
    clock, opener
        Its time, and how its port is opened.

    Raises
    ------
    DeviceError
        If the port cannot be opened.
    """

    increment, most = 1, 0xFFFFFFFE

    def __init__(self, settings: RigDoserSettings, name: str, clock: Clock, opener: PortOpener = open_port) -> None:
        self._settings, self.name = settings, name
        self.ticks_per_ul = settings.steps_per_ul
        self._identity: wire.Identity
        self._last: wire.State
        self._most_ever: int | None = None
        """Steps that cannot have been passed, from what it counted and was told to do in this program."""
        self._line = RigDoserLine(settings.port, name, clock, opener)

    # -- who -----------------------------------------------------------------------------------------------------------

    def greet(self) -> Standing:
        """Wait for the board, which opening the port resets; see who it is, and stop it if it runs."""
        banner = self._line.wait_for_banner()
        if banner and banner.protocol not in wire.PROTOCOLS:
            raise self._other_version(banner.protocol)
        try:
            identity = self._again("I")
        except NoReplyError as error:
            raise DeviceError(f"{self.name}: no tankrig doser answers there; check the port and the board") from error
        if not isinstance(identity, wire.Identity) or identity.protocol not in wire.PROTOCOLS:
            raise self._other_version(getattr(identity, "protocol", 0))
        wanted = self._settings.serial
        if wanted is not None and wanted != identity.serial:
            raise DeviceError(f"{self.name}: is doser {identity.serial}, the rig file wants {wanted}; check the port")
        self._identity = identity
        standing = self.rest()
        self.name = f"doser {identity.serial} on {self._settings.port}"
        return standing

    def _other_version(self, version: int) -> DeviceError:
        known = " or ".join(f"{number:02X}" for number in wire.PROTOCOLS)
        return DeviceError(f"{self.name}: speaks protocol {version:02X}, not {known}; update its firmware or tankrig")

    @property
    def identity(self) -> str:
        """By its serial number."""
        return f"rig-doser {self._identity.serial}"

    @property
    def dose_cap(self) -> int | None:
        """The firmware's cap for one dose."""
        return self._identity.dose_cap

    # -- counting ------------------------------------------------------------------------------------------------------

    def answers(self) -> bool:
        """Whether it answers one status request."""
        try:
            self._line.ask("S")
        except NoReplyError:
            return False
        return True

    def rest(self, leg: Leg | None = None) -> Standing:
        """Its status once the motor rests; stops it if it runs."""
        state = self._status()
        for _ in range(ATTEMPTS):
            if not state.moving:
                return self._standing(state, leg)
            self._line.stop()
            state = self._status()
        raise NoReplyError(f"{self.name}: does not stop; pull its power")

    def _standing(self, state: wire.State, leg: Leg | None) -> Standing:
        self._last, high = state, state.count
        if state.reason is wire.Reason.MEMORY and self._most_ever is not None:
            high = min(high, self._most_ever)  # it has lost its count, which this program has seen
        else:
            self._most_ever = state.count
        return Standing(
            total=Count(high, min(state.low, high), high),
            known=wire.Flag.UNSURE not in state.flags,
            reached=leg is None or (state.count == leg.end and state.reason is wire.Reason.REACHED),
            stopped=wire.Flag.STOPPED in state.flags,
            why=wire.REASONS[state.reason],
        )

    def remember_unknown(self, low: int, high: int) -> None:
        """Nothing: its firmware remembers, and tells the next program."""

    def assign(self, total: Count) -> None:
        """Have the firmware take over that count."""
        known_stops = [(self._last.stops, _HEX4)] if self._identity.protocol >= wire.RESOLVES_NAME_STOPS else []
        reply = self._again("Z", (total.best, _HEX8), *known_stops)
        if isinstance(reply, wire.Refusal):
            raise DeviceError(f"{self.name}: cannot take over {total.best} steps: {reply.why}")

    # -- moving --------------------------------------------------------------------------------------------------------

    def refusal(self, target: int, now: Count) -> str | None:
        """Refused beyond its lifetime cap."""
        left = self._identity.life_cap - self._last.life
        if target - now.best <= left:
            return None
        return f"{left / self.ticks_per_ul:g} µl of its lifetime are left; refill it and commission it anew"

    def prepare(self, target: int) -> Leg | None:
        """The whole dose at once, if anything is missing."""
        missing = target - self._last.count
        return Leg(target, missing / self._identity.rate) if missing > 0 else None

    def set_off(self, target: int, leg: Leg, unless: Callable[[], bool]) -> None:
        """Have the dose taken; sent again only after a status has shown that it was not, with the same number."""
        self._most_ever = max(self._most_ever or 0, target)
        dose_id = self._last.id + 1
        for _ in range(ATTEMPTS):
            if unless():
                raise NotSetOffError(f"{self.name}: a stop is latched; clear it first")
            try:
                reply = self._line.ask("D", (dose_id, _HEX8), (leg.end, _HEX8))
            except NoReplyError:
                reply = self._status()
            if isinstance(reply, wire.Refusal):
                raise NotSetOffError(f"{self.name}: refused a dose: {reply.why}")
            if isinstance(reply, wire.State) and reply.id == dose_id:
                return
        raise NotSetOffError(f"{self.name}: did not take a dose in {ATTEMPTS} attempts; check the cable")

    def poll(self) -> tuple[bool, Count | None]:
        """Its status; the encoder may not have seen the last step yet."""
        state = self._status()
        return state.moving, Count(state.count, state.low, state.count)

    def stop(self) -> None:
        """The stop byte, three times. It is no request, so that it feeds nothing."""
        self._line.stop()

    def clear(self) -> None:
        """Clear the latch, unless a stop has come that was not told of."""
        reply = self._again("C", (self._last.stops, _HEX4))
        if isinstance(reply, wire.Refusal):
            raise DeviceError(f"{self.name}: cannot clear its stop: {reply.why}")

    def leave_alone(self) -> None:
        """Nothing: its watchdog minds only while the motor runs."""

    def close(self) -> None:
        """Let go of the port."""
        self._line.close()

    # -- asking --------------------------------------------------------------------------------------------------------

    def _status(self) -> wire.State:
        reply = self._again("S")
        if not isinstance(reply, wire.State):
            raise DeviceError(f"{self.name}: refused to tell its status; reset it")
        return reply

    def _again(self, command: str, *arguments: tuple[int, int]) -> wire.Reply:
        """Ask what may be asked twice, until a reply comes."""
        for _ in range(ATTEMPTS - 1):
            with suppress(NoReplyError):
                return self._line.ask(command, *arguments)
        return self._line.ask(command, *arguments)

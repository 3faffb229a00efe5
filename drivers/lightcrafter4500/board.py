"""What a LightCrafter 4500 is asked to do, step by step as TI's guide has it, each step read back before the next."""

import logging
from collections.abc import Callable
from contextlib import suppress

from drivers.clock import Clock
from tankrig.errors import DeviceError

from .pattern_table import PatternTable
from .usb_link import NAME, UsbLink

POWER, INPUT, VIDEO, STATUS, MODE = 0x0200, 0x1A00, 0x071C, 0x1A0C, 0x1A1B
SOURCE, TRIGGER, RUN, TIMING, VALIDATE = 0x1A22, 0x1A23, 0x1A24, 0x1A29, 0x1A1A
LUT, MAILBOX_AT, MAILBOX, MAILBOX_DATA = 0x1A31, 0x1A32, 0x1A33, 0x1A34

_log = logging.getLogger(__name__)

_ON = 0
_STOPPED, _STARTED = 0, 2
_VIDEO_MODE, _PATTERN_MODE = 0, 1
_FROM_VIDEO, _FROM_FLASH = 0, 3
_BY_VIDEO, _BY_TRIGGER = 0, 1
_CLOSED, _IMAGES, _PATTERNS = 0, 1, 2
_PARALLEL_PORT = 0
_LOCK_BITS, _LOCKED = 0x03, 2
_VIDEO_STATUS_BYTES = 28
_SEQUENCER_RUNS = 0x02
_VALIDATING = 0x80
_STARTS = 2

_POLL_S = 0.05
_WAKE_S, _STOP_S, _LOCK_S, _MODE_S, _VALIDATION_S, _START_S = 5.0, 2.0, 3.0, 1.0, 2.0, 0.3

_ERRORS = {
    0x01: "exposure or period out of range; correct refresh_hz and exposure_us",
    0x02: "pattern number out of range; correct flash",
}
_WARNINGS = {
    0x04: "its trigger output 1 is held over black",
    0x08: "there is no black after a pattern before an external trigger",
    0x10: "exposures end less than 230 µs before the next pattern",
}


class PatternBoard:
    """A LightCrafter 4500 behind its USB.

    Parameters
    ----------
    link
        To it.
    clock
        Of all waits.

    Attributes
    ----------
    warnings
        What it had to say about the settings that it accepted.
    """

    def __init__(self, link: UsbLink, clock: Clock) -> None:
        self._link, self._clock = link, clock
        self.warnings: tuple[str, ...] = ()

    def wake(self) -> None:
        """Bring it out of standby, if it is there; that takes 2 s, and the command that does it is not acknowledged.

        Raises
        ------
        DeviceError
            If it stays asleep.
        """
        if self._byte(POWER) == _ON:
            return
        self._link.tell(POWER, bytes([_ON]))
        if not self._comes(lambda: self._byte(POWER) == _ON, _WAKE_S):
            raise DeviceError(f"{NAME}: does not wake from standby within {_WAKE_S:g} s; switch it off and on")

    def stop(self) -> None:
        """Stop the sequence that runs or is paused; while one does, no setting is accepted.

        Raises
        ------
        DeviceError
            If it does not stop.
        """

        def stopped() -> bool:
            self._link.write(RUN, bytes([_STOPPED]))
            return self._byte(RUN) == _STOPPED

        if not self._comes(stopped, _STOP_S):
            raise DeviceError(f"{NAME}: goes on showing its patterns when told to stop; switch it off and on")

    def tell_stop(self) -> None:
        """Tell it to stop, and wait for nothing: for a board that answers no more."""
        with suppress(DeviceError):
            self._link.tell(RUN, bytes([_STOPPED]))

    def enter_pattern_mode(self) -> None:
        """Lock to the video input, and only then enter pattern mode; else it would run and show nothing.

        Raises
        ------
        DeviceError
            If it sees no video, or does not change its mode.
        """
        self._enter(_VIDEO_MODE)
        self._link.write(INPUT, bytes([_PARALLEL_PORT]))
        if not self._comes(self._locked, _LOCK_S):
            raise DeviceError(
                f"{NAME}: sees no video at its HDMI input; check the HDMI cable, and that the desktop has the screen on"
            )
        self._enter(_PATTERN_MODE)

    def load(self, table: PatternTable) -> None:
        """Take over a table of patterns, and have it validated; the sequence has to be stopped.

        Raises
        ------
        DeviceError
            If it does not accept the table. What it only warns of is in `warnings`.
        """
        write = self._link.write
        write(SOURCE, bytes([_FROM_FLASH if table.from_flash else _FROM_VIDEO]))
        write(LUT, table.configuration())
        write(TRIGGER, bytes([_BY_TRIGGER if table.from_flash else _BY_VIDEO]))
        write(TIMING, table.times())
        if table.from_flash:
            self._put(_IMAGES, bytes(table.images))
        self._put(_PATTERNS, table.pattern_lines())
        write(VALIDATE, b"\0")
        self._require_valid()

    def start(self) -> None:
        """Start the sequence that was loaded, again if the first start is lost, and make sure that patterns come.

        Raises
        ------
        DeviceError
            If it does not start, or nothing comes of it.
        """
        for _ in range(_STARTS):
            self._link.write(RUN, bytes([_STARTED]))
            if self._comes(lambda: self._byte(RUN) == _STARTED, _START_S):
                break
        else:
            raise DeviceError(f"{NAME}: does not start its patterns, told {_STARTS} times; switch it off and on")
        if not self._comes(self._displays, _START_S):
            raise DeviceError(
                f"{NAME}: has started and shows nothing; check the HDMI cable, switch it off and on, and open it again"
            )

    def start_once(self) -> None:
        """Start a sequence that is shown once: told once only, so that it is never shown twice."""
        self._link.write(RUN, bytes([_STARTED]))

    def require_displaying(self) -> None:
        """Make sure that the patterns of the video input are on the mirrors.

        Raises
        ------
        DeviceError
            If they are not.
        """
        if not self._locked():
            raise DeviceError(f"{NAME}: has lost the video at its HDMI input; check the HDMI cable and open it again")
        if not self._displays():
            raise DeviceError(f"{NAME}: has stopped showing patterns; switch it off and on, and open it again")

    def _enter(self, mode: int) -> None:
        self._link.write(MODE, bytes([mode]))
        if not self._comes(lambda: self._byte(MODE) == mode, _MODE_S):
            which = "pattern" if mode == _PATTERN_MODE else "video"
            raise DeviceError(f"{NAME}: does not enter {which} mode; switch it off and on")

    def _put(self, mailbox: int, data: bytes) -> None:
        for command, sent in ((MAILBOX, bytes([mailbox])), (MAILBOX_AT, b"\0"), (MAILBOX_DATA, data)):
            self._link.write(command, sent)
        self._link.write(MAILBOX, bytes([_CLOSED]))

    def _require_valid(self) -> None:
        status = _VALIDATING

        def validated() -> bool:
            nonlocal status
            status = self._byte(VALIDATE)
            return not status & _VALIDATING

        if not self._comes(validated, _VALIDATION_S):
            raise DeviceError(f"{NAME}: does not come to an end of checking its settings; switch it off and on")
        for bit, complaint in _ERRORS.items():
            if status & bit:
                raise DeviceError(f"{NAME}: does not accept its settings: {complaint}")
        self.warnings = tuple(said for bit, said in _WARNINGS.items() if status & bit)
        for said in self.warnings:
            _log.info("%s: accepts its settings and warns that %s", NAME, said)

    def _locked(self) -> bool:
        return self._link.read(VIDEO, _VIDEO_STATUS_BYTES)[0] & _LOCK_BITS == _LOCKED

    def _displays(self) -> bool:
        return bool(self._byte(STATUS) & _SEQUENCER_RUNS)

    def _byte(self, command: int) -> int:
        return self._link.read(command, 1)[0]

    def _comes(self, true: Callable[[], bool], within_s: float) -> bool:
        """Whether something becomes true in time."""
        deadline_s = self._clock.monotonic() + within_s
        while not true():
            if self._clock.monotonic() > deadline_s:
                return False
            self._clock.sleep(_POLL_S)
        return True

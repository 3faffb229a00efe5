"""A LightCrafter 4500 as a projector: USB makes it show every refresh of its HDMI input as one 8-bit pattern."""

import logging
import threading
from collections.abc import Callable
from typing import Any

from drivers.clock import Clock, SystemClock
from drivers.hdmi.projector import HdmiProjector
from tankrig.devices import Confirming, Flip, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .board import PatternBoard
from .pattern_table import LED, Line, PatternTable, Trigger
from .settings import LightcrafterSettings
from .usb_link import NAME, UsbLink

_log = logging.getLogger(__name__)


class Lightcrafter:
    """Implements `tankrig.devices.Projector` and `Confirming`.

    Parameters
    ----------
    settings
        From the rig file.
    backend
        Of pyusb.
    window
        Makes the projector that feeds its HDMI input.
    clock
        Of all waits for its USB.

    Raises
    ------
    DeviceError
        When its USB or its screen is not there, it sees no video, or it does not accept its settings.
    """

    def __init__(
        self,
        settings: LightcrafterSettings,
        backend: Any = None,
        window: Callable[[LightcrafterSettings], Projector] = HdmiProjector,
        clock: Clock | None = None,
    ) -> None:
        self._settings = settings
        self._turn = threading.Lock()
        self._closed = False
        clock = clock or SystemClock()
        self._link = UsbLink(backend, clock)
        self._board = PatternBoard(self._link, clock)
        try:
            self._board.wake()
            self._window = window(settings)
            try:
                self._board.stop()
                self._board.enter_pattern_mode()
                self._board.load(_each_refresh(settings))
                self._board.start()
            except BaseException:
                self._board.tell_stop()
                self._window.close()
                raise
        except BaseException:
            self._link.close()
            raise

    @property
    def name(self) -> str:
        """For messages."""
        return f"{NAME} at {self._window.name}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._settings.shape

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the board had to say about the settings that it accepted."""
        return self._board.warnings

    def show(self, pattern: Pattern) -> Flip:
        """Swap `pattern` onto its HDMI input, and return when it is there.

        Raises
        ------
        DeviceError
            If the pattern has another shape, the screen is gone or does not swap in time, the board does not show its
            input, or this is closed.
        """
        with self._turn:
            self._require_open()
            flip = self._window.show(pattern)
            self._board.require_displaying()
            return flip

    def confirm(self) -> None:
        """Make sure that what was shown last is still on its HDMI input, and that the board shows its input.

        Raises
        ------
        DeviceError
            If the screen is gone, the board shows nothing, or this is closed.
        """
        with self._turn:
            self._require_open()
            if isinstance(self._window, Confirming):
                self._window.confirm()
            self._board.require_displaying()

    def close(self) -> None:
        """Stop the board's patterns and make sure that it has, which leaves it dark; let go of USB and screen."""
        with self._turn:
            if self._closed:
                return
            self._closed = True
            try:
                self._window.close()
            finally:
                self._go_dark()

    def _go_dark(self) -> None:
        try:
            self._board.stop()
        except DeviceError as error:
            self._board.tell_stop()
            _log.warning("%s; nobody can tell whether it is dark: look at it", error)
        finally:
            self._link.close()

    def _require_open(self) -> None:
        if self._closed:
            raise DeviceError(f"{self.name}: is closed; open it again")


def _each_refresh(settings: LightcrafterSettings) -> PatternTable:
    """The video input as one 8-bit pattern of each refresh: pattern 0 is the 8 bits of green."""
    period_us = settings.period_us
    exposure_us = settings.exposure_us or period_us
    line = Line(0, 8, LED[settings.led], Trigger.RISING, black=exposure_us < period_us)
    return PatternTable((line,), exposure_us, period_us)

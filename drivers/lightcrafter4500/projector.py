"""A LightCrafter 4500 as a projector.

USB makes it show every refresh of its HDMI input as one 8-bit pattern; in a burst, patterns from its flash, each with a
trigger for the camera.
"""

import logging
import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

from drivers.clock import Clock, SystemClock
from drivers.hdmi.projector import HdmiProjector
from tankrig.devices import BurstTiming, Confirming, Flip, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .board import PatternBoard
from .flash import Flash, lines
from .pattern_table import DARK_US, LEAST_EXPOSURE_US, LED, MOST_ENTRIES, PatternTable, TableEntry, Trigger
from .settings import LightcrafterSettings
from .usb_link import NAME, UsbLink

_log = logging.getLogger(__name__)

_WITHIN_US = 200
"""By which a pattern of a burst is lit for less than the camera exposes, so that all of its light is in the frame."""


class Lightcrafter:
    """Implements `tankrig.devices.Projector`, `Confirming` and `BurstProjector`.

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
        self._on_video, self._burst_loaded = False, False
        self._flash = Flash(settings.flash, settings.shape) if settings.flash else None
        clock = clock or SystemClock()
        self._link = UsbLink(backend, clock)
        self._board = PatternBoard(self._link, clock)
        try:
            self._board.wake()
            self._window = window(settings)
            try:
                self._board.stop()
                self._board.enter_pattern_mode()
                self._show_video()
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
            if not self._on_video:
                self._show_video()
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
            if not self._on_video:
                raise DeviceError(f"{self.name}: shows nothing since its burst; show a pattern first")
            if isinstance(self._window, Confirming):
                self._window.confirm()
            self._board.require_displaying()

    def load_burst(self, patterns: Sequence[Pattern], exposure_ms: float) -> BurstTiming:
        """Go dark and get ready to show `patterns`, which are in flash, for a camera that exposes `exposure_ms`.

        Raises
        ------
        DeviceError
            If a pattern is not in flash, they are too many, or `exposure_ms` is too short for them; then what was shown
            goes on. If the board does not accept them, or this is closed.
        """
        with self._turn:
            self._require_open()
            table = self._burst(patterns, exposure_ms)
            self._on_video = False
            self._board.stop()
            self._board.load(table)
            self._burst_loaded = True
            called = self._settings.burst_trigger != "internal"
            return BurstTiming(table.exposure_us / 1e3, None if called else table.period_us / 1e3)

    def play_burst(self) -> None:
        """Show the patterns that were loaded, once, from the first on (as they are called for, where triggered).

        Raises
        ------
        DeviceError
            If none were loaded since the last time, it does not acknowledge, or this is closed.
        """
        with self._turn:
            self._require_open()
            if not self._burst_loaded:
                raise DeviceError(f"{self.name}: has no patterns to show in a burst; load them first")
            self._burst_loaded = False
            self._board.start_once()

    def close(self) -> None:
        """Stop the board's patterns and make sure that it has, which leaves it dark; let go of USB and screen."""
        with self._turn:
            if self._closed:
                return
            self._closed = True
            try:
                self._go_dark()  # before the desktop shows where the window was
            finally:
                self._window.close()

    def _go_dark(self) -> None:
        try:
            self._board.stop()
        except DeviceError as error:
            self._board.tell_stop()
            _log.warning("%s; nobody can tell whether it is dark: look at it", error)
        finally:
            self._link.close()

    def _show_video(self) -> None:
        """Have its HDMI input shown, after whatever it did before."""
        self._board.stop()
        self._burst_loaded = False
        self._board.load(_each_refresh(self._settings))
        self._board.start()
        self._on_video = True

    def _burst(self, patterns: Sequence[Pattern], exposure_ms: float) -> PatternTable:
        settings = self._settings
        if self._flash is None:
            raise DeviceError(f"{self.name}: shows no bursts, since nobody has said what its flash holds; set flash")
        if not 1 <= len(patterns) <= MOST_ENTRIES:
            raise DeviceError(f"{self.name}: shows 1 to {MOST_ENTRIES} patterns in a burst, not {len(patterns)}")
        places = self._flash.places(patterns)
        lit_us = round(1000 * exposure_ms) - _WITHIN_US
        least_us = max(LEAST_EXPOSURE_US[place.bits - 1] for place in places)
        if lit_us < least_us:
            raise DeviceError(
                f"{self.name}: takes {least_us} µs for a pattern of {places[0].bits} bits, and the camera exposes "
                f"{exposure_ms:g} ms; expose {math.ceil((least_us + _WITHIN_US) / 100) / 10:g} ms or longer"
            )
        found, images = lines(places, LED[settings.led], Trigger[settings.burst_trigger.upper()])
        period_us = lit_us + _WITHIN_US + max(DARK_US, round(1000 * settings.burst_gap_ms))
        return PatternTable(found, lit_us, period_us, images)

    def _require_open(self) -> None:
        if self._closed:
            raise DeviceError(f"{self.name}: is closed; open it again")


def _each_refresh(settings: LightcrafterSettings) -> PatternTable:
    """The video input as one 8-bit pattern of each refresh: pattern 0 is the 8 bits of green."""
    period_us = settings.period_us
    exposure_us = settings.exposure_us or period_us
    line = TableEntry(0, 8, LED[settings.led], Trigger.RISING, black=exposure_us < period_us)
    return PatternTable((line,), exposure_us, period_us)

"""A LightCrafter 4500 as a projector: USB makes it show every refresh of its HDMI input as one 8-bit pattern."""

import struct
import time
from collections.abc import Callable
from typing import Any

from drivers.hdmi.projector import HdmiProjector
from tankrig.devices import Confirming, Flip, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .settings import LightcrafterSettings
from .usb_link import NAME, UsbLink

POWER, MODE, SOURCE, TRIGGER, RUN, TIMING = 0x0200, 0x1A1B, 0x1A22, 0x1A23, 0x1A24, 0x1A29
LUT, MAILBOX_AT, MAILBOX, MAILBOX_DATA, VALIDATE = 0x1A31, 0x1A32, 0x1A33, 0x1A34, 0x1A1A
_STOP, _START = 0, 2
_LED = {"red": 1, "green": 2, "blue": 4, "white": 7}
_VALIDATION_S = 2.0
_BUSY = 0x80
_COMPLAINTS = {
    0x01: "exposure or period out of range; correct refresh_hz and exposure_us",
    0x02: "pattern number out of range",
    0x04: "trigger out overlaps; correct exposure_us",
    0x08: "black after the pattern is missing; correct exposure_us",
    0x10: "exposure and period do not go together; correct exposure_us",
}


class Lightcrafter:
    """Implements `tankrig.devices.Projector`.

    Parameters
    ----------
    settings
        From the rig file.
    backend
        Of pyusb.
    window
        Makes the projector that feeds its HDMI input.

    Raises
    ------
    DeviceError
        When its USB or its screen is not there, or it does not accept its settings.
    """

    def __init__(
        self,
        settings: LightcrafterSettings,
        backend: Any = None,
        window: Callable[[LightcrafterSettings], Projector] = HdmiProjector,
    ) -> None:
        self._settings = settings
        self._link = UsbLink(backend)
        try:
            self._window = window(settings)
            try:
                self._set_up()
            except BaseException:
                self._window.close()
                raise
        except BaseException:
            self._link.close()
            raise
        self._closed = False

    @property
    def name(self) -> str:
        """For messages."""
        return f"{NAME} at {self._window.name}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._settings.shape

    def show(self, pattern: Pattern) -> Flip:
        """Swap `pattern` onto its HDMI input, and return when it is there.

        Raises
        ------
        DeviceError
            If the pattern has another shape, the screen is gone or does not swap in time, or this is closed.
        """
        if self._closed:
            raise DeviceError(f"{self.name}: is closed; open it again")
        return self._window.show(pattern)

    def confirm(self) -> None:
        """Make sure that what was shown last is still on its HDMI input.

        Raises
        ------
        DeviceError
            If the screen is gone.
        """
        if isinstance(self._window, Confirming):
            self._window.confirm()

    def close(self) -> None:
        """Go dark and let go of USB and screen."""
        if self._closed:
            return
        self._closed = True
        self._window.close()
        try:
            self._link.write(RUN, bytes([_STOP]))
        except DeviceError:
            pass  # it is gone, and so dark
        finally:
            self._link.close()

    def _set_up(self) -> None:
        settings, write = self._settings, self._link.write
        period_us = settings.period_us
        # Trigger: the HDMI input's vertical synchronisation, positive edge (1); pattern 0 is the 8 bits of green.
        pattern = bytes([1, 8 | _LED[settings.led] << 4, 0])
        for command, data in (
            (RUN, bytes([_STOP])),  # nothing else is accepted while it runs
            (POWER, b"\0"),
            (MODE, b"\1"),
            (SOURCE, b"\0"),
            (LUT, bytes([0, 1, 0, 0])),
            (TRIGGER, b"\0"),
            (TIMING, struct.pack("<II", settings.exposure_us or period_us, period_us)),
            (MAILBOX, b"\2"),
            (MAILBOX_AT, b"\0"),
            (MAILBOX_DATA, pattern),
            (MAILBOX, b"\0"),
            (VALIDATE, b"\0"),
        ):
            write(command, data)
        self._require_valid()
        write(RUN, bytes([_START]))

    def _require_valid(self) -> None:
        deadline = time.monotonic() + _VALIDATION_S
        while (status := self._link.read(VALIDATE)[0]) & _BUSY:
            if time.monotonic() > deadline:
                raise DeviceError(f"{NAME}: does not come to an end of checking its settings; switch it off and on")
            time.sleep(0.01)
        for bit, complaint in _COMPLAINTS.items():
            if status & bit:
                raise DeviceError(f"{NAME}: does not accept its settings: {complaint}")

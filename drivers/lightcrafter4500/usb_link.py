"""Commands to a LightCrafter 4500: 64-byte reports over USB, each acknowledged."""

import errno
import struct
from typing import Any

from tankrig.errors import DeviceError

VENDOR, PRODUCT = 0x0451, 0x6401
_REPORT = 64
_OUT, _IN = 0x01, 0x81
_READ, _REPLY, _ERROR = 0x80, 0x40, 0x20
_TIMEOUT_MS = 1000
NAME = "LightCrafter 4500"


def packed(command: int, data: bytes, sequence: int, read: bool = False) -> bytes:
    """One report.

    Examples
    --------
    >>> packed(0x1A24, b"\\x02", 0)[:8].hex(" ")
    '40 00 03 00 24 1a 02 00'
    """
    flags = _REPLY | (_READ if read else 0)
    return struct.pack("<BBHH", flags, sequence, 2 + len(data), command) + data.ljust(_REPORT - 6, b"\0")


class UsbLink:
    """The one LightCrafter that is connected.

    Parameters
    ----------
    backend
        Of pyusb; its own choice where left out.

    Raises
    ------
    DeviceError
        When there is none, there are several, or this user may not open it.
    """

    def __init__(self, backend: Any = None) -> None:
        import usb.core
        import usb.util

        self._usb = usb
        self._sequence = 0
        self._device = _only(backend)
        try:
            if self._device.is_kernel_driver_active(0):
                self._device.detach_kernel_driver(0)
            self._device.set_configuration()
            usb.util.claim_interface(self._device, 0)
        except usb.core.USBError as error:
            raise self._explained(error, "opened") from error

    def write(self, command: int, data: bytes) -> None:
        """Carry out `command`.

        Raises
        ------
        DeviceError
            When it is refused or not acknowledged in time.
        """
        self._exchange(command, data, read=False)

    def read(self, command: int) -> bytes:
        """The device's answer to `command`."""
        return self._exchange(command, b"", read=True)

    def close(self) -> None:
        """Let go of it; may be called any number of times."""
        self._usb.util.dispose_resources(self._device)

    def _exchange(self, command: int, data: bytes, read: bool) -> bytes:
        self._sequence = (self._sequence + 1) % 256
        try:
            self._device.write(_OUT, packed(command, data, self._sequence, read), _TIMEOUT_MS)
            while True:
                reply = bytes(self._device.read(_IN, _REPORT, _TIMEOUT_MS))
                if len(reply) >= 4 and reply[1] == self._sequence:
                    break  # else a late reply to a command that was given up
        except self._usb.core.USBError as error:
            raise self._explained(error, f"asked for {command:04X}") from error
        if reply[0] & _ERROR:
            raise DeviceError(f"{NAME}: refuses command {command:04X}; switch it off and on, and open it again")
        (length,) = struct.unpack_from("<H", reply, 2)
        return reply[4 : 4 + length]

    def _explained(self, error: Any, tried: str) -> DeviceError:
        match error.errno:
            case errno.EACCES:
                advice = (
                    f'this user may not open it; put SUBSYSTEM=="usb", ATTR{{idVendor}}=="{VENDOR:04x}", MODE="0666" '
                    f"into /etc/udev/rules.d/70-lightcrafter.rules and plug it in again"
                )
            case errno.EBUSY:
                advice = "another program uses it; close that one"
            case errno.ENODEV | errno.EIO | errno.EPIPE:
                advice = "it is gone; plug it in and open it again"
            case _:
                advice = f"it did not answer in time ({error.strerror}); switch it off and on"
        return DeviceError(f"{NAME}: cannot be {tried}: {advice}")


def _only(backend: Any) -> Any:
    import usb.core

    try:
        found = list(usb.core.find(find_all=True, idVendor=VENDOR, idProduct=PRODUCT, backend=backend))
    except usb.core.NoBackendError as error:
        raise DeviceError(f"{NAME}: the USB library is missing; run: sudo apt install libusb-1.0-0") from error
    if len(found) != 1:
        how = "is not connected; plug its USB in" if not found else "is there several times; leave one plugged in"
        raise DeviceError(f"{NAME}: {how}")
    return found[0]

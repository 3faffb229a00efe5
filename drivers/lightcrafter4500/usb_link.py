"""Commands to a LightCrafter 4500: messages in 64-byte reports over USB, each answered within a second or never."""

import errno
import struct
from itertools import count
from typing import Any

from drivers.clock import Clock, SystemClock
from tankrig.errors import DeviceError

VENDOR, PRODUCT = 0x0451, 0x6401
NAME = "LightCrafter 4500"
REPLY_S = 1.0
"""Within which a command is answered; a read that is not is asked once more."""

_REPORT = 64
_OUT, _IN = 0x01, 0x81
_READ, _REPLY, _REFUSED = 0x80, 0x40, 0x20
_HEADER = 4
_MOST_STRAY = 1000
"""Reports that are no answer; at one a millisecond they fill the time of a reply."""
_LEFT_OVER_MS = 10


class SilentError(DeviceError):
    """It did not answer in time."""


def packed(command: int, data: bytes, sequence: int, read: bool = False, reply: bool = True) -> bytes:
    """A command as the reports that carry it, padded to whole ones.

    Examples
    --------
    >>> packed(0x1A24, b"\\x02", 0)[:8].hex(" ")
    '40 00 03 00 24 1a 02 00'
    >>> len(packed(0x1A34, bytes(59), 0))
    128
    """
    flags = (_REPLY if reply else 0) | (_READ if read else 0)
    message = struct.pack("<BBHH", flags, sequence, 2 + len(data), command) + data
    return message + bytes(-len(message) % _REPORT)


class UsbLink:
    """The one LightCrafter that is connected.

    Parameters
    ----------
    backend
        Of pyusb; its own choice where left out.
    clock
        Of the time-outs.

    Raises
    ------
    DeviceError
        When there is none, there are several, or this user may not open it.
    """

    def __init__(self, backend: Any = None, clock: Clock | None = None) -> None:
        import usb.core
        import usb.util

        self._usb, self._clock = usb, clock or SystemClock()
        self._sequence = 0
        self._late: set[int] = set()
        self._taken_from_kernel = False
        self._device = _only(backend)
        try:
            if self._kernel_has_it():
                self._device.detach_kernel_driver(0)
                self._taken_from_kernel = True
            self._device.set_configuration()
            usb.util.claim_interface(self._device, 0)
            self._drop_left_over()
        except usb.core.USBError as error:
            self.close()
            raise self._explained(error, "opened") from error

    def write(self, command: int, data: bytes) -> None:
        """Have `command` carried out; it is sent once, whatever happens to its acknowledgement.

        Raises
        ------
        DeviceError
            When it is refused or not acknowledged in time.
        """
        self._exchange(command, data, read=False)

    def tell(self, command: int, data: bytes) -> None:
        """Send `command` and wait for no acknowledgement.

        Raises
        ------
        DeviceError
            When it cannot be sent.
        """
        self._send(command, data, read=False, reply=False)

    def read(self, command: int, length: int) -> bytes:
        """Ask for the answer of `length` bytes to `command`, once more when none comes.

        Raises
        ------
        DeviceError
            When it is refused, or not answered twice.
        """
        try:
            return self._exchange(command, b"", read=True, length=length)
        except SilentError:
            return self._exchange(command, b"", read=True, length=length)

    def close(self) -> None:
        """Let go of it, and give it back to the kernel; may be called any number of times."""
        try:
            self._usb.util.release_interface(self._device, 0)
            if self._taken_from_kernel:
                self._taken_from_kernel = False
                self._device.attach_kernel_driver(0)
        except self._usb.core.USBError:
            pass  # it is gone
        finally:
            self._usb.util.dispose_resources(self._device)

    def _kernel_has_it(self) -> bool:
        try:
            return bool(self._device.is_kernel_driver_active(0))
        except NotImplementedError:  # on systems whose kernel never takes it
            return False

    def _drop_left_over(self) -> None:
        """Throw away what the board still had to say to the program before."""
        try:
            for _ in range(_MOST_STRAY):
                self._device.read(_IN, _REPORT, _LEFT_OVER_MS)
        except self._usb.core.USBTimeoutError:
            pass  # nothing more

    def _exchange(self, command: int, data: bytes, read: bool, length: int = 0) -> bytes:
        deadline_s = self._clock.monotonic() + REPLY_S
        self._send(command, data, read, reply=True)
        flags = _READ if read else 0
        for _ in range(_MOST_STRAY):
            reply = self._report(command, deadline_s)
            if len(reply) < _HEADER:
                continue  # empty
            if reply[1] != self._sequence or reply[0] & _READ != flags:
                self._late.add(reply[1])  # to a command that was given up
                continue
            if reply[0] & _REFUSED:
                raise DeviceError(
                    f"{NAME}: refuses command {_words(command, data)}; end other programs that use it, switch it off "
                    f"and on, and open it again"
                )
            (told,) = struct.unpack_from("<H", reply, 2)
            if told == length or not read:
                return self._whole(command, reply, told, deadline_s)
        raise SilentError(
            f"{NAME}: sends nothing but empty and late reports in reply to {_words(command, data)}; unplug its USB and "
            f"plug it in again"
        )

    def _send(self, command: int, data: bytes, read: bool, reply: bool) -> None:
        self._sequence = self._next_sequence()
        message = packed(command, data, self._sequence, read, reply)
        try:
            for at in range(0, len(message), _REPORT):
                self._device.write(_OUT, message[at : at + _REPORT], round(1000 * REPLY_S))
        except self._usb.core.USBError as error:
            raise self._explained(error, f"asked for {_words(command, data)}") from error

    def _next_sequence(self) -> int:
        """A number that no late reply had, so that another one like it is not taken for an answer."""
        if len(self._late) > 200:
            self._late.clear()
        return next(number % 256 for number in count(self._sequence + 1) if number % 256 not in self._late)

    def _whole(self, command: int, reply: bytes, length: int, deadline_s: float) -> bytes:
        """The data of a reply, of which all but the first 60 bytes come in reports without a header."""
        data = reply[_HEADER:]
        while len(data) < length:
            data += self._report(command, deadline_s)
        return data[:length]

    def _report(self, command: int, deadline_s: float) -> bytes:
        left_ms = round(1000 * (deadline_s - self._clock.monotonic()))
        try:
            if left_ms > 0:
                return bytes(self._device.read(_IN, _REPORT, left_ms))
        except self._usb.core.USBTimeoutError:
            pass
        except self._usb.core.USBError as error:
            raise self._explained(error, f"asked for {_words(command, b'')}") from error
        raise SilentError(
            f"{NAME}: did not answer {_words(command, b'')} in time, {REPLY_S:g} s; check its USB cable, switch it off "
            f"and on"
        )

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


def _words(command: int, data: bytes) -> str:
    return f"{command:04X}" + (f" ({data[:8].hex(' ')}{' …' if len(data) > 8 else ''})" if data else "")


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

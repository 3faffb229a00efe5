"""The controller behind a USB backend, so that the real pyusb talks to it: HID reports of 64 bytes each way."""

import array
import errno
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core
import usb.util

from .controller import Controller, RefusedError

VENDOR, PRODUCT, SERIAL = 0x0451, 0x6401, "LCR4500-0001"
OUT, IN, REPORT = 0x01, 0x81, 64
READ, REPLY, REFUSED = 0x80, 0x40, 0x20
LONGEST_MESSAGE = 512


@dataclass
class Faults:
    """What goes wrong on the cable, set at any time.

    Parameters
    ----------
    empty_reports, stale_reports
        How many of the next replies are preceded by a report of no bytes, or by a late reply of another command.
    stale_for_ever
        Whether late replies never end, and no true one comes.
    lost_replies
        How many of the next replies do not come.
    refuse_next
        How many of the next commands are refused whatever they are.
    unplugged
        Whether the cable is pulled.
    """

    empty_reports: int = 0
    stale_reports: int = 0
    stale_for_ever: bool = False
    lost_replies: int = 0
    refuse_next: int = 0
    unplugged: bool = False


class LightcrafterOnBus(usb.backend.IBackend):  # type: ignore[misc]
    """One LightCrafter 4500 on the bus: `usb.core.find(backend=LightcrafterOnBus(Controller()))`.

    Parameters
    ----------
    controller
        What answers.
    clock, sleep
        Time, s.
    kernel_driver
        Whether the kernel's HID driver holds the interface until it is detached.
    """

    def __init__(
        self,
        controller: Controller,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        kernel_driver: bool = True,
    ) -> None:
        self.controller, self.faults = controller, Faults()
        self._clock, self._sleep = clock, sleep
        self._kernel_driver = kernel_driver
        self._turn = threading.Lock()
        self._replies: deque[bytes] = deque()
        self._message = bytearray()
        self.commands: list[tuple[bool, int, bytes]] = []

    @property
    def waits_for_more(self) -> bool:
        """Whether it has the beginning of a message that comes in several reports."""
        return bool(self._message)

    # -- reports -------------------------------------------------------------------------------------------------------

    def intr_write(self, _handle: Any, _ep: int, _intf: int, data: "array.array[int]", _timeout: int) -> int:
        """A report to the board; long messages come in several."""
        self._check_plugged()
        with self._turn:
            self._message += data.tobytes()
            length = 4 + int.from_bytes(self._message[2:4], "little")
            if not 6 <= length <= LONGEST_MESSAGE:
                self._message.clear()
            elif len(self._message) >= length:
                message, self._message = bytes(self._message[:length]), bytearray()
                self._obey(message)
        return len(data)

    def intr_read(self, _handle: Any, _ep: int, _intf: int, buffer: "array.array[int]", timeout: int) -> int:
        """The next report from the board."""
        until_s = self._clock() + timeout / 1000
        while True:
            self._check_plugged()
            with self._turn:
                if self.faults.stale_for_ever:
                    self._replies.append(_stale())
                if self._replies:
                    report = self._replies.popleft()[: len(buffer)]
                    buffer[: len(report)] = array.array("B", report)
                    return len(report)
            if self._clock() >= until_s:
                raise usb.core.USBTimeoutError("Operation timed out", errno=errno.ETIMEDOUT)
            self._sleep(min(0.002, timeout / 1000))

    bulk_write, bulk_read = intr_write, intr_read

    def _obey(self, message: bytes) -> None:
        flags, sequence = message[0], message[1]
        command, data, now_s = int.from_bytes(message[4:6], "little"), message[6:], self._clock()
        self.commands.append((bool(flags & READ), command, data))
        self.controller.advance(now_s)
        if self.controller.deaf(command, now_s):
            return
        answer, acknowledged = b"", True
        try:
            if self.faults.refuse_next:
                self.faults.refuse_next -= 1
                raise RefusedError
            if flags & READ:
                answer = self.controller.read(command, now_s)
            else:
                acknowledged = self.controller.write(command, data, now_s)
        except RefusedError:
            flags |= REFUSED
        if flags & REPLY and acknowledged and not self.faults.stale_for_ever:
            self._reply(bytes([flags, sequence]) + len(answer).to_bytes(2, "little") + answer)

    def _reply(self, message: bytes) -> None:
        faults = self.faults
        if faults.lost_replies:
            faults.lost_replies -= 1
            return
        if faults.empty_reports:
            faults.empty_reports -= 1
            self._replies.append(b"")
        if faults.stale_reports:
            faults.stale_reports -= 1
            self._replies.append(_stale())
        for start in range(0, len(message), REPORT):
            self._replies.append(message[start : start + REPORT].ljust(REPORT, b"\0"))

    def _check_plugged(self) -> None:
        if self.faults.unplugged:
            raise usb.core.USBError("No such device (it may have been disconnected)", errno=errno.ENODEV)

    # -- what pyusb asks of a bus --------------------------------------------------------------------------------------

    def enumerate_devices(self) -> Iterator[object]:
        """The boards that are plugged in: one or none."""
        if not self.faults.unplugged:
            yield self

    def get_parent(self, _dev: object) -> None:
        """No hub is between computer and board."""

    def get_device_descriptor(self, _dev: object) -> SimpleNamespace:
        """As the board has it; strings 1 to 3 are maker, product, serial number."""
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0110, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=VENDOR, idProduct=PRODUCT, bcdDevice=0x0200, iManufacturer=1, iProduct=2,
            iSerialNumber=3, bNumConfigurations=1, address=5, bus=1, port_number=1, port_numbers=(1,), speed=2,
        )  # fmt: skip

    def get_configuration_descriptor(self, _dev: object, _config: int) -> SimpleNamespace:
        """The only configuration that the board has."""
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=41, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0xC0, bMaxPower=50, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, _dev: object, intf: int, alt: int, _config: int) -> SimpleNamespace:
        """One HID interface."""
        if intf or alt:
            raise IndexError("there is one interface")
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=2, bInterfaceClass=3,
            bInterfaceSubClass=0, bInterfaceProtocol=0, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, _dev: object, ep: int, _intf: int, _alt: int, _config: int) -> SimpleNamespace:
        """Interrupt in 81 and out 01."""
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(IN, OUT)[ep], bmAttributes=usb.util.ENDPOINT_TYPE_INTR,
            wMaxPacketSize=REPORT, bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, _dev: object) -> "LightcrafterOnBus":
        """Open the board, as long as it is plugged in."""
        self._check_plugged()
        return self

    def close_device(self, _handle: object) -> None:
        """What had come is lost."""
        self._replies.clear()

    def set_configuration(self, _handle: object, _value: int) -> None:
        """As it is."""
        self._check_held()

    def get_configuration(self, _handle: object) -> int:
        """The only one."""
        return 1

    def set_interface_altsetting(self, _handle: object, _intf: int, _alt: int) -> None:
        """As it is."""

    def claim_interface(self, _handle: object, _intf: int) -> None:
        """Busy as long as the kernel has it."""
        self._check_held()

    def _check_held(self) -> None:
        self._check_plugged()
        if self._kernel_driver:
            raise usb.core.USBError("Resource busy", errno=errno.EBUSY)

    def release_interface(self, _handle: object, _intf: int) -> None:
        """Let go of it."""

    def is_kernel_driver_active(self, _handle: object, _intf: int) -> bool:
        """Whether the kernel's HID driver has it."""
        return self._kernel_driver

    def detach_kernel_driver(self, _handle: object, _intf: int) -> None:
        """Take it from the kernel."""
        self._kernel_driver = False

    def attach_kernel_driver(self, _handle: object, _intf: int) -> None:
        """Give it back."""
        self._kernel_driver = True

    def reset_device(self, _handle: object) -> None:
        """What had come is lost."""
        self._replies.clear()

    def clear_halt(self, _handle: object, _ep: int) -> None:
        """Nothing is halted."""

    def ctrl_transfer(
        self, _handle: object, _type: int, request: int, value: int, _index: int, data: Any, _timeout: int
    ) -> int:
        """Answer requests for the strings that name maker, product and serial number; refuse all others."""
        texts = {1: "Texas Instruments", 2: "DLPC350", 3: SERIAL}
        if request != 0x06 or value >> 8 != 3:
            raise usb.core.USBError("Pipe error", errno=errno.EPIPE)
        body = texts[value & 0xFF].encode("utf-16-le") if value & 0xFF else b"\x09\x04"
        block = (bytes([2 + len(body), 3]) + body)[: len(data)]
        data[: len(block)] = array.array("B", block)
        return len(block)


def _stale() -> bytes:
    """A late reply to a command of long ago."""
    return bytes([READ | REPLY, 0xEE, 1, 0, 0x55]).ljust(REPORT, b"\0")

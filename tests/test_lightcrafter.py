"""The LightCrafter 4500 driver through pyusb, against the device's side of the protocol from the programmer's guide."""

# ruff: noqa: ARG002 (a backend's methods take what pyusb gives them)

import errno
import re
import struct
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import usb.backend
import usb.core

from drivers.lightcrafter4500.projector import Lightcrafter
from drivers.lightcrafter4500.settings import LightcrafterSettings
from drivers.lightcrafter4500.usb_link import packed
from drivers.registry import open_device
from tankrig.errors import DeviceError
from tankrig.testing.projector import ProjectorContract


class Board:
    """What the board makes of commands; refuses what comes while it runs, and what it has no place for."""

    def __init__(self) -> None:
        self.mode, self.source, self.power, self.running = 0, 3, 1, True
        self.timing, self.lut, self.mailbox, self.pattern = (0, 0), b"", 0, b""
        self.validated_reads = -1
        self.refuses: set[int] = set()

    def write(self, command: int, data: bytes) -> bool:
        """Whether it is accepted."""
        if command in self.refuses:
            return False
        if self.running and command not in (0x1A24, 0x0200):
            return False
        match command:
            case 0x0200:
                self.power = data[0]
            case 0x1A24:
                if data[0] == 2 and self.validated_reads < 1:
                    return False
                self.running = data[0] == 2
            case 0x1A1B:
                self.mode = data[0]
            case 0x1A22:
                self.source = data[0]
            case 0x1A29:
                self.timing = struct.unpack("<II", data)
            case 0x1A31:
                self.lut = data
            case 0x1A33:
                self.mailbox = data[0]
            case 0x1A34:
                if self.mailbox != 2:
                    return False
                self.pattern = data
            case 0x1A1A:
                self.validated_reads = 0
            case 0x1A23 | 0x1A32:
                pass
            case _:
                return False
        return True

    def read(self, command: int) -> bytes | None:
        if command != 0x1A1A or self.validated_reads < 0:
            return None
        self.validated_reads += 1
        exposure, period = self.timing
        wrong = 0x10 if exposure != period and exposure > period - 230 else 0
        return bytes([0x80 if self.validated_reads == 1 else wrong])


class ScriptedBackend(usb.backend.IBackend):
    """The USB side of one board."""

    def __init__(self) -> None:
        self.board = Board()
        self.boards = 1
        self.kernel_driver = True
        self.claimed = False
        self.replies: list[bytes] = []
        self.fails: int | None = None
        self.silent = False

    def enumerate_devices(self):
        return range(self.boards)

    def get_device_descriptor(self, dev):
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=0x0451, idProduct=0x6401, bcdDevice=0x100, iManufacturer=1, iProduct=2,
            iSerialNumber=0, bNumConfigurations=1, address=dev + 1, bus=1, port_number=1, port_numbers=(1,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev, config):
        if config:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=41, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0xC0, bMaxPower=50, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev, intf, alt, config):
        if intf or alt:
            raise IndexError
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=2, bInterfaceClass=3,
            bInterfaceSubClass=0, bInterfaceProtocol=0, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(0x01, 0x81)[ep], bmAttributes=3, wMaxPacketSize=64,
            bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev):
        self._fail()
        return dev

    def close_device(self, dev_handle):
        self.claimed = False

    def set_configuration(self, dev_handle, config_value):
        assert not self.kernel_driver, "the kernel's HID driver still has it"

    def get_configuration(self, dev_handle):
        return 1

    def claim_interface(self, dev_handle, intf):
        self.claimed = True

    def release_interface(self, dev_handle, intf):
        self.claimed = False

    def is_kernel_driver_active(self, dev_handle, intf):
        return self.kernel_driver

    def detach_kernel_driver(self, dev_handle, intf):
        self.kernel_driver = False

    def intr_write(self, dev_handle, ep, intf, data, timeout):
        self._fail()
        report = bytes(data)
        assert (ep, len(report)) == (0x01, 64)
        flags, sequence, length, command = struct.unpack_from("<BBHH", report)
        told = report[6 : 4 + length]
        answer = self.board.read(command) if flags & 0x80 else (b"" if self.board.write(command, told) else None)
        reply = struct.pack("<BBH", flags | (0x20 if answer is None else 0), sequence, len(answer or b"")) + (
            answer or b""
        )
        self.replies.append(reply.ljust(64, b"\0"))
        return 64

    def intr_read(self, dev_handle, ep, intf, buff, timeout):
        self._fail()
        assert ep == 0x81
        if self.silent or not self.replies:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        reply = self.replies.pop(0)
        buff[: len(reply)] = type(buff)("B", reply)
        return len(reply)

    def _fail(self) -> None:
        if self.fails is not None:
            raise usb.core.USBError("scripted", -1, self.fails)


@pytest.fixture
def usb_side():
    return ScriptedBackend()


def settings(**changes):
    screen = {"model": "DLP"}
    return LightcrafterSettings(**{"screen": screen, "refresh_hz": 60.0, "latency_ms": 30.0, **changes})


@pytest.fixture
def reopen(usb_side, tmp_path):
    opened = []

    def window(settings):
        """Stands for the window at its HDMI input, which has tests of its own."""
        return open_device("simulated-projector", {"folder": tmp_path, "shape": list(settings.shape)})

    def open_again(**changes):
        usb_side.kernel_driver = True
        opened.append(Lightcrafter(settings(**changes), usb_side, window))
        return opened[-1]

    yield open_again
    for projector in opened:
        projector.close()


@pytest.fixture
def projector(reopen):
    return reopen()


def test_it_is_set_up_to_show_its_video_input_as_8_bit_patterns_without_gamma(projector, usb_side):
    board = usb_side.board
    assert (board.mode, board.source, board.power, board.running) == (1, 0, 0, True)
    assert board.timing == (16667, 16667)
    assert board.lut == bytes([0, 1, 0, 0])
    assert board.pattern == bytes([1, 0x78, 0])
    assert board.validated_reads == 2, "the validation was not waited for"
    projector.close()
    assert not board.running
    assert not usb_side.claimed


def test_an_old_reply_is_not_taken_for_this_commands(reopen, usb_side):
    usb_side.replies.append(bytes([0x60, 0xEE, 0, 0]).ljust(64, b"\0"))
    assert reopen().shape == (1140, 912)


def test_a_refused_command_is_named_and_the_window_closed(reopen, usb_side):
    usb_side.board.refuses.add(0x1A29)
    with pytest.raises(DeviceError, match="LightCrafter 4500: refuses command 1A29"):
        reopen()
    assert not usb_side.claimed


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.EACCES, r"may not open it; put SUBSYSTEM==\"usb\", ATTR\{idVendor\}==\"0451\""),
        (errno.EBUSY, "another program uses it"),
        (errno.ENODEV, "it is gone; plug it in"),
    ],
)
def test_what_usb_says_becomes_what_to_do(reopen, usb_side, number, reason):
    usb_side.fails = number
    with pytest.raises(DeviceError, match=reason):
        reopen()


def test_a_board_that_does_not_answer_is_given_up(reopen, usb_side):
    usb_side.silent = True
    began = time.monotonic()
    with pytest.raises(DeviceError, match="did not answer in time"):
        reopen()
    assert time.monotonic() - began < 10.0


@pytest.mark.parametrize(("boards", "reason"), [(0, "is not connected"), (2, "is there several times")])
def test_there_must_be_one(reopen, usb_side, boards, reason):
    usb_side.boards = boards
    with pytest.raises(DeviceError, match=reason):
        reopen()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"exposure_us": 16500}, "exposure_us is the period, 16667, or at most 16437"),
        ({"exposure_us": 100}, "exposure_us"),
        ({"refresh_hz": 240.0}, "give refresh_hz 120 or less"),
    ],
)
def test_times_that_the_mirrors_cannot_keep_are_refused_before_anything_is_sent(changes, reason):
    table = {"screen": {"model": "DLP"}, "refresh_hz": 60.0, "latency_ms": 30.0, **changes}
    with pytest.raises(DeviceError, match=reason):
        open_device("lightcrafter-4500", table)


def test_reports_are_those_of_the_page():
    page = (Path(__file__).parents[1] / "firmware_notes" / "lightcrafter4500.md").read_text()
    vectors = [bytes.fromhex(vector) for vector in re.findall(r"^\| .* \| `([0-9A-F ]+)` \|$", page, re.MULTILINE)]
    assert vectors == [
        packed(0x1A24, b"\x02", 0)[:7],
        packed(0x1A24, b"\x00", 1)[:7],
        packed(0x1A29, struct.pack("<II", 16667, 16667), 7)[:14],
        packed(0x1A1A, b"", 13, read=True)[:6],
    ]


class TestLightcrafter(ProjectorContract):
    @pytest.fixture
    def projector(self, reopen):
        return reopen()

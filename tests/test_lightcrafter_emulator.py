"""The stand-in for a LightCrafter 4500 against its page: bytes and times in, bytes and light out, without a driver."""

from typing import Any

import pytest
import usb.core
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.lightcrafter4500.emulator.backend import LightcrafterOnBus
from drivers.lightcrafter4500.emulator.controller import Controller, Habits


class LightCrafter:
    """A board on the bus of the real pyusb; time goes on while a read waits, and when a test says so."""

    def __init__(self, **habits: Any) -> None:
        self.now_s, self.edges = 0.0, list[tuple[int, float]]()
        self.controller = Controller(Habits(**habits), lambda output, at_s: self.edges.append((output, at_s)))
        self.board = LightcrafterOnBus(self.controller, clock=lambda: self.now_s, sleep=self.wait)
        device = usb.core.find(idVendor=0x0451, idProduct=0x6401, backend=self.board)
        assert device is not None
        self.device, self._sequence = device, 0
        device.detach_kernel_driver(0)
        device.set_configuration()

    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    def send(self, flags: int, command: int, data: bytes = b"") -> None:
        self._sequence = (self._sequence + 1) % 256
        message = bytes([flags, self._sequence, *(2 + len(data)).to_bytes(2, "little"), *command.to_bytes(2, "little")])
        message += data
        for start in range(0, len(message), 64):
            self.device.write(0x01, message[start : start + 64].ljust(64, b"\0"))

    def reply(self) -> bytes:
        return bytes(self.device.read(0x81, 64, timeout=500))

    def write(self, command: int, *data: int) -> bool:
        """Whether it was acknowledged and not refused."""
        self.send(0x40, command, bytes(data))
        reply = self.reply()
        assert reply[1] == self._sequence
        return not reply[0] & 0x20

    def read(self, command: int) -> bytes:
        self.send(0xC0, command)
        reply = self.reply()
        assert reply[1] == self._sequence
        assert not reply[0] & 0x20
        return reply[4 : 4 + int.from_bytes(reply[2:4], "little")]

    def configure(
        self,
        *entries: int,
        exposure_us: int = 16667,
        period_us: int = 16667,
        source: int = 0,
        trigger_mode: int = 0,
        repeat: int = 1,
    ) -> None:
        """Locked to its video, pattern mode, and a table; neither validated nor started."""
        assert self.write(0x1A00, 0)
        self.wait(1.0)
        assert self.write(0x1A1B, 1)
        self.wait(1.0)
        assert self.read(0x1A1B) == b"\1"
        assert self.write(0x1A22, source)
        assert self.write(0x1A23, trigger_mode)
        assert self.write(0x1A29, *exposure_us.to_bytes(4, "little"), *period_us.to_bytes(4, "little"))
        assert self.write(0x1A31, len(entries) - 1, repeat, len(entries) - 1, 0)
        assert self.write(0x1A33, 2)
        assert self.write(0x1A32, 0)
        assert self.write(0x1A34, *b"".join(entry.to_bytes(3, "little") for entry in entries))
        assert self.write(0x1A33, 0)

    def validate(self) -> int:
        assert self.write(0x1A1A, 0)
        assert self.read(0x1A1A)[0] & 0x80
        self.wait(1.0)
        return self.read(0x1A1A)[0]

    def start(self) -> int:
        """How many tries it took."""
        for tries in range(1, 5):
            assert self.write(0x1A24, 2)
            if self.read(0x1A24) == b"\2":
                return tries
        raise AssertionError("it never started")


def entry(number: int = 0, bits: int = 8, trigger: int = 1, black: bool = False, shares: bool = False) -> int:
    return trigger | number << 2 | bits << 8 | 7 << 12 | black << 17 | shares << 19


def test_the_pages_vectors_do_what_they_say() -> None:
    board = LightCrafter()
    for text in ("40 07 0A 00 29 1A 1B 41 00 00 1B 41 00 00", "40 01 03 00 24 1A 00"):
        report = bytes.fromhex(text)
        board.device.write(0x01, report.ljust(64, b"\0"))
        assert board.reply()[:4] == bytes([0x40, report[1], 0, 0])
    assert board.read(0x1A29) == bytes.fromhex("1B4100001B410000")
    board.device.write(0x01, bytes.fromhex("C00D02001A1A").ljust(64, b"\0"))
    assert board.reply()[:5] == bytes.fromhex("C00D010000")


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_start_after_video_mode_is_acknowledged_and_may_need_another_try(lost: int) -> None:
    board = LightCrafter(lost_starts=lost)
    board.configure(entry(black=True))
    assert board.validate() == 0
    assert board.start() == lost + 1
    board.wait(1.0)
    assert board.read(0x1A0C)[0] & 2
    assert len(board.controller.shown) == pytest.approx(60, abs=2)
    assert board.write(0x1A24, 0)
    assert board.read(0x1A24) == b"\0"
    assert board.start() == 1


@pytest.mark.parametrize(
    ("entries", "timing", "said"),
    [
        ([entry(black=True)], {}, 0),
        ([entry(black=True)], {"exposure_us": 8000, "period_us": 8000}, 1),  # 8 bits take 8333 µs
        ([entry(black=True)], {"exposure_us": 17000}, 1),  # longer than its period
        ([entry(black=True)], {"period_us": 17000, "exposure_us": 17000}, 1),  # longer than a video frame
        ([entry(number=3, black=True)], {}, 2),  # three 8-bit pictures in 24 planes
        ([entry(number=24, bits=1, black=True)], {}, 0),  # white fill
        ([entry(bits=1, black=True), entry(1, 1, 3, shares=True)], {"exposure_us": 500, "period_us": 1000}, 4 | 8),
        ([entry()], {}, 8),  # a warning: no post vector before an externally triggered one
        ([entry(black=True)], {"exposure_us": 16500}, 16),  # a warning: dark for 167 µs only
        ([entry(black=True)], {"exposure_us": 16437}, 0),
    ],
)
def test_validation_tells_errors_from_warnings_and_only_errors_forbid_a_start(
    entries: list[int], timing: dict[str, int], said: int
) -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(*entries, **timing)
    assert board.validate() == said
    assert board.write(0x1A24, 2)
    assert board.read(0x1A24)[0] == (0 if said & 3 else 2)


def test_it_does_not_start_unvalidated_or_with_settings_changed_since() -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(entry(black=True))
    assert board.write(0x1A24, 2)
    assert board.read(0x1A24) == b"\0"
    board.validate()
    board.write(0x1A29, *bytes.fromhex("1B4100001B410000"))
    assert board.write(0x1A24, 2)
    assert board.read(0x1A24) == b"\0"


@pytest.mark.parametrize("command", [0x1A1B, 0x1A22, 0x1A23, 0x1A29, 0x1A31, 0x1A33, 0x1A1A])
@pytest.mark.parametrize("action", [1, 2])
def test_while_running_or_paused_settings_are_refused(command: int, action: int) -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(entry(black=True))
    board.validate()
    board.start()
    board.write(0x1A24, action)
    assert not board.write(command, *[1] * 8)
    assert board.write(0x1A24, 0)
    assert board.write(0x1A29, *bytes.fromhex("1B4100001B410000"))


def test_in_standby_and_while_waking_it_knows_its_power_only() -> None:
    board = LightCrafter(in_standby=True)
    assert board.read(0x0200) == b"\1"
    board.send(0xC0, 0x1A1B)
    with pytest.raises(usb.core.USBTimeoutError):
        board.reply()
    board.send(0x40, 0x0200, b"\0")
    with pytest.raises(usb.core.USBTimeoutError):
        board.reply()
    assert board.read(0x0200) == b"\1"
    board.wait(2.0)
    assert board.read(0x0200) == b"\0"
    assert board.read(0x1A1B) == b"\0"


def test_the_video_is_locked_only_when_selected_present_and_given_time() -> None:
    board = LightCrafter()
    assert board.read(0x1A00) == b"\1", "a test pattern at first"
    assert board.read(0x071C)[0] & 3 != 2
    board.write(0x1A00, 0)
    assert board.read(0x071C)[0] & 3 != 2
    board.wait(1.0)
    status = board.read(0x071C)
    assert status[0] & 3 == 2
    assert (int.from_bytes(status[1:3], "little"), int.from_bytes(status[3:5], "little")) == (912, 1140)
    board.controller.frame_s = None
    assert board.read(0x071C)[0] & 3 != 2


def test_pattern_mode_without_a_locked_video_says_running_and_shows_nothing() -> None:
    board = LightCrafter(lost_starts=0, lock_s=5.0)
    board.configure(entry(black=True))
    board.validate()
    assert board.start() == 1
    board.wait(1.0)
    assert board.read(0x1A24) == b"\2"
    assert not board.read(0x1A0C)[0] & 2
    assert board.read(0x1A0A)[0] & 0x40
    assert not board.controller.shown


def test_unknown_commands_and_a_closed_mailbox_are_refused_with_the_nack_bit() -> None:
    board = LightCrafter()
    assert not board.write(0x1AEE, 1)
    assert not board.write(0x1A34, 1, 2, 3)
    assert not board.write(0x1A32, 0)
    board.send(0xC0, 0x1AEE)
    assert board.reply()[0] & 0x20


def test_empty_late_and_lost_reports_reach_pyusb_as_they_are() -> None:
    board = LightCrafter()
    board.board.faults.empty_reports = board.board.faults.stale_reports = 1
    board.send(0xC0, 0x1A24)
    assert board.reply() == b""
    assert board.reply()[1] == 0xEE
    assert board.reply()[1] == 1
    board.board.faults.lost_replies = 1
    board.send(0xC0, 0x1A24)
    with pytest.raises(usb.core.USBTimeoutError):
        board.reply()
    board.board.faults.stale_for_ever = True
    board.send(0xC0, 0x1A24)
    assert {board.reply()[1] for _ in range(100)} == {0xEE}
    board.board.faults.unplugged = True
    with pytest.raises(usb.core.USBError, match="No such device"):
        board.reply()
    assert usb.core.find(idVendor=0x0451, backend=board.board) is None


def test_the_kernels_driver_has_to_be_detached() -> None:
    device = usb.core.find(idVendor=0x0451, backend=LightcrafterOnBus(Controller()))
    assert device is not None
    assert device.is_kernel_driver_active(0)
    with pytest.raises(usb.core.USBError, match="busy"):
        device.write(0x01, bytes(64))
    device.detach_kernel_driver(0)
    assert device.write(0x01, bytes(64)) == 64


def test_a_long_table_comes_in_several_reports_and_reads_back() -> None:
    board = LightCrafter(lost_starts=0)
    entries = [entry(number, 1, 3 if number else 0) for number in range(24)] * 2
    board.configure(*entries, exposure_us=300, period_us=300, source=3, trigger_mode=1)
    assert board.validate() == 0
    board.write(0x1A33, 2)
    board.send(0xC0, 0x1A34)
    blocks = [board.reply() for _ in range(3)]
    assert b"".join(blocks)[4 : 4 + 3 * 48] == b"".join(line.to_bytes(3, "little") for line in entries)


@pytest.mark.parametrize("rate_hz", [100, 500, 2000])
def test_each_trigger_shows_the_next_pattern_and_triggers_the_camera(rate_hz: int) -> None:
    board = LightCrafter(lost_starts=0)
    entries = [entry(number, 1, black=True) for number in range(10)]
    board.configure(*entries, exposure_us=235, period_us=465, source=3, trigger_mode=1)
    assert board.validate() == 0
    board.start()
    began_s = board.now_s + 0.01
    shown = [board.controller.trigger_in(began_s + i / rate_hz) for i in range(1000)]
    assert all(shown)
    assert [pattern.line for pattern in board.controller.shown] == [i % 10 for i in range(1000)]
    cameras = [at_s for output, at_s in board.edges if output == 1]
    assert cameras == [pattern.from_s for pattern in board.controller.shown]
    assert sum(output == 2 for output, _ in board.edges) == 100


def test_a_trigger_within_the_period_is_missed_and_falling_edges_are_none() -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(entry(0, 1, black=True), exposure_us=235, period_us=1000, source=3, trigger_mode=1)
    board.validate()
    board.start()
    began_s = board.now_s + 0.01
    edges = [board.controller.trigger_in(began_s + t) for t in (0.0, 0.0005, 0.001)]
    assert edges == [True, False, True]
    assert board.controller.missed_triggers == 1
    assert not board.controller.trigger_in(began_s + 1.0, rising=False)


@settings(deadline=None)
@given(st.lists(st.integers(0, 255), min_size=64, max_size=64), st.integers(0, 3))
def test_no_report_whatsoever_ends_the_board(report: list[int], repeats: int) -> None:
    board = LightCrafter()
    for _ in range(repeats + 1):
        board.device.write(0x01, bytes(report))
    while board.board.waits_for_more:  # the rest of what it takes for a longer message
        board.device.write(0x01, bytes(64))
    board.wait(5.0)
    board.send(0xC0, 0x0200)
    assert any(board.reply()[1] == 1 for _ in range(60))

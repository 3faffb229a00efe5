"""The LightCrafter 4500 driver through pyusb: what a rig file may say, who may open it, and a projector's contract."""

import errno
import re
import struct
from pathlib import Path

import pytest
import usb.core

from drivers.lightcrafter4500.emulator.backend import LightcrafterOnBus
from drivers.lightcrafter4500.emulator.controller import Controller, Habits
from drivers.lightcrafter4500.projector import Lightcrafter
from drivers.lightcrafter4500.settings import LightcrafterSettings
from drivers.lightcrafter4500.usb_link import packed
from drivers.registry import open_device
from tankrig.errors import DeviceError
from tankrig.testing.projector import ProjectorContract

from .lightcrafter_bench import LightcrafterBench


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.EACCES, r"may not open it; put SUBSYSTEM==\"usb\", ATTR\{idVendor\}==\"0451\""),
        (errno.EBUSY, "another program uses it"),
        (errno.ENODEV, "it is gone; plug it in"),
    ],
)
def test_what_usb_says_becomes_what_to_do(monkeypatch, number, reason):
    def fails(*_):
        raise usb.core.USBError("scripted", -1, number)

    bench = LightcrafterBench()
    monkeypatch.setattr(bench.board, "open_device", fails)
    with pytest.raises(DeviceError, match=reason):
        bench.open()


@pytest.mark.parametrize(("boards", "reason"), [(0, "is not connected"), (2, "is there several times")])
def test_there_must_be_one(monkeypatch, boards, reason):
    bench = LightcrafterBench()
    monkeypatch.setattr(bench.board, "enumerate_devices", lambda: iter([object()] * boards))
    with pytest.raises(DeviceError, match=reason):
        bench.open()


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
    """Over a window that swaps in real time, on a stand-in that is quick to lock, to change mode and to validate."""

    @pytest.fixture
    def reopen(self, tmp_path):
        board = LightcrafterOnBus(Controller(Habits(mode_s=0.0, validate_s=0.0, lock_s=0.0)))
        table = LightcrafterSettings(screen={"model": "DLP"}, refresh_hz=60.0, latency_ms=30.0)
        opened = []

        def window(settings):
            return open_device("simulated-projector", {"folder": tmp_path, "shape": list(settings.shape)})

        def open_again():
            opened.append(Lightcrafter(table, board, window))
            return opened[-1]

        yield open_again
        for projector in opened:
            projector.close()

"""Every fault of line and board ends in a clear state: what was delivered has true bounds, or is latched unknown."""

import os
import threading
import time
import tty
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.emulator.frames import framed
from drivers.rig_doser.line import RigDoserLine
from drivers.rig_doser.wire import Refusal
from tankrig.errors import DeviceError, UndecidedError

from .doser_bench import Bench
from .virtual_time import World


@pytest.fixture
def bench(tmp_path: Path):
    with Bench(tmp_path, dose_cap=20_000) as bench:
        yield bench


@pytest.fixture
def doser(bench: Bench) -> RigDoser:
    return bench.open()


def assert_bounds_hold(doser: RigDoser, bench: Bench) -> None:
    _, low, high = doser.delivered()
    assert low - 1e-9 <= bench.true_ul <= high + 1e-9


def test_a_lossy_line_delays_a_dose_and_changes_nothing_else(bench: Bench, doser: RigDoser) -> None:
    for i, faults in enumerate(({"lose": 0.003}, {"corrupt": 0.003}, {"duplicate": 0.5}), start=1):
        bench.no_faults()
        bench.faults(**faults)
        doser.dose_to(30.0 * i)
        assert bench.true_ul == 30.0 * i


def test_late_replies_are_not_taken_for_others(bench: Bench, doser: RigDoser) -> None:
    bench.faults(delay_ms=400.0)  # longer than the driver waits: each reply arrives during the next request
    with pytest.raises(DeviceError):
        doser.dose_to(50.0)
    bench.no_faults()
    time.sleep(0.3)
    if doser.stopped:
        doser.clear_stop()
    doser.dose_to(60.0)
    assert bench.true_ul == 60.0


@pytest.mark.parametrize(
    ("fault", "why"), [("reset_after", "reset"), ("stall_after", "stalled"), ("unplug_after", "line is gone")]
)
@pytest.mark.parametrize("steps", [0, 1, 37, 299])
def test_what_befalls_a_dose_in_the_middle_is_told(
    bench: Bench, doser: RigDoser, fault: str, why: str, steps: int
) -> None:
    bench.faults(**{fault: steps})
    with pytest.raises(DeviceError, match=why):
        doser.dose_to(30.0)
    assert bench.true_ul == steps / 10
    assert doser.stopped
    assert_bounds_hold(doser, bench)


def test_a_stalled_doser_waits_for_a_person(bench: Bench, doser: RigDoser) -> None:
    bench.faults(stall_after=100)
    with pytest.raises(UndecidedError):
        doser.dose_to(30.0)
    bench.no_faults()
    assert doser.unknown
    doser.clear_stop()
    with pytest.raises(UndecidedError):
        doser.dose_to(30.0)
    with pytest.raises(DeviceError, match="between"):
        doser.resolve(25.0)
    doser.resolve(bench.true_ul)
    assert not doser.unknown
    doser.dose_to(30.0)
    assert bench.true_ul == 30.0


def test_a_silent_doser_is_unknown_and_a_new_program_asks_it(bench: Bench, doser: RigDoser) -> None:
    def silence() -> None:
        while bench.true_ul < 2.0:
            time.sleep(0.001)
        bench.faults(mute=True, deaf=True)

    silencer = threading.Thread(target=silence)
    silencer.start()
    with pytest.raises(UndecidedError, match="no reply"):
        doser.dose_to(2000.0)
    silencer.join()
    assert doser.unknown
    assert bench.true_ul < 2000.0, "the watchdog has not stopped the motor"
    assert_bounds_hold(doser, bench)
    bench.no_faults()
    doser.close()
    again = bench.open()
    assert again.delivered().low_ul == again.delivered().high_ul == pytest.approx(bench.true_ul)
    assert again.stopped


def test_a_pulled_cable_is_told_at_once_and_the_doser_comes_back_by_its_link(bench: Bench, doser: RigDoser) -> None:
    doser.dose_to(10.0)
    bench.do("unplug")
    with pytest.raises(DeviceError, match="plug it in"):
        doser.delivered()
    assert doser.stopped
    assert not doser.unknown, "nothing moved"
    doser.close()
    with pytest.raises(DeviceError, match="plugged in"):
        bench.open()
    bench.do("plug")
    assert bench.open().delivered().volume_ul == 10.0


def test_lost_memory_is_said_and_the_life_cap_holds(bench: Bench, doser: RigDoser) -> None:
    doser.dose_to(10.0)
    bench.do("forget")
    time.sleep(0.1)
    with pytest.raises(UndecidedError):
        doser.dose_to(20.0)
    doser.resolve(10.0)
    doser.clear_stop()
    with pytest.raises(DeviceError, match="lifetime"):
        doser.dose_to(20.0)
    assert bench.true_ul == 10.0


def test_caps_of_the_firmware_hold_before_anything_moves(tmp_path: Path) -> None:
    with Bench(tmp_path, dose_cap=200, life_cap=300) as bench:
        doser = bench.open()
        with pytest.raises(DeviceError, match="20 µl at most"):
            doser.dose_to(20.1)
        doser.dose_to(20.0)
        with pytest.raises(DeviceError, match="10 µl of its lifetime"):
            doser.dose_to(30.1)
        assert not doser.stopped
        assert bench.true_ul == 20.0


def test_the_limit_of_the_rig_file_holds(bench: Bench) -> None:
    with pytest.raises(DeviceError, match="5 µl at most"):
        bench.open(dose_limit_ul=5.0).dose_to(6.0)


def test_junk_instead_of_a_banner_is_no_obstacle(bench: Bench) -> None:
    bench.faults(junk=True)
    assert bench.open().delivered().volume_ul == 0.0


def test_another_device_on_the_port_is_refused(bench: Bench) -> None:
    bench.faults(stranger=True)
    with pytest.raises(DeviceError, match="no tankrig doser answers there"):
        bench.open()


def test_another_doser_than_the_rig_files_is_refused(bench: Bench) -> None:
    with pytest.raises(DeviceError, match="TD000001, the rig file wants TD000002"):
        bench.open(serial="TD000002")


def test_a_second_program_on_the_port_is_refused(bench: Bench, doser: RigDoser) -> None:
    with pytest.raises(DeviceError, match="another program"):
        bench.open()
    assert doser.delivered().volume_ul == 0.0


def test_a_file_that_is_no_port_is_refused(tmp_path: Path, bench: Bench) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="cannot open"):
        bench.open(port=str(tmp_path / "file"))


def test_a_stop_outlives_the_program(bench: Bench, doser: RigDoser) -> None:
    doser.stop()
    doser.close()
    again = bench.open()
    assert again.stopped
    again.clear_stop()
    assert not again.stopped


def test_a_stop_that_crosses_a_clear_wins(bench: Bench, doser: RigDoser) -> None:
    """The clear is on its way while the stop button is pressed: nothing may move after."""
    doser.stop()
    bench.faults(delay_ms=200.0)
    late = threading.Timer(0.02, doser.stop)
    late.start()
    with pytest.raises(DeviceError, match="again meanwhile"):
        doser.clear_stop()
    late.join()
    bench.no_faults()
    assert doser.stopped
    with pytest.raises(DeviceError):
        doser.dose_to(10.0)
    doser.close()
    assert bench.open().stopped
    assert bench.true_ul == 0.0


def test_noise_that_looks_like_a_stop_byte_stops_and_is_told(bench: Bench, doser: RigDoser) -> None:
    bench.port_of(doser).write(b"\x18")
    with pytest.raises(DeviceError, match="stop is latched"):
        doser.dose_to(10.0)
    doser.clear_stop()
    assert doser.dose_to(10.0).volume_ul == 10.0


def test_a_stale_reply_is_never_taken_for_the_right_one() -> None:
    """A reply that comes too late is followed by the right one: the driver must wait for that."""
    master, slave = os.openpty()
    tty.setraw(slave)
    line = RigDoserLine(os.ttyname(slave), "doser", SystemClock())

    def answer() -> None:
        sequence = int(os.read(master, 100)[1:3], 16)
        os.write(master, framed(f"<{sequence - 1:02X}E03") + b"\x00junk" + framed(f"<{sequence:02X}E04"))

    doser = threading.Thread(target=answer)
    doser.start()
    assert line.ask("S") == Refusal(0x04)
    doser.join()
    line.close()
    os.close(master)
    os.close(slave)


def test_a_person_settles_a_stall_of_either_version(tmp_path: Path) -> None:
    for protocol in (1, 2):
        (folder := tmp_path / str(protocol)).mkdir()
        with Bench(folder, world=World(), protocol=protocol, rate=400.0) as bench:
            doser = bench.open()
            bench.faults(stall_after=100)
            with pytest.raises(UndecidedError):
                doser.dose_to(30.0)
            bench.no_faults()
            doser.resolve(bench.true_ul)
            doser.clear_stop()
            doser.dose_to(30.0)
            assert bench.true_ul == pytest.approx(30.0)


def test_a_version_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    with (
        Bench(tmp_path, world=World(), protocol=3) as bench,
        pytest.raises(DeviceError, match=r"speaks protocol 03, not 01 or 02; update its firmware or tankrig"),
    ):
        bench.open()

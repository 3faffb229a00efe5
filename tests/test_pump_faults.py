"""What goes wrong with New Era and Cavro pumps ends in a sentence and a clear state; nothing moves that should not."""

import os
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import SystemClock
from drivers.new_era.wire import packet
from drivers.registry import open_device
from drivers.serial_line import NoReplyError, SerialLine, open_port
from tankrig.errors import DeviceError, UndecidedError

from .doser_bench import AnyBench, CavroBench, NewEraBench

BENCHES = pytest.mark.parametrize("bench", [NewEraBench, CavroBench], indirect=True)


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[AnyBench]:
    with request.param(tmp_path) as made:
        yield made


def assert_bounds_hold(doser: Any, bench: AnyBench) -> None:
    _, low, high = doser.delivered()
    assert low - 1e-9 <= bench.true_ul <= high + 1e-9


@BENCHES
def test_a_stall_is_unknown_until_a_person_has_said_what_was_delivered(bench: AnyBench) -> None:
    doser = bench.open()
    bench.faults(stall_after=100)
    with pytest.raises(UndecidedError, match=r"stalled|resistance"):
        doser.dose_to(100.0)
    bench.no_faults()
    assert doser.unknown
    assert_bounds_hold(doser, bench)
    with pytest.raises(UndecidedError):
        doser.dose_to(100.0)
    doser.close()
    again = bench.open()
    assert again.unknown, "a new program has forgotten"
    with pytest.raises(DeviceError, match="cannot have been delivered"):
        again.resolve(90.0)
    again.resolve(bench.true_ul)
    if isinstance(bench, CavroBench):
        again.clear_stop()
        with pytest.raises(DeviceError, match=r"plunger met too much resistance.* calibrate pump --initialise"):
            again.dose_to(100.0)
        again.initialise()
    again.clear_stop()
    again.dose_to(100.0)
    assert 98.0 < bench.true_ul <= 100.0


@BENCHES
def test_a_power_cut_in_mid_dose_is_unknown(bench: AnyBench) -> None:
    doser = bench.open()
    doser.dose_to(5.0)
    bench.faults(reset_after=60)
    with pytest.raises(UndecidedError):
        doser.dose_to(100.0)
    assert_bounds_hold(doser, bench)
    assert doser.delivered().high_ul <= 100.0


def test_an_error_in_the_answer_to_a_repeated_move_does_not_mean_that_it_did_not_begin(tmp_path: Path) -> None:
    """Obeyed, power cut before the answer, repeated: the pump, not initialised now, refuses the repeat."""
    with CavroBench(tmp_path) as bench:
        doser = bench.open()
        port, moves = bench.port_of(doser), []
        write = port.write

        def write_and_cut(data: bytes) -> int:
            if b"A2850R" in data and not moves:  # 150 of 3000 increments
                bench.faults(delay_ms=200.0, reset_after=3)
            moves.extend([data] if b"A2850R" in data else [])
            return write(data)

        port.write = write_and_cut
        with pytest.raises(UndecidedError):
            doser.dose_to(50.0)
        assert len(moves) > 1, "it was not repeated"
        assert bench.true_ul > 0.0
        assert_bounds_hold(doser, bench)


@BENCHES
def test_a_power_cut_between_doses_costs_no_ink_and_no_count(bench: AnyBench) -> None:
    doser = bench.open()
    doser.dose_to(20.0)
    bench.do("reset")
    time.sleep(0.1)
    if isinstance(bench, CavroBench):
        with pytest.raises(DeviceError, match="not initialised"):
            doser.dose_to(30.0)
        bench.put_right(doser)
    doser.clear_stop()
    doser.dose_to(30.0)
    assert 28.0 < bench.true_ul <= 30.0
    assert_bounds_hold(doser, bench)


@BENCHES
def test_a_pulled_cable_in_mid_dose(bench: AnyBench) -> None:
    """The pump has power of its own: its watchdog (New Era), or the end of the piece (Cavro), stops it."""
    slow = {"rate_ml_per_min": 6.0} if isinstance(bench, NewEraBench) else {}
    doser = bench.open(**slow)
    bench.faults(unplug_after=60)
    with pytest.raises(UndecidedError, match="line is gone"):
        doser.dose_to(900.0)
    assert_bounds_hold(doser, bench)
    doser.close()
    with pytest.raises(DeviceError, match="no such port"):
        bench.open()
    time.sleep(2.0)
    before = bench.true_ul
    time.sleep(0.2)
    assert bench.true_ul == before <= 900.0
    assert isinstance(bench, CavroBench) or before < 400.0, "its watchdog has not stopped it"
    bench.do("plug")
    again = bench.open()
    assert again.stopped
    assert not again.unknown, "its counter went on counting, and is right"
    _, low, high = again.delivered()
    assert low <= bench.true_ul <= high < low + 6.0
    with pytest.raises(DeviceError, match="nothing to resolve"):
        again.resolve(150.0)


@BENCHES
def test_a_lossy_line_delays_a_dose_and_changes_nothing_else(bench: AnyBench) -> None:
    doser = bench.open()
    for i, faults in enumerate(({"lose": 0.002}, {"corrupt": 0.002}), start=1):
        bench.no_faults()
        bench.faults(**faults)
        for _ in range(20):
            if doser.delivered().volume_ul > 29.0 * i:
                break
            try:
                doser.dose_to(30.0 * i)
            except UndecidedError:
                doser.resolve(bench.true_ul)
            except DeviceError:
                doser.clear_stop()
        assert 29.0 * i < bench.true_ul <= 30.0 * i


def test_a_dose_larger_than_the_syringe_takes_several_strokes(tmp_path: Path) -> None:
    with CavroBench(tmp_path, time_scale=0.3, speed_ul_per_s=250.0, syringe_ul=250.0) as bench:
        doser = bench.open()
        assert doser.dose_to(700.0).volume_ul == pytest.approx(700.0, abs=doser.increment_ul)
        assert bench.true_ul == pytest.approx(doser.delivered().volume_ul)
        assert bench.board.core.initialised_times == 0, "it initialised by itself"


def test_a_new_era_count_goes_on_where_its_display_ends(tmp_path: Path) -> None:
    """The display loses digits above 999.9: the counter is cleared in time, and the total stays right."""
    with NewEraBench(tmp_path, time_scale=0.2) as bench:
        doser = bench.open()
        for total in (600.0, 1500.0, 2500.0):
            doser.dose_to(total)
            assert total - 1.0 < bench.true_ul <= total
            assert_bounds_hold(doser, bench)


def test_a_new_era_pump_set_to_another_diameter_is_set_right_and_keeps_its_count(tmp_path: Path) -> None:
    with NewEraBench(tmp_path) as bench:
        doser = bench.open()
        doser.dose_to(20.0)
        doser.close()
        with open_port(str(tmp_path / "doser"), 19200, "somebody else", SystemClock(0.2)) as port:
            port.write(b"\r0DIA10.00\r")
            assert b"00S\x03" in port.read_until(b"\x03")
        assert bench.board.command({})["board"]["dia"] == 10.0
        again = bench.open()
        assert again.delivered().volume_ul == pytest.approx(19.7, abs=0.2)
        again.dose_to(30.0)
        assert 28.0 < bench.true_ul <= 30.0


def test_a_count_file_is_for_one_syringe(tmp_path: Path) -> None:
    with CavroBench(tmp_path) as bench:
        bench.open().close()
        with pytest.raises(DeviceError, match=r"count_file .* name another count_file for another syringe"):
            bench.open(syringe_ul=500.0)
        (tmp_path / "count").write_text("{}")
        with pytest.raises(DeviceError, match="restore it from a copy"):
            bench.open()


@BENCHES
def test_a_stranger_on_the_port_is_told(bench: AnyBench) -> None:
    bench.faults(stranger=True)
    with pytest.raises(DeviceError, match=r"answers there.*(port|correct)"):
        bench.open()


@BENCHES
def test_nobody_or_another_address_or_baud_on_the_port_is_told(bench: AnyBench) -> None:
    with pytest.raises(DeviceError, match=r"no .* pump answers there at \d+ baud; check port, baud, address 7"):
        bench.open(address=7)
    bench.faults(mute=True)
    with pytest.raises(DeviceError, match=r"no .* pump answers there"):
        bench.open()


@BENCHES
def test_a_second_program_is_refused(bench: AnyBench) -> None:
    doser = bench.open()
    with pytest.raises(DeviceError, match="another program has it open"):
        bench.open()
    doser.dose_to(10.0)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open every port")
@BENCHES
def test_a_port_without_permission_is_told(bench: AnyBench) -> None:
    (bench.folder / "doser").resolve().chmod(0)
    with pytest.raises(DeviceError, match="no permission"):
        bench.open()


def test_the_doctor_sees_a_pump_that_is_not_initialised(tmp_path: Path) -> None:
    from drivers.cavro.health import checks

    with CavroBench(tmp_path) as bench:
        doser = bench.open()
        check, model = checks({}, doser)
        assert check.passed
        assert model.finding.startswith("XCalibur with firmware '737230 A' at 500 µl/s")
        bench.do("reset")
        time.sleep(0.1)
        check, _ = checks({}, doser)
        assert not check.passed
        assert (check.finding, check.remedy[:16]) == ("it is not initialised", "let it initialis")
    assert not list(checks({}, None))


GOOD = {
    "new-era": {"port": "/dev/none", "diameter_mm": 12.0, "rate_ml_per_min": 5.0, "count_file": "count"},
    "cavro": {"port": "/dev/none", "syringe_ul": 1000.0, "speed_ul_per_s": 100.0, "count_file": "count"},
}


@pytest.mark.parametrize(
    ("driver", "change", "reason"),
    [
        ("new-era", {}, r"cannot open /dev/none: there is no such port"),
        ("cavro", {}, r"cannot open /dev/none: there is no such port"),
        ("new-era", {"diameter_mm": 0}, r"new-era: setting diameter_mm: .* greater than or equal to 0.1"),
        ("new-era", {"rate_ml_per_min": -1.0}, r"setting rate_ml_per_min"),
        ("new-era", {"watchdog_s": 0}, r"setting watchdog_s"),
        ("new-era", {"baud": 0}, r"setting baud"),
        ("cavro", {"syringe_ul": 0}, r"cavro: setting syringe_ul"),
        ("cavro", {"baud": 19200}, r"cavro: setting baud: .* 9600 or 38400"),
        ("cavro", {"address": 16}, r"cavro: setting address"),
        ("new-era", {"diameter": 12.0}, r"setting diameter: .*it takes port, diameter_mm"),
    ],
)
def test_wrong_settings_are_told_in_one_sentence(driver: str, change: dict[str, Any], reason: str) -> None:
    with pytest.raises(DeviceError, match=reason) as caught:
        open_device(driver, GOOD[driver] | change)
    assert "\n" not in str(caught.value)


def test_a_speed_that_the_pump_cannot_do_is_told_before_it_is_asked_anything(tmp_path: Path) -> None:
    with (
        CavroBench(tmp_path) as bench,
        pytest.raises(DeviceError, match=r"speed_ul_per_s = 1e\+06 .* give 0.833 to 1e\+03"),
    ):
        bench.open(speed_ul_per_s=1e6)


@BENCHES
def test_the_limit_of_the_rig_file_holds_before_anything_moves(bench: AnyBench) -> None:
    doser = bench.open(dose_limit_ul=5.0)
    with pytest.raises(DeviceError, match="5 µl at most"):
        doser.dose_to(6.0)
    assert bench.true_ul == 0.0
    assert not doser.stopped


@BENCHES
def test_a_stop_just_before_it_sets_off_wins(bench: AnyBench) -> None:
    """The stop comes after everything was made ready and before the pump is told to go."""
    doser = bench.open()
    prepare = doser.pump.prepare
    doser.pump.prepare = lambda *args: (prepare(*args), doser.stop())
    with pytest.raises(DeviceError, match="stop"):
        doser.dose_to(50.0)
    assert bench.true_ul == 0.0
    assert not doser.unknown
    doser.pump.prepare = prepare
    doser.clear_stop()
    doser.dose_to(50.0)


def test_new_era_settings_that_do_not_read_back_are_refused(tmp_path: Path) -> None:
    """A pump that keeps another volume than it was told must not run."""
    with NewEraBench(tmp_path) as bench:
        doser = bench.open()
        port = bench.port_of(doser)
        write = port.write
        port.write = lambda data: write(packet("0VOL100.0") if b"VOL9.700" in data else data)
        with pytest.raises(DeviceError, match=r"VOL reads back as '100.0UL' and not '9.700UL'"):
            doser.dose_to(10.0)
        port.write = write
        assert bench.true_ul == 0.0
        assert not doser.unknown


def test_a_late_reply_is_not_taken_for_another() -> None:
    """A Cavro answer names nothing: after one that did not come in time the line has to fall silent first."""
    from drivers.cavro import wire
    from drivers.cavro.emulator.frames import Reader, answered

    master, slave = os.openpty()
    tty.setraw(slave)
    line = SerialLine(os.ttyname(slave), 9600, "pump", wire.replies, lambda _: None, SystemClock(0.2))

    def answer() -> None:
        reader, asked = Reader(), 0
        while asked < 2:
            for _ in reader.feed(os.read(master, 100)):
                asked += 1
                time.sleep(0.08 if asked == 1 else 0.0)  # the first comes after the host has given up on it
                os.write(master, answered(0x60, str(1000 * asked)))

    device = threading.Thread(target=answer)
    device.start()
    with pytest.raises(NoReplyError):
        line.exchange(wire.command(1, 1, "?"), wire.reply)
    assert line.exchange(wire.command(1, 2, "?"), wire.reply).data == "2000"
    device.join()
    line.close()
    os.close(master)
    os.close(slave)

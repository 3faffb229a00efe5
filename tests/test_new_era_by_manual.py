"""What New Era's manual says a driver must cope with: the real driver against a stand-in that does as it says."""

import itertools
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import given

from drivers.counted.record import Begun, CountFile
from drivers.new_era.pump import four_digits, rate_in_unit
from tankrig.errors import DeviceError, UndecidedError

from .strict_pumps import NEW_ERA, new_era


def test_power_failure_mode_is_switched_off(tmp_path: Path) -> None:
    """It began its program anew by itself: 380.9 on the way to 300, and then the truth was refused."""
    with new_era(tmp_path, habits=replace(NEW_ERA, power_failure=True), rate_ml_per_min=3.0) as bench:
        doser = bench.open()
        bench.world.after(2.0, lambda: bench.faults(mute=True, deaf=True))
        bench.world.after(4.0, lambda: bench.do("reset"))
        with pytest.raises(UndecidedError):
            doser.dose_to(300.0)
        bench.world.advance(30.0)
        assert 50.0 < bench.true_ul <= 300.0, "it has begun anew"
        bench.no_faults()
        _, low_ul, high_ul = doser.delivered()
        assert low_ul <= bench.true_ul <= high_ul <= 300.0
        doser.resolve(bench.true_ul)


def test_a_pump_that_begins_anew_by_itself_may_have_delivered_anything(tmp_path: Path) -> None:
    """A dose that an earlier version cut off, with power failure mode on: the truth must not be refused."""
    with new_era(tmp_path, habits=replace(NEW_ERA, power_failure=True), rate_ml_per_min=3.0) as bench:
        doser = bench.open()
        doser.dose_to(50.0)
        doser.close()
        bench.cable.carry(b"0PF1\r", 19200)
        bench.world.advance(0.1)
        assert bench.board.command({})["board"]["pf"] == 1
        left = CountFile(tmp_path / "count", "an earlier version", 0.001)
        left.update(begun=Begun("dose", 300_000))
        left.close()
        again = bench.open()
        assert again.unknown
        again.resolve(380.9)
        again.clear_stop()
        assert again.delivered().volume_ul == pytest.approx(380.9, abs=0.1)
        again.dose_to(400.0)
        assert bench.board.command({})["board"]["pf"] == 0


def test_a_pump_that_cannot_tell_its_power_failure_mode_needs_a_persons_word(tmp_path: Path) -> None:
    with new_era(tmp_path, habits=replace(NEW_ERA, knows_power_failure=False)) as bench:
        with pytest.raises(DeviceError, match=r'does not know the command PF; .* power_failure_mode = "off"') as caught:
            bench.open()
        assert "\n" not in str(caught.value)
        bench.open(power_failure_mode="off").dose_to(30.0)
        assert 28.0 < bench.true_ul <= 30.0


@pytest.mark.parametrize("ignored", [0, 1, 2, 3, 4])
def test_the_first_opening_after_power_up_works(tmp_path: Path, ignored: int) -> None:
    """The first commands are ignored, the next is answered by an alarm, `SAF` too."""
    with new_era(tmp_path, habits=replace(NEW_ERA, ignored_first=ignored)) as bench:
        for cut in (False, True, True):
            if cut:
                bench.do("reset")
                bench.world.advance(1.0)
            doser = bench.open()
            doser.clear_stop()
            doser.dose_to(doser.delivered().volume_ul + 20.0)
            doser.close()


@pytest.mark.parametrize("rate", [1e-5, 6.0, 90.0])
def test_a_rate_that_the_pump_cannot_do_is_told_when_it_is_opened(tmp_path: Path, rate: float) -> None:
    """It showed only when a dose began, which then latched a stop, though the doctor was green."""
    with new_era(tmp_path) as bench:
        with pytest.raises(
            DeviceError, match=r"rate_ml_per_min = .* is not one it can do with a syringe of 12 mm"
        ) as told:
            bench.open(rate_ml_per_min=rate)
        assert "\n" not in str(told.value)
        doser = bench.open(rate_ml_per_min=5.0)
        assert not doser.stopped
        doser.dose_to(20.0)


def test_a_rate_is_tried_with_the_diameter_that_it_is_for(tmp_path: Path) -> None:
    """Stored for a wide syringe and out of range for this one, which only `RUN` would tell."""
    with new_era(tmp_path, rate_ml_per_min=2.0) as bench:
        bench.open(diameter_mm=20.0, rate_ml_per_min=14.0, count_file=tmp_path / "wide").close()
        with pytest.raises(DeviceError, match="is not one it can do with a syringe of 12 mm"):
            bench.open(rate_ml_per_min=14.0)


@pytest.mark.parametrize("watchdog_s", [2, 3, 10])
def test_no_alarm_while_nothing_moves(tmp_path: Path, watchdog_s: int) -> None:
    """Its buzzer sounded 3 s after every dose."""
    with new_era(tmp_path) as bench:
        doser = bench.open(watchdog_s=watchdog_s)
        for total_ul in (20.0, 40.0):
            bench.world.advance(60.0)
            doser.dose_to(total_ul)
            bench.world.advance(60.0)
            doser.delivered()
        bench.world.advance(60.0)
        told = bench.board.command({})["board"]
        assert not told["buzzer"]
        assert told["alarms"].get("T", 0) == 0
        doser.close()
        bench.world.advance(60.0)
        assert bench.board.command({})["board"]["alarms"].get("T", 0) == 0


def test_asking_a_pump_at_rest_sets_nothing(tmp_path: Path) -> None:
    """Every frame of a run asks what the tank holds; the pump stores what is set, and the mode too."""
    with new_era(tmp_path) as bench:
        doser = bench.open()
        doser.dose_to(20.0)
        doser.delivered()
        port, sent = bench.port_of(doser), []
        write = port.write
        port.write = lambda data: (sent.append(data), write(data))[1]
        begun_s = bench.world.now_s
        for _ in range(10):
            assert doser.delivered().volume_ul == pytest.approx(20.0, abs=0.5)
        assert set(sent) == {b"0DIS\r"}
        assert bench.world.now_s - begun_s < 10 * 0.05
        bench.do("reset")
        bench.world.advance(1.0)
        doser.dose_to(40.0)
        _, low_ul, high_ul = doser.delivered()
        assert low_ul <= bench.true_ul <= high_ul <= 40.5


@pytest.mark.parametrize("what", ["forget", "reset"])
def test_it_runs_only_what_was_read_back_in_the_same_life(tmp_path: Path, what: str) -> None:
    """Whichever write of a dose it loses its power at, with its memory or not: a forgotten volume pumps for ever.

    It pumped 858 µl where 39 were asked: what was read back last, function, phase and counter, reads as in a new pump.
    """
    number, refused = 0, 0
    while True:
        (folder := tmp_path / str(number)).mkdir()
        with new_era(folder, rate_ml_per_min=0.6) as bench:
            doser = bench.open()
            port, left = bench.port_of(doser), itertools.count(number, -1)
            write = port.write

            def write_and_lose(data: bytes, bench: Any = bench, left: Any = left, write: Any = write) -> int:
                if next(left) == 0:
                    bench.do(what)
                return write(data)

            port.write = write_and_lose
            with suppress(DeviceError):
                doser.dose_to(10.0)
            refused += bench.true_ul < 9.0
            assert bench.true_ul <= 10.0
            low_ul, high_ul = doser.last_known[1:]
            assert low_ul - 1e-9 <= bench.true_ul <= high_ul + 1e-9
            if next(left) >= 0:
                break
        number += 1
    assert number > 30
    assert refused > 10


@pytest.mark.parametrize("waits_s", [0.0, 10.0])
@pytest.mark.parametrize("survives", [False, True])
@pytest.mark.parametrize("what", ["stall", "reset"])
def test_what_befell_it_unheard_is_not_excluded_by_a_later_alarm(
    tmp_path: Path, what: str, survives: bool, waits_s: float
) -> None:
    """It keeps one alarm, and tells it once: that of its watchdog may follow one that nobody has heard.

    A counter that survives the loss of its power stands as it was stored last.
    """
    with new_era(tmp_path, rate_ml_per_min=2.4, counter_survives=survives) as bench:
        doser, world = bench.open(), bench.world
        doser.dose_to(10.0)
        world.after(1.0, lambda: bench.faults(mute=True))
        world.after(1.25, lambda: bench.faults(**{f"{what}_after": 0}))
        with pytest.raises(UndecidedError):
            doser.dose_to(300.0)
        world.advance(waits_s)
        bench.no_faults()
        _, low_ul, high_ul = doser.delivered()
        assert 20.0 < low_ul <= bench.true_ul <= high_ul <= 300.0
        doser.resolve(bench.true_ul)


def test_a_stall_before_its_watchdog_acted_is_allowed_for(tmp_path: Path) -> None:
    """Unplugged and stalled at once: only the watchdog's alarm was told, and the low bound was a step too high."""
    with new_era(tmp_path, rate_ml_per_min=2.4) as bench:
        doser = bench.open()
        bench.faults(unplug_after=1, stall_after=1)
        with pytest.raises(UndecidedError, match="line is gone"):
            doser.dose_to(300.0)
        doser.close()
        bench.world.advance(10.0)
        bench.no_faults()
        bench.do("plug")
        again = bench.open()
        _, low_ul, high_ul = again.delivered()
        assert low_ul <= bench.true_ul <= high_ul


def test_its_watchdog_minds_while_it_doses(tmp_path: Path) -> None:
    with new_era(tmp_path, rate_ml_per_min=3.0) as bench:
        doser, world = bench.open(), bench.world
        world.after(1.0, lambda: world.advance(20.0))
        with pytest.raises(DeviceError, match="watchdog heard nothing"):
            doser.dose_to(500.0)
        assert bench.true_ul < 50.0 * 5.0


def test_a_stop_reaches_it_in_either_mode(tmp_path: Path) -> None:
    """At rest it is in Basic mode; somebody may have started it by its keypad."""
    with new_era(tmp_path, rate_ml_per_min=3.0) as bench:
        doser = bench.open()
        doser.dose_to(10.0)
        for typed in (b"0PHN1\r", b"0VOL100.0\r", b"0RUN\r"):
            bench.cable.carry(typed, 19200)
            bench.world.advance(0.1)
        assert bench.moving
        doser.stop()
        bench.world.advance(0.1)
        assert not bench.moving


@given(value=st.floats(1e-3, 9999.4))
def test_numbers_havefour_digits_at_most(value: float) -> None:
    """9.9996 went out as 10.000."""
    text = four_digits(value)
    assert sum(map(str.isdigit, text)) <= 4
    assert len(text.partition(".")[2]) <= 3
    assert float(text) == pytest.approx(value, abs=0.5e-3, rel=0.6e-3)
    rate, unit = rate_in_unit(value / 100.0)
    assert float(rate) * {"MM": 1.0, "UM": 1e-3, "UH": 1e-3 / 60}[unit] == pytest.approx(value / 100.0, rel=2e-3)

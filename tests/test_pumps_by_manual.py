"""What the manuals say a driver must cope with: the real drivers against stand-ins that do as the manuals say."""

import itertools
import os
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from drivers.cavro import wire
from drivers.cavro.doser import CavroDoser
from drivers.cavro.emulator.core import MODELS
from drivers.cavro.emulator.core import Habits as CavroHabits
from drivers.cavro.settings import CavroSettings
from drivers.counted.record import Begun, CountFile
from drivers.new_era.doser import NewEraDoser
from drivers.new_era.emulator.core import Habits as NewEraHabits
from drivers.new_era.pump import four_digits, rate_in_unit
from drivers.new_era.settings import NewEraSettings
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.settings import RigDoserSettings
from tankrig.errors import DeviceError, UndecidedError

from .doser_bench import AnyBench, Bench, CavroBench, NewEraBench
from .virtual_time import World

BY_MANUAL = CavroHabits(speeds_interact=True, speed_rounding=1, repeat_flag_decides=True, overload_stays=True)
XLP = replace(BY_MANUAL, model=MODELS["xlp"])
NEW_ERA = NewEraHabits(checks_rates=True)
STRICT = pytest.mark.parametrize("habits", [BY_MANUAL, XLP], ids=["xcalibur", "xlp"])
TOLD_WITHIN_S = 3.0
BOARD_BOOTS_S = 2.0
"""The boot loader of a board that opening its port has reset; the driver waits 3 s at most for the first word."""


def cavro(folder: Path, habits: CavroHabits = BY_MANUAL, **how: Any) -> CavroBench:
    return CavroBench(folder, world=World(), habits=habits, **how)


def new_era(folder: Path, **how: Any) -> NewEraBench:
    return NewEraBench(folder, world=World(), **({"habits": NEW_ERA} | how))


# -- Cavro -------------------------------------------------------------------------------------------------------------


@STRICT
@pytest.mark.parametrize("speed", [1.0, 8.0, 20.0, 50.0, 120.0, 150.0, 200.0, 266.0, 290.0, 500.0, 1000.0])
def test_a_cavro_doses_at_every_speed_that_it_can_do(tmp_path: Path, habits: CavroHabits, speed: float) -> None:
    """At 20 to 266 µl/s the start speed did not read back: dosed, then "no reply", unknown until a power cycle."""
    with cavro(tmp_path, habits, speed_ul_per_s=speed) as bench:
        doser, volume_ul = bench.open(), min(300.0, 20.0 * speed)
        begun_s = bench.world.now_s
        assert doser.dose_to(volume_ul).volume_ul == pytest.approx(volume_ul, abs=doser.increment_ul)
        assert bench.true_ul == pytest.approx(volume_ul, abs=doser.increment_ul)
        assert not doser.unknown
        assert bench.world.now_s - begun_s >= volume_ul / speed


@STRICT
@pytest.mark.parametrize("speed", [10.0, 100.0, 400.0, 1000.0])
def test_a_cavro_moves_at_the_speed_asked(tmp_path: Path, habits: CavroHabits, speed: float) -> None:
    """An XCalibur counts speeds in half-increments: it went half as fast."""
    with cavro(tmp_path, habits, speed_ul_per_s=speed) as bench:
        doser, world = bench.open(), bench.world
        seen: list[tuple[float, float]] = []

        def look() -> None:
            seen.append((world.now_s, bench.true_ul))
            if len(seen) < 400:
                world.after(0.01, look)

        world.after(0.0, look)
        doser.dose_to(min(800.0, 3.0 * speed))
        rates = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(seen, seen[10:], strict=False)]
        assert max(rates) == pytest.approx(speed, rel=0.1)


@STRICT
@pytest.mark.parametrize("speed", [2.0, 60.0, 266.0, 700.0, 1000.0])
def test_the_last_move_of_a_killed_program_takes_a_second_at_most(
    tmp_path: Path, habits: CavroHabits, speed: float
) -> None:
    """A Cavro has no watchdog: it ends the move it is on, ramps included."""
    with cavro(tmp_path, habits, speed_ul_per_s=speed) as bench:
        doser, world = bench.open(), bench.world
        rested: list[float] = []

        def hang() -> None:
            hung_s = world.now_s
            while bench.moving and world.now_s < hung_s + 5.0:
                world.advance(0.01)
            rested.append(world.now_s - hung_s)

        for _ in range(5):
            world.after(0.9, hang)
            doser.dose_to(doser.delivered().volume_ul + min(150.0, 3.0 * speed))
        assert max(rested) <= 1.02


def test_what_a_cavro_is_set_to_is_what_it_tells(tmp_path: Path) -> None:
    """Start and cutoff speed go with the top speed, so that the pump changes none of them by itself."""
    for number, speed in enumerate((9.0, 100.0, 200.0, 900.0)):
        (folder := tmp_path / str(number)).mkdir()
        with cavro(folder, replace(BY_MANUAL, speed_rounding=0), speed_ul_per_s=speed) as bench:
            doser = bench.open()
            doser.dose_to(5.0)
            top = round(6.0 * speed)
            start = min(900, top)
            assert bench.board.command({})["board"]["speeds"] == {"V": top, "v": start, "c": start}


@given(speed=st.floats(0.5, 2000.0), syringe_ul=st.sampled_from([50.0, 250.0, 1000.0, 5000.0]), fine=st.booleans())
def test_a_stroke_has_as_many_pulses_on_both_models(speed: float, syringe_ul: float, fine: bool) -> None:
    given = {"port": "p", "syringe_ul": syringe_ul, "speed_ul_per_s": speed, "count_file": Path("c"), "fine": fine}
    xcalibur, xlp = (CavroSettings(**given, model=model) for model in ("xcalibur", "xlp"))
    assert xcalibur.pulses_per_s == xlp.pulses_per_s == round(speed * 6000 / syringe_ul)
    assert xlp.increments_per_pulse == 2 * xcalibur.increments_per_pulse == (8.0 if fine else 1.0)


@pytest.mark.parametrize(
    ("told", "says", "refusal"),
    [
        (
            "xlp",
            {"model": "xcalibur"},
            r"'XLP6000 A', which is not known as an XCalibur's; .* give model = .xlp.",
        ),
        ("xcalibur", {"model": "xlp"}, r"'737230 A', an XCalibur's, and the rig file says .*; give model = .xcalibur."),
        (
            "xlp",
            {"model": "xlp", "firmware": "XLP6000 C"},
            r"'XLP6000 A', and the rig file says firmware",
        ),
        ("xcalibur", {"model": "xcalibur", "firmware": "other"}, r"correct the port, or model and firmware"),
        ("xlp", {"model": "xlp"}, None),
        ("xlp", {"model": "xlp", "firmware": "XLP6000 A"}, None),
        ("xcalibur", {"model": "xcalibur"}, None),
        ("xcalibur", {"model": "xcalibur", "firmware": "737230 A"}, None),
    ],
)
def test_a_model_other_than_the_rig_files_is_told_and_moves_nothing(
    tmp_path: Path, told: str, says: dict[str, str], refusal: str | None
) -> None:
    """An XLP behind an XCalibur's rig file delivered 50 and reported 100 ± 0."""
    with cavro(tmp_path, replace(BY_MANUAL, model=MODELS[told])) as bench:
        if refusal is None:
            bench.open(**says).dose_to(100.0)
            assert bench.true_ul == pytest.approx(100.0, abs=1.0)
            return
        with pytest.raises(DeviceError, match=refusal) as caught:
            bench.open(**says)
        assert "\n" not in str(caught.value)
        assert bench.true_ul == 0.0


def test_firmware_that_nobody_knows_needs_a_persons_word(tmp_path: Path) -> None:
    strange = replace(MODELS["xcalibur"], firmware="30013720-C")
    with cavro(tmp_path, replace(BY_MANUAL, model=strange)) as bench:
        with pytest.raises(DeviceError, match=r"or firmware = '30013720-C' if it is an XCalibur"):
            bench.open()
        bench.open(firmware="30013720-C").dose_to(50.0)
        assert bench.true_ul == pytest.approx(50.0, abs=0.5)


@given(late_s=st.floats(0.0, 2.5), every=st.integers(1, 6))
@settings(max_examples=60, deadline=None)
def test_answers_that_come_late_are_not_taken_for_others(
    tmp_path_factory: pytest.TempPathFactory, late_s: float, every: int
) -> None:
    """Whatever is late, a position counts only with the line's order proved, and the proof changes nothing."""
    with cavro(tmp_path_factory.mktemp("late"), speed_ul_per_s=60.0) as bench:
        doser = bench.open()
        doser.dose_to(20.0)
        turns = itertools.count()

        def late() -> None:
            bench.faults(delay_ms=1e3 * late_s if next(turns) % every == 0 else 0.0)
            bench.world.after(0.11, late)

        bench.world.after(0.0, late)
        for total_ul in (50.0, 80.0, 110.0):
            with suppress(DeviceError):
                doser.dose_to(total_ul)
            with suppress(DeviceError):
                doser.delivered()
            _, low_ul, high_ul = doser.last_known
            assert low_ul - 1e-9 <= bench.true_ul <= min(high_ul, 110.0) + 1e-9


def test_the_proof_of_order_sets_nothing(tmp_path: Path) -> None:
    """It used to set the start speed, which a pump changes by itself, and which counts for the next move."""
    with cavro(tmp_path, speed_ul_per_s=60.0) as bench:
        doser = bench.open()
        port, asked, proofs = bench.port_of(doser), [], set()
        write = port.write
        port.write = lambda data: (asked.append(data[3:-2].decode()), write(data))[1]
        for _ in range(20):
            asked.clear()
            doser.delivered()
            proofs.add(tuple(asked[: asked.index("Q")]))
        assert proofs == {("?", "?", "&"), ("&", "&", "?")}


@STRICT
def test_an_overload_is_told_whether_or_not_asking_takes_it_away(tmp_path: Path, habits: CavroHabits) -> None:
    for number, stays in enumerate((False, True)):
        (folder := tmp_path / str(number)).mkdir()
        with cavro(folder, replace(habits, overload_stays=stays), speed_ul_per_s=60.0) as bench:
            doser = bench.open()
            bench.faults(stall_after=120)
            with pytest.raises(UndecidedError, match="resistance"):
                doser.dose_to(100.0)
            bench.no_faults()
            _, low_ul, high_ul = doser.delivered()
            assert low_ul - 1e-9 <= bench.true_ul <= high_ul + 1e-9


def test_an_error_left_over_from_another_command_is_not_taken_for_a_refusal(tmp_path: Path) -> None:
    """Every answer after an error carries it, until `Q` has told it."""
    with cavro(tmp_path, speed_ul_per_s=60.0) as bench:
        doser = bench.open()
        for number, wrong in enumerate(("V9R", "v1R", "G9", "A99999R", "!R"), 1):
            bench.world.advance(0.1)
            bench.port_of(doser).write(wire.command(1, number, wrong))
            bench.world.advance(0.1)
            (told,) = wire.replies(bytearray(bench.port_of(doser).received))
            assert bool(wire.reply(told).error) is (wrong in ("v1R", "A99999R", "!R"))
            doser.dose_to(6.0 * number)
        assert bench.true_ul == pytest.approx(30.0, abs=doser.increment_ul)


def test_a_full_syringe_is_initialised_in_the_time_that_it_takes(tmp_path: Path) -> None:
    with cavro(tmp_path, speed_ul_per_s=60.0) as bench:
        doser = bench.open()
        doser.dose_to(10.0)  # for which it was filled
        begun_s = bench.world.now_s
        doser.initialise()
        assert bench.world.now_s - begun_s > 10.0
        doser.dose_to(40.0)
        assert doser.delivered().volume_ul == pytest.approx(40.0, abs=doser.increment_ul)


# -- New Era -----------------------------------------------------------------------------------------------------------


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


# -- the rig's own doser -----------------------------------------------------------------------------------------------


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


# -- lost replies ------------------------------------------------------------------------------------------------------

DOSERS: dict[str, Callable[[Path], AnyBench]] = {
    "rig 01": lambda folder: Bench(folder, world=World(), rate=400.0),
    "rig 02": lambda folder: Bench(folder, world=World(), rate=400.0, protocol=2),
    "New Era": lambda folder: new_era(folder, rate_ml_per_min=2.4),
    "XCalibur": lambda folder: cavro(folder, speed_ul_per_s=40.0, syringe_ul=250.0),
    "XLP": lambda folder: cavro(folder, XLP, speed_ul_per_s=40.0, syringe_ul=250.0),
}


@pytest.mark.parametrize("deaf", [False, True])
@pytest.mark.parametrize("kind", list(DOSERS))
def test_a_lost_reply_is_told_within_three_seconds(kind: str, deaf: bool, tmp_path: Path) -> None:
    """Whichever write of a dose is the first that is not answered: it took a New Era 40 s."""
    longest_s, number = 0.0, 0
    while True:
        (folder := tmp_path / str(number)).mkdir()
        with DOSERS[kind](folder) as bench:
            doser = bench.open()
            silent_s = self_silencing(bench, doser, after_writes=number, deaf=deaf)
            try:
                doser.dose_to(40.0)
                break
            except DeviceError:
                assert silent_s, "it failed before anything was lost"
                longest_s = max(longest_s, bench.world.now_s - silent_s[0])
            low_ul, high_ul = doser.last_known[1:]
            assert low_ul - 1e-9 <= bench.true_ul <= high_ul + 1e-9
        number += 1
    print(f"{kind}: {number} writes, longest {longest_s:.2f} s")
    assert number >= 8
    assert longest_s <= TOLD_WITHIN_S


@pytest.mark.parametrize("what", ["delivered", "clear_stop", "open"])
@pytest.mark.parametrize("kind", list(DOSERS))
def test_silence_outside_a_dose_is_told_soon(kind: str, what: str, tmp_path: Path) -> None:
    """Opening too, though a pump just switched on ignores some commands; a board that resets has its banner's time."""
    with DOSERS[kind](tmp_path) as bench:
        doser = bench.open()
        doser.dose_to(10.0)
        doser.stop()
        if what == "open":
            doser.close()
        bench.faults(mute=True)
        begun_s = bench.world.now_s
        with pytest.raises(DeviceError):
            bench.open() if what == "open" else getattr(doser, what)()
        took_s = bench.world.now_s - begun_s
        print(f"{kind}, {what}: {took_s:.2f} s")
        boots_s = (
            BOARD_BOOTS_S if what == "open" and isinstance(bench, Bench) else 0.0
        )  # opening the port resets the board
        assert took_s <= boots_s + TOLD_WITHIN_S


SILENT: dict[str, Callable[[str, Path], object]] = {
    "rig": lambda port, _: RigDoser(RigDoserSettings(port=port, steps_per_ul=10.0)),
    "New Era": lambda port, count: NewEraDoser(
        NewEraSettings(port=port, diameter_mm=12.0, rate_ml_per_min=5.0, count_file=count)
    ),
    "Cavro": lambda port, count: CavroDoser(
        CavroSettings(port=port, model="xcalibur", syringe_ul=250.0, speed_ul_per_s=40.0, count_file=count)
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", list(SILENT))
def test_a_pseudo_terminal_where_nobody_answers_is_told_within_three_seconds(kind: str, tmp_path: Path) -> None:
    """By this computer's clock; the rig's board has its banner's time besides."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        begun_s = time.monotonic()
        with pytest.raises(DeviceError, match=r"no .* answers there; check|answers there at .* check port"):
            SILENT[kind](os.ttyname(slave), tmp_path / "count")
        took_s = time.monotonic() - begun_s
    finally:
        os.close(master)
        os.close(slave)
    print(f"{kind}: {took_s:.2f} s")
    assert took_s <= TOLD_WITHIN_S + (BOARD_BOOTS_S if kind == "rig" else 0.0)


def self_silencing(bench: AnyBench, doser: Any, after_writes: int, deaf: bool) -> list[float]:
    """Nothing is heard any more from the n-th write on; when that was."""
    port, since = bench.port_of(doser), []
    write, left = port.write, itertools.count(after_writes, -1)

    def silencing(data: bytes) -> int:
        if next(left) == 0:
            since.append(bench.world.now_s)
            bench.faults(mute=True, deaf=deaf)
        return write(data)

    port.write = silencing
    return since

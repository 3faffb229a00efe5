"""What Cavro's manuals say a driver must cope with: the real driver against a stand-in that does as they say."""

import itertools
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from drivers.cavro import wire
from drivers.cavro.emulator.core import MODELS
from drivers.cavro.emulator.core import Habits as CavroHabits
from drivers.cavro.settings import CavroSettings
from tankrig.errors import DeviceError, UndecidedError

from .strict_pumps import BY_MANUAL, XLP, cavro

STRICT = pytest.mark.parametrize("habits", [BY_MANUAL, XLP], ids=["xcalibur", "xlp"])


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

"""Waves of light tell order 1 from the rest: against an independent program's images, and by what must hold anyway."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tankrig import ImageError, SequenceError, open_run
from tankrig.bench import Bench
from tankrig.light.single import single_scattering
from tankrig.live.results import DoseFit, SeriesFit, from_fields, to_fields
from tankrig.live.separated import Separated, told_of
from tankrig.pattern import Sheet, Wave, draw
from tankrig.pattern.wall import Wall
from tankrig.run.derived import damaged_derived, read_derived, write_derived
from tankrig.run.reading import StoredFrames
from tankrig.scene import Camera, Medium, Tank
from tankrig.separation import (
    Separation,
    Transfer,
    demodulated,
    expected_separation,
    order_one,
    transfer_of,
    what_changed,
)
from tankrig.separation.expected import agreement, sheet_scene
from tankrig.separation.order_one import OrderOne
from tankrig.separation.order_one_fit import KNOWN_SLOPE_SD, asymmetry_of, fit_order_one, slope_of
from tankrig.separation.transfer import LIQUID
from tankrig.separation.waves import Waves, noise_of_pairs
from tankrig.sequence import Capture, Separate, Sequence, Series, Wait
from ui.cli import main

TRUTH = Path(__file__).parent / "data" / "waves"
"""Made by an independent Monte Carlo with the beams that the patterns light; README.md beside them says how."""
WALL = Wall((120, 80), (-40.0, 40.0), (0.0, 120.0))
TANK = Tank((160.0, 80.0, 120.0))
PERIODS = (4.0, 8.0, 16.0)
Z_MM, Y_MM = (58.0, 62.0), (-30.0, 30.0)
CASES = sorted(path.stem for path in TRUTH.glob("*.npz"))


def bench_of(case: str) -> Bench:
    if case.startswith("p"):
        camera = Camera("pinhole", (40, 80), 2.0, (80.0, 0.0, 520.0))
        return Bench(TANK, WALL, "pinhole", camera, (-400.0, 0.0, 60.0))
    return Bench(TANK, WALL, "collimated", Camera("orthographic", (40, 80), 2.0))


def truth_of(case: str) -> tuple[dict[float, Waves], Medium]:
    """Waves with the independent program's own noise, which is what the frames' noise would be."""
    with np.load(TRUTH / f"{case}.npz") as data:
        medium = Medium(*(float(one) for one in data["medium"]))
        sheet, sheet_sd = data["sheet"].astype(float), data["sheet_sd"].astype(float)
        waves = {}
        for period in PERIODS:
            crests, sd = data[f"wave_{period:g}"].astype(float), data[f"wave_{period:g}_sd"].astype(float)
            # Shifts by half a period are the sheet less these: M = 2 I₀ − S + i (2 I₁ − S).
            wave_sd = np.sqrt(2.0 * np.square(sd).sum(axis=0) + np.square(sheet_sd))
            waves[period] = Waves(sheet, 2.0 * crests[0] - sheet + 1j * (2.0 * crests[1] - sheet), sheet_sd, wave_sd)
    return waves, medium


def measured(case: str) -> tuple:
    bench = bench_of(case)
    waves, medium = truth_of(case)
    transfers = [transfer_of(Wave(period, Z_MM, 0.0, Y_MM), bench, bench.camera) for period in PERIODS]
    scene = sheet_scene(transfers[0].wave, bench, bench.camera, medium)
    return order_one(list(waves.values()), transfers), scene


@pytest.mark.parametrize("case", CASES)
def test_order_1_is_found_without_a_model_and_its_uncertainty_holds(case: str) -> None:
    """In thin, medium and thick ink: what waves tell is order 1, which the truth has exactly."""
    found, scene = measured(case)
    truth = single_scattering(scene)
    known = found.known
    assert known.mean() > 0.6
    z = ((found.image - truth) / found.sd)[known]
    assert 0.9 < float(np.mean(np.abs(z) < 1.96)) < 0.99
    assert 0.8 < float(np.sqrt(np.mean(z**2))) < 1.1
    beside = agreement(found, truth)
    assert abs(beside.ratio - 1.0) < 2.5 * beside.sd
    assert not beside.doubt
    assert agreement(found, 1.3 * truth).doubt or beside.sd > 0.07
    if "thick" not in case:
        assert beside.sd < 0.05
        known_phase = slope_of(scene.medium), KNOWN_SLOPE_SD
        alone = fit_order_one([(found, scene)], known_phase)
        assert abs(alone.sigma_t - scene.medium.sigma_t) < 2.5 * alone.sigma_t_sd
        assert alone.sigma_t_sd < 0.04 * alone.sigma_t
        side = scene.medium.sigma_s * float(scene.medium.phase_function.at(0.0))
        assert abs(alone.at_right_angle - side) < 2.5 * alone.at_right_angle_sd
        (start,) = alone.media(gain=1.0)
        assert abs(start.g - scene.medium.g) < 0.03, "with an absolute gain the height of order 1 tells g"


@pytest.mark.parametrize("case", [case for case in CASES if "medium" in case])
def test_it_beats_the_largest_less_the_smallest(case: str) -> None:
    """Nayar's rule takes all that follows the finest wave, and noise with it, for order 1."""
    found, scene = measured(case)
    truth, known = single_scattering(scene), found.known
    waves, _ = truth_of(case)
    finest = waves[PERIODS[0]]
    shifted = [0.5 * (finest.sheet + np.real(finest.wave * np.exp(-0.5j * np.pi * number))) for number in range(4)]
    simple = np.max(shifted, axis=0) - np.min(shifted, axis=0)
    wrong = [float(np.linalg.norm((one - truth)[known])) for one in (found.image, simple)]
    assert wrong[0] < 0.5 * wrong[1]


@pytest.mark.parametrize("case", ["o-thin", "o-medium"])
def test_the_model_says_what_the_waves_show_order_by_order(case: str) -> None:
    bench = bench_of(case)
    waves, medium = truth_of(case)
    with np.load(TRUTH / f"{case}.npz") as data:
        for period in PERIODS if case == "o-thin" else PERIODS[::2]:  # denser liquids take longer
            said = expected_separation(Wave(period, Z_MM, 0.0, Y_MM), bench, bench.camera, medium, 0.01)
            seen, sd = waves[period].wave, waves[period].wave_sd
            lit = slice(8, 32), slice(0, 80)
            allowed = 3.0 * np.sqrt(np.square(sd[lit]).sum()) + 0.005 * float(waves[period].sheet[lit].sum())
            assert abs((said["all"].wave - seen)[lit].sum()) < allowed
            total = sum(one.wave for order, one in said.items() if order != "all")
            np.testing.assert_allclose(total, said["all"].wave, atol=1e-9 * float(np.abs(seen).max()))
            # In stretches along x, how much of each order follows the wave; order 1 follows it all over.
            turn = np.exp(-1j * np.angle(said[1].wave))
            for index, orders in enumerate(((1,), (2,))):
                follow = np.real(sum(said[one].wave for one in orders) * turn)[lit].reshape(24, 4, 20).sum(axis=(0, 2))
                whole = waves[period].sheet[lit].reshape(24, 4, 20).sum(axis=(0, 2))
                truth = data[f"follow_{period:g}"][index]
                assert np.all(np.abs(follow / whole - truth) < 0.01), (period, orders)


@given(st.floats(0.002, 0.02), st.floats(0.0, 0.85), st.floats(0.1, 1e4), st.integers(0, 2**32 - 1))
@settings(max_examples=4, deadline=None)
def test_sheets_at_several_heights_tell_the_phase_function_about_90_degrees(
    sigma_t: float, g: float, gain: float, seed: int
) -> None:
    """In perspective; one sheet alone can hardly tell a steep phase function from extinction."""
    chance = np.random.default_rng(seed)
    bench, liquid = bench_of("p"), Medium(0.05 * sigma_t, 0.95 * sigma_t, g)
    bench = replace(bench, camera=bench.camera.binned(2))  # four pixels in one, with half the noise
    sheets = []
    for middle in (20.0, 60.0, 100.0):
        scene = sheet_scene(Wave(8.0, (middle - 2.0, middle + 2.0), 0.0, Y_MM), bench, bench.camera, liquid)
        truth = gain * single_scattering(scene)
        noise = np.full(truth.shape, 0.005 * float(truth.max()))
        seen = np.where(truth > 0.0, truth + noise * chance.standard_normal(truth.shape), np.nan)
        sheets.append((OrderOne(seen, noise, np.zeros(truth.shape), 1.0, (0.0,)), scene))
    one, all_three = fit_order_one(sheets[1:2]), fit_order_one(sheets)
    for name, true in (("sigma_t", sigma_t), ("slope", slope_of(liquid))):
        assert abs(getattr(all_three, name) - true) < 4.5 * getattr(all_three, f"{name}_sd"), name
    assert all_three.slope_sd < 0.6 * one.slope_sd
    assert all_three.sigma_t_sd < 0.6 * one.sigma_t_sd
    assert all_three.cosines[0] < -0.1
    assert all_three.cosines[1] > 0.1
    ratio, sd = all_three.phase(np.array([80.0, 90.0, 100.0]))
    p = np.asarray(liquid.phase_function.at(np.cos(np.radians([80.0, 90.0, 100.0]))))
    assert np.all(np.abs(ratio - p / p[1]) <= 4.5 * sd + 1e-3)
    assert asymmetry_of(slope_of(liquid)) == pytest.approx(g, abs=0.01)


@given(st.integers(1, 4), st.floats(0.0, 1.0), st.floats(0.0, 6.0), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_what_follows_and_what_does_not_come_back(quarters: int, part: float, phase: float, seed: int) -> None:
    chance = np.random.default_rng(seed)
    count = 4 * quarters
    sheet = chance.uniform(1.0, 9.0, (5, 7))
    steps = 2.0 * np.pi * np.arange(count)[:, None, None] / count
    pictures = 0.5 * sheet * (1.0 + part * np.cos(phase - steps))
    found = demodulated(pictures, np.full((count, 1, 1), 1e-9))
    np.testing.assert_allclose(found.sheet, sheet, rtol=1e-9)
    np.testing.assert_allclose(found.modulated, part * sheet, atol=1e-7)
    np.testing.assert_allclose(found.even, (1.0 - part) * sheet, atol=1e-7)


def test_noise_is_told_from_the_waves_themselves_and_carried_on() -> None:
    """No frame has to be taken twice to know how noisy they are."""
    chance = np.random.default_rng(8)
    y, x = np.mgrid[:80, :120]
    sheet = 4000.0 * np.exp(-x / 60.0)
    steps = np.arange(4)[:, None, None] / 4.0
    clean = 0.5 * sheet * (1.0 + 0.6 * np.cos(2.0 * np.pi * (y / 8.0 - steps)))
    noise = np.sqrt(25.0 + 0.8 * clean)
    found = [clean + noise * chance.standard_normal(clean.shape) for _ in range(3)]
    told = noise_of_pairs(found)
    for one in told:
        assert 0.9 < float(np.median(one / noise)) < 1.1
        assert float(np.mean(np.abs(one / noise - 1.0) < 0.25)) > 0.95
    waves = demodulated(found[0], told[0])
    z = (waves.sheet - sheet) / waves.sheet_sd
    assert 0.95 < float(np.std(z)) < 1.05
    dark = demodulated(np.sqrt(25.0) * chance.standard_normal(clean.shape), np.full(clean.shape, 5.0))
    assert float(np.sqrt(np.mean(dark.modulated**2))) < float(np.sqrt(np.mean(np.abs(dark.wave) ** 2)))


@pytest.mark.parametrize(("light", "said"), [(0.0, True), (1.0, True), (10.0, False)])
def test_pictures_of_noise_are_said_to_be_that(light: float, said: bool) -> None:
    """Water without ink, photographed briefly: nothing cast doubt on 105 ± 7 % of order 1."""
    y, x = np.mgrid[:40, :80]
    steps = np.arange(4)[:, None, None] / 4.0
    pictures = 0.5 * light * (1.0 + np.cos(2.0 * np.pi * (y / 8.0 - steps))) + 0.0 * x
    noise = np.full(pictures.shape, 1.0)
    waves = demodulated(pictures + np.random.default_rng(3).standard_normal(pictures.shape), noise)
    transfer = Transfer(Wave(16.0, Z_MM, 0.0, Y_MM), np.exp(2j * np.pi * y / 8.0))
    nowhere = np.zeros(y.shape, bool)
    bench = bench_of("o-thin")
    found = Separation(
        0.0, Z_MM, bench, bench.camera, {16.0: waves}, (transfer,), what_changed(pictures, noise), nowhere, ""
    )
    assert bool(found.doubts) == bool(found.lost_in_noise) == said
    assert not found.faults, "what all pixels tell together still counts"


@given(st.floats(0.03, 0.1), st.booleans())
@settings(max_examples=20, deadline=None)
def test_what_changed_meanwhile_is_told(amount: float, lamp: bool) -> None:
    y, x = np.mgrid[:64, :64]
    steps = np.arange(4)[:, None, None] / 4.0
    pictures = 100.0 * np.exp(-x / 50.0) * (1.0 + 0.5 * np.cos(2 * np.pi * (y / 8.0 - steps)))
    noise = np.full(pictures.shape, 0.5)
    noisy = pictures + np.random.default_rng(1).normal(0.0, 0.5, pictures.shape)
    assert not what_changed(noisy, noise)
    plume = np.exp(-((x - 20.0) ** 2 + (y - 30.0) ** 2) / 50.0) * 8.0
    late = noisy * np.where(np.array([0, 1, 0, 1])[:, None, None] == 1, 1.0 + amount * (1.0 if lamp else plume), 1.0)
    told = what_changed(late, noise)
    assert told
    assert (told.lamp > 0.5) == lamp


@given(st.sampled_from([4, 8]), st.sampled_from([8.0, 16.0, 30.0]), st.floats(0.5, 3.0))
@settings(max_examples=40, deadline=None)
def test_shifts_of_a_wave_add_up_to_the_sheet_whatever_the_projectors_response(
    shifts: int, period: float, gamma: float
) -> None:
    wall = Wall((60, 320), (80.0, -80.0), (0.0, 120.0), gamma=gamma)
    step = Separate(Z_MM, (period,), shifts, y_mm=(-60.0, 60.0))
    drawn = [draw(one, wall).pixels for one in step.patterns.values()]
    light = np.sum([wall.fractions[one] for one in drawn], axis=0)
    lit = draw(Sheet((-60.0, 60.0), Z_MM), wall).pixels > 0
    coarsest = np.diff(wall.fractions).max()
    np.testing.assert_allclose(light[lit], shifts / 2.0, atol=shifts * coarsest)
    assert not light[~lit].any()
    for first, second in zip(drawn[0::2], drawn[1::2], strict=True):
        pair = wall.fractions[first] + wall.fractions[second]
        np.testing.assert_allclose(pair[lit], 1.0, atol=2.0 * coarsest)


def test_a_step_is_written_out_and_its_waves_are_not_photographs_for_fits() -> None:
    from tankrig.live.photograph_plan import PhotographPlan

    step = Separate(Z_MM, (16.0, 32.0), frames=2, y_mm=Y_MM, heights_mm=(30.0, 60.0))
    sequence = Sequence("two heights", (Series((0.0, 100.0), (step, Capture("full"))),))
    assert sequence.frames == 2 * (2 * (1 + 2 * 2 * 4) + 1)
    assert sequence.tasks[2].label == "dose 1 of 2, separate 2 of 17, capture wave-16mm-z28-32-0of4 × 2"
    assert {one.z_mm for one in step.patterns.values()} == {(28.0, 32.0), (58.0, 62.0)}
    bench = bench_of("o")
    plan = PhotographPlan.of(bench, sequence, list(sequence.drawn(WALL).values()))
    assert {one.name for one in plan.patterns.values()} == {"dark", "full"}


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"shifts": 6}, "give 4, 8"),
        ({"periods_mm": ()}, "periods_mm is empty"),
        ({"periods_mm": (8.0, 8.0)}, "one twice"),
        ({"periods_mm": (float("inf"),)}, "no length"),
        ({"z_mm": (62.0, 58.0)}, "is no sheet"),
        ({"frames": 0}, "records nothing"),
    ],
)
def test_a_step_that_cannot_separate_is_refused_in_a_sentence(keys: dict, said: str) -> None:
    with pytest.raises(SequenceError, match=said):
        Separate(**({"z_mm": Z_MM} | keys))


def test_a_wave_finer_than_the_projector_or_blurred_away_is_refused() -> None:
    fine = Sequence("fine", (Separate(Z_MM, (3.0, 8.0)),))
    with pytest.raises(SequenceError, match="finer than 4 of the projector's pixels"):
        fine.drawn(WALL)
    bench = bench_of("o")
    soft = replace(bench.camera, blur_mm=4.0)
    with pytest.raises(ImageError, match="so fine"):
        transfer_of(Wave(8.0, Z_MM), bench, soft)
    with pytest.raises(ImageError, match="two periods or more"):
        order_one([], [])


def test_blur_of_both_lenses_is_divided_out() -> None:
    """A wave that lenses have blurred is followed less; order 1 must not come out fainter for that."""
    bench = bench_of("o")
    sharp = [transfer_of(Wave(period, Z_MM, 0.0, Y_MM), bench, bench.camera) for period in PERIODS]
    blurred_camera = replace(bench.camera, blur_mm=0.8)
    soft = [transfer_of(Wave(period, Z_MM, 0.0, Y_MM), bench, blurred_camera) for period in PERIODS]
    truth = single_scattering(sheet_scene(sharp[0].wave, bench, bench.camera, LIQUID))
    waves = []
    for period, one in zip(PERIODS, sharp, strict=True):
        left = np.exp(-2.0 * np.pi**2 * (0.8 / period) ** 2)
        waves.append(Waves(truth, truth * one.factor * left, np.full(truth.shape, 1e-6), np.full(truth.shape, 1e-6)))
    found = order_one(waves, soft)
    np.testing.assert_allclose(found.image[found.known], truth[found.known], rtol=2e-3)


def test_derived_arrays_are_kept_whole_and_damage_is_seen(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    arrays = {"order_1": np.arange(12.0).reshape(3, 4)}
    file = write_derived(tmp_path / "run", "one", arrays, "name of the frames", dose_ml=0.2)
    kept, about = read_derived(file)
    np.testing.assert_array_equal(kept["order_1"], arrays["order_1"])
    assert (about["frames"], about["dose_ml"]) == ("name of the frames", 0.2)
    assert damaged_derived(tmp_path / "run") == ()
    whole = file.read_bytes()
    for place in (10, len(whole) // 2, len(whole) - 30):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        assert damaged_derived(tmp_path / "run") == ("one.npz",) or read_derived(file)[1] == about


SEPARATED = """
name = "separated"
exposure_ms = 100.0

[[steps]]
do = "dose"
total_ul = 400.0

[[steps]]
do = "mix"
at_least_s = 1.0
exposure_ms = 5.0

[[steps]]
do = "separate"
z_mm = [58.0, 62.0]
y_mm = [-60.0, 60.0]
periods_mm = [8.0, 16.0]

[[steps]]
do = "capture"
pattern = "full"
exposure_ms = 5.0
"""


def test_from_a_sequence_to_order_1_by_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run on the simulated rig, whose ink's σt is known, separated by the command; its arrays are in the run."""
    from drivers.simulated.settings import MILK, PURE_WATER

    monkeypatch.chdir(tmp_path)
    Path("separate.toml").write_text(SEPARATED)
    assert main(["run", "separate.toml", "--out", "run", "--no-fit"]) == 0
    capsys.readouterr()
    read, whole = [], StoredFrames.read
    monkeypatch.setattr(
        StoredFrames, "read", lambda self, frame, *more, **named: read.append(frame["index"])
        or whole(self, frame, *more, **named)
    )  # fmt: skip
    assert main(["separate", "run", "--json"]) == 0
    assert len(read) == len({*read}) == 9, "each wave's frame and the dark's once, and no photograph for fits"
    (sheet,) = json.loads(capsys.readouterr().out)["sheets"]
    assert sheet["dose_ml"] == pytest.approx(0.4)
    sigma_t = 0.4 * MILK.sigma_t + PURE_WATER.sigma_t
    assert abs(sheet["sigma_t"] - sigma_t) < max(3.0 * sheet["sigma_t_sd"], 0.02 * sigma_t)
    assert Path(sheet["picture"]).stat().st_size > 10_000
    assert sheet["doubts"] == []
    (file,) = Path("run/derived").glob("*.npz")
    arrays, about = read_derived(file)
    assert {"sheet", "modulated_8mm", "even_16mm", "order_1", "order_1_noise"} <= arrays.keys()
    assert about["frames"]
    _order_1_speaks_for_the_right_liquid_and_against_another(0.4)
    assert main(["recover", "run"]) == 0
    assert "calculated anew" not in capsys.readouterr().out
    file.write_bytes(file.read_bytes()[:-100])
    assert main(["recover", "run"]) == 0, "nothing that was recorded is lost"
    assert f"{file.name} (tankrig separate run)" in capsys.readouterr().out.replace("\n", " ")
    assert len(open_run("run").events("frame")) == 10


def _order_1_speaks_for_the_right_liquid_and_against_another(dose_ml: float) -> None:
    from drivers.simulated.settings import MILK, PURE_WATER
    from drivers.simulated.tank import mixture

    liquid = mixture(PURE_WATER, MILK, dose_ml)
    liquid = Medium(*liquid.coefficients)
    separated = Separated.of_run(open_run("run"))
    (starts,) = separated.media.values()
    assert {one.g for one in starts} == {0.0, 0.5, 0.85}, "parallel light tells nothing of g"
    (one,) = separated.sheets
    seen = told_of(one).alone
    assert seen is not None
    assert all(
        abs(start.sigma_t - liquid.sigma_t) < max(3.0 * seen.sigma_t_sd, 0.02 * liquid.sigma_t) for start in starts
    )
    gain = seen.at_right_angle / (liquid.sigma_s * float(liquid.phase_function.at(0.0)))
    right = DoseFit(dose_ml, liquid, (1e-6, 1e-5, 0.002), gain=gain)
    assert separated.beside(right).order_one == ""
    denser = Medium(1.5 * liquid.sigma_a, 1.5 * liquid.sigma_s, liquid.g)
    doubted = separated.beside(replace(right, medium=denser, gain=gain / 1.5))
    assert "by its decay order 1 has σt" in doubted.order_one
    assert "the fit has the wrong liquid" in doubted.order_one
    assert from_fields(to_fields(doubted)) == doubted, "the journal keeps it"
    assert "order_one" not in to_fields(right)
    series = SeriesFit((dose_ml, 2.0), Medium(*(c / dose_ml for c in denser.coefficients[:2]), denser.g),
                       Medium(0.0, 0.0, 0.0), (1e-6, 1e-5, 0.002, 1e-6), gain / 1.5, verdict="It fits.")  # fmt: skip
    assert separated.beside_series(series).verdict.startswith("It fits. At 0.4 ml ")


def test_a_run_without_waves_is_refused_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tankrig.run.folder import create_run
    from tankrig.sequence.loading import sequence_table

    sequence = Sequence("nothing", (Wait(0.0),))
    create_run(tmp_path / "run", (4, 6), "uint16", 1, {"name": "nothing", "sequence": sequence_table(sequence)})
    assert main(["separate", str(tmp_path / "run")]) == 2
    assert 'do = "separate"' in capsys.readouterr().err

"""Pictures that are designed: what they are expected to tell is what fits state, and no picture is better nearby."""

import json
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tankrig import SceneError, SequenceError
from tankrig.advice.cells import CellLight, cell_light, designing_camera, even_cells, parts_of, with_parts
from tankrig.advice.design import Prospect, designed
from tankrig.advice.expected import Known, Shot, about_liquid
from tankrig.advice.next_pictures import next_pictures, usual_pictures
from tankrig.advice.ranking import answer_by_paths
from tankrig.bench import Bench
from tankrig.estimation.phase_families import Family, fixed, reynolds_mccormick
from tankrig.estimation.phase_result import scattering_of
from tankrig.pattern import Cells, draw
from tankrig.pattern.wall import Wall
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.phase_functions import ReynoldsMcCormick
from tankrig.sequence.loading import sequence_from_table
from ui.cli import main

LIQUID = Medium(5e-4, 0.02, 0.8)
SHAPE = 12, 18
SCENE = Scene(
    Tank((72.0, 48.0, 40.0)), LIQUID, Projector("collimated", (Beam((-18.0, 18.0), (18.0, 22.0)),)),
    Camera("orthographic", SHAPE, 4.0),
)  # fmt: skip
BENCH = Bench(SCENE.tank, Wall((40, 48), (-24.0, 24.0), (0.0, 40.0)), "collimated", SCENE.camera)
EMULSION = Medium(5e-4, 0.02, phase=ReynoldsMcCormick(0.7, 0.8))
FITTED = st.sampled_from([None, reynolds_mccormick()])
GAIN, READ, SHOT = 2.0, 0.01, 0.02
WANTED = st.sampled_from(["all", "sum", "sigma_a", "sigma_s", "g"])


def some_light(count: int = 5, seed: int = 0, sheets: int = 1, family: Family | None = None) -> CellLight:
    """Cells that glow about their rows, each liquid's values changing them otherwise."""
    chance = np.random.default_rng(seed)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    images, slopes = [], []
    for number in range(sheets * count):
        at, wide = SHAPE[0] * (number % count + 0.5) / count, 1.0 + 0.1 * columns
        glow = np.exp(-0.5 * ((rows - at) / wide) ** 2 - columns / 12.0)
        images.append(glow)
        slopes.append([-30.0 * columns * glow, 50.0 * glow * (1.0 - columns / 9.0), (rows - at) ** 2 / wide**2 * glow])
        if family is not None:
            slopes[-1].append(np.sqrt(columns + 1.0) * (rows - at) * glow)
    scene = SCENE if family is None else replace(SCENE, medium=EMULSION)
    bumpy = 1.0 + 0.1 * chance.normal(size=(sheets * count, 1, *SHAPE))
    z_mm = [(8.0 + 10.0 * k, 12.0 + 10.0 * k) for k in range(sheets)]
    cells = even_cells((-18.0, 18.0), z_mm, count)
    return CellLight(cells, scene, np.array(images), np.array(slopes) * bumpy, np.ones(SHAPE, bool), family)


def prospect(light: CellLight, error: float = 0.003, **keys: object) -> Prospect:
    return Prospect(light, GAIN, lambda image: READ**2 + SHOT**2 * image, error, **keys)


@given(
    st.integers(0, 10**6), st.integers(1, 3), WANTED, st.booleans(), st.booleans(), st.floats(0.5, 50.0), FITTED
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_the_way_up_is_the_way_up(
    seed: int, pictures: int, wanted: str, offset_free: bool, full: bool, frames: float, family: Family | None
) -> None:
    """A slope that is wrong would end designs anywhere, and nobody would see it."""
    light = some_light(seed=seed, family=family)
    one = prospect(light, offset_free=offset_free, saturation=3.0 if full else None)
    one = one.with_pictures(np.ones((1, 5)), 2.0)
    light = np.random.default_rng(seed).uniform(0.2, 0.9, (pictures, 5))
    _, slope = one.value_and_slope(light, frames, wanted)
    step = 1e-4
    for place in np.ndindex(light.shape):
        change = np.zeros(light.shape)
        change[place] = step
        by_difference = (one.value(light + change, frames, wanted) - one.value(light - change, frames, wanted)) / step
        assert slope[place] == pytest.approx(0.5 * by_difference, rel=1e-4, abs=1e-5 * float(np.abs(slope).max()))


@given(st.floats(1.0, 100.0), st.booleans(), st.floats(0.0, 0.01), st.integers(0, 100), FITTED)
@settings(max_examples=20, deadline=None)
def test_it_counts_what_advice_counts(
    frames: int, offset_free: bool, error: float, seed: int, family: Family | None
) -> None:
    """One picture tells as much as the same pattern does to `tankrig advise`, model's error and all."""
    light, parts = some_light(seed=seed, family=family), np.array([1.0, 0.3, 0.0, 0.6, 1.0])
    ink = light.scene.medium
    known = Known(ink, 0.0, GAIN, offset_free, lambda image: READ**2 + SHOT**2 * image, error, family)
    shot = Shot("cells", light.scene, 1.0, 0.0, frames)
    told = about_liquid(known, shot, lambda *_: light.picture(parts))
    values = known.values.size
    covariance = told.covariance(np.append(known.widest, 10.0))[:values, :values]
    if family is not None:
        covariance = scattering_of(known.values[:2], known.values[2:], covariance, family).covariance
    found = prospect(light, error, offset_free=offset_free).expected(parts[None], frames)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-4, atol=1e-7 * covariance.max())


def test_neither_frames_nor_more_pictures_average_the_models_error_away() -> None:
    light = some_light()
    one, sheet = prospect(light, 0.01), np.ones((1, 5))
    most = [one.expected(sheet, frames).relative_sd["sigma_s"] for frames in (1e6, 1e9)]
    assert most[1] == pytest.approx(most[0], rel=0.01)
    again = one.expected(np.ones((50, 5)), 1e9).relative_sd["sigma_s"]
    assert again == pytest.approx(most[1], rel=0.01), "the model errs alike in all pictures"
    without = prospect(light, 0.0)
    few, many = (without.expected(sheet, frames).relative_sd["sigma_s"] for frames in (1.0, 100.0))
    assert few == pytest.approx(10.0 * many, rel=0.01)


@given(st.floats(0.2, 3.0), FITTED)
@settings(max_examples=20, deadline=None)
def test_what_is_known_is_carried_to_another_dose(share: float, family: Family | None) -> None:
    """Two doses of one ink tell as much in whichever order they are photographed."""
    thin = some_light(seed=1, family=family)
    medium = thin.scene.medium
    dense = replace(medium, sigma_a=medium.sigma_a / share, sigma_s=medium.sigma_s / share)
    there = replace(some_light(seed=2, family=family), scene=replace(thin.scene, medium=dense))
    sheet, stripes = np.ones((1, 5)), np.array([[1.0, 0.0, 1.0, 0.0, 1.0]])
    onward = prospect(thin).with_pictures(sheet, 4.0).at_dose(there, share).with_pictures(stripes, 4.0)
    back = prospect(there).with_pictures(stripes, 4.0).at_dose(thin, 1.0 / share).with_pictures(sheet, 4.0)
    one, other = (known.expected(np.zeros((1, 5)), 1e-9).relative_sd for known in (onward, back))
    for name, sd in one.items():
        assert sd == pytest.approx(other[name], rel=1e-3)


@given(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5), st.booleans(), st.floats(1.0, 20.0))
@settings(max_examples=20, deadline=None)
def test_what_was_photographed_counts_as_a_designed_picture_would(
    parts: list[float], offset_free: bool, frames: float
) -> None:
    light = some_light()
    one, shown = prospect(light, offset_free=offset_free), np.array(parts)
    before, after = (
        again.expected(np.ones((1, 5)), 4.0).covariance
        for again in (
            one.with_pictures(shown[None], frames), one.with_photograph(*light.picture(shown), light.used, frames),
        )
    )  # fmt: skip
    np.testing.assert_allclose(before, after, rtol=1e-9)
    alone = one.expected(np.ones((1, 5)), 4.0).covariance
    assert np.linalg.slogdet(after)[1] <= np.linalg.slogdet(alone)[1] + 1e-9


def test_a_picture_is_designed_beside_photographs_and_serves_the_next_fit_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A live fit moves a little with each frame; computing all cells anew each time would take seconds."""
    asked: list[Medium] = []
    sheet = np.ones(5)

    def cells_light(
        cells: Cells, _bench: Bench, _camera: Camera, medium: Medium, progress: Callable, _family: None
    ) -> CellLight:
        asked.append(medium)
        progress(1.0)
        return replace(some_light(), scene=replace(SCENE, medium=medium), cells=cells)

    module = sys.modules[next_pictures.__module__]
    monkeypatch.setattr(module, "cell_light", cells_light)
    monkeypatch.setattr(module, "pattern_light", lambda *_: some_light().picture(sheet))
    known = Known(LIQUID, 0.0, GAIN, False, lambda image: READ**2 + SHOT**2 * image, 0.003)
    taken, cells = [Shot("sheet", SCENE, 1.0, 0.0, 20, np.ones(SHAPE, bool))], even_cells((-18.0, 18.0), [(18, 22)], 5)
    told: list[float] = []
    unsure = (0.3 * LIQUID.sigma_a, 0.001 * LIQUID.sigma_s, 0.002)
    found = next_pictures(
        known, 1.0, unsure, BENCH, SCENE.camera, cells, 1, 4, taken=taken, progress=told.append, limit_s=20.0
    )
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)
    assert len(asked) == len(set(asked)) == 3, "the liquid, and one with less absorption and one with more"
    assert found.now is not None
    assert np.linalg.slogdet(found.design.after.covariance)[1] < np.linalg.slogdet(found.now.covariance)[1]
    assert found.bits >= 0.0, "no worse than another usual picture beside the sheet"
    moved = Known(Medium(1.003 * LIQUID.sigma_a, 0.997 * LIQUID.sigma_s, 0.802), 0.0, GAIN, False, known.noise, 0.003)
    next_pictures(moved, 1.0, unsure, BENCH, SCENE.camera, cells, 1, 4, taken=taken, limit_s=20.0)
    assert set(asked[3:]) == set(asked[:3])
    by_itself = next_pictures(known, 1.0, unsure, BENCH, SCENE.camera, cells, 1, 4, limit_s=20.0)
    assert by_itself.now is None


@given(st.integers(0, 1000), WANTED)
@settings(max_examples=10, deadline=None)
def test_a_design_is_never_worse_than_where_it_began_and_stays_within_the_projector(seed: int, wanted: str) -> None:
    one = prospect(some_light(seed=seed))
    starts = [light[None] for light in usual_pictures(one.light.cells).values()]
    found = designed([one], starts, 4.0, wanted, limit_s=20.0)
    best = min(one.value(light, 4.0, wanted) for light in starts)
    assert one.value(found.light, 4.0, wanted) <= best + 1e-12
    assert found.bits >= 0.0
    assert found.light.min() >= 0.0
    assert found.light.max() <= 1.0
    near = np.clip(found.light + np.random.default_rng(seed).normal(0.0, 0.03, (20, *found.light.shape)), 0.0, 1.0)
    assert min(one.value(light, 4.0, wanted) for light in near) > one.value(found.light, 4.0, wanted) - 2e-3


def test_a_design_keeps_the_camera_from_saturating() -> None:
    light = some_light()
    sheet = np.ones((1, 5))
    brightest = GAIN * light.images.sum(axis=0).max()
    one = prospect(light, 0.0, saturation=0.5 * brightest)
    found = designed([one], [sheet], 4.0, limit_s=20.0)
    assert one.value(found.light, 4.0, "all") < one.value(sheet, 4.0, "all") - 0.1
    shown = GAIN * light.picture(found.light[0])[0]
    assert (shown > 0.97 * 0.5 * brightest).sum() < (light.picture(sheet[0])[0] * GAIN > 0.97 * 0.5 * brightest).sum()


def test_when_its_time_is_over_it_answers_with_the_best_so_far() -> None:
    ticks = iter(np.arange(0.0, 1e6, 0.2))
    one = prospect(some_light())
    found = designed([one], [np.ones((1, 5))], 4.0, limit_s=0.9, clock=lambda: float(next(ticks)))
    assert found.seconds < 2.0
    assert found.bits >= 0.0


@given(
    st.lists(st.floats(0.0, 1.0), min_size=3, max_size=12), st.floats(0.5, 3.0), st.booleans(), st.integers(1, 3)
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_cells_have_the_light_they_are_said_to_have_whatever_the_projectors_response(
    light: list[float], gamma: float, mirrored: bool, sheets: int
) -> None:
    wall = Wall((60, 160), (80.0, -80.0) if mirrored else (-80.0, 80.0), (0.0, 120.0), gamma=gamma)
    z_mm = tuple((20.0 + 30.0 * k, 24.0 + 30.0 * k) for k in range(sheets))
    cells = Cells((-60.0, 60.0), z_mm, tuple(tuple(light) for _ in z_mm))
    shown = wall.fractions[draw(cells, wall).pixels]
    assert not shown[:, np.abs(wall.y_centres_mm) > 60.0].any()
    coarsest = float(np.diff(wall.fractions).max())
    for low, high in z_mm:
        rows = shown[(wall.z_centres_mm > low) & (wall.z_centres_mm < high)]
        for number, part in enumerate(light):
            left = -60.0 + number * cells.cell_mm
            inside = (wall.y_centres_mm > left + 1e-9) & (wall.y_centres_mm < left + cells.cell_mm - 1e-9)
            np.testing.assert_allclose(rows[:, inside], part, atol=coarsest)
    assert with_parts(cells, parts_of(cells)).light == tuple(tuple(np.round(light, 4).tolist()) for _ in z_mm)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"light": ((1.0,), (1.0,))}, "give each sheet"),
        ({"light": ((1.0, 2.0),)}, "outside 0…1"),
        ({"y_mm": (60.0, -60.0)}, "is no width"),
        ({"z_mm": ((58.0, 62.0), (60.0, 64.0)), "light": ((1.0,), (1.0,))}, "overlap"),
    ],
)
def test_cells_that_are_none_are_refused_in_a_sentence(keys: dict, said: str) -> None:
    good = {"y_mm": (-60.0, 60.0), "z_mm": ((58.0, 62.0),), "light": ((1.0, 0.5),)}
    with pytest.raises(SequenceError, match=said):
        Cells(**(good | keys))
    with pytest.raises(SequenceError, match="finer than the projector"):
        draw(Cells((-60.0, 60.0), ((58.0, 62.0),), ((1.0,) * 200,)), Wall((60, 160), (-80.0, 80.0), (0.0, 120.0)))


def test_the_light_of_cells_adds_up_to_that_of_the_picture_and_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tankrig.light.tangent import tank_tangent

    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    cells = even_cells((-18.0, 18.0), [(18.0, 22.0)], 3)
    told: list[float] = []
    found = cell_light(cells, BENCH, BENCH.camera, LIQUID, told.append)
    whole = tank_tangent(found.scene, 4, seed=5, blur_mm=4.0)
    picture, changes = found.picture(np.ones(3))
    image = whole.prediction.image
    assert np.linalg.norm(picture - image) < 0.01 * np.linalg.norm(image)
    for one, other in zip(changes, whole.slopes, strict=True):
        assert np.linalg.norm(one - other) < 0.03 * np.linalg.norm(other)
    np.testing.assert_allclose(found.images[0], found.images[2][::-1])  # light at −y is the mirror image of that at y
    assert len(told) > 1
    told.clear()
    again = cell_light(cells, BENCH, BENCH.camera, LIQUID, told.append)
    assert told == [1.0], "what is kept is not computed again"
    np.testing.assert_array_equal(again.images, found.images)
    known, many = Known(LIQUID, 0.0, 1.0, False, np.copy, 0.001), even_cells((-18.0, 18.0), [(18.0, 22.0)], 41)
    with pytest.raises(SequenceError, match="give fewer"):
        next_pictures(known, 1.0, (), BENCH, BENCH.camera, many)
    with pytest.raises(SequenceError, match="beyond what the projector lights, y = -24…24 mm"):
        next_pictures(known, 1.0, (), BENCH, BENCH.camera, even_cells((-60.0, 60.0), [(18.0, 22.0)], 3))
    assert designing_camera(replace(BENCH.camera, shape=(120, 180), pixel_mm=0.4))[1] == 3


def test_light_of_cells_of_a_liquid_whose_phase_function_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No liquid of a lab is Henyey–Greenstein's; what a picture tells of its phase function comes with the cells."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    cells, family = even_cells((-18.0, 18.0), [(18.0, 22.0)], 3), reynolds_mccormick()
    found = cell_light(cells, BENCH, BENCH.camera, EMULSION, family=family)
    whole, slopes = answer_by_paths(family)(found.scene, EMULSION)
    picture, changes = found.picture(np.ones(3))
    assert np.linalg.norm(picture - whole) < 0.02 * np.linalg.norm(whole)
    for one, other in zip(changes, slopes, strict=True):
        assert np.linalg.norm(one - other) < 0.05 * np.linalg.norm(other)
    told = prospect(found, 0.0).expected(np.ones((1, 3)), 1e5)
    given_phase = cell_light(cells, BENCH, BENCH.camera, EMULSION, family=fixed(EMULSION.phase_function))
    as_if_known = prospect(given_phase, 0.0).expected(np.ones((1, 3)), 1e5)
    assert told.relative_sd["sigma_s"] > 1.2 * as_if_known.relative_sd["sigma_s"], "what else is fitted widens"
    assert as_if_known.relative_sd["g"] == 0.0
    with pytest.raises(SceneError, match="nothing says which family"):
        cell_light(cells, BENCH, BENCH.camera, EMULSION)


def test_from_a_guess_to_a_sequence_that_shows_them_by_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A person asks for pictures, and runs what comes: the dry run takes it, and it ends once enough is known."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    rig = Path(main.__code__.co_filename).parents[2] / "drivers" / "simulated" / "rig.toml"
    text = rig.read_text(encoding="utf-8")
    for before, after in (
        ("[240.0, 160.0, 120.0]", "[72.0, 48.0, 40.0]"), ("[80, 120]", "[24, 36]"),
        ("y_mm = [-80.0, 80.0]", "y_mm = [-24.0, 24.0]"), ("z_mm = [0.0, 120.0]", "z_mm = [0.0, 40.0]"),
    ):  # fmt: skip
        assert before in text
        text = text.replace(before, after)
    Path("rig.toml").write_text(text, encoding="utf-8")
    Path("s.toml").write_text('name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\n', encoding="utf-8")
    common = ["advise", "--sequence", "s.toml", "--rig", "rig.toml", "--ink", "0.0005", "0.02", "0.8"]
    asked = [*common, "--design", "next.toml", "--cells", "4", "--dose-ul", "1000", "--until", "sigma_s", "1%"]
    assert main([*asked, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bits"] >= 0.0
    assert set(told["relative_sd"]) == {"sigma_a", "sigma_s", "g"}
    sequence = sequence_from_table(tomllib.loads(Path("next.toml").read_text(encoding="utf-8")), "next.toml")
    assert [type(sequence.patterns[f"designed-{k}"]) for k in (1, 2)] == [Cells, Cells]
    assert str(sequence.tasks[-1].action.until) == "σs known to 1 %"
    assert main(["run", "next.toml", "--rig", "rig.toml", "--dry-run"]) == 0
    capsys.readouterr()
    assert main([*common, "--design", "next.toml"]) == 2
    assert "--dose-ul" in capsys.readouterr().err
    assert main([*asked, "--until", "g", "soon"]) == 2
    assert "--until wants" in capsys.readouterr().err


TRUE = 1.5e-4
"""Tolerance of images that stand for the truth: fits state .05 to .1 %, and count on nothing else."""


@pytest.mark.long
@pytest.mark.timeout(3000)
def test_fits_of_designed_pictures_hold_the_liquid_as_often_as_they_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A design looks for where errors are small; if it found where they are only stated small, fits would be off."""
    from tankrig.estimation.one_liquid import fit_liquid
    from tankrig.estimation.scaling import Scaling
    from tankrig.estimation.several_images import observed
    from tankrig.image.predict import predict

    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    chance, cells = np.random.default_rng(5), even_cells((-18.0, 18.0), [(18.0, 22.0)], 6)
    z: dict[str, list[np.ndarray]] = {"designed": [], "sheet and stripes": []}
    over = []
    for number in range(8):
        sigma_s, absorbed = np.exp(chance.uniform(np.log([0.01, 0.02]), np.log([0.06, 0.1])))
        liquid = Medium(float(sigma_s * absorbed), float(sigma_s), float(chance.uniform(0.3, 0.85)))
        light = cell_light(cells, BENCH, BENCH.camera, liquid)
        peak = float(light.images.sum(axis=0).max())
        now = Prospect(light, 1.0 / peak, lambda image: 1e-6 + 4e-6 * image, 0.001)
        found = designed([now], [np.ones((2, 6))], 4.0, limit_s=60.0)
        usual = [with_parts(cells, light) for light in (np.ones(6), np.arange(6) % 2.0)]
        for name, pictures in (("designed", found.pictures), ("sheet and stripes", usual)):
            scenes = [BENCH.scene(draw(one, BENCH.wall, "cells"), LIQUID) for one in pictures]
            noises, images = [], []
            for scene in scenes:
                seen = predict(replace(scene, medium=liquid), "tank", tolerance=TRUE, seed=50 + number)
                truth = seen.image / peak
                noises.append(np.sqrt((1e-6 + 4e-6 * truth) / 4.0))
                images.append(truth + noises[-1] * chance.standard_normal(truth.shape))
            fit = fit_liquid(observed(images, scenes, noises), scenes, Scaling.given("free", 0.0), start=liquid)
            assert fit is not None
            sd = np.sqrt(np.diag(fit.covariance))
            z[name].append((np.array(fit.medium.coefficients) - liquid.coefficients) / sd)
            if name == "designed":
                over.append(sd / np.sqrt(np.diag(found.after.covariance)))
            print(number, name, liquid.coefficients, np.round(z[name][-1], 2), flush=True)
    inside = {name: float(np.mean(np.abs(one) < 1.96)) for name, one in z.items()}
    for name, one in z.items():
        print(f"{name}: within 95 %: {inside[name]:.2f}, rms z {np.sqrt(np.mean(np.square(one))):.2f}")
    assert inside["designed"] > 0.83  # of 24 by chance 0.95 ± 0.045
    assert 0.4 < float(np.median(over)) < 2.5

"""A prepared model of any phase function answers like the tank model of liquids that it was not made from."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.errors import SceneError
from tankrig.estimation.phase_families import free
from tankrig.image.prepare import Prepared
from tankrig.light.double import double_scattering
from tankrig.light.double.pairs import double_pairs
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.phases import plan, preparation
from tankrig.light.prepared.phases.traits import splines as splines_apart
from tankrig.light.tank import tank_image
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.free_phase import FreePhase
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import HenyeyGreenstein, Mixture, ReynoldsMcCormick, TwoTerm
from tankrig.scene.phase_table import PhaseFunction, phase_quadrature
from tests.stress_scenes import relative

BEAD = Mie(0.5, 1.5868, 1.3317, 633.0)
LIGHT = Projector("collimated", (Beam((-20.0, -4.0), (58.0, 62.0)), Beam((30.0, 42.0), (40.0, 50.0), 0.5)))
SCENE = Scene(Tank(), Medium(0.0004, 0.01, 0.8), LIGHT, Camera("orthographic", (20, 30), 8.0))
BOX = Box((0.0085, 0.0117), (0.9, 0.9999), (0.75, 0.87))
TOLERANCE = 0.02
LIQUIDS = {"bead": BEAD, "gegenbauer": ReynoldsMcCormick(0.7, 1.1), "two": TwoTerm(0.87, -0.3, 0.95)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def cached(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))


@pytest.fixture(scope="module")
def live(folder: Path) -> Iterator[Prepared]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(folder))
        patch.setattr(plan, "FEWEST", 0.3)  # media of those at the usual tolerance; a half takes twice as long
        yield tankrig.prepare(SCENE, TOLERANCE, box=BOX, phases="any")


phases = st.one_of(
    st.builds(HenyeyGreenstein, st.floats(-0.5, 0.95)),
    st.builds(TwoTerm, st.floats(0.3, 0.95), st.floats(-0.6, -0.1), st.floats(0.7, 1.0)),
    st.builds(FreePhase, st.floats(0.0, 0.95), st.lists(st.floats(-1.5, 1.5), max_size=16).map(tuple)),
    st.builds(Mie, st.floats(0.1, 1.4), st.floats(1.45, 1.62), st.just(1.3317), st.just(633.0)),
)


@settings(max_examples=15, deadline=None)
@given(phases)
def test_splines_keep_what_smooth_kernels_make_of_a_phase_function(phase: PhaseFunction) -> None:
    """Light, mean cosine and further moments would else differ between order 2 and the rest."""
    splines = splines_apart(5.0)
    sine, weights = phase_quadrature()
    cosine = 1.0 - 2.0 * sine**2
    found = 8.0 * math.pi * weights * sine * (splines.at(cosine) @ splines.coefficients(phase))
    moments = np.polynomial.legendre.legvander(cosine, 8).T @ found
    assert np.abs(moments - phase.moments(8)).max() < 2e-4


@pytest.mark.parametrize("surface", ["matched", "fresnel"])
def test_pairs_of_splines_make_order_2_of_any_phase_function(surface: str) -> None:
    """Order 2 is half of the light that tells phase functions apart."""
    scene = replace(SCENE, tank=replace(SCENE.tank, surface=surface), medium=Medium(0.0, 0.012, 0.0))
    splines = splines_apart(5.0)
    tables = double_pairs(scene, splines)
    for phase in (*LIQUIDS.values(), HenyeyGreenstein(0.0), HenyeyGreenstein(0.93), FreePhase(0.8, (1.0, -1.0, 0.7))):
        truth = double_scattering(replace(scene, medium=Medium(0.0, 0.012, phase=phase))) / 0.012**2
        assert relative(tables.image(splines.coefficients(phase)), truth) < 1e-3
    patterns = np.linalg.qr(np.random.default_rng(0).normal(size=(600, 3)))[0].T
    numbers = splines.coefficients(BEAD)
    along = np.einsum("i,ijp,j->p", numbers, tables.along(patterns.reshape(3, 20, 30)), numbers)
    assert along == pytest.approx(patterns @ tables.image(numbers).ravel(), rel=1e-3, abs=1e-4 * np.abs(along).max())


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", LIQUIDS)
@pytest.mark.parametrize(("sigma_a", "sigma_s"), [(0.0004, 0.0098), (0.0001, 0.0112)])
def test_it_answers_like_the_tank_model_and_says_how_well(
    live: Prepared, name: str, sigma_a: float, sigma_s: float
) -> None:
    medium = Medium(sigma_a, sigma_s, phase=LIQUIDS[name])
    one, other = (tank_image(replace(SCENE, medium=medium), batches=8, seed=seed).image for seed in (11, 12))
    found = live.predict(medium)
    squared = np.vdot(found - one, found - other) / np.vdot(one, other)  # without either's noise
    assert live.error_at(medium) < 0.03
    assert squared < (1.7 * live.error_at(medium)) ** 2
    assert abs(found.sum() / (0.5 * (one + other)).sum() - 1.0) < 0.01


@pytest.mark.timeout(600)
def test_its_slopes_are_those_of_its_images(live: Prepared) -> None:
    """A fit that is led elsewhere ends beside the optimum, and its errors are wrong."""
    medium = Medium(0.0004, 0.01, phase=BEAD)
    others = [HenyeyGreenstein(0.8), FreePhase(0.85, (1.0, -0.5)), BEAD]
    image, slopes = live.slopes(medium, others)
    assert image == pytest.approx(live.predict(medium), rel=1e-6)

    def difference(ahead: Medium, behind: Medium, step: float) -> np.ndarray:
        return (live.predict(ahead) - live.predict(behind)) / step

    by_a = difference(replace(medium, sigma_a=5e-4), replace(medium, sigma_a=3e-4), 2e-4)
    by_s = difference(replace(medium, sigma_s=0.0101), replace(medium, sigma_s=0.0099), 2e-4)
    assert relative(slopes[0], by_a) < 5e-3
    assert relative(slopes[1], by_s) < 5e-3
    for other, slope in zip(others[:2], slopes[2:4], strict=True):
        mixed = Medium(medium.sigma_a, medium.sigma_s, phase=Mixture((BEAD, other), (0.99, 0.01)))
        assert relative(difference(mixed, medium, 0.01), slope) < 0.03
    assert np.abs(slopes[4]).max() == 0.0
    hazy = Medium(0.0004, 0.01, 0.8)
    _, by_g = live.predict(hazy, derivatives=True)
    stepped = difference(replace(hazy, g=0.803), replace(hazy, g=0.797), 0.006)
    assert relative(by_g[2], stepped) < 0.01


@pytest.mark.timeout(600)
def test_an_image_is_fitted_by_it(live: Prepared) -> None:
    """By its family, in a second or two instead of half a minute."""
    truth = Medium(0.0004, 0.01, phase=ReynoldsMcCormick(0.72, 1.0))
    image = tank_image(replace(SCENE, medium=truth), batches=32, seed=3).image
    noise = 0.003 * image.max()
    image = image + np.random.default_rng(0).normal(0.0, noise, image.shape)
    found = tankrig.estimate(image, SCENE, noise=noise, model=live, phase="reynolds-mccormick")
    sd = np.sqrt(np.diag(found.covariance))
    assert abs(found.medium.sigma_s - 0.01) < max(0.015 * 0.01, 3.0 * sd[1])
    assert abs(found.medium.g - truth.g) < max(0.015, 3.0 * sd[2])
    assert sd[1] < 0.05 * 0.01


@pytest.mark.timeout(600)
def test_what_is_kept_is_read_again_and_a_file_of_other_shapes_is_not(
    live: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels and products must never read what a damaged file happens to hold."""
    made: list[object] = []
    monkeypatch.setattr(preparation, "assemble", lambda *given: made.append(given) or live.answer)
    monkeypatch.setattr(preparation, "training_images", lambda *_: None)
    again = tankrig.prepare(SCENE, TOLERANCE, box=BOX, phases="any")
    medium = Medium(0.0004, 0.01, phase=BEAD)
    assert made == []
    assert np.array_equal(again.predict(medium), live.predict(medium))
    whole = dict(np.load(live.path))
    for name, value in {
        "twice": whole["twice"][:-1],
        "error": np.full(4, np.nan),
        "patterns": np.zeros((3, 5)),
    }.items():
        np.savez(live.path, **(whole | {name: value}))
        assert tankrig.prepare(SCENE, TOLERANCE, box=BOX, phases="any").answer is live.answer
    assert len(made) == 3


def test_what_it_does_not_know_is_refused_in_one_sentence(live: Prepared) -> None:
    with pytest.raises(SceneError, match=r"outside 0\.75 … 0\.87"):
        live.predict(Medium(0.0004, 0.0096, 0.5))
    with pytest.raises(SceneError, match="use slopes"):
        live.predict(Medium(0.0004, 0.0098, phase=BEAD), derivatives=True)
    slanting = replace(SCENE, camera=Camera("pinhole", (20, 30), 8.0, (120.0, 0.0, 620.0)))
    with pytest.raises(SceneError, match="collimated, sharp light"):
        tankrig.prepare(slanting, phases="any")
    with pytest.raises(SceneError, match='"mie" is unknown'):
        tankrig.prepare(SCENE, phases="mie")  # type: ignore[arg-type]


def test_a_medium_beside_the_box_is_answered_by_the_nearest_inside() -> None:
    """A search steps too far now and then, and must come back."""
    for phase in (HenyeyGreenstein(0.97), Mie(1.0, 1.5868, 1.3317, 633.0), FreePhase(0.3, (0.5,))):
        beside = Medium(0.0001, 0.03, phase=phase)
        near = BOX.nearest(beside)
        assert BOX.holds(near)
        assert near.g == pytest.approx(BOX.g[0] if beside.g < BOX.g[0] else BOX.g[1], abs=1e-6)
    inside = Medium(0.0002, 0.01, phase=BEAD)
    assert BOX.nearest(inside) is inside
    assert free().phase(free().like(0.8)).mean_cosine == pytest.approx(0.8, abs=1e-3)

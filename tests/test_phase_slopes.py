"""How images change with a phase function, by light paths and by moments, and how far fits trust that."""

from dataclasses import replace

import numpy as np
import pytest

import tankrig
from tankrig.estimation.borne_out import SETTLED
from tankrig.estimation.coordinates import Range
from tankrig.estimation.differences import liquid_slopes_of
from tankrig.estimation.estimate import fit_models
from tankrig.estimation.followed import Followed
from tankrig.estimation.forward import models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.optimiser import solve
from tankrig.estimation.phase_answer import Asked
from tankrig.estimation.phase_block import CoefficientsBlock, PhaseBlock
from tankrig.estimation.phase_families import as_free, free, henyey_greenstein
from tankrig.estimation.problem import Problem
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.series_forward import tank_model
from tankrig.estimation.shots import Shot
from tankrig.estimation.versions import Models, image_of
from tankrig.light.tank import tank_image
from tankrig.prediction import Prediction
from tankrig.scene import Camera, Medium
from tankrig.scene.phase_functions import HenyeyGreenstein, ReynoldsMcCormick, TwoTerm
from tests.phase_images import TANK, Array, many_turns
from tests.test_estimation import SCENE


@pytest.mark.long
def test_models_about_an_image_know_the_finer_shapes_of_a_phase_function() -> None:
    """By five moments of p some shapes changed orders ≥ 3 by a half of what they do, and fits followed that."""
    family = free()
    scene = replace(TANK, camera=Camera("orthographic", (20, 30), 8.0))
    at = as_free(TwoTerm(0.88, -0.3, 0.94))

    def liquid(off: Array) -> Medium:
        return Medium(6e-4, 0.02, phase=family.phase(at + off))

    def image(off: Array) -> dict[str, Array]:
        found = tank_image(replace(scene, medium=liquid(off)), batches=16, seed=3)
        return {"all": found.image, "high": found.image - found.orders[1] - found.orders[2]}

    model, here = Followed(scene, 16, 3, None, family=family, sharp=True), image(np.zeros(at.size))
    exact = Prediction(here["all"], "tank")
    near = model.about(liquid(np.zeros(at.size)), exact, model.shares(liquid(np.zeros(at.size))))
    assert np.abs(near(liquid(np.zeros(at.size))).image - here["all"]).max() < 1e-3 * here["all"].max()
    for shape in (5, 6, 9):
        there = image(step := 0.3 * np.eye(at.size)[shape])
        off = near(liquid(step)).image - there["all"]
        assert np.linalg.norm(off) < 0.4 * np.linalg.norm(there["high"] - here["high"]), shape


def test_fits_stay_close_to_where_an_exact_image_was_made() -> None:
    """What an image hardly tells goes where derivatives' noise leads it."""
    blocks = (CoefficientsBlock(Range.of_tank(240.0)), PhaseBlock(free()))
    image = np.arange(1.0, 25.0).reshape(4, 6)
    seen = observe(image, (4, 6), 0.1)
    shot = Shot(seen, SCENE, Models(many_turns, None, family=free()))
    view = shot.view(lambda _: image, lambda _: np.zeros((19, 4, 6)), np.full((4, 6), 1e-3))
    problem = Problem((view,), blocks, Scaling(1.0, 0.0), quick=False)
    place = np.concatenate([one.start(Medium(0.001, 0.02, 0.8)) for one in blocks])
    place[3:] = 0.9
    end = solve(replace(problem, close=(place, 4.0)), place, 1e-9, 30).coordinates
    assert end[3:] == pytest.approx(np.full(16, 0.72), rel=1e-4)  # 4 · .9/(4 + 1)
    assert solve(problem, place, 1e-9, 30).coordinates[3:] == pytest.approx(np.zeros(16), abs=1e-4)


def test_families_are_weighed_by_the_models_that_they_are_fitted_with() -> None:
    """Noise of differences passes for knowledge: steps along what nothing tells end at once, wherever they are."""
    scene = replace(TANK, camera=Camera("orthographic", (10, 15), 16.0))
    liquid = Medium(3e-4, 0.01, phase=free().phase(as_free(TwoTerm(0.88, -0.3, 0.94))))
    found = []
    for models in (models_of(scene, "tank", None).of(free()), models_of(scene, "tank", None, free())):
        _, differentiated = models.refined(liquid)
        found.append(models.slopes_of(differentiated, 240.0)(liquid))
    weighed, asked = found
    assert weighed.tolist() == asked.tolist()


def test_a_correction_goes_no_further_than_exact_images_bear_out() -> None:
    """Models that change .45 times as much as the image does ask for steps that are twice too long."""

    def tank(liquid: Medium) -> Prediction:
        return replace(many_turns(liquid), model="tank")

    def dull(liquid: Medium) -> Prediction:
        sigma_s = 0.02 * (liquid.sigma_s / 0.02) ** 0.45
        return tank(Medium(liquid.sigma_a, sigma_s, phase=liquid.phase_function))

    family, truth = henyey_greenstein(), Medium(0.001, 0.024, phase=HenyeyGreenstein(0.8))
    image = tank(truth).image
    noise = 0.003 * float(image.max())
    seen = observe(image + np.random.default_rng(0).normal(0.0, noise, image.shape), image.shape, noise)
    models = Models(tank, lambda _: (dull, dull), exact=lambda liquid, _: tank(liquid), family=family)
    found = fit_models(seen, SCENE, Scaling(1.0, 0.0), models, lambda _: None, asked=Asked(family))
    assert found.medium.sigma_s == pytest.approx(truth.sigma_s, rel=SETTLED)  # as near as such a fit comes to rest


def test_derivatives_are_taught_by_exact_images() -> None:
    """Derivatives that promise what they do not keep promised the same again, and fits ended where they began."""
    family, scene = free(), replace(TANK, camera=Camera("orthographic", (10, 15), 16.0))
    at = as_free(TwoTerm(0.88, -0.3, 0.94))
    off = np.linspace(-0.1, 0.1, at.size)
    centre, ahead = (Medium(5e-4, 0.02 + 2e-4 * k, phase=family.phase(at + k * off)) for k in (0.0, 1.0))
    here, there = (
        Prediction(tank_image(replace(scene, medium=one), batches=4, seed=3).image, "tank") for one in (centre, ahead)
    )
    model = Followed(scene, 1, 0, None, family=family)
    nothing = np.zeros((2 + at.size, 10, 15))
    taught = model.taught(nothing, centre, here, ahead, there)
    unmoved, foretold = (model.about(centre, here, shares)(ahead).image for shares in (nothing, taught))
    assert np.linalg.norm(foretold - there.image) < 0.1 * np.linalg.norm(unmoved - there.image)
    across = np.zeros(2 + at.size)
    across[2], across[3] = off[1], -off[0]
    assert np.abs(np.tensordot(across, taught, 1)).max() < 1e-9
    assert model.taught(nothing, centre, here, centre, here) is nothing


@pytest.mark.long
def test_a_family_is_fitted_by_light_paths_from_nowhere() -> None:
    """Its first guess is Henyey–Greenstein's, by models that know the family's derivatives."""
    scene = replace(TANK, camera=Camera("orthographic", (10, 15), 16.0))
    liquid = Medium(3e-4, 0.01, phase=ReynoldsMcCormick(0.6, 1.2))
    image = tank_image(replace(scene, medium=liquid), seed=5, batches=8).image
    found = tankrig.estimate(image, scene, noise=0.005 * image.max(), gain=1.0, phase="reynolds-mccormick")
    off = np.array(found.medium.coefficients) - liquid.coefficients
    assert (np.abs(off) < 4.0 * np.sqrt(np.diag(found.covariance))[:3]).all()


def test_many_scatterings_remember_of_a_phase_function_only_its_first_moments() -> None:
    """A fit takes their derivatives from a few images; were these wrong, errors and steps would be."""
    scene = replace(TANK, camera=Camera("orthographic", (20, 30), 8.0))
    family = free()
    liquid = Medium(5e-4, 0.01, phase=family.phase(as_free(ReynoldsMcCormick(0.7, 0.9))))
    models = models_of(scene, "tank", None, family)
    model = tank_model(scene, 2, 0)
    length_mm = max(scene.tank.size_mm)
    whole = liquid_slopes_of(image_of(model), length_mm, family)(liquid)
    quick = models.slopes_of(model, length_mm)(liquid)
    sizes, off = (np.linalg.norm(one.reshape(len(one), -1), axis=1) for one in (whole, quick - whole))
    assert (off[:2] == 0.0).all()
    assert np.median(off / sizes) < 0.04
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(sizes)

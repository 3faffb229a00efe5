"""Fits of beads by what their label says, which is not quite what they are."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import tankrig
from tankrig.estimation.coordinates import Range
from tankrig.estimation.followed import Followed
from tankrig.estimation.forward import models_of
from tankrig.estimation.modes import by_ladder
from tankrig.estimation.observation import observe
from tankrig.estimation.optimiser import solve
from tankrig.estimation.phase_answer import liquid_blocks
from tankrig.estimation.phase_families import labelled
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.series_forward import series_models
from tankrig.estimation.shots import Shot, rough_problem
from tankrig.scene import Medium
from tankrig.scene.mie import Mie
from tests.phase_images import TANK, Array, many_turns, photographed
from tests.test_estimation import SCENE


def test_prepared_models_look_for_a_labels_diameter_all_about_an_end() -> None:
    """Beads of 2 µm in a series ended at 1.968 µm, as the cheap models' best place led."""
    truth, label = (Mie(diameter_um, 1.5834, 1.3317, 633.0, spread=0.02) for diameter_um in (2.0, 2.08))
    liquid, family = Medium(0.001, 0.02, phase=truth), labelled(label)
    image = many_turns(liquid).image
    noise = 0.003 * float(image.max())
    image = image + np.random.default_rng(0).normal(0.0, noise, image.shape)
    models = series_models(SCENE, lambda *_: many_turns, family)
    shot = Shot(observe(image, SCENE.camera.shape, noise, None), SCENE, models)
    blocks = liquid_blocks(Range.of_tank(200.0))(family)
    problem = rough_problem([shot], blocks, Scaling.given(1.0, 0.0))
    start = np.concatenate([block.start(liquid) for block in blocks])
    beside = start.copy()
    beside[2:] = [0.4, *family.like(liquid.g)[1:]]
    steps = 20
    end = solve(problem, beside, 1.0, steps, damping=0.0)
    best, moved = by_ladder(end, family, 1.0, steps)
    assert best.cost < end.cost - 0.5
    assert best.cost < problem.at(start).cost  # the truth's own, which noise is always better than somewhere
    assert moved is None  # one valley


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    ("name", "label", "truth_um", "sigma_s"),
    [
        ("bead-0.5um", Mie(0.525, 1.5804, 1.3317, 633.0), 0.5, 0.010),
        ("bead-2um", Mie(2.0887, 1.58186, 1.3317, 633.0, spread=0.02), 2.0, 0.030),
    ],
)
def test_beads_are_what_their_label_says_but_for_its_errors(
    name: str, label: Mie, truth_um: float, sigma_s: float
) -> None:
    """The label is 4 to 5 % off in the diameter, of which p(90°) goes up and down by a factor.

    Beads of 2 µm came out as 1.91 ± .03 of many sizes, σs 8 standard deviations off and called determined.
    """
    image, noise = photographed(name)
    found = tankrig.estimate(image, TANK, noise=noise, phase=label)
    diameter, sd = found.scattering.parameters["diameter_um"]
    assert abs(diameter - truth_um) < max(0.003 * truth_um, 2.5 * sd)
    assert sd < 0.02 * truth_um
    off = abs(found.medium.sigma_s - sigma_s)
    assert off < max(0.015 * sigma_s, 2.5 * math.sqrt(found.covariance[1, 1]))
    assert found.identifiable["sigma_s"]


def test_few_paths_tell_what_an_unlike_liquids_image_is() -> None:
    """Another mode's image about an exact one is as right as many paths make it, where its derivatives are not."""
    label = labelled(Mie(2.0, 1.58242, 1.3317, 633.0, spread=0.02))
    places = np.array([[-0.4, 2.5, 0.9], [0.0, 0.0, 0.0]])
    at, there = (Medium(0.0009, 0.03, phase=label.phase(place)) for place in places)
    models = models_of(TANK, "tank", None, label)
    few = Followed(TANK, 8, 1, None, family=label)
    known = models.exact(at, 0.25)
    told, truth = few.beside(at, known, there).image, models.exact(there, 0.25).image

    def off(image: Array) -> float:
        smooth = gaussian_filter(image - truth, 1.0)
        return float(np.linalg.norm(smooth) / np.linalg.norm(truth))

    assert off(told) < 0.003
    assert off(few.about(at, known, few.shares(at))(there).image) > 2.0 * off(told)

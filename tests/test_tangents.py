"""Derivatives along the paths are those of the image, and noise that is kept apart is the image's."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from tankrig.estimation.uncertainty import PatternedError, SmoothError
from tankrig.light import behind_lenses
from tankrig.light.double import double_scattering_of
from tankrig.light.paths.block import SMALL
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.tangents import traced_tangents
from tankrig.light.tangent import Turning, tank_accurate, tank_steady, tank_tangent
from tankrig.light.tank import tank_image, twice_of
from tankrig.scene import Medium, Scene
from tankrig.scene.optics import Blur, Halo
from tankrig.scene.phase_functions import Mixture, TwoTerm
from tankrig.scene.phase_table import PhaseFunction
from tests.stress_scenes import medium_of, scene_of

Array = NDArray[np.float64]


def behind_lenses_that_blur(scene: Scene) -> Scene:
    """The same with soft beams, and a camera that blurs and has a halo and a veil."""
    camera = replace(scene.camera, blur=Blur(1.5), halo=Halo(0.03, 25.0), veil=0.01)
    return replace(scene, camera=camera, projector=replace(scene.projector, blur=Blur(1.0)))


SCENES = {
    "parallel": scene_of(medium_of(1.0, 0.05, 0.6), "parallel"),
    "pinholes": scene_of(medium_of(1.0, 0.05, 0.6), "pinhole"),
    "mirror": scene_of(medium_of(1.0, 0.05, 0.2), "parallel", surface="fresnel"),
    "backward": scene_of(medium_of(2.0, 0.02, -0.4), "parallel"),
}
SCENES["lenses"] = behind_lenses_that_blur(SCENES["pinholes"])
COEFFICIENTS = ("sigma_a", "sigma_s", "g")
PINHOLES = pytest.param("pinholes", marks=pytest.mark.long)
"""Where the same light behind lenses that blur, or parallel light, says as much."""


def changed(scene: Scene, **values: float) -> Scene:
    medium = {name: getattr(scene.medium, name) for name in COEFFICIENTS} | values
    return scene.__class__(scene.tank, Medium(**medium), scene.projector, scene.camera)


@pytest.mark.parametrize("name", SCENES)
def test_the_image_that_comes_with_derivatives_is_the_image(name: str) -> None:
    """A fit steps on one and ends on the other: they must not be two models."""
    scene = SCENES[name]
    image = tank_image(scene, seed=3, batches=6).image
    found = tank_tangent(scene, 6, seed=3).prediction
    assert np.linalg.norm(found.image - image) < 1e-6 * np.linalg.norm(image)


@pytest.mark.parametrize("name", SCENES)
def test_light_of_one_order_goes_with_a_power_of_scattering(name: str) -> None:
    """Order 3 is in proportion to σs³ at one extinction, whatever a path does on its way: exact in every cell."""
    scene = SCENES[name]
    light, by_absorption, by_scattering, _ = traced_tangents(scene, CellGrid.of(scene), (1, 0), 3, 2e-4, SMALL)
    assert np.allclose(by_scattering - by_absorption, 3.0 * light / scene.medium.sigma_s, rtol=1e-9, atol=0.0)
    assert by_absorption.sum() < 0.0
    assert (by_absorption <= np.abs(by_absorption).max() / 20.0).all()  # a little more than 0 beside bright cells


@pytest.mark.parametrize("name", ["parallel", PINHOLES, "mirror", "backward", "lenses"])
def test_derivatives_are_those_of_the_light(name: str) -> None:
    """A derivative that is off makes steps creep and errors lie; differences know nothing of scores."""
    scene = SCENES[name]
    medium, slopes = scene.medium, tank_tangent(scene, 8, seed=5).slopes
    steps = {"sigma_a": 0.05 * medium.sigma_a, "sigma_s": 0.03 * medium.sigma_s, "g": 0.03 * (1.0 - medium.g**2)}
    for slope, (coefficient, step) in zip(slopes, steps.items(), strict=True):
        at = getattr(medium, coefficient)
        above, below = (
            tank_image(changed(scene, **{coefficient: at + sign * step}), tolerance=0.005, seed=5, batches=8).image
            for sign in (1.0, -1.0)
        )
        difference = (above - below) / (2.0 * step)
        mine, other = (one.reshape(4, 6, 4, 9).sum(axis=(1, 3)) for one in (slope, difference))
        assert np.linalg.norm(mine - other) < 0.04 * np.linalg.norm(other), coefficient


@pytest.mark.parametrize("name", ["parallel", PINHOLES, "lenses"])
def test_derivatives_towards_another_phase_function_are_those_of_the_light(name: str) -> None:
    """Of any phase function they come along the paths too; fits of emulsions and beads step by them."""
    scene, phase, other = SCENES[name], TwoTerm(0.7, -0.3, 0.9), TwoTerm(0.72, -0.28, 0.88)
    coefficients = scene.medium.coefficients[:2]

    def lit(by: float, phase: PhaseFunction) -> Scene:
        return replace(scene, medium=Medium(coefficients[0], by * coefficients[1], phase=phase))

    turning = Turning([other, phase], [other], np.array([[1.0], [0.0]]))
    found = tank_tangent(lit(1.0, phase), 8, seed=5, turning=turning)
    mixed = Mixture((phase, other), (0.5, 0.5))  # half of the way
    low, middle, high, more = (
        tank_image(one, tolerance=0.005, seed=5, batches=8).image
        for one in (lit(1.0, phase), lit(1.0, mixed), lit(1.0, other), lit(1.01, phase))
    )
    assert np.linalg.norm(found.prediction.image - low) < 1e-3 * np.linalg.norm(low)
    by_phase = 4.0 * middle - 3.0 * low - high
    for slope, difference, off in (
        (found.slopes[2], by_phase, 0.05),
        (found.slopes[1], (more - low) / (0.01 * coefficients[1]), 0.08),
    ):
        mine, seen = (one.reshape(4, 6, 4, 9).sum(axis=(1, 3)) for one in (slope, difference))
        assert np.linalg.norm(mine - seen) < off * np.linalg.norm(seen)
    assert np.linalg.norm(found.slopes[3]) < 1e-12 * np.linalg.norm(low)  # where it is, there is no way
    assert found.noise.shape[1:] == found.slopes.shape
    alone = tank_steady(lit(1.0, phase), 8, seed=5)
    assert np.allclose(alone.image, found.prediction.image, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("parallel", 0.01),
        ("parallel", 0.001),
        ("pinholes", 0.01),
        pytest.param("pinholes", 0.001, marks=pytest.mark.long),
    ],
)
def test_order_2_is_quadratic_in_the_phase_function_and_knows_its_slope(name: str, tolerance: float) -> None:
    """A fit of a free phase function has seventeen of these slopes on each image: they come along, for no tables of
    their own."""
    scene, phase, other = SCENES[name], TwoTerm(0.7, -0.3, 0.9), TwoTerm(0.4, -0.1, 0.7)
    sigma_a, sigma_s, _ = scene.medium.coefficients
    media = [Medium(sigma_a, sigma_s, phase=one) for one in (phase, Mixture((phase, other), (0.5, 0.5)), other)]
    start, middle, end = double_scattering_of(scene, media, tolerance)
    image, slope, none = double_scattering_of(scene, media[:1], tolerance, others=[other, phase])
    assert np.linalg.norm(image - start) < 3e-3 * np.linalg.norm(start)  # tables of several are as fine as one wants
    by_differences = 4.0 * middle - 3.0 * start - end
    assert np.linalg.norm(slope - by_differences) < 0.01 * np.linalg.norm(by_differences)
    assert np.linalg.norm(none) < 1e-12 * np.linalg.norm(start)


@pytest.mark.parametrize("name", ["parallel", "pinholes", "lenses"])
def test_patterns_of_noise_are_how_images_scatter(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What noise does to a fitted number is what its patterns do: for sums over any part of an image too."""
    scene = SCENES[name]
    twice = cache(lambda scene, media, tolerance: twice_of(scene, media, tolerance))  # it has no noise
    monkeypatch.setattr(
        behind_lenses, "twice_of", lambda scene, media, tolerance, **_: twice(scene, tuple(media), tolerance)
    )
    made = [tank_accurate(scene, 1, seed=seed) for seed in range(24)]
    images = np.array([one.image for one in made])
    rows, columns = np.mgrid[:24, :36]
    for weight in (np.ones((24, 36)), np.cos(columns / 8.0), np.sin(rows / 3.0)):
        seen = np.var(np.tensordot(images, weight, 2), ddof=1)
        told = np.mean([np.sum(np.tensordot(one.patterns, weight, 2) ** 2) for one in made if one.patterns is not None])
        assert 0.35 < seen / told < 2.0


@pytest.mark.parametrize("name", ["parallel", PINHOLES])
def test_patterns_of_noise_are_how_derivatives_scatter(name: str) -> None:
    """What noise adds to what tells coefficients apart is taken off by them: too small, and fits say too much."""
    scene = SCENES[name]
    made = [tank_tangent(scene, 6, seed=seed, lattice=SMALL, blur_mm=4.0) for seed in range(16)]
    seen = np.var([one.slopes for one in made], axis=0, ddof=1).sum(axis=(1, 2))
    told = np.mean([np.square(one.noise).sum(axis=0) for one in made], axis=0).sum(axis=(1, 2))
    assert (seen / told > 0.5).all()
    assert (seen / told < 1.6).all()


def test_patterned_errors_move_what_they_are_like() -> None:
    """A response that looks like a pattern moves by all of it, one that is orthogonal to it does not move."""
    pattern, used = np.zeros((1, 4, 6)), np.ones((4, 6), bool)
    pattern[0, :, :3] = 0.5
    error = PatternedError(pattern, SmoothError(np.zeros((4, 6)), 6.0))
    like, unlike = pattern[0][used], np.zeros((4, 6))
    unlike[:, 3:] = 1.0
    found = error.between(np.array([like, unlike[used]]), used)
    assert np.allclose(found, [[(0.25 * 12) ** 2, 0.0], [0.0, 0.0]])

"""Spheres that nobody has labelled are told from what an image says of a free phase function's shapes."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tankrig.estimation.phase_average import LikelySpheres, together
from tankrig.estimation.phase_evidence import Score, about_spheres, by_free, families
from tankrig.estimation.phase_families import as_free, free
from tankrig.estimation.phase_result import Scattering
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.spheres import spheres
from tankrig.scene import Medium
from tankrig.scene.free_phase import Shaped, shapes_at
from tankrig.scene.mie import Mie
from tankrig.scene.phase_fields import phase_fields, phase_from_fields
from tankrig.scene.phase_functions import HenyeyGreenstein, TwoTerm
from tankrig.scene.phase_table import PhaseFunction

KNOWN = 0.1
"""Standard deviation to which an image tells each amplitude, and the share to which it tells σs."""


def seen(phase: PhaseFunction, seed: int) -> tuple[Score, NDArray[np.float64]]:
    """What an image of a liquid of σs .02 might say."""
    sd = np.concatenate([[5e-4, 0.002, 0.02], np.full(16, KNOWN)])
    truth = np.concatenate([[0.001, 0.02], as_free(phase)])
    at = truth + np.random.default_rng(seed).normal(0.0, sd) * np.where(np.arange(truth.size) == 2, 0.0, 1.0)
    return Score(at, np.zeros(truth.size), np.diag(1.0 / sd), np.zeros((truth.size, 1))), np.diag(sd**2)


def answered(phase: PhaseFunction, seed: int) -> Scattering:
    """What families make of that together."""
    score, spread = seen(phase, seed)
    freely = by_free(score, spread, free())
    return together([freely, *families(score, freely)])


@pytest.mark.parametrize(
    "bead",
    [Mie(0.35, 1.587, 1.3317, 633.0, 0.03), Mie(1.3, 1.46, 1.332, 532.0, 0.05), Mie(2.2, 1.49, 1.33, 650.0, 0.1)],
)
def test_beads_are_told_by_their_diameter_in_wavelengths(bead: Mie) -> None:
    """Whatever light they are seen by, and whatever they are made of; with the rings of their phase function."""
    found = answered(bead, 1)
    assert found.families["spheres"] > 0.9
    diameter, sd = found.parameters["diameter_in_wavelengths"]
    expected = 1e3 * bead.diameter_um / bead.wavelength_nm
    assert abs(diameter - expected) < 3.0 * sd
    assert sd < 0.1 * expected
    angles = np.cos(np.radians(np.arange(80.0, 101.0, 2.0)))
    off = np.log(found.liquid.phase_function.at(angles) / bead.at(angles))
    smooth = np.log(free().phase(as_free(bead)).at(angles) / bead.at(angles))
    assert np.abs(off).max() < max(0.25, 0.8 * np.abs(smooth).max())


@pytest.mark.parametrize("phase", [HenyeyGreenstein(0.7), TwoTerm(0.9, -0.4, 0.95)])
def test_what_is_no_sphere_is_not_taken_for_one(phase: PhaseFunction) -> None:
    found = answered(phase, 2)
    assert found.families.get("spheres", 0.0) < 0.5
    assert found.liquid.g == pytest.approx(phase.mean_cosine, abs=3.0 * math.sqrt(found.covariance[2, 2]))


@pytest.mark.parametrize("seed", range(3))
def test_an_emulsion_that_is_hardly_off_spheres_is_not_taken_for_them(seed: int) -> None:
    """An image tells σs p at the angles that it sees well, and σs by itself hardly: so σs rests on p's shape, of which
    spheres of one kind have no other. What droplets are off them by is counted."""
    bead, (told_sd, by_itself_sd) = Mie(0.2, 1.465, 1.333, 532.0, 0.3), (0.005, 0.1)
    emulsion = Shaped(bead, tuple(np.random.default_rng(seed).normal(0.0, 0.03, 16).tolist()))
    angles = np.cos(np.radians(np.arange(50.0, 136.0, 5.0)))
    own, sigma_s = spheres().coordinates(bead), 0.01
    shapes, none = shapes_at(angles), np.zeros(angles.size)
    response = np.vstack([
        np.column_stack([none, none + 1.0 / sigma_s, none, shapes.T]) / told_sd,
        np.array([0.0, 1.0 / sigma_s, *[0.0] * 17]) / by_itself_sd,
        np.array([1.0 / 0.0001, *[0.0] * 18]),
    ])  # fmt: skip
    off = np.append(np.log(emulsion.at(angles) / bead.at(angles)) / told_sd, [0.0, 0.0])
    at = np.array([0.0005, sigma_s, *as_free(bead)])
    along, square = np.linalg.qr(response)
    score = Score(at, along.T @ off, square, np.zeros((at.size, 1)))
    liquid = Medium(0.0005, sigma_s, phase=spheres().phase(own))
    found = together(about_spheres(score, liquid, own))
    sd = math.sqrt(found.covariance[1, 1])
    assert abs(found.liquid.sigma_s - sigma_s) < 3.0 * sd < 0.3 * sigma_s


def leaves(much: float) -> SimpleNamespace:
    """An optimum whose images leave so much, of a problem in which they are what they leave."""
    problem = SimpleNamespace(whitened=lambda images: images, scale=lambda _: (), left_by=lambda images: images[0])
    return SimpleNamespace(left=np.full(100, much), images=[np.full(100, much)], problem=problem)


@pytest.mark.parametrize(("much", "alone"), [(1.0, False), (1.04, False), (1.1, True), (3.0, True)])
def test_nothing_smooth_is_weighed_beside_spheres_that_leave_far_less(much: float, alone: bool) -> None:
    """Its errors, widened by what it had left, had made particles of many sizes seven times as likely."""
    beside = LikelySpheres((None,), cast(Evaluation, leaves(much)), np.eye(20), free())
    assert beside.alone(cast(Evaluation, leaves(1.0))) == alone
    # Not where images hold structure of another cause, as a bench's do.
    assert not replace(beside, structure=10.0).alone(cast(Evaluation, leaves(1.0)))


def test_members_say_what_images_can_tell() -> None:
    """Of one light's spheres and another's of the same number of wavelengths images are alike."""
    green, red = Mie(0.5, 1.6, 1.33, 500.0, 0.04), Mie(0.6, 1.6, 1.33, 600.0, 0.04)
    family = spheres()
    np.testing.assert_allclose(family.coordinates(green), family.coordinates(red))
    told = family.parameters(family.coordinates(green))
    assert told == pytest.approx(
        {"diameter_in_wavelengths": 1.0, "index_over_water": 1.6 / 1.33, "spread": 0.04}, rel=2e-3
    )
    cosine = np.linspace(-1.0, 1.0, 50)
    np.testing.assert_allclose(family.phase(family.coordinates(red)).at(cosine), red.at(cosine), rtol=2e-3)


def test_the_series_summed_at_few_cosines_is_the_table() -> None:
    bead = Mie(1.0, 1.5868, 1.3317, 633.0, 0.03)
    cosine = np.cos(np.radians(np.linspace(1.0, 179.0, 90)))
    np.testing.assert_allclose(bead.density(cosine), bead.at(cosine), rtol=1e-3)


def test_a_shaped_phase_function_is_kept_as_fields() -> None:
    one = Shaped(TwoTerm(0.9, -0.3, 0.95), (0.1, -0.2))
    again = phase_from_fields(phase_fields(one))
    assert again == one
    assert 2.0 * math.pi * np.trapezoid(one.at(np.linspace(-1.0, 1.0, 20001)), np.linspace(-1.0, 1.0, 20001)) == (
        pytest.approx(1.0, abs=1e-4)
    )
    assert Medium(0.0, 0.01, phase=one).g == pytest.approx(one.mean_cosine)

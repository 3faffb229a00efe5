"""The infinite medium: exact numbers that any transport code has to meet."""

import math

import numpy as np
import pytest

from tankrig.errors import SceneError
from tankrig.light.infinite import fluence_transform, point_source_fluence, streaming_inverse
from tankrig.scene import Medium

ISOTROPIC = {
    0.5: (0.058695137513, 1.29132413865e-4),
    0.9: (0.143283861525, 2.91512506981e-3),
    0.99: (0.220194572544, 0.0198417362186),
    0.999: (0.247957255837, 0.0362650143091),
}
"""Albedo: fluence rate at 1 and 5 mean free paths."""
FORWARD_PEAKED = {
    (0.9, 0.9): (0.07625294607, 0.002275766366, 1.97160936e-5),
    (0.99, 0.9): (0.08550188252, 0.004562863377, 3.919644701e-4),
    (0.999, 0.99): (0.08007734442, 0.003290314359, 2.298203507e-4),
}
"""(albedo, g): fluence rate at 1, 5 and 20 mean free paths."""


def of_albedo(albedo: float, g: float, sigma_t: float = 1.0) -> Medium:
    return Medium(sigma_a=(1.0 - albedo) * sigma_t, sigma_s=albedo * sigma_t, g=g)


@pytest.mark.parametrize("albedo", ISOTROPIC)
def test_isotropic_point_source_matches_published_digits(albedo):
    """Multiple scattering of isotropic media would be wrong at any density."""
    found = point_source_fluence([1.0, 5.0], of_albedo(albedo, 0.0))
    np.testing.assert_allclose(found, ISOTROPIC[albedo], rtol=1e-11)


@pytest.mark.parametrize(("albedo", "g"), FORWARD_PEAKED)
def test_forward_peaked_point_source_matches_published_digits(albedo, g):
    """Harmonics of a forward-peaked phase function would be cut too early, or coupled wrongly."""
    found = point_source_fluence([1.0, 5.0, 20.0], of_albedo(albedo, g))
    np.testing.assert_allclose(found, FORWARD_PEAKED[albedo, g], rtol=4e-10)  # the last digit printed


def test_lengths_scale():
    """A scene in other units would give other light."""
    near, far = point_source_fluence(1.0, of_albedo(0.9, 0.5)), point_source_fluence(50.0, of_albedo(0.9, 0.5, 0.02))
    assert far == pytest.approx(near / 50.0**2, rel=1e-12)


@pytest.mark.parametrize(("albedo", "g"), [(0.9, 0.0), (0.99, 0.85), (0.9, -0.5)])
def test_absorbed_power_and_spread(albedo, g):
    """Energy would be lost or made: ∫φ dV = 1/σa, and ⟨r²⟩ = 2/(σa (σt − gσs)) says how far light gets."""
    medium = of_albedo(albedo, g)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    edges = np.concatenate([[0.0], np.geomspace(1.0, 36.0 / math.sqrt(3.0 * medium.sigma_a * (1.0 - g * albedo)), 12)])
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    radius = middle[:, None] + half[:, None] * nodes
    shell = half[:, None] * weights * 4.0 * np.pi * radius**2 * point_source_fluence(radius, medium)
    assert shell.sum() * medium.sigma_a == pytest.approx(1.0, rel=1e-5)
    spread = np.sum(shell * radius**2) / shell.sum()
    assert spread == pytest.approx(2.0 / (medium.sigma_a * (medium.sigma_t - g * medium.sigma_s)), rel=1e-5)


def test_orders_integrate_and_add_up():
    """An order's image would carry the wrong share of the light: ∫φₙ dV = σsⁿ/σtⁿ⁺¹, and all orders are the whole."""
    medium, wave_number, degree = of_albedo(0.6, 0.5, 0.3), np.array([0.0, 0.05, 0.4]), 60
    streaming = streaming_inverse(wave_number, medium.sigma_t, 0, degree)
    field = streaming[:, :, 0]
    total = np.zeros(3)
    for order in range(80):
        assert field[0, 0] == pytest.approx(medium.sigma_s**order / medium.sigma_t ** (order + 1), rel=1e-12)
        total += field[:, 0]
        scattered = medium.sigma_s * medium.g ** np.arange(degree + 1) * field
        field = np.einsum("kij,kj->ki", streaming, scattered)
    np.testing.assert_allclose(total, fluence_transform(wave_number, medium), rtol=1e-9)


def test_free_streaming_keeps_degrees_that_are_cut_off():
    """Uncollided light would be wrong at fine detail: with no scattering, φ̂ = arctan(k/σt)/k however few degrees."""
    wave_number = np.array([0.01, 1.0, 30.0])
    found = streaming_inverse(wave_number, 0.1, 0, 3)[:, 0, 0]
    np.testing.assert_allclose(found, np.arctan(wave_number / 0.1) / wave_number, rtol=1e-6)


def test_no_absorption_is_refused():
    """A user would get a number for light that never ends."""
    with pytest.raises(SceneError, match="sigma_a = 0"):
        point_source_fluence(1.0, Medium(0.0, 1.0, 0.5))


@pytest.mark.parametrize("absorbed", [1e-1, 1e-3, 1e-6, 1e-9])
def test_hardly_absorbing_media_stay_stable(absorbed):
    """Digits would be lost as σa → 0, where the light tends to 3 σs(1 − g)/(4πr) and more σa can only dim it."""
    radius = np.array([0.5, 3.0, 20.0])
    found = point_source_fluence(radius, Medium(absorbed, 1.0 - absorbed, 0.8))
    brightest = point_source_fluence(radius, Medium(1e-13, 1.0, 0.8))
    assert np.all(found < brightest)
    if absorbed == 1e-9:
        np.testing.assert_allclose(found, brightest, rtol=1e-3)
        assert found[2] == pytest.approx(3.0 * 0.2 / (4.0 * np.pi * 20.0), rel=0.05)

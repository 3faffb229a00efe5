"""What a fit leaves is shown where it is, and told when it is in one place only."""

import re

import numpy as np

from tests.test_estimation import KNOWN, MEDIUM, fit, noisy


def test_structure_is_a_map_that_shows_where() -> None:
    """Where the model fails is what a person looks for; noise alone must leave the map empty."""
    image, noise = noisy(MEDIUM)
    clean = fit(image, KNOWN, noise)
    assert clean.structure is not None
    assert np.nanmax(np.abs(clean.structure)) < 5.5
    shadow = image.copy()
    shadow[10:18, 8:16] *= 0.9
    dirty = fit(shadow, KNOWN, noise)
    assert dirty.structure is not None
    row, column = np.unravel_index(np.nanargmax(np.abs(dirty.structure)), image.shape)
    assert 8 <= row <= 20
    assert 6 <= column <= 18


def test_what_stands_out_in_one_place_is_told() -> None:
    """A reflection in a corner is too small a part of the image to count as structure, and still wrong."""
    for seed in range(5):
        image, noise = noisy(MEDIUM, seed=seed)
        assert "holds structure" not in fit(image, KNOWN, noise).verdict
        image[2:6, 30:34] += 3.0 * noise
        assert re.search(r"holds structure around row [34], column 3[0-4]", fit(image, KNOWN, noise).verdict)


def test_what_nothing_explains_determines_neither_scattering_nor_asymmetry() -> None:
    """A liquid like Petzold's left such structure, and its g was told six standard deviations off, as determined."""
    image, noise = noisy(MEDIUM)
    x, y = np.arange(image.shape[1]) / image.shape[1], np.arange(image.shape[0]) / image.shape[0]
    image = image * (1.0 + 0.05 * np.cos(9.0 * x + 1.0) * np.sin(7.0 * y[:, None]))
    found = fit(image, KNOWN, noise)
    assert not found.identifiable["sigma_s"]
    assert not found.identifiable["g"]
    assert "may well have another phase function" in found.verdict
    assert "all the same" not in found.verdict


def test_slight_structure_is_called_what_it_is_and_large_structure_a_model_that_does_not_hold() -> None:
    """Beside numbers that were right to a percent stood that the model does not hold, for .2 % of the image."""
    image, noise = noisy(MEDIUM, 3e-4)
    x, y = np.arange(image.shape[1]) / image.shape[1], np.arange(image.shape[0]) / image.shape[0]
    ripple = np.cos(9.0 * x + 1.0) * np.sin(7.0 * y[:, None])
    for size, slight in ((0.006, True), (0.05, False)):
        verdict = fit(image * (1.0 + size * ripple), KNOWN, noise).verdict
        assert "holds structure of" in verdict
        assert ("what that may do to the coefficients is in their intervals" in verdict) is slight
        assert ("the model does not hold as described" in verdict) is not slight

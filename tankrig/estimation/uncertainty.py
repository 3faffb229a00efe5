"""How well a fit knows its coefficients: camera noise, the model's own error, and what the data leave open.

The fitted coefficients respond to an error ε of the image as δθ = A ε, A = (J W Jᵀ + P)⁻¹ J W, where J are the image's
derivatives less what gain and offset can imitate, W the weights, and P a weak prior (standard deviations of ten times
σt for σa and σs, 1 for g) that keeps undetermined directions finite. Their covariance is then

    A ⟨noise²⟩ Aᵀ + A ⟨model error²⟩ Aᵀ + F⁻¹ P F⁻¹,        F = J W Jᵀ + P.

(What may be misaligned is believed to a standard deviation of 1; a belief that weighs t times as much, see
`overconfidence`, puts t into P and t² between the F⁻¹.)

The model's error is taken to be random, of the size that the model states pixel by pixel (or that the residual shows,
where that is more, in proportion to the image), counted twice, and smooth: one third of its power at each of the
correlation lengths 1/32, 1/8 and 1/2 of the tank's length. White errors of that size would average out over thousands
of pixels, which errors of a model don't; intervals that leave it out are fiction.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Medium

Array = NDArray[np.float64]

CORRELATION_LENGTHS = (1.0 / 32.0, 1.0 / 8.0, 1.0 / 2.0)
"""Of the model's error, as shares of the tank's length."""
PATTERN = 2.0
"""A model's error is no random draw: where it looks like a change of the medium it moves coefficients further than
random patterns of its size do (two to three times on dense reference images). It is counted with this factor."""

DETERMINED = 0.2
"""Relative standard deviation of a coefficient up to which it counts as determined."""
DETERMINED_G = 0.1
"""The same for g, absolute."""

UNBELIEVED = 1e-4
"""Weight of a belief that has no say."""


@dataclass(frozen=True)
class Sensitivity:
    """What a fit responds to, on the (rows, columns) grid, 0 where a pixel isn't used.

    Parameters
    ----------
    changes
        (k, n) weighted derivatives by σa, σs, g, and what may be misaligned in standard deviations, of the used pixels,
        less what gain and offset imitate.
    beliefs
        (k, priors) what that leaves of priors on gain and offset.
    weight
        (n,) weights, 1 over the standard deviation that the fit assumed.
    used
        (rows, columns), n of them True.
    firmness
        (k − 3,) how many times its precision the belief in each misalignment weighs.
    """

    changes: Array
    beliefs: Array
    weight: Array
    used: NDArray[np.bool_]
    firmness: Array = field(default_factory=lambda: np.ones(0))


def covariance(
    sensitivity: Sensitivity, medium: Medium, noise: Array, error: Array, pixel_mm: float, length_mm: float
) -> Array:
    """Covariance of (σa, σs, g, misalignments), shape (k, k); the latter in standard deviations.

    Parameters
    ----------
    sensitivity
        Of the fit.
    medium
        Where the fit ended.
    noise
        Standard deviation of the camera's noise, (rows, columns).
    error
        Standard deviation of the model's error, (rows, columns), in image units.
    pixel_mm, length_mm
        Side of a pixel; longest side of the tank.
    """
    count = len(sensitivity.changes)
    scale = np.array([10.0 * medium.sigma_t, 10.0 * medium.sigma_t, 1.0, *np.ones(count - 3)])
    changes, beliefs = sensitivity.changes * scale[:, None], sensitivity.beliefs * scale[:, None]
    firmness = np.array([1.0, 1.0, 1.0, *sensitivity.firmness])
    known = beliefs @ beliefs.T
    inverse = np.linalg.inv(changes @ changes.T + known + np.diag(firmness))
    response = (inverse @ changes) * sensitivity.weight
    by_noise = response * noise[sensitivity.used]
    total = by_noise @ by_noise.T + inverse @ (known + np.diag(firmness**2)) @ inverse
    total += by_smooth_errors(response, sensitivity.used, PATTERN * error, length_mm / pixel_mm)
    spread: Array = total * np.outer(scale, scale)
    return 0.5 * (spread + spread.T)


def overconfidence(
    sensitivity: Sensitivity, medium: Medium, noise: Array, error: Array, pixel_mm: float, length_mm: float
) -> Array:
    """How many times more an image seems to tell about each misalignment than it does, (k − 3,).

    A fit weighs pixels as if the model's error were another in each. It is smooth, as a misalignment's own image is: in
    a medium liquid that of light too high is nearly another gain and absorption, an error of 0.3 % looked like
    1.2 ± 0.1 mm, and the belief in ± 0.5 mm had no say. Beliefs must weigh more by as much
    as the image weighs too much.

    Parameters
    ----------
    sensitivity, medium, noise, error, pixel_mm, length_mm
        As for `covariance`.
    """
    alone = replace(sensitivity, firmness=np.full(len(sensitivity.changes) - 3, UNBELIEVED))
    white = np.hypot(noise, error)
    seems, is_so = (
        np.diag(covariance(alone, medium, one, other, pixel_mm, length_mm))[3:]
        for one, other in ((white, np.zeros_like(error)), (noise, error))
    )
    return np.asarray(np.maximum(is_so / seems, 1.0))


def by_smooth_errors(response: Array, used: NDArray[np.bool_], error: Array, length: float) -> Array:
    """Covariance that the model's error in one image gives to what responds to it, (k, k).

    Parameters
    ----------
    response
        (k, n) change per unit of image, of the used pixels.
    used
        (rows, columns), n of them True.
    error
        (rows, columns) standard deviation of the model's error.
    length
        The tank's, in pixels.
    """
    grid = np.zeros((len(response), *used.shape))
    grid[:, used] = response * error[used]
    parts = [_smooth_products(grid, share * length) for share in CORRELATION_LENGTHS]
    mean: Array = np.mean(parts, axis=0)
    return mean


def _smooth_products(grid: Array, length: float) -> Array:
    """Σ_ij a_i K_ij b_j for all pairs of (k, rows, columns), K a Gaussian correlation of `length` pixels."""
    rows, columns = grid.shape[1:]
    along_y, along_x = _correlation(rows, length), _correlation(columns, length)
    smoothed = along_y @ grid @ along_x
    products: Array = np.einsum("aij,bij->ab", grid, smoothed)
    return products


def _correlation(count: int, length: float) -> Array:
    at = np.arange(count)
    matrix: Array = np.exp(-0.5 * ((at[:, None] - at) / length) ** 2)
    return matrix


def identifiable(medium: Medium, spread: Array) -> dict[str, bool]:
    """Which of σa, σs, g the data determine: σs and σa to `DETERMINED` of themselves, g to `DETERMINED_G`."""
    sd = np.sqrt(np.diag(spread))
    return {
        "sigma_a": bool(sd[0] <= DETERMINED * medium.sigma_a),
        "sigma_s": bool(sd[1] <= DETERMINED * medium.sigma_s),
        "g": bool(sd[2] <= DETERMINED_G),
    }


def held_back(
    sensitivity: Sensitivity, medium: Medium, noise: Array, error: Array, pixel_mm: float, length_mm: float
) -> bool:
    """Whether the model's error leaves a coefficient undetermined that noise alone would not.

    Parameters
    ----------
    sensitivity, medium, noise, error, pixel_mm, length_mm
        As for `covariance`.
    """
    with_error, without = (
        identifiable(medium, covariance(sensitivity, medium, noise, one, pixel_mm, length_mm))
        for one in (error, np.zeros_like(error))
    )
    return with_error != without


def reduced_scattering(medium: Medium, spread: Array) -> tuple[float, float]:
    """σs(1 − g) and its standard deviation: what thick media tell even where σs and g are lost."""
    slope = np.array([0.0, 1.0 - medium.g, -medium.sigma_s])
    return medium.sigma_s * (1.0 - medium.g), math.sqrt(float(slope @ spread @ slope))


def extinction(medium: Medium, spread: Array) -> tuple[float, float]:
    """σt = σa + σs and its standard deviation: what thin media tell even where σa and σs are lost."""
    slope = np.array([1.0, 1.0, 0.0])
    return medium.sigma_t, math.sqrt(float(slope @ spread @ slope))

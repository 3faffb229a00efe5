"""What a residual's structure says about the values: how far usual faults of a bench that look like it move them.

A fault changes images by a pattern P. What of it looks like a change of the values, the fit takes for one: the values
move by θ = F⁻¹ J W P per unit of the fault. The rest, P⊥ = P − Jᵀθ, stays in the residual r and tells the fault's size,
a = r·P⊥ / P⊥·P⊥, so that the values are off by a θ if this is the fault. A halo of 3 % about all light leaves 0.3 % of
a thin liquid's image and moves σs by 17 %: how large a residual is says little of what it stands for.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.uncertainty import ModelError, Sensitivity

Array = NDArray[np.float64]
Image = NDArray[np.floating]

HALOS = (1.0 / 32.0, 1.0 / 8.0, 1.0 / 2.0)
"""Widths of halos, as shares of the longer side of an image."""
BLUR = 1.0
"""Width, in pixels, of the blur of edges."""
SEEN = 3.0
"""Standard deviations of its size from which on a fault is seen."""
STRAY = 0.01
"""Share of the light that lenses commonly spread into a halo; nothing on a bench measures it."""


def faults_of(image: Image) -> Array:
    """(faults, rows, columns) changes of an image by what is usually not as described.

    Halos of several widths (stray light in lenses and air), blurred edges, a shift along y and along x and another
    scale (a camera or a beam that was moved), light uneven along y and along x, and a veil of even light.
    """
    from scipy.ndimage import gaussian_filter

    image = np.asarray(image, float)
    rows, columns = image.shape
    y, x = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
    down, right = np.gradient(image) if min(image.shape) > 1 else (np.zeros_like(image), np.zeros_like(image))
    blurred = gaussian_filter(image, BLUR, mode="constant") - image
    moved = [down, right, 0.5 * rows * y * down + 0.5 * columns * x * right]
    return np.array(
        [*halos_of(image), blurred, *moved, image * y, image * x, np.full(image.shape, float(image.mean()))]
    )


def halos_of(image: Image) -> Array:
    """(`HALOS`, rows, columns) changes of an image by halos of all of its light."""
    from scipy.ndimage import gaussian_filter

    image = np.asarray(image, float)
    widths = [share * max(image.shape) for share in HALOS]
    return np.array([gaussian_filter(image, width, mode="constant") - image for width in widths])


def moved_by_faults(
    sensitivity: Sensitivity, residual: Array, faults: Array, noise: Sequence[Image], errors: Sequence[ModelError]
) -> Array:
    """Covariance (k, k) of what faults would have moved the values by, were each what the residual shows of it.

    Parameters
    ----------
    sensitivity
        Of the fit.
    residual
        (n,) at the optimum, whitened.
    faults
        (faults, n) changes of all images, whitened, less what gain and offset imitate.
    noise, errors
        Of each image, as for `Sensitivity.covariance`: what may pass for a fault by chance.
    """
    values, sized, chance = _told(sensitivity, faults, noise, errors)
    sizes = sized @ residual
    moved = (sizes[:, None] * values)[sizes**2 > SEEN**2 * chance]
    return np.asarray(moved.T @ moved)


def moved_unseen(
    sensitivity: Sensitivity, faults: Array, size: float, noise: Sequence[Image], errors: Sequence[ModelError]
) -> Array:
    """(k,) how far faults of a size would move each value at most that no residual would show.

    Parameters
    ----------
    sensitivity, faults, noise, errors
        As for `moved_by_faults`.
    size
        Of each fault, in units of its pattern.
    """
    values, _, chance = _told(sensitivity, faults, noise, errors)
    hidden = size**2 < SEEN**2 * chance
    return np.asarray(size * np.abs(values[hidden]).max(axis=0, initial=0.0))


def shown(
    sensitivity: Sensitivity, residual: Array, faults: Array, noise: Sequence[Image], errors: Sequence[ModelError],
    met: Array | float = 0.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """(faults,) the size of each fault that a residual shows, its standard deviation, and (faults, k) what it moves.

    Parameters
    ----------
    sensitivity, residual, faults, noise, errors
        As for `moved_by_faults`.
    met
        (faults,) what of the products of faults and residual no fault makes, see `met_by_noise`.
    """
    values, sized, chance = _told(sensitivity, faults, noise, errors)
    sizes = sized @ residual - met * np.sum(sized**2, axis=1)
    return np.asarray(sizes), np.sqrt(np.maximum(chance, 1e-300)), np.asarray(sizes[:, None] * values)


def _told(
    sensitivity: Sensitivity, faults: Array, noise: Sequence[Image], errors: Sequence[ModelError]
) -> tuple[Array, Array, Array]:
    """For each fault (k,) what one unit of it moves the values by, (n,) what times the residual is its size, and the
    variance that noise and the model's own error give to that size."""
    values = np.array([sensitivity.step(fault) for fault in faults])
    left = faults - values @ sensitivity.changes
    sized = left / np.maximum(np.sum(left**2, axis=1, keepdims=True), 1e-300)
    chance = np.zeros(len(faults))
    ends = np.cumsum([one.changes.shape[1] for one in sensitivity.responses])[:-1]
    seen = zip(sensitivity.responses, np.split(sized, ends, axis=1), noise, errors, strict=True)
    for one, part, sigma, error in seen:
        of_image = one.whitening.transposed(part)
        chance += np.sum((of_image * sigma[one.used]) ** 2, axis=1) + np.diag(error.between(of_image, one.used))
    return values, sized, chance

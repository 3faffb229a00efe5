"""What a fit leaves, as a map in standard deviations, and what it looks like."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHED = 1.5
"""Standard deviation, in pixels, of the Gaussian over which the map is averaged."""
TELLING = 0.3
"""Share of a residual's structure that a cause explains before it is named."""
LOCAL = 6.0
"""Standard deviations of the averaged residual, model's error counted, that are no chance at any place of an image."""


def structure_map(residual: Array, used: Mask, error: Array | None = None) -> Array:
    """Residual averaged over neighbouring pixels, in standard deviations of what noise and model leave of it.

    Parameters
    ----------
    residual
        (rows, columns) in standard deviations of the noise; anything where it isn't used.
    used
        Where it counts.
    error
        Of the model, (rows, columns), in the unit of `residual` and alike over neighbours, so that it does not average
        out; none where not given.

    Returns
    -------
    (rows, columns): beyond ±4 there is structure; NaN where nothing near was used.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(0, 1, (60, 80))
    >>> everywhere = np.ones((60, 80), bool)
    >>> float(structure_map(noise, everywhere).std().round())
    1.0
    >>> float(structure_map(noise + 0.7, everywhere).mean().round())
    4.0
    """
    from scipy.ndimage import gaussian_filter

    near = gaussian_filter(used.astype(float), SMOOTHED)
    total = gaussian_filter(np.where(used, residual, 0.0), SMOOTHED)
    # The kernel's square is a Gaussian narrower by √2, with a total of 1/(4π width²).
    variance = gaussian_filter(used.astype(float), SMOOTHED / np.sqrt(2.0)) / (4.0 * np.pi * SMOOTHED**2)
    if error is not None:
        variance += gaussian_filter(np.where(used, error, 0.0), SMOOTHED) ** 2
    found: Array = np.where(near > 0.1, total / np.sqrt(np.maximum(variance, 1e-12)), np.nan)
    return found


def standing_out(residual: Array, used: Mask, error: Array) -> tuple[float, int, int] | None:
    """Where a residual stands out most, as in `structure_map`; None where chance may do that.

    Returns
    -------
    Standard deviations, row, column.

    Examples
    --------
    >>> noise = np.random.default_rng(1).normal(0, 1, (60, 80))
    >>> everywhere, exact = np.ones((60, 80), bool), np.zeros((60, 80))
    >>> standing_out(noise, everywhere, exact)
    >>> noise[20:23, 40:43] += 5.0
    >>> standing_out(noise, everywhere, exact)[1:]
    (21, 41)
    """
    sizes = np.nan_to_num(np.abs(structure_map(residual, used, error)))
    row, column = np.unravel_index(np.argmax(sizes), sizes.shape)
    size = float(sizes[row, column])
    return (size, int(row), int(column)) if size > LOCAL else None


def likely_cause(
    residual: Array, unhidden: Callable[[Array], Array], causes: Mapping[str, Callable[[], list[Array]]]
) -> tuple[str, float] | None:
    """Which cause explains most of a residual.

    Parameters
    ----------
    residual
        (n,) weighted, of the used pixels.
    unhidden
        Changes of the image (k, rows, columns) weighted, less what the fit has already had a chance to explain, (k, n).
    causes
        Name and changes of the image.

    Returns
    -------
    Name and share of the structure that it explains; None where none explains `TELLING` of it.
    """
    excess = float(residual @ residual) - residual.size
    shares = {}
    for name, changes in causes.items():
        basis = np.linalg.qr(unhidden(np.stack(changes())).T)[0]
        shares[name] = (float(np.sum((residual @ basis) ** 2)) - basis.shape[1]) / max(excess, 1e-300)
    best = max(shares, key=lambda name: shares[name])
    return (best, min(shares[best], 1.0)) if shares[best] > TELLING else None

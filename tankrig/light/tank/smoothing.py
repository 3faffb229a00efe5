"""Orders ≥ 3 are smooth along the beams and vary alike from row to row: what is neither is noise.

The image is projected on low-degree Legendre polynomials in x and on as many common profiles across the rows as stand
out from the noise. Measured on three beams at σt = .02, ϖ = .99, g = .5 with perspective, half a million paths: error
2.6 % of the total before, 0.4 % after; no blur does that, as beams are narrower than any blur that would.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEGREE = 12
"""Highest degree of the polynomials in x."""

UNSEEN = 2.5
"""Real error over the scatter of the projected batches, as the projection is drawn from the same noise: 2.1…2.7."""


def smoothed(batches: Array) -> tuple[Array, Array]:
    """Mean of independent noisy images, with what cannot be told from noise removed.

    Parameters
    ----------
    batches
        (n, classes, rows, columns) images of n independent batches by order class; fewer than 4 don't tell noise from
        light, and their mean is returned as it is.

    Returns
    -------
    images
        (classes, rows, columns); their sum is the sum's own projection.
    stderr
        (rows, columns) one-sigma error of the classes' sum.

    Examples
    --------
    >>> x, y = np.linspace(0, 1, 60), np.linspace(-1, 1, 40)
    >>> truth = np.exp(-y[:, None] ** 2) * np.exp(-2 * x)
    >>> noisy = truth + np.random.default_rng(0).normal(0, 0.1, (16, 1, 40, 60))
    >>> images, stderr = smoothed(noisy)
    >>> before = np.linalg.norm(noisy.mean(axis=(0, 1)) - truth)
    >>> bool(np.linalg.norm(images[0] - truth) < 0.3 * before)
    True
    """
    count, _, rows, columns = batches.shape
    if count < 4:
        return batches.mean(axis=0), np.zeros((rows, columns))
    along = _legendre(columns)
    coefficients = batches @ along
    totals = coefficients.sum(axis=1)
    project = _projection(totals)
    if project is None:
        return batches.mean(axis=0), np.zeros((rows, columns))
    spread = (project @ totals @ along.T).std(axis=0, ddof=1) / np.sqrt(count)
    classes = coefficients.mean(axis=0)
    whole = project @ classes.sum(axis=0)
    # What stands out in a class need not in the sum: order 3 alone lost 14 % beside a wall where the sum lost 1 %.
    largest = int(np.argmax(np.abs(classes).sum(axis=(1, 2))))
    for k in range(len(classes)):
        own = _projection(coefficients[:, k])
        if k != largest and own is not None:
            classes[k] = own @ classes[k]
    classes[largest] += whole - classes.sum(axis=0)
    return classes @ along.T, UNSEEN * spread


def _projection(batches: Array) -> Array | None:
    """(rows, rows) that keeps of batches' mean (n, rows, degrees) the profiles that stand out; None without noise.

    Scaled so that the noise is about 1 everywhere, singular values above its largest one are signal. What is just above
    is kept in part: a profile that came and went as the medium changes would make the image jump.
    """
    count, rows, degrees = batches.shape
    variance = batches.var(axis=0, ddof=1) / count
    overall = variance.mean()
    if overall <= 0.0:
        return None
    by_row = np.sqrt(variance.mean(axis=1) + 1e-6 * overall)[:, None]
    by_degree = np.sqrt(variance.mean(axis=0) / overall + 1e-6)
    profiles, strength, _ = np.linalg.svd(batches.mean(axis=0) / (by_row * by_degree), full_matrices=False)
    noise = np.sqrt(rows) + np.sqrt(degrees)
    kept = 1.0 - (noise / np.maximum(strength, noise)) ** 2
    project: Array = by_row * ((profiles * kept) @ profiles.T) / by_row.T
    return project


def _legendre(columns: int) -> Array:
    """(columns, degrees) orthonormal cell averages of Legendre polynomials."""
    from numpy.polynomial import legendre

    edges = np.linspace(-1.0, 1.0, columns + 1)
    degrees = min(DEGREE, columns - 1) + 1
    integrals = np.array([legendre.legval(edges, legendre.legint(row)) for row in np.eye(degrees)])
    return np.linalg.qr(np.diff(integrals, axis=1).T)[0]

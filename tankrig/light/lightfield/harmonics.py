"""Spherical harmonics as the light field's kernel needs them: orthonormal, one azimuthal order at a time."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.light.infinite import coupling_squared

Floats = NDArray[np.float64]


def legendre(order: int, degree: int, cosine: Floats) -> Floats:
    """Orthonormal associated Legendre functions P̄_lm, so that Y_lm = P̄_lm(cos θ) e^{imφ} and ∫ |Y_lm|² dω = 1.

    Parameters
    ----------
    order, degree
        Azimuthal order m ≥ 0 and highest degree L ≥ m.
    cosine
        cos θ, shape (N,).

    Returns
    -------
    array (N, L − m + 1), degrees m … L along the last axis

    Examples
    --------
    >>> bool(abs(legendre(0, 1, np.array([0.5]))[0, 1] - math.sqrt(3 / (4 * math.pi)) * 0.5) < 1e-15)
    True
    """
    values = np.zeros((*cosine.shape, degree - order + 1))
    # (−1)^m is left out: it cancels wherever two harmonics of one order are multiplied.
    norm = math.sqrt(math.prod((2 * j + 1) / (2 * j) for j in range(1, order + 1)) / (4.0 * math.pi))
    values[..., 0] = norm * (1.0 - cosine**2) ** (order / 2)
    coupling = np.sqrt(coupling_squared(np.arange(order, degree + 1), order))
    for index in range(1, degree - order + 1):
        values[..., index] = cosine * values[..., index - 1]
        if index > 1:
            values[..., index] -= coupling[index - 1] * values[..., index - 2]
        values[..., index] /= coupling[index]
    return values

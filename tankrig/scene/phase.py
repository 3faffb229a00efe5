"""Henyey–Greenstein phase function: how likely a scattering turns by an angle θ (the paper's Eq. 5, corrected)."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel


@kernel
def henyey_greenstein(cosine: float, g: float) -> float:
    """Phase function p(cos θ) of one scattering, in 1/sr, for a scalar; meant for use inside kernels.

    p = (1 − g²) / (4π (1 + g² − 2 g cos θ)^(3/2)), normalised to ∫ p dω = 1. The paper prints the exponent as 2/3,
    with which the integral is 0.384 at g = 0.8.

    Parameters
    ----------
    cosine
        cos θ = ω'·ω, the incoming direction of travel times the outgoing one.
    g
        Asymmetry, the mean of cos θ; −1 < g < 1.

    Examples
    --------
    >>> round(henyey_greenstein(0.3, 0.0) * 4 * math.pi, 12)
    1.0
    """
    # 1 + g² − 2 g c written as a sum of non-negative terms: no cancellation when g → ±1 and θ → 0 or π.
    spread = (1.0 - abs(g)) ** 2 + 2.0 * abs(g) * (1.0 - cosine if g >= 0.0 else 1.0 + cosine)
    return (1.0 - g) * (1.0 + g) / (4.0 * math.pi * spread * math.sqrt(spread))


def phase_function(cosine: NDArray[np.floating], g: float) -> NDArray[np.floating]:
    """Phase function p(cos θ) in 1/sr, for arrays (Eq. 5 with its exponent corrected to 3/2).

    Parameters
    ----------
    cosine
        cos θ of each scattering, any shape.
    g
        Asymmetry; −1 < g < 1.

    Returns
    -------
    array of the shape and precision of `cosine`

    Examples
    --------
    >>> import numpy as np
    >>> nodes, weights = np.polynomial.legendre.leggauss(200)
    >>> float(np.round(2 * np.pi * np.sum(weights * phase_function(nodes, 0.8)), 9))
    1.0
    """
    cosine = np.asarray(cosine)
    spread = (1.0 - abs(g)) ** 2 + 2.0 * abs(g) * (1.0 - np.sign(g or 1.0) * cosine)
    value: NDArray[np.floating] = (1.0 - g) * (1.0 + g) / (4.0 * np.pi * spread**1.5)
    return value

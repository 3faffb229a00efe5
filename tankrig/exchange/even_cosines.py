"""A phase function between even steps of cos θ, as other programs keep it; the forward peak needs many of them."""

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

MOST_STEPS = 65_536
CLOSE = 5e-4
"""Largest error of the light and of the first three Legendre moments, after which no finer steps are taken."""


def even_cosines(phase: PhaseFunction) -> tuple[Array, Array, float]:
    """Cosines in even steps from −1 to 1 and p in 1/sr there, linear in between and normalised.

    Parameters
    ----------
    phase
        Any.

    Returns
    -------
    cosines, values, error
        (n,) both; and the largest error of its light and its first three moments before it was normalised, n doubled
        from 512 until that is below 5e-4.
    """
    true = phase.moments(3)
    steps = 512
    while True:
        cosine = np.linspace(-1.0, 1.0, steps + 1)
        values = _sampled(phase, cosine)
        moments = _moments(cosine, values)
        error = float(np.abs(moments - true).max())
        if error <= CLOSE or steps >= MOST_STEPS:
            return cosine, values / moments[0], error
        steps *= 2


def _sampled(phase: PhaseFunction, cosine: Array) -> Array:
    """p at the cosines; at the last, where it may be steep, so that the last step keeps its light."""
    values = phase.at(cosine)
    light = phase.share_within(cosine[-2:-1])[0] / (2.0 * np.pi)
    step = cosine[-1] - cosine[-2]
    values[-1] = max(2.0 * light / step - values[-2], 0.0)
    return values


def _moments(cosine: Array, values: Array) -> Array:
    """(4,) Legendre moments of what is linear between the cosines, by Gauss's two points in each step: exact to l = 2
    and, steps being small, for l = 3."""
    half, middle = 0.5 * np.diff(cosine), 0.5 * (cosine[1:] + cosine[:-1])
    found = np.zeros(4)
    for sign in (-1.0, 1.0):
        at = middle + sign * half / np.sqrt(3.0)
        p = np.interp(at, cosine, values)
        found += 2.0 * np.pi * np.polynomial.legendre.legvander(at, 3).T @ (half * p)
    return found


def inverse_distribution(phase: PhaseFunction, count: int) -> Array:
    """(count,) cos θ below which the shares 1/(count+1), 2/(count+1) … of scatterings lie; its ends, ∓1, left out."""
    shares = np.arange(1, count + 1) / (count + 1.0)
    sine = np.linspace(0.0, 1.0, 200_001)
    turned = phase.share_within(1.0 - 2.0 * sine**2)  # by less than θ; rises with sin(θ/2)
    turned = np.maximum.accumulate(turned / turned[-1])
    rising = np.concatenate([[True], np.diff(turned) > 0.0])
    return np.asarray(1.0 - 2.0 * np.interp(1.0 - shares, turned[rising], sine[rising] ** 2))

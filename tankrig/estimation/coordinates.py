"""Coordinates in which a fit searches a liquid, log σs, logit ϖ and atanh g, and how far it searches.

Every allowed value is an ordinary point in them. Values are what is reported, and what derivatives and covariances are
of: σa, σs and g.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Medium

Array = NDArray[np.float64]

NAMES = ("sigma_a", "sigma_s", "g")
"""Coefficients in the order of every covariance and derivative."""

MEAN_FREE_PATHS = (1e-3, 100.0)
"""Range of σs, in scatterings along the tank's longest side, that a fit searches."""
ALBEDO = (0.01, 1.0 - 1e-6)
ASYMMETRY = (-0.95, 0.98)
NEAR_EDGE = np.array([0.01, 0.1, 0.001])
"""Distance from the edge of the range, in log σs, logit ϖ and atanh g, that counts as at it."""
LONGEST_STEP = np.array([1.0, 2.0, 0.5])
"""In log σs, logit ϖ and atanh g; further than this no linearisation is trusted."""


def to_coordinates(medium: Medium) -> Array:
    """(log σs, logit ϖ, atanh g) of a medium that scatters; logit ϖ of one that does not absorb is infinite.

    Examples
    --------
    >>> to_coordinates(Medium(0.0, 1.0, 0.0))
    array([ 0., inf,  0.])
    >>> medium = to_medium(to_coordinates(Medium(0.001, 0.02, -0.3)))
    >>> round(medium.sigma_a, 12), round(medium.sigma_s, 12), round(medium.g, 12)
    (0.001, 0.02, -0.3)
    """
    logit = math.log(medium.sigma_s / medium.sigma_a) if medium.sigma_a > 0.0 else math.inf
    return np.array([math.log(medium.sigma_s), logit, math.atanh(medium.g)])


def to_medium(coordinates: Array) -> Medium:
    """Medium at (log σs, logit ϖ, atanh g); logit ϖ = log(σs/σa)."""
    return Medium(*coefficients(coordinates))


def coefficients(coordinates: Array) -> tuple[float, float, float]:
    """Its σa, σs and g, without the checks that a medium makes."""
    scattering, logit, asymmetry = (float(value) for value in coordinates)
    sigma_s = math.exp(scattering)
    return sigma_s * math.exp(-logit), sigma_s, math.tanh(asymmetry)


def slopes(medium: Medium) -> Array:
    """∂(σa, σs, g)/∂(log σs, logit ϖ, atanh g), shape (3, 3)."""
    return np.array(
        [
            [medium.sigma_a, -medium.sigma_a, 0.0],
            [medium.sigma_s, 0.0, 0.0],
            [0.0, 0.0, (1.0 - medium.g) * (1.0 + medium.g)],
        ]
    )


@dataclass(frozen=True)
class Range:
    """Where a fit searches.

    Parameters
    ----------
    low, high
        Coordinates.
    sigma_t
        (low, high) extinction that the forward model answers for, 1/mm.
    """

    low: Array
    high: Array
    sigma_t: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def of_media(
        cls,
        sigma_s: tuple[float, float],
        albedo: tuple[float, float],
        g: tuple[float, float],
        sigma_t: tuple[float, float] = (0.0, math.inf),
    ) -> "Range":
        """From coefficients, 1/mm, each (low, high)."""
        edges = [
            np.array([math.log(sigma_s[k]), math.log(albedo[k] / (1.0 - albedo[k])), math.atanh(g[k])]) for k in (0, 1)
        ]
        return cls(edges[0], edges[1], sigma_t)

    @classmethod
    def of_tank(cls, length_mm: float) -> "Range":
        """Everything that a tank of this length can tell from clear water and from chalk."""
        low, high = (paths / length_mm for paths in MEAN_FREE_PATHS)
        return cls.of_media((low, high), ALBEDO, ASYMMETRY)

    def at_edge(self, medium: Medium) -> tuple[str, ...]:
        """Coefficients that a fit left at the edge, where no optimum is: "sigma_a", "sigma_s", "g".

        Examples
        --------
        >>> tank = Range.of_tank(240.0)
        >>> tank.at_edge(Medium(0.001, 0.02, 0.98)), tank.at_edge(Medium(0.0, 0.02, 0.5))
        (('g',), ('sigma_a',))
        """
        if medium.sigma_a == 0.0:
            return ("sigma_a",)
        at = to_coordinates(medium)
        near = (at <= self.low + NEAR_EDGE) | (at >= self.high - NEAR_EDGE)
        near[0] |= not self.sigma_t[0] < medium.sigma_t < self.sigma_t[1]
        return tuple(name for name, edge in (("sigma_a", near[1]), ("sigma_s", near[0]), ("g", near[2])) if edge)

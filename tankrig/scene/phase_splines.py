"""Phase functions as sums of cubic B-splines: what is linear in p is then a product with a few coefficients.

The splines are even in a stretched angle t(θ) = θ/h + c ln(1 + θ/θ₀): close together straight on, where p may be steep,
and h apart elsewhere. Coefficients are those of least squares over the sphere, so what a smooth kernel makes of p is
kept far better than p itself.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.phase_table import PhaseFunction, by_nodes, phase_quadrature, sines

Array = NDArray[np.float64]

NEAR_DEG = 0.2
"""θ₀."""
CROWDED = 3.0
"""c: in each e-fold of θ + θ₀ there are so many more splines."""


class SplineRecord(NamedTuple):
    """Splines for kernels: how many, and `PhaseSplines.places`."""

    number: int
    places: Array


@dataclass(frozen=True)
class PhaseSplines:
    """Cubic B-splines of the angle.

    Parameters
    ----------
    apart_deg
        h, the distance of splines far from straight on.

    Examples
    --------
    >>> from tankrig.scene.phase_functions import HenyeyGreenstein
    >>> splines, hazy = PhaseSplines(4.0), HenyeyGreenstein(0.8)
    >>> found = splines.at(np.array([0.0])) @ splines.coefficients(hazy)
    >>> bool(abs(found[0] / hazy.at(0.0) - 1.0) < 1e-3)
    True
    """

    apart_deg: float

    @property
    def count(self) -> int:
        """How many there are."""
        return self._panels + 3

    @property
    def _panels(self) -> int:
        return int(np.ceil(self._stretched(np.array([1.0]))[0]))

    def _stretched(self, sine: Array) -> Array:
        """t of sin(θ/2)."""
        angle = np.degrees(2.0 * np.arcsin(sine))
        return np.asarray(angle / self.apart_deg + CROWDED * np.log1p(angle / NEAR_DEG))

    @cached_property
    def places(self) -> Array:
        """(NODES,) t at even steps of sin(θ/2), scaled to whole panels; for kernels."""
        stretched = self._stretched(sines())
        return np.asarray(stretched * (self._panels / stretched[-1]))

    @property
    def record(self) -> SplineRecord:
        """For kernels."""
        return SplineRecord(self.count, self.places)

    def at(self, cosine: Array) -> Array:
        """(n, count) splines at n cosines."""
        sine = np.sqrt(np.clip(0.5 - 0.5 * np.asarray(cosine, float), 0.0, 1.0))
        place = np.interp(sine, sines(), self.places)
        panel = np.minimum(place.astype(np.intp), self._panels - 1)
        result = np.zeros((place.size, self.count))
        for k, weight in enumerate(cubic_weights(place - panel)):
            result[np.arange(place.size), panel + k] = weight
        return result

    @cached_property
    def at_nodes(self) -> Array:
        """(NODES, count) splines at the nodes of a table of p."""
        return self.at(1.0 - 2.0 * sines() ** 2)

    @cached_property
    def from_nodes(self) -> Array:
        """(count, NODES): times a table of p, the coefficients."""
        nodes, weights = phase_quadrature()
        splines = self.at(1.0 - 2.0 * nodes**2)
        weighted = splines * (weights * nodes)[:, None]
        return np.asarray(np.linalg.solve(splines.T @ weighted, by_nodes(weighted)), float)

    def coefficients(self, phase: PhaseFunction) -> Array:
        """(count,) of a phase function, in 1/sr."""
        return np.asarray(self.from_nodes @ phase.table)


def cubic_weights(share: Array) -> tuple[Array, Array, Array, Array]:
    """Of the four cubic B-splines over a panel, at a share of it."""
    rest = 1.0 - share
    return (
        rest**3 / 6.0,
        (3.0 * share**3 - 6.0 * share**2 + 4.0) / 6.0,
        (3.0 * rest**3 - 6.0 * rest**2 + 4.0) / 6.0,
        share**3 / 6.0,
    )

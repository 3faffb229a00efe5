"""What a prepared model knows of a phase function: numbers that are linear in p."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.phase_splines import PhaseSplines
from tankrig.scene.phase_table import NODES, PhaseFunction, moments_of_nodes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhaseTraits:
    """Spline coefficients for orders 1 and 2, and Legendre moments for the rest.

    Parameters
    ----------
    once_deg, twice_deg
        Distance of the splines for order 1, which sees p itself, and for order 2, which sees it through integrals.
    highest
        Degree of the last moment.

    Examples
    --------
    >>> from tankrig.scene.phase_functions import HenyeyGreenstein
    >>> traits = PhaseTraits()
    >>> found = traits.of(HenyeyGreenstein(0.5))
    >>> found.size == traits.count, found[traits.moments][:3].round(6).tolist()
    (True, [1.0, 0.5, 0.25])
    """

    once_deg: float = 2.0
    twice_deg: float = 5.0
    highest: int = 10

    @property
    def once(self) -> slice:
        """Coefficients for order 1."""
        return slice(0, splines(self.once_deg).count)

    @property
    def twice(self) -> slice:
        """Coefficients for order 2."""
        return slice(self.once.stop, self.once.stop + splines(self.twice_deg).count)

    @property
    def moments(self) -> slice:
        """Legendre moments 0 … highest."""
        return slice(self.twice.stop, self.twice.stop + self.highest + 1)

    @property
    def count(self) -> int:
        """Of all numbers."""
        return self.moments.stop

    @cached_property
    def _of_nodes(self) -> Array:
        """(count, NODES)."""
        parts = (splines(self.once_deg).from_nodes, splines(self.twice_deg).from_nodes, moments_of_nodes(self.highest))
        return np.concatenate(parts).reshape(self.count, NODES)

    def of(self, phase: PhaseFunction) -> Array:
        """(count,) of a phase function."""
        return np.asarray(self._of_nodes @ phase.table)


@lru_cache(maxsize=8)
def splines(apart_deg: float) -> PhaseSplines:
    """Splines at a distance, whose tables are made once."""
    return PhaseSplines(apart_deg)

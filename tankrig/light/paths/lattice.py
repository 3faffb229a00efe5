"""Evenly spread points in many dimensions: rank-1 lattices, shifted at random.

The generating vectors were found component by component for smooth periodic functions (Korobov space of smoothness 1,
product weights 0.6 · 0.85^j); shifting a lattice at random makes averages unbiased and shows their error.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import part

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lattice:
    """A rank-1 lattice.

    Parameters
    ----------
    points
        How many, a prime.
    vector
        Its generating vector; dimensions beyond it are random.
    """

    points: int
    vector: tuple[int, ...]

    def shifted(self, seed: tuple[int, int]) -> Array:
        """(2, dimensions) array for `coordinate`: steps from point to point, and the shift drawn from `seed`."""
        return np.array([np.array(self.vector) / self.points, np.random.default_rng(seed).random(len(self.vector))])


LARGE = Lattice(
    16381,
    (1, 3711, 5711, 13060, 7766, 9236, 14053, 1873, 7793, 8459, 3605, 2582, 6806, 4796, 8934, 9442, 11037, 5041, 1034,
     15372, 15617, 11275, 2991, 7961, 11101, 4158, 15912, 7644, 5777, 4623, 15818, 75, 4123, 13920, 9562, 1969, 4133,
     1954, 7938, 6556, 2194, 242, 14941, 6825, 5944, 8057, 785, 8667),
)  # fmt: skip
"""A tenth less noise per path."""

SMALL = Lattice(
    4093,
    (1, 2378, 3641, 3804, 509, 328, 3086, 2973, 768, 925, 2864, 1490, 536, 897, 2883, 3511, 3998, 3406, 3919, 311, 3717,
     2054, 3575, 3016, 1354, 400, 3689, 1174, 2209, 2952, 382, 3817, 1697, 296, 2515, 1248, 3239, 1463, 3080, 746, 2071,
     2592, 3368, 914, 1576, 653, 3820, 3658),
)  # fmt: skip
"""Finer steps in time where few paths do."""


@part
def coordinate(point: int, dimension: int, lattice: Array) -> float:
    """Coordinate in [0, 1) of a point of a shifted lattice; beyond the lattice's dimensions a hash of all that."""
    if dimension < lattice.shape[1]:
        value: float = point * lattice[0, dimension] + lattice[1, dimension]
        return value - math.floor(value)
    state = np.uint64(point) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(dimension) * np.uint64(0xD1B54A32D192ED03)
    state += np.uint64(lattice[1, 0] * 9007199254740992.0)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    state ^= state >> np.uint64(31)
    return float(state >> np.uint64(11)) / 9007199254740992.0

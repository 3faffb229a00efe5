"""Evenly spread points in many dimensions: a rank-1 lattice, shifted at random.

The generating vector was found component by component for smooth periodic functions (Korobov space of smoothness 1,
product weights 0.6 · 0.85^j); shifting the lattice at random makes averages unbiased and shows their error.
"""

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel

POINTS = 16381
"""Number of points of the lattice, a prime."""

VECTOR = np.array(
    [1, 3711, 5711, 13060, 7766, 9236, 14053, 1873, 7793, 8459, 3605, 2582, 6806, 4796, 8934, 9442, 11037, 5041, 1034,
     15372, 15617, 11275, 2991, 7961, 11101, 4158, 15912, 7644, 5777, 4623, 15818, 75, 4123, 13920, 9562, 1969, 4133,
     1954, 7938, 6556, 2194, 242, 14941, 6825, 5944, 8057, 785, 8667]
)  # fmt: skip


@kernel
def coordinate(point: int, dimension: int, shift: NDArray[np.float64]) -> float:
    """Coordinate in [0, 1) of a lattice point; beyond the lattice's dimensions a hash of point, dimension and shift."""
    if dimension < VECTOR.size:
        value: float = (point * VECTOR[dimension]) % POINTS / POINTS + shift[dimension]
        return value - 1.0 if value >= 1.0 else value
    state = np.uint64(point) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(dimension) * np.uint64(0xD1B54A32D192ED03)
    state += np.uint64(shift[0] * 9007199254740992.0)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    state ^= state >> np.uint64(31)
    return float(state >> np.uint64(11)) / 9007199254740992.0

"""Chebyshev polynomials of one and two coordinates on [−1, 1]."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from tankrig.compiled import kernel

Array = NDArray[np.float64]


def nodes(count: int) -> Array:
    """Zeros of the Chebyshev polynomial of degree `count`."""
    return np.cos(np.pi * (np.arange(count) + 0.5) / count)


def values(at: ArrayLike, degree: int) -> Array:
    """Polynomials of degrees 0 … degree, (…, degree + 1)."""
    places = np.asarray(at, float)
    return np.reshape(chebyshev.chebvander(places, degree), (*places.shape, degree + 1))


@kernel
def values_and_slopes(at: float, degree: int) -> Array:
    """Polynomials of degrees 0 … degree and their derivatives at one place, (2, degree + 1)."""
    result = np.zeros((2, degree + 1))
    result[0, 0] = 1.0
    if degree > 0:
        result[0, 1], result[1, 1] = at, 1.0
    for n in range(2, degree + 1):
        result[0, n] = 2.0 * at * result[0, n - 1] - result[0, n - 2]
        result[1, n] = 2.0 * (result[0, n - 1] + at * result[1, n - 1]) - result[1, n - 2]
    return result


@dataclass(frozen=True)
class Plane:
    """Products of polynomials of two coordinates.

    Parameters
    ----------
    degrees
        Highest of each coordinate.
    fullness
        Products of degrees (i, j) with i/I + j/J ≤ fullness are kept: 2 for all, 1 for a triangle.

    Examples
    --------
    >>> Plane((2, 1), 1.0).size
    4
    """

    degrees: tuple[int, int]
    fullness: float = 2.0

    @cached_property
    def pairs(self) -> NDArray[np.int64]:
        """(2, size) degrees of the products."""
        first, second = self.degrees
        kept = [
            (i, j)
            for i in range(first + 1)
            for j in range(second + 1)
            if i / max(first, 1) + j / max(second, 1) <= self.fullness + 1e-9
        ]
        return np.array(kept).T

    @property
    def size(self) -> int:
        """How many products there are."""
        return int(self.pairs.shape[1])

    def values(self, first: ArrayLike, second: ArrayLike) -> Array:
        """Products at places, (…, size)."""
        i, j = self.pairs
        return values(first, self.degrees[0])[..., i] * values(second, self.degrees[1])[..., j]

    def values_and_slopes(self, first: float, second: float) -> Array:
        """Products at one place and their derivatives by the two coordinates, (3, size)."""
        return _products(self, first, second)


@lru_cache(maxsize=8)
def _products(plane: Plane, first: float, second: float) -> Array:
    """The same, remembered, as several terms ask for them."""
    i, j = plane.pairs
    a, b = values_and_slopes(first, plane.degrees[0])[:, i], values_and_slopes(second, plane.degrees[1])[:, j]
    result = np.empty((3, i.size))
    np.multiply(a, b[0], out=result[:2])
    np.multiply(a[0], b[1], out=result[2])
    result.flags.writeable = False
    return result

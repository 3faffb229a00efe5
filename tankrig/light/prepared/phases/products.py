"""Polynomials of σt, mean cosine and how a phase function differs from Henyey–Greenstein."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.polynomials import Plane

Array = NDArray[np.float64]

DIRECTIONS = 7
"""In which phase functions of one mean cosine differ, the largest first."""
CURVED = 3
"""Of these, in which images bend."""


@dataclass(frozen=True)
class Excess:
    """How moments differ from those of Henyey–Greenstein with the same mean cosine, in a few directions.

        z = (m_l − m₁^l − mean_l) · directions,  l = 2 … highest

    Light that has turned n times has moments m_l^n, so differences count by m_l² of the third.

    Parameters
    ----------
    mean
        (l,) over the phase functions trained with.
    directions
        (l, DIRECTIONS), scaled so that z is 0 ± 1 over these.
    """

    mean: Array
    directions: Array

    @classmethod
    def of(cls, moments: Array) -> "Excess":
        """Of training phase functions' moments, (n, 1 + highest)."""
        excess = _excess(moments)
        mean, counts = excess.mean(axis=0), np.mean(moments[:, 2:] ** 2, axis=0)
        _, size, axes = np.linalg.svd((excess - mean) * counts, full_matrices=False)
        kept = min(DIRECTIONS, int(np.sum(size > 1e-9 * max(size[0], 1e-12))))
        scale = size[:kept] / np.sqrt(len(moments))
        return cls(mean, counts[:, None] * axes[:kept].T / scale)

    def at(self, moments: Array) -> Array:
        """(…, directions) z of moments, (…, 1 + highest)."""
        return np.asarray((_excess(moments) - self.mean) @ self.directions)

    def rates(self, moments: Array) -> Array:
        """(directions, 1 + highest) derivatives of one z by its moments."""
        degrees = np.arange(2, moments.size)
        by_moment = np.zeros((degrees.size, moments.size))
        by_moment[:, 2:] = np.eye(degrees.size)
        by_moment[:, 1] = -degrees * moments[1] ** (degrees - 1)
        return np.asarray(self.directions.T @ by_moment)


def _excess(moments: Array) -> Array:
    degrees = np.arange(2, moments.shape[-1])
    return np.asarray(moments[..., 2:] - moments[..., 1:2] ** degrees)


@dataclass(frozen=True)
class Products:
    """Polynomials of u and v, each z by itself and by u and v, and products of the first few z.

    Parameters
    ----------
    plane
        Of u (σt) and v (mean cosine).
    directions
        How many z there are.
    tilted
        Whether z goes by u and v, and bends.
    """

    plane: Plane
    directions: int
    tilted: bool = True

    @cached_property
    def _pairs(self) -> NDArray[np.intp]:
        return np.array(np.triu_indices(min(CURVED, self.directions) if self.tilted else 0))

    @property
    def size(self) -> int:
        """How many there are."""
        return self.plane.size + self.directions * (3 if self.tilted else 1) + self._pairs.shape[1]

    def values(self, u: Array, v: Array, z: Array) -> Array:
        """(n, size) at n places, z (n, directions)."""
        i, j = self._pairs
        tilted = [z * u[:, None], z * v[:, None], z[:, i] * z[:, j]] if self.tilted else []
        return np.concatenate([self.plane.values(u, v), z, *tilted], axis=1)

    def values_and_slopes(self, u: float, v: float, z: Array) -> tuple[Array, Array]:
        """(size,) at one place, and (2 + directions, size) derivatives by u, v and z."""
        i, j = self._pairs
        plane, one = self.plane.values_and_slopes(u, v), np.eye(self.directions)
        slopes = np.zeros((2 + self.directions, self.size))
        slopes[:2, : self.plane.size] = plane[1:]
        at = self.plane.size + self.directions
        slopes[2:, self.plane.size : at] = one
        if not self.tilted:
            return np.concatenate([plane[0], z]), slopes
        slopes[0, at : at + self.directions] = z
        slopes[2:, at : at + self.directions] = u * one
        at += self.directions
        slopes[1, at : at + self.directions] = z
        slopes[2:, at : at + self.directions] = v * one
        slopes[2:, at + self.directions :] = one[:, i] * z[j] + one[:, j] * z[i]
        return np.concatenate([plane[0], z, u * z, v * z, z[i] * z[j]]), slopes

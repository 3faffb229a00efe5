"""The images that a prepared model is made from: orders 1 and 2 exactly, the rest from light paths, at chosen media.

One light path at ϖ = 1 serves every albedo: the light of order n is ϖⁿ times its, so paths are recorded by order and
summed for all albedos at once.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from tankrig.light.double import double_scattering
from tankrig.light.single import single_scattering
from tankrig.light.tank.high_orders import CellGrid, traced
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

HIGHEST_ORDER = 2000
BIN_GROWTH = 1.1
"""Ratio of successive orders at which a new image begins; within one, all orders count as equally bright (0.05 %)."""
FAINTEST = 3e-4
"""Share of its weight at which a path ends."""
DEGREES = 20
"""Polynomials along x that keep a noisy image."""


def exact_images(scene: Scene, sigma_t: float, g: float) -> Array:
    """Orders 1 and 2 at ϖ = 1, (2, pixels)."""
    lit = replace(scene, medium=Medium(0.0, sigma_t, g))
    return np.stack([single_scattering(lit).ravel(), double_scattering(lit).ravel()])


@dataclass(frozen=True)
class PathImages:
    """Images of orders ≥ 3 from light paths, for several albedos at once.

    Parameters
    ----------
    scene
        Any scene; its medium does not matter.
    albedos
        Of the images.
    """

    scene: Scene
    albedos: tuple[float, ...]

    @cached_property
    def grid(self) -> CellGrid:
        """Cells that paths are recorded in."""
        return CellGrid.of(self.scene)

    @cached_property
    def along(self) -> Array:
        """(columns, degrees) orthonormal polynomials in x."""
        columns = self.grid.columns
        middles = (np.arange(columns) + 0.5) * 2.0 / columns - 1.0
        return np.linalg.qr(legendre.legvander(middles, min(DEGREES, columns) - 1))[0]

    @cached_property
    def _firsts(self) -> list[int]:
        firsts = [3]
        while firsts[-1] < HIGHEST_ORDER:
            firsts.append(max(firsts[-1] + 1, round(firsts[-1] * BIN_GROWTH)))
        return firsts

    @cached_property
    def _bins(self) -> NDArray[np.int64]:
        return np.searchsorted(self._firsts, np.arange(self._firsts[-1]), side="right").clip(1) - 1

    @cached_property
    def _shares(self) -> Array:
        """(albedos, bins) mean of ϖⁿ over the orders of a bin."""
        orders = np.arange(3, self._bins.size)
        powers = np.array(self.albedos)[:, None] ** orders
        return np.stack([powers[:, self._bins[3:] == one].mean(axis=1) for one in range(len(self._firsts) - 1)], axis=1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of what `sample` gives: albedos, rows, degrees in x."""
        return len(self.albedos), self.grid.rows, self.along.shape[1]

    def sample(self, sigma_t: float, g: float, seed: int, batches: int) -> Array:
        """Mean image of several shifted lattices of paths by albedo, in rows of cells and polynomials in x."""
        lit = replace(self.scene, medium=Medium(0.0, sigma_t, g))
        total = np.zeros((len(self._firsts) - 1, self.grid.rows, self.grid.columns))
        for batch in range(batches):
            total += traced(lit, self.grid, (seed, batch), HIGHEST_ORDER, FAINTEST, self._bins)
        if self.grid.symmetric:
            total = 0.5 * (total + total[:, ::-1])
        images = np.tensordot(self._shares, total @ self.along, 1) / batches
        return np.asarray(images)

    def to_pixels(self, patterns: Array) -> Array:
        """Images of cells (n, rows, degrees) as the camera's pixels, (n, pixels)."""
        return np.array([self.grid.to_pixels(pattern @ self.along.T).ravel() for pattern in patterns])

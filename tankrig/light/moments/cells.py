"""The coarse cells that the tank is cut into."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Tank

Single = NDArray[np.float32]


@dataclass(frozen=True)
class Cells:
    """Equal cells that fill the tank.

    Parameters
    ----------
    counts
        How many along x, y and z.
    size_mm
        Their sides.
    """

    counts: tuple[int, int, int]
    size_mm: tuple[float, float, float]

    @classmethod
    def of(cls, tank: Tank, side_mm: float) -> "Cells":
        """Cells with sides of about `side_mm`, at least four along each side of the tank.

        Examples
        --------
        >>> Cells.of(Tank((240.0, 160.0, 120.0)), 8.0).counts
        (30, 20, 15)
        """
        across, along, up = (max(4, round(side / side_mm)) for side in tank.size_mm)
        x, y, z = tank.size_mm
        return cls((across, along, up), (x / across, y / along, z / up))


def averaged_over(before: Cells, after: Cells, moments: Single) -> Single:
    """(moments, nx, ny, nz) averages over other cells of the same tank.

    Examples
    --------
    >>> fine, coarse = Cells((4, 4, 6), (1.0, 1.0, 1.0)), Cells((4, 4, 4), (1.0, 1.0, 1.5))
    >>> bool(np.allclose(averaged_over(fine, coarse, np.ones((1, 4, 4, 6), np.float32)), 1.0))
    True
    """
    for axis, (many, few) in enumerate(zip(before.counts, after.counts, strict=True), start=1):
        low, high = np.arange(few)[:, None] * many / few, np.arange(1, few + 1)[:, None] * many / few
        cell = np.arange(many)
        shares = np.clip(np.minimum(high, cell + 1) - np.maximum(low, cell), 0.0, None) * few / many
        moments = _along(axis, shares, moments)
    return np.ascontiguousarray(moments)


def interpolated(before: Cells, after: Cells, moments: Single) -> Single:
    """(moments, nx, ny, nz) values at other cells of the same tank, linear between centres and on to the walls.

    Examples
    --------
    >>> coarse, fine = Cells((4, 4, 4), (2.0, 2.0, 2.0)), Cells((4, 4, 8), (2.0, 2.0, 1.0))
    >>> values = np.broadcast_to(np.arange(4, dtype=np.float32), (1, 4, 4, 4))
    >>> interpolated(coarse, fine, values)[0, 0, 0].tolist()
    [-0.25, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.25]
    """
    for axis, (few, many) in enumerate(zip(before.counts, after.counts, strict=True), start=1):
        place = (np.arange(many) + 0.5) * few / many - 0.5
        cell = np.clip(np.floor(place).astype(int), 0, few - 2)
        shares = np.zeros((many, few))
        shares[np.arange(many), cell] = 1.0 - (place - cell)
        shares[np.arange(many), cell + 1] = place - cell
        moments = _along(axis, shares, moments)
    return np.ascontiguousarray(moments)


def _along(axis: int, shares: NDArray[np.float64], moments: Single) -> Single:
    """Weighted sums along an axis; `shares` is (after, before)."""
    return np.moveaxis(np.tensordot(shares.astype(np.float32), moments, (1, axis)), 0, axis)

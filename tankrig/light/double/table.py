"""A table of J between rays of the projector and lines of sight, which every beam and pixel is put together from.

J depends on where the line of sight leaves the surface, x and y, and on the light ray, y₀ and z₀. It is singular like
−ln|δ| where the line meets the ray, δ = y − y_c(x; y₀, z₀) its distance from there, and smooth in all else.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.light.rays import Geometry
from tankrig.scene import Beam
from tankrig.scene.description import Interval

Array = NDArray[np.float64]

STEEPEST = 300.0
"""Largest exponent that is taken out of J before it is interpolated."""


class Table(NamedTuple):
    """J at its nodes."""

    x_mm: Array
    """(nx,) where lines of sight leave the surface."""
    fractions: Array
    """(nk,) |δ| as a share of the distance from the crossing to the side wall."""
    margin: float
    """The shares f are even steps of ln(f / (1 + margin − f))."""
    y0_mm: Array
    """(ny,), (nz,) where light rays enter."""
    z0_mm: Array
    values: Array
    """(nz, ny, 2, nx, nk): J·exp(κ (x + |δ|)) over the share of the light seen, which changes little; the third axis
    is the side of the crossing, y below or above it."""
    decay: float
    """κ in 1/mm: σt, or less where exp(σt x) would overflow."""
    mirrored: bool
    """Whether the light goes by way of the surface."""
    inner_mm: Interval
    """The y₀ between which light doesn't reach the side walls."""


@dataclass(frozen=True)
class LitHeight:
    """Beams whose order 2 one table serves.

    Parameters
    ----------
    geometry
        Numbers of the scene, of the source that the beams come from.
    beams
        Those of the height `z_mm`; where `shared`, all of the source's.
    z_mm
        (low, high) of each beam; where `shared`, from the lowest to the highest of them.
    mirrored
        Whether the light goes by way of the surface between its two scatterings.
    shared
        Whether the beams have different heights, too many for a table each.
    """

    geometry: Geometry
    beams: tuple[Beam, ...]
    z_mm: Interval
    mirrored: bool
    shared: bool


class Stack(NamedTuple):
    """J of several liquids at the nodes of one table."""

    values: Array
    """(nz, ny, 2, nx, nk, liquids), each as `Table.values`: what does not depend on the liquid is then worked out
    once for all of them."""
    decays: Array
    """(liquids,) κ of each."""


def decay_of(sigma_t: float, geometry: Geometry) -> float:
    """κ for `Table.decay`, 1/mm."""
    return float(min(sigma_t, STEEPEST / (geometry.length + 2.0 * geometry.half_width)))


def y_weights(table: Table, at: float) -> Array:
    """Weights that interpolate between the nodes in y₀: a polynomial where light stays inside, straight elsewhere."""
    nodes, weights = table.y0_mm, np.zeros(table.y0_mm.size)
    inner = (nodes > table.inner_mm[0]) & (nodes < table.inner_mm[1])
    if table.inner_mm[0] <= at <= table.inner_mm[1]:
        weights[inner] = lagrange(nodes[inner], at)
        return weights
    outer = np.flatnonzero(~inner)
    k = int(np.clip(np.searchsorted(nodes[outer], at) - 1, 0, outer.size - 2))
    before, after = outer[k], outer[k + 1]
    weights[after] = (at - nodes[before]) / (nodes[after] - nodes[before])
    weights[before] = 1.0 - weights[after]
    return weights


def lagrange(nodes: Array, at: float) -> Array:
    """Weights of the polynomial through all `nodes` at one place."""
    weights = np.ones(nodes.size)
    for k in range(nodes.size):
        others = np.delete(nodes, k)
        weights[k] = np.prod((at - others) / (nodes[k] - others))
    return weights

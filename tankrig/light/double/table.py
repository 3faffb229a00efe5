"""Table of J between rays of the projector and lines of sight, from which every beam and pixel is put together.

J depends on where the line of sight leaves the surface, x and y, and on the light ray, y₀ and z₀. It is singular like
−ln|δ| where the line meets the ray, δ = y − y_c(x; y₀, z₀) its distance from there, and smooth in all else; so nodes
are geometric in δ on both sides of the crossing, graded towards the walls in x, and few in y₀ and z₀.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.double.pair import depth_below, pair_radiance, share_seen
from tankrig.light.rays import Geometry, light_ray, mirror_symmetric, shift_invariant, sight_line, sighting_row
from tankrig.scene import Scene
from tankrig.threads import THREADS

Array = NDArray[np.float64]

WALL, STRAIGHT = 0.02, 1e6
"""Margins: where lines of sight slant, they leave the tank through its side walls, and J falls to 0 in a small share
of the way there; where they don't, nodes are graded towards the crossing only."""
CLOSE = 0.05
"""Of nodes in y₀ where light leaves through the side walls: their distance over half the tank's width."""
STEEPEST = 300.0
"""Largest exponent that is taken out of J before it is interpolated."""


@dataclass(frozen=True)
class Fineness:
    """How finely J is tabulated.

    Parameters
    ----------
    nodes
        Of the Gauss–Legendre rule in every panel.
    ratio, slanted_ratio
        Of successive nodes in δ; the latter where lines of sight or light rays slant, and leave the tank through its
        side walls.
    curvature
        Error of order 2 up to which one ray stands for a beam's whole height.
    more_rays
        Beyond it, so many more than the height asks for.
    slanted_finest, slanted_near
        Where lines slant: length below which the image need not be resolved, in that asked for, and the first node in
        δ, in the former.
    mirrored
        Power of the ratio for light by way of the surface, which comes from afar and changes slowly.
    """

    nodes: int
    ratio: float
    slanted_ratio: float
    curvature: float
    more_rays: int = 2
    slanted_finest: float = 1.0
    slanted_near: float = 0.02
    mirrored: float = 1.0


FINE = Fineness(nodes=5, ratio=1.45, slanted_ratio=1.3, curvature=0.001)
"""Errs by 0.04 % of orders 1 and 2 at most (nine scenes, g −0.4…0.95, both projectors and cameras)."""
COARSE = Fineness(
    nodes=3, ratio=1.6, slanted_ratio=1.45, curvature=0.004,
    more_rays=1, slanted_finest=2.0, slanted_near=0.05, mirrored=2.0,
)  # fmt: skip
"""Errs by 0.1 % at most, in less than half the time, and in a third of it where lines slant."""


@dataclass(frozen=True)
class Table:
    """J at its nodes.

    Parameters
    ----------
    x_mm
        (nx,) where lines of sight leave the surface.
    fractions
        (nk,) |δ| as a share of the distance from the crossing to the side wall.
    margin
        The shares f are even steps of ln(f / (1 + margin − f)).
    y0_mm, z0_mm
        (ny,), (nz,) where light rays enter.
    inner_mm
        The y₀ between which light doesn't reach the side walls.
    values
        (nz, ny, 2, nx, nk): J·exp(κ (x + |δ|)) over the share of the light seen, which changes little; the third axis
        is the side of the crossing, y below or above it.
    """

    x_mm: Array
    fractions: Array
    margin: float
    y0_mm: Array
    inner_mm: tuple[float, float]
    z0_mm: Array
    values: Array
    decay: float
    """κ in 1/mm: σt, or less where exp(σt x) would overflow."""
    mirrored: bool
    """Whether the light goes by way of the surface."""


def fill_table(
    scene: Scene,
    geometry: Geometry,
    z_mm: tuple[float, float],
    mirrored: bool,
    finest_mm: float,
    fineness: Fineness,
    between: bool = False,
) -> tuple[Table, Array]:
    """Compute J for beams of one height, or of all within a height.

    Parameters
    ----------
    scene, geometry
        What to compute it for.
    z_mm
        Lower and upper edge of the beams on the plane x = 0.
    mirrored
        By way of the water surface.
    finest_mm
        Length below which the image need not be resolved.
    fineness
        Of nodes and panels.
    between
        With so many nodes in z₀ that their polynomial holds between them, not only for the whole height.

    Returns
    -------
    table, weights
        `weights` (nz,) integrate over z₀, mm.
    """
    height = scene.tank.size_mm[2]
    low, high = z_mm
    sigma_t = scene.medium.sigma_t
    # One node across a beam errs by (thickness/scale)²/24 or so, n nodes by its n-th power.
    curvature = ((high - low) * max(sigma_t, 4.0 / height)) ** 2 / 24.0
    rays = math.ceil((high - low) * max(sigma_t / 3.0, 2.0 / height))
    count = 1 if curvature < fineness.curvature else fineness.more_rays + rays
    nodes, weights = np.polynomial.legendre.leggauss(min(count + (3 if between else 0), 40))
    z0 = 0.5 * (low + high) + 0.5 * (high - low) * nodes
    width = 2.0 * geometry.half_width
    if shift_invariant(scene):
        margin, ratio, near_mm = STRAIGHT, fineness.ratio, 0.02 * finest_mm
    else:
        margin, ratio, near_mm = WALL, fineness.slanted_ratio, fineness.slanted_near * finest_mm
        finest_mm *= fineness.slanted_finest
    if mirrored:
        ratio **= fineness.mirrored
    x = _x_nodes(geometry, low, high, finest_mm)
    decades = math.log(width / near_mm)
    first, last = -decades - math.log(1.0 + margin), -math.log(margin)
    nodes_y = np.exp(np.linspace(first, last, 1 + math.ceil((last - first) / math.log(ratio))))
    fractions = (1.0 + margin) * nodes_y / (1.0 + nodes_y)
    if shift_invariant(scene):
        y0, inner = np.zeros(1), (-math.inf, math.inf)
    else:
        edges = [edge for beam in scene.projector.beams for edge in beam.y_mm]
        y0, inner = _y_nodes(geometry, min(edges), max(edges), 0.5 * (low + high))
    decay = min(sigma_t, STEEPEST / (geometry.length + width))
    rule = np.polynomial.legendre.leggauss(fineness.nodes)
    values = np.zeros((z0.size, y0.size, 2, x.size, fractions.size))
    fill = _fill_shifted if shift_invariant(scene) else _fill_slanted
    half = y0.size // 2 if mirror_symmetric(scene) else 0
    some, one_sided = y0[: y0.size - half], values[:, : y0.size - half]
    given = (one_sided, geometry, decay, sigma_t, scene.medium.g, x, fractions, some, z0, mirrored, *rule)
    with ThreadPoolExecutor(THREADS) as pool:
        parts = [pool.submit(fill, *given, part, THREADS) for part in range(THREADS)]
        for part in parts:
            part.result()
    values[:, y0.size - half :] = values[:, :half, ::-1][:, ::-1]  # the other side is the mirror image
    return Table(x, fractions, margin, y0, inner, z0, values, decay, mirrored), 0.5 * (high - low) * weights


def _y_nodes(geometry: Geometry, low: float, high: float, z0: float) -> tuple[Array, tuple[float, float]]:
    """Nodes in y₀, ascending, and within which of them light stays between the side walls.

    There few nodes make one polynomial. Beyond, J changes at once from what a ray that passes near by scatters to what
    one does that has left the tank, and nodes are close to each other.
    """
    inner_low, inner_high = _staying(geometry, low, z0, high), _staying(geometry, high, z0, low)
    spread, middle = inner_high - inner_low, 0.5 * (inner_high + inner_low)
    near_wall = math.sqrt(max(1.0 - max(abs(low), abs(high)) / geometry.half_width, 0.1))
    many = 3 + math.ceil(1.5 * spread / geometry.half_width / near_wall) if spread > 0.0 else 0
    inner = middle - 0.5 * spread * np.cos(np.pi * (np.arange(many) + 0.5) / max(many, 1))
    close = CLOSE * geometry.half_width
    below = np.linspace(low, inner_low, 2 + math.ceil((inner_low - low) / close))[: None if inner_low > low else 0]
    above = np.linspace(inner_high, high, 2 + math.ceil((high - inner_high) / close))[
        : None if inner_high < high else 0
    ]
    return np.concatenate([below, inner, above]), (inner_low, inner_high)


def _staying(geometry: Geometry, edge: float, z0: float, other: float) -> float:
    """The y₀ nearest to `edge` and no farther than `other` whose light doesn't reach a side wall."""
    from scipy.optimize import brentq

    def beyond(y0: float) -> float:
        ux, uy, _ = light_ray(geometry, y0, z0)
        return float(math.copysign(1.0, edge - other) * (y0 + uy / ux * geometry.length) - geometry.half_width)

    if beyond(edge) <= 0.0:
        return edge
    return other if beyond(other) >= 0.0 else float(brentq(beyond, min(edge, other), max(edge, other)))


def _x_nodes(geometry: Geometry, low: float, high: float, finest_mm: float) -> Array:
    """Nodes in x, graded towards the walls and towards where lines of sight meet the beam at the walls."""
    special = [0.0, geometry.length]
    for wall in (0.0, geometry.length):
        for z in (low, high):
            special.append(_seen_from_above(geometry, wall, z))
    for z in (low, high):  # where the light itself meets the surface
        ux, _, uz = light_ray(geometry, 0.0, z)
        if abs(uz) > 1e-12:
            special.append((geometry.height - z) / uz * ux)
    places = np.array([place for place in special if 0.0 <= place <= geometry.length])
    x, nodes = 0.0, [0.0]
    largest = geometry.length / 28.0
    while x < geometry.length:
        gap = np.abs(places - x)
        ahead = places[places > x + 1e-9]
        step = min(max(0.4 * gap.min(), 0.25 * finest_mm), largest)
        if ahead.size:
            step = min(step, max(ahead[0] - x, 0.25 * finest_mm) if ahead[0] - x < 1.3 * step else 0.6 * (ahead[0] - x))
        x = min(x + max(step, 0.2 * finest_mm), geometry.length)
        nodes.append(x)
    return np.array(nodes)


def _seen_from_above(geometry: Geometry, x: float, z: float) -> float:
    """The x on the surface through which the camera sees the point (x, 0, z)."""
    seen = x
    for _ in range(20):
        vx, _, vz, _ = sight_line(geometry, seen, 0.0)
        seen = x + vx / vz * (geometry.height - z)
    return float(seen)


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


@kernel
def _fill_shifted(
    values: Array, geometry: Geometry, decay: float, sigma_t: float, g: float, x: Array, fractions: Array, y0: Array,
    z0: Array, mirrored: bool, nodes: Array, weights: Array, part: int, parts: int,
) -> None:  # fmt: skip
    """Every second x, where only y − y₀ matters: both lines are put symmetrically about y = 0, inside the tank."""
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for k in range(fractions.size):
                delta = 2.0 * geometry.half_width * fractions[k]
                value = pair_radiance(
                    geometry,
                    sigma_t,
                    g,
                    x[i],
                    y0[0] + 0.5 * delta,
                    y0[0] - 0.5 * delta,
                    z0[j],
                    mirrored,
                    nodes,
                    weights,
                )
                value *= math.exp(decay * (x[i] + delta))
                values[j, 0, 0, i, k] = value
                values[j, 0, 1, i, k] = value


@kernel
def _fill_slanted(
    values: Array, geometry: Geometry, decay: float, sigma_t: float, g: float, x: Array, fractions: Array, y0: Array,
    z0: Array, mirrored: bool, nodes: Array, weights: Array, part: int, parts: int,
) -> None:  # fmt: skip
    """Every second x, with nodes between the crossing and either side wall; J over `share_seen`."""
    inside = 0.999 * geometry.half_width  # at the wall itself both are 0
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for m in range(y0.size):
                crossing = sighting_row(geometry, x[i], y0[m], z0[j])
                depth = depth_below(geometry, x[i], y0[m], z0[j], mirrored)
                for side in range(2):
                    span = geometry.half_width - crossing if side == 1 else geometry.half_width + crossing
                    for k in range(fractions.size):
                        delta = max(span, 1e-6) * fractions[k]
                        y = crossing + delta if side == 1 else crossing - delta
                        y = min(max(y, -inside), inside)
                        value = pair_radiance(geometry, sigma_t, g, x[i], y, y0[m], z0[j], mirrored, nodes, weights)
                        share = max(share_seen(geometry, x[i], y, abs(y - crossing), depth), 1e-9)
                        value *= math.exp(decay * (x[i] + delta)) / share
                        values[j, m, side, i, k] = value

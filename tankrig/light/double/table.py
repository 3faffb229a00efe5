"""A table of J between rays of the projector and lines of sight, which every beam and pixel is put together from.

J depends on where the line of sight leaves the surface, x and y, and on the light ray, y₀ and z₀. It is singular like
−ln|δ| where the line meets the ray, δ = y − y_c(x; y₀, z₀) its distance from there, and smooth in all else; so nodes
are geometric in δ on both sides of the crossing, graded towards the walls in x, and few in y₀ and z₀. Where the line
would meet a ray far beside the tank, they are geometric about the wall through which the ray has left (`nearest_row`).
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.geometry.optics import crossing_offset
from tankrig.light.double.ray_and_sight import Pair, add_pair, depth_below, meet_beyond, nearest_row, share_seen
from tankrig.light.quadrature import Rule, gauss_legendre
from tankrig.light.rays import (
    Geometry,
    light_ray,
    mirror_symmetric,
    path_inside,
    shift_invariant,
)
from tankrig.light.water import Water, water_of
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.description import Interval
from tankrig.scene.phase_table import PhaseFunction
from tankrig.threads import THREADS

Array = NDArray[np.float64]

MIRRORED = 0.05
"""Share of order 2 at most that comes by way of the surface: 1.4 to 3.6 %."""
WALL, STRAIGHT = 0.02, 1e6
"""Margins: where lines of sight slant, they leave the tank through its side walls, and J falls to 0 in a small share
of the way there; where they don't, nodes are graded towards the crossing only."""
CLOSE = 0.0125
"""Of nodes in y₀ where light leaves through the side walls: their distance over half the tank's width."""
SEEN_APART, LEAVING, MOST_APART = 1.0, 12.0, 24
"""Lengths that images are resolved to, by which the rows of one more ray are apart; how many more there are where rays
of one beam leave through floor or surface all along the tank; and how many more at most. Two pinholes 25 and 40 mm from
their faces, with 2 + 1 rays for beams of 10 and 25 mm, made order 2 .3 of itself off, with six more .05."""
FEW_APART = 4
"""How many more at most where the light is little, see `double_scattering_of`."""
HEIGHTS, PLACES = 5, 12
"""Of rays of a beam, and along the tank, at which that is looked at."""
PEAKED, NEARER = 0.002, 0.1
"""Width of a phase function's peak below which nodes begin so many times nearer to a ray: with Fournier and Forand's
an image of slanted lines was .54 % off, and is .24."""
STEEPEST = 300.0
"""Largest exponent that is taken out of J before it is interpolated."""


@dataclass(frozen=True)
class Fineness:
    """How finely J is tabulated.

    Parameters
    ----------
    nodes
        Of the Gauss–Legendre rule in every panel; of other phase functions than Henyey–Greenstein's at least as many as
        of fine tables, for rules of three pass by Mie's lobes: order 2 of beads of 2 µm was .9 % too faint.
    ratio, slanted_ratio
        Of successive nodes in δ; the latter where lines of sight or light rays slant, and leave the tank through its
        side walls.
    curvature, slanted_curvature
        Error of order 2 up to which one ray stands for a beam's whole height; the latter where lines slant, and what is
        higher is seen elsewhere.
    more_rays
        Beyond it, so many more than the height asks for.
    slanted_near
        Where lines slant: the first node in δ, in lengths below which the image need not be resolved.
    mirrored
        Power of the ratio for light by way of the surface, which comes from afar and changes slowly.
    apart
        Where lines slant and the light goes on less than steeply (g < `STEEP_G`): how many times farther apart nodes in
        y₀ are.
    most_apart
        How many more rays stand at most for a height whose rays are seen apart, see `SEEN_APART`.
    """

    nodes: int
    ratio: float
    slanted_ratio: float
    curvature: float
    slanted_curvature: float
    more_rays: int = 2
    slanted_near: float = 0.02
    mirrored: float = 1.0
    apart: float = 1.0
    most_apart: int = MOST_APART


FINE = Fineness(nodes=5, ratio=1.45, slanted_ratio=1.3, curvature=0.001, slanted_curvature=0.0003)
"""Errs by 0.04 % of orders 1 and 2 at most (nine scenes, g −0.4…0.95, both projectors and cameras), but where light of
g .95 slants: see `table_error`. One ray for pinholes' beams of 4.5 mm made order 2 .12 % too faint, .35 % off."""
COARSE = Fineness(
    nodes=3, ratio=1.6, slanted_ratio=1.7, curvature=0.004, slanted_curvature=0.0006,
    more_rays=1, slanted_near=0.05, mirrored=2.0, apart=2.0,
)  # fmt: skip
"""Errs by 0.1 % at most, in less than half the time, and in a fifth of it where lines slant: there by .05 to .23 % of
order 2 in eight scenes. With one ray for 4 mm and a finest length twice as long it was .17 to 1.3 %, in half the time.
"""
ROUGH = replace(COARSE, slanted_ratio=2.0, slanted_curvature=0.0012, slanted_near=0.1)
ROUGHEST = replace(ROUGH, nodes=2, slanted_curvature=0.003, apart=3.0)
"""Where lines slant, in a half and a quarter of the coarse ones' time: of 33 random scenes they err by .23 and .55 % of
order 2 in the median and by .95 and 1.4 % at most, but the latter by 2 % where there is three times more of it."""
STEEP_G = 0.9
"""Mean cosine from which J changes too much with y₀ for that: order 2 would be off by .17 instead of .12 % at g .95."""


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


def laid_out(
    scene: Scene,
    geometry: Geometry,
    z_mm: tuple[float, float],
    mirrored: bool,
    finest_mm: float,
    fineness: Fineness,
    between: bool = False,
    peaked: bool = False,
) -> tuple[Table, Array]:
    """Nodes of a table for beams of one height, or of all within a height, with no values yet.

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
    peaked
        Where J grows faster than a logarithm towards the ray, see `PEAKED`: nodes begin nearer to it.

    Returns
    -------
    table, weights
        `weights` (nz,) integrate over z₀, mm.
    """
    height = scene.tank.size_mm[2]
    low, high = z_mm
    sigma_t = scene.medium.sigma_t
    rays = math.ceil((high - low) * max(sigma_t / 3.0, 2.0 / height))
    straight = shift_invariant(scene)
    enough = fineness.curvature if straight else fineness.slanted_curvature
    bends = curvature(high - low, sigma_t, height) * (MIRRORED if mirrored else 1.0)
    more = 0 if straight or between else min(rays_apart(scene, geometry, z_mm, finest_mm), fineness.most_apart)
    count = 1 if bends < enough and more == 0 else fineness.more_rays + rays + more
    nodes, weights = np.polynomial.legendre.leggauss(
        min(count + (_more_between(high - low, height) if between else 0), 40)
    )
    z0 = 0.5 * (low + high) + 0.5 * (high - low) * nodes
    width = 2.0 * geometry.half_width
    if straight:
        margin, ratio, near_mm = STRAIGHT, fineness.ratio, 0.02 * finest_mm
    else:
        margin, ratio, near_mm = WALL, fineness.slanted_ratio, fineness.slanted_near * finest_mm
        near_mm *= NEARER if peaked else 1.0
    if mirrored:
        ratio **= fineness.mirrored
    x = _x_nodes(geometry, low, high, finest_mm, 2.0 if mirrored and not straight else 1.0)
    decades = math.log(width / near_mm)
    first, last = -decades - math.log(1.0 + margin), -math.log(margin)
    nodes_y = np.exp(np.linspace(first, last, 1 + math.ceil((last - first) / math.log(ratio))))
    fractions = (1.0 + margin) * nodes_y / (1.0 + nodes_y)
    if straight:
        y0, inner = np.zeros(1), (-math.inf, math.inf)
    else:
        apart = (fineness.apart if scene.medium.g < STEEP_G else 1.0) * (2.0 if mirrored else 1.0)
        y0, inner = _y_nodes(geometry, _lit(scene, geometry, z_mm), 0.5 * (low + high), apart)
    decay = _decay(sigma_t, geometry)
    values = np.zeros((z0.size, y0.size, 2, x.size, fractions.size))
    return Table(x, fractions, margin, y0, z0, values, decay, mirrored, inner), 0.5 * (high - low) * weights


def rays_apart(scene: Scene, geometry: Geometry, z_mm: Interval, finest_mm: float) -> int:
    """How many more rays stand for a height whose rays are seen far apart, or leave the tank at different places."""
    lit = _lit(scene, geometry, z_mm)
    ends = lit[0][0], max(high for _, high in lit)
    heights = np.linspace(*z_mm, HEIGHTS)
    apart, leaving = 0.0, 0.0
    for y0 in ends:
        last = [_left_at(geometry, y0, z0) for z0 in heights]
        leaving = max(leaving, (max(last) - min(last)) / geometry.length)
        for x in np.linspace(0.0, geometry.length, PLACES):
            rows = [nearest_row(geometry, x, y0, z0, True) for z0, end in zip(heights, last, strict=True) if x <= end]
            apart = max(apart, max(rows) - min(rows)) if rows else apart
    return min(int(apart / (SEEN_APART * finest_mm)) + int(LEAVING * leaving), MOST_APART)


def _left_at(geometry: Geometry, y0: float, z0: float) -> float:
    """The x at which a ray leaves the tank, mm."""
    ux, uy, uz = light_ray(geometry, y0, z0)
    enter, leave = path_inside(geometry, 0.0, y0, z0, ux, uy, uz)
    return float(max(leave, enter) * ux)


def curvature(high_mm: float, sigma_t: float, height: float) -> float:
    """What one ray for a beam so high errs by, (thickness/scale)²/24 or so; n rays err by its n-th power."""
    return (high_mm * max(sigma_t, 4.0 / height)) ** 2 / 24.0


class Stack(NamedTuple):
    """J of several liquids at the nodes of one table."""

    values: Array
    """(nz, ny, 2, nx, nk, liquids), each as `Table.values`: what does not depend on the liquid is then worked out
    once for all of them."""
    decays: Array
    """(liquids,) κ of each."""


def hardest(media: Sequence[Medium]) -> Medium:
    """As dense as the densest of liquids, and as steep as the steepest."""
    return Medium(0.0, max(one.sigma_t for one in media), max(one.g for one in media))


def peaked(medium: Medium) -> bool:
    """Whether a liquid scatters forward in so sharp a peak that tables need nodes nearer to their rays."""
    return medium.phase_function.record.width < PEAKED


def fill_stack(
    scene: Scene,
    media: Sequence[Medium],
    lit: LitHeight,
    finest_mm: float,
    fineness: Fineness,
    others: Sequence[PhaseFunction] = (),
) -> tuple[Table, Stack, Array]:
    """Compute J of several liquids at the nodes of `laid_out`, as close as the densest and the steepest want them.

    Parameters
    ----------
    scene
        Its own medium does not matter.
    media
        The liquids.
    lit
        The beams that the table is for.
    finest_mm, fineness
        As for `laid_out`.
    others
        Phase functions near that of the one liquid there is then; after J the stack holds how it changes by the share
        of the way to each.

    Returns
    -------
    table, stack, weights
        The table has the nodes, and no values; `weights` (nz,) integrate over z₀, mm.
    """
    geometry = lit.geometry
    table, weights = laid_out(
        replace(scene, medium=hardest(media)), geometry, lit.z_mm, lit.mirrored, finest_mm, fineness, lit.shared,
        any(peaked(one) for one in media),
    )  # fmt: skip
    y0 = table.y0_mm
    fill = _fill_shifted if shift_invariant(scene) else _fill_slanted
    half = y0.size // 2 if mirror_symmetric(scene) else 0
    decays = np.array([_decay(one.sigma_t, geometry) for one in media]).repeat(1 + len(others))
    found = np.empty((*table.values.shape, decays.size))
    densities = np.ascontiguousarray(np.array([one.table for one in others]).T) if others else None
    lobed = any(one.phase is not None for one in media)
    rule, each = gauss_legendre(max(fineness.nodes, FINE.nodes) if lobed else fineness.nodes), 1 + len(others)
    with ThreadPoolExecutor(THREADS) as pool:
        for number, medium in enumerate(media):
            values = np.zeros((*table.values.shape, each))
            one_sided = table._replace(y0_mm=y0[: y0.size - half], decay=float(decays[number * each]))
            given = values[:, : y0.size - half], one_sided, geometry, water_of(medium), densities, rule
            for part in [pool.submit(fill, *given, part, THREADS) for part in range(THREADS)]:
                part.result()
            values[:, y0.size - half :] = values[:, :half, ::-1][:, ::-1]  # the other side is the mirror image
            found[..., number * each : (number + 1) * each] = values
    return table, Stack(found, decays), weights


def _decay(sigma_t: float, geometry: Geometry) -> float:
    """κ for `Table.decay`, 1/mm."""
    return float(min(sigma_t, STEEPEST / (geometry.length + 2.0 * geometry.half_width)))


def _more_between(span: float, height: float) -> int:
    """Nodes in z₀ beyond those that the whole height needs, so that the polynomial holds for beams within it.

    One does for a twentieth of the water's depth (1e-5 of orders 1 and 2), as for beams of a rolled picture.
    """
    return 1 + min(2, int(4.0 * span / height))


def _lit(scene: Scene, geometry: Geometry, z_mm: Interval) -> list[Interval]:
    """The y₀ that beams within a height light, ascending."""
    low, high = z_mm
    if geometry.reflected:
        low, high = 2.0 * geometry.height - high, 2.0 * geometry.height - low
    close = 1e-6 * geometry.height
    return sorted(
        beam.y_mm for beam in scene.projector.beams if low - close <= beam.z_mm[0] and beam.z_mm[1] <= high + close
    )


def _y_nodes(geometry: Geometry, lit: list[Interval], z0: float, apart: float) -> tuple[Array, Interval]:
    """Nodes in y₀, ascending, and within which of them light stays between the side walls.

    There few nodes make one polynomial. Beyond, J changes at once from what a ray that passes near by scatters to what
    one does that has left the tank, and nodes are close to each other, where there is light.
    """
    low, high = lit[0][0], max(end for _, end in lit)
    inner_low, inner_high = _staying(geometry, low, z0, high), _staying(geometry, high, z0, low)
    spread, middle = inner_high - inner_low, 0.5 * (inner_high + inner_low)
    near_wall = math.sqrt(max(1.0 - max(abs(low), abs(high)) / geometry.half_width, 0.1))
    many = math.ceil(2.0 + (4.0 + 3.0 * spread / geometry.half_width / near_wall) / apart) if spread > 0.0 else 0
    inner = middle - 0.5 * spread * np.cos(np.pi * (np.arange(many) + 0.5) / max(many, 1))
    close = apart * CLOSE * geometry.half_width
    below = _close_nodes([(start, min(end, inner_low)) for start, end in lit if start < inner_low], close)
    above = _close_nodes([(max(start, inner_high), end) for start, end in lit if end > inner_high], close)
    return np.concatenate([below, inner, above]), (float(inner_low), float(inner_high))


def _close_nodes(lit: list[Interval], close: float) -> Array:
    """Nodes that are close to each other in intervals, which ascend; those that nearly touch are one."""
    parts: list[Interval] = []
    for start, end in lit:
        if parts and start - parts[-1][1] < close:
            parts[-1] = parts[-1][0], max(end, parts[-1][1])
        else:
            parts.append((start, end))
    # Two parts that are each other's mirror images have as many, whatever rounding says of their widths.
    each = [np.linspace(start, end, 2 + math.ceil((end - start) / close - 1e-6)) for start, end in parts]
    return np.concatenate([np.empty(0), *each])


def _staying(geometry: Geometry, edge: float, z0: float, other: float) -> float:
    """The y₀ nearest to `edge` and no farther than `other` whose light doesn't reach a side wall."""
    from scipy.optimize import brentq

    def beyond(y0: float) -> float:
        ux, uy, _ = light_ray(geometry, y0, z0)
        return float(math.copysign(1.0, edge - other) * (y0 + uy / ux * geometry.length) - geometry.half_width)

    if beyond(edge) <= 0.0:
        return edge
    return other if beyond(other) >= 0.0 else float(brentq(beyond, min(edge, other), max(edge, other)))


def _x_nodes(geometry: Geometry, low: float, high: float, finest_mm: float, apart: float) -> Array:
    """Nodes in x, graded towards the walls and towards where lines of sight meet the beam at the walls.

    So many times farther apart than light wants that comes straight.
    """
    finest_mm *= apart
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
    largest = apart * geometry.length / 28.0
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
    if not geometry.camera_pinhole:
        return x
    away, above = x - geometry.camera_x, geometry.camera_z - geometry.height
    rho = crossing_offset(abs(away), geometry.height - z, above, geometry.refractive_index, 0.0, 1.0)
    return float(geometry.camera_x + math.copysign(rho, away))


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
    values: Array, table: Table, geometry: Geometry, water: Water, others: Array | None, rule: Rule, part: int,
    parts: int,
) -> None:  # fmt: skip
    """Every second x, where only y − y₀ matters: both lines are put symmetrically about y = 0, inside the tank."""
    x, fractions, _, y0, z0, _, decay, mirrored, _ = table
    sigma_t, _, phase = water
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for k in range(fractions.size):
                delta = 2.0 * geometry.half_width * fractions[k]
                pair = Pair(x[i], y0[0] + 0.5 * delta, y0[0] - 0.5 * delta, z0[j], mirrored)
                found = values[j, 0, 0, i, k]
                add_pair(found, geometry, sigma_t, phase, others, pair, rule)
                found *= math.exp(decay * (x[i] + delta))
                values[j, 0, 1, i, k] = found


@kernel
def _fill_slanted(
    values: Array, table: Table, geometry: Geometry, water: Water, others: Array | None, rule: Rule, part: int,
    parts: int,
) -> None:  # fmt: skip
    """Every second x, with nodes between the crossing and either side wall; J over `share_seen`."""
    x, fractions, _, y0, z0, _, decay, mirrored, _ = table
    sigma_t, _, phase = water
    inside = 0.999 * geometry.half_width  # at the wall itself both are 0
    for i in range(part, x.size, parts):
        beyond = meet_beyond(geometry, x[i], y0, z0)
        for j in range(z0.size):
            for m in range(y0.size):
                crossing = nearest_row(geometry, x[i], y0[m], z0[j], beyond)
                depth = depth_below(geometry, x[i], y0[m], z0[j], mirrored)
                for side in range(2):
                    span = geometry.half_width - crossing if side == 1 else geometry.half_width + crossing
                    for k in range(fractions.size):
                        delta = max(span, 1e-6) * fractions[k]
                        y = crossing + delta if side == 1 else crossing - delta
                        y = min(max(y, -inside), inside)
                        pair = Pair(x[i], y, y0[m], z0[j], mirrored)
                        found = values[j, m, side, i, k]
                        add_pair(found, geometry, sigma_t, phase, others, pair, rule)
                        share = max(share_seen(geometry, x[i], y, abs(y - crossing), depth), 1e-9)
                        found *= math.exp(decay * (x[i] + delta)) / share

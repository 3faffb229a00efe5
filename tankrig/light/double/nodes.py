"""Where the nodes of a table of J are.

They are geometric in δ on both sides of the crossing, where J is singular, graded towards the walls in x, and few in y₀
and z₀. Where the line of sight would meet a ray far beside the tank, they are geometric about the wall through which
the ray has left (`nearest_row`).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.geometry.optics import crossing_offset
from tankrig.light.double.fineness import MOST_APART, STEEP_G, Fineness
from tankrig.light.double.ray_and_sight import nearest_row
from tankrig.light.double.table import Table, decay_of
from tankrig.light.rays import Geometry, light_ray, path_inside, shift_invariant
from tankrig.scene import Medium, Scene
from tankrig.scene.description import Interval
from tankrig.scene.phase_table import SHARP

Array = NDArray[np.float64]

MIRRORED = 0.05
"""Share of order 2 at most that comes by way of the surface: 1.4 to 3.6 %."""
WALL, STRAIGHT = 0.02, 1e6
"""Margins: where lines of sight slant, they leave the tank through its side walls, and J falls to 0 in a small share
of the way there; where they don't, nodes are graded towards the crossing only."""
CLOSE = 0.0125
"""Of nodes in y₀ where light leaves through the side walls: their distance over half the tank's width."""
SEEN_APART, LEAVING = 1.0, 12.0
"""Lengths that images are resolved to, by which the rows of one more ray are apart; and how many more there are where
rays of one beam leave through floor or surface all along the tank. Two pinholes 25 and 40 mm from their faces, with
2 + 1 rays for beams of 10 and 25 mm, made order 2 .3 of itself off, with six more .05."""
HEIGHTS, PLACES = 5, 12
"""Of rays of a beam, and along the tank, at which that is looked at."""
NEARER = 0.01
"""Where a phase function's peak is sharp nodes begin so many times nearer to a ray, as do the panels between them: with
Fournier and Forand's, order 2 was 4.1 % too faint in parallel light and .9 % in slanted, and is .06 and .07 %."""


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
        Where J grows faster than a logarithm towards the ray, see `NEARER`: nodes begin nearer to it.

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
    x = _x_nodes(geometry, low, high, finest_mm, 1.0 if straight else fineness.along * (2.0 if mirrored else 1.0))
    decades = math.log(width / near_mm)
    first, last = -decades - math.log(1.0 + margin), -math.log(margin)
    nodes_y = np.exp(np.linspace(first, last, 1 + math.ceil((last - first) / math.log(ratio))))
    fractions = (1.0 + margin) * nodes_y / (1.0 + nodes_y)
    if straight:
        y0, inner = np.zeros(1), (-math.inf, math.inf)
    else:
        apart = (fineness.apart if scene.medium.g < STEEP_G else 1.0) * (2.0 if mirrored else 1.0)
        y0, inner = _y_nodes(geometry, _lit(scene, geometry, z_mm), 0.5 * (low + high), apart)
    decay = decay_of(sigma_t, geometry)
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


def hardest(media: Sequence[Medium]) -> Medium:
    """As dense as the densest of liquids, and as steep as the steepest."""
    return Medium(0.0, max(one.sigma_t for one in media), max(one.g for one in media))


def peaked(medium: Medium) -> bool:
    """Whether a liquid scatters forward in so sharp a peak that tables need nodes nearer to their rays."""
    return medium.phase_function.record.width < SHARP


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
    finest_mm = min(apart * finest_mm, geometry.length)
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
    largest = min(apart / 28.0, 0.25) * geometry.length  # cubics go through four nodes, so no step is longer
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

"""Order 1 along lines of sight, without noise (the paper's Eq. 7, corrected).

    I₁ = T ∫ ds σs p(cos θ) exp(−σt (d₁ + d₂)) E₀(y₀, z₀) (a/(x + a))²/c

d₁ is the path from the wall x = 0, d₂ the path to the surface, a the distance of a pinhole projector from the wall and
c the x-component of its ray (the factor is 1 for collimated light), T = (1 − F)/n² at a Fresnel surface. The paper's
equation has no integral along the line of sight.

The integrand is smooth between the lines where a line of sight crosses an edge of a beam, or meets a side wall there,
so that it is cut along those lines and every piece is integrated by Gauss–Legendre: the error is that of smooth
functions, whatever the edges. Where faces of the tank cut the light off, it is cut wherever a line of sight ends at
another face, or begins or ends on another side of a beam's edge, than the next one does: such rows are searched for.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.bent_light import add_along_sight_in_bent_light, entry_seen
from tankrig.light.columns import lit_between
from tankrig.light.liquids import Liquids, add_scattered
from tankrig.light.quadrature import PANEL, Rule, SightRules
from tankrig.light.rays import Edges, Geometry, Ray, bent, light_kept, light_ray, path_inside, sight_line

Array = NDArray[np.float64]

FAINT = 60.0
"""Free paths after which light is fainter than any rounding."""
SHORT = 1 / 800
"""Share of the tank's height: twice so far, between two cuts, light changes so evenly that two lines of sight do, and
one in the middle of a pixel in which it has no end."""
EVEN = 1 / 40
"""Share of the distance from the tank of projector or camera, whichever is nearer: over so much, light that has no end
there changes as evenly."""
ROOT_THIRD = math.sqrt(1.0 / 3.0)
"""Where they lie, in halves of the width (Gauss)."""
CUT_SHARE, HALVINGS = 1e-6, 14
"""Of a span in which rows are searched for: how far beside its ends lines are looked at; and how often it is halved."""
MOST_ROWS = 32
"""Of a span, that it is cut at."""
FAR_AWAY = 4.0
"""Of the tank's height or half of its width, beyond which light rays are not looked for any more."""
TURNING, SHORTEST_MM = 0.1, 1.0
"""Share of the projector's distance along which its light turns by so little that two nodes on a line of sight do, and
a length that they may always have."""
STEEP = 0.3
"""Tangent, between the vertical and lines of sight in the water, from which on the far and the near wall cut light off
at other rows on either side of a pixel."""


class SharpBeam(NamedTuple):
    """A beam that begins and ends at once, and what it scatters where it enters."""

    edges: Edges
    strength: float
    """σs E₀, W/mm³."""


@kernel
def add_across_sights(
    found: Array, factor: float, geometry: Geometry, span: tuple[float, float, float], ends: Array,
    liquids: Liquids, edges: Edges, rules: SightRules,
) -> None:  # fmt: skip
    """Add to (liquids,) a factor times ∫ dy I₁(x, y)/(σs E₀) over a span: x, y low, y high.

    It is cut at rows where light ends, in order.
    """
    (nodes, weights), depth_rule = rules
    x, low, high = span
    start = low
    for k in range(ends.size + 1):
        end = min(max(ends[k], low), high) if k < ends.size else high
        half = 0.5 * (end - start)
        even = start == low and end == high and end - start <= _even_over(geometry)
        if even and half <= SHORT * geometry.height:
            y = start + half
            _add_along_sight(found, factor * (end - start), geometry, x, y, liquids, edges, depth_rule)
        elif half > 0.0 and (even or half <= SHORT * geometry.height):
            for side in (-ROOT_THIRD, ROOT_THIRD):
                y = start + half * (1.0 + side)
                _add_along_sight(found, factor * half, geometry, x, y, liquids, edges, depth_rule)
        elif half > 0.0:
            for j in range(nodes.size):
                y = start + half * (1.0 + nodes[j])
                _add_along_sight(found, factor * half * weights[j], geometry, x, y, liquids, edges, depth_rule)
        start = max(start, end)


@part
def _even_over(geometry: Geometry) -> float:
    """Length in mm, across lines of sight, over which light changes evenly where none begins or ends: two lines do."""
    above = geometry.camera_z - geometry.height if geometry.camera_pinhole else FAR_AWAY * geometry.length
    return EVEN * min(above, -geometry.light_x if geometry.light_pinhole else above)


@kernel
def rows_cut_off(geometry: Geometry, span: tuple[float, float, float], ends: Array, edges: Edges, rows: Array) -> int:
    """Write to (`MOST_ROWS`,) those rows of a span where light ends and where faces cut it off, in order: how many.

    Parameters
    ----------
    geometry
        Numbers of the scene.
    span
        x, y low, y high.
    ends
        Rows where light ends, in order.
    edges
        Of the beam.
    rows
        Written to.
    """
    x, low, high = span
    start, count = low, 0
    for k in range(ends.size + 1):
        end = min(max(ends[k], low), high) if k < ends.size else high
        while start < end and count < MOST_ROWS:
            start = _next_cut(geometry, (x, start, end), edges)
            rows[count] = start
            count += 1
        start = max(start, end)
    return count


@kernel
def _next_cut(geometry: Geometry, span: tuple[float, float, float], edges: Edges) -> float:
    """The first y of a span, beyond its start, on whose two sides lines of sight run unlike; its end if there is none.

    One that two such rows lie close behind each other in may be missed.
    """
    x, start, end = span
    aside = CUT_SHARE * (end - start)
    low, high = start + aside, end - aside
    first = course(geometry, x, low, edges)
    if course(geometry, x, high, edges) == first:
        middle = 0.5 * (low + high)
        if course(geometry, x, middle, edges) == first:
            return end
        high = middle
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if course(geometry, x, middle, edges) == first:
            low = middle
        else:
            high = middle
    return high


@kernel
def course(geometry: Geometry, x: float, y: float, edges: Edges) -> int:
    """Which face of the tank a line of sight ends at, and on which sides of a beam's edges it begins and ends.

    What is seen along lines of one course changes smoothly with x and y, but for the beam's corners.
    """
    vx, vy, vz, _ = sight_line(geometry, x, y)
    low, high = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    if high <= low:
        return -1
    sight = Ray(x, y, geometry.height, vx, vy, vz)
    at_x, height = x - vx * high, geometry.height - vz * high
    face = 0 if height < 1e-9 * geometry.height else 1 if at_x < 1e-9 or at_x > geometry.length - 1e-9 else 2
    for depth in (low, high):
        entry = entry_seen(geometry, sight, depth) if geometry.light_pinhole else (y - vy * depth, sight.z - vz * depth)
        for k in range(2):
            face = 3 * face + (0 if entry[k] < edges[2 * k] else 1 if entry[k] <= edges[2 * k + 1] else 2)
    return face


@kernel
def ever_cut_off(geometry: Geometry, edges: Edges) -> bool:
    """Whether `cut_off` may be true anywhere."""
    if not (geometry.camera_pinhole or geometry.light_pinhole):
        return False
    for x in (0.0, geometry.length):
        vx, _, vz, _ = sight_line(geometry, x, 0.0)
        if abs(vx) > STEEP * vz:
            return True
    return _reaches_faces(geometry, geometry.length, edges)


@kernel
def cut_off(geometry: Geometry, x_left: float, width: float, edges: Edges) -> bool:
    """Whether faces of the tank cut off what is lit on some lines of sight between two x of slanted light or sight."""
    vx, _, vz, _ = sight_line(geometry, x_left + width, 0.0)
    if abs(vx) > STEEP * vz:
        near, far = lit_between(geometry, x_left, width, edges, edges[2])
        also_near, also_far = lit_between(geometry, x_left, width, edges, edges[3])
        if min(near, also_near) < 1e-9 or max(far, also_far) > geometry.length - 1e-9:
            return True
    far = x_left + width - min(vx, 0.0) / vz * geometry.height  # as far as lines of sight get
    return _reaches_faces(geometry, min(far, geometry.length), edges)


@kernel
def _reaches_faces(geometry: Geometry, far: float, edges: Edges) -> bool:
    """Whether light reaches floor, surface or a side wall before some x: it spreads, so that its corners do first."""
    for k in range(4):
        ux, uy, uz = light_ray(geometry, edges[k // 2], edges[2 + k % 2])
        y, z = edges[k // 2] + uy / ux * far, edges[2 + k % 2] + uz / ux * far
        if abs(y) > geometry.half_width + 1e-9 or z < -1e-9 or z > geometry.height + 1e-9:
            return True
    return False


@kernel
def strays(geometry: Geometry, edges: Edges) -> bool:
    """Whether a beam's corners, extended beyond the tank, get so far that rows they are seen at do not bound its light.

    Extended beyond the camera, for one, they are seen on the other side.
    """
    above = 0.5 * (geometry.camera_z - geometry.height) if geometry.camera_pinhole else FAR_AWAY * geometry.height
    for k in range(4):
        ux, uy, uz = light_ray(geometry, edges[k // 2], edges[2 + k % 2])
        y, z = edges[k // 2] + uy / ux * geometry.length, edges[2 + k % 2] + uz / ux * geometry.length
        if z > geometry.height + above or z < -FAR_AWAY * geometry.height or abs(y) > FAR_AWAY * geometry.half_width:
            return True
    return False


@kernel
def _add_along_sight(
    found: Array, factor: float, geometry: Geometry, x: float, y: float, liquids: Liquids, edges: Edges, rule: Rule
) -> None:
    """Add ∫ p exp(−σt (d₁ + d₂)) E/E₀ ds along the line of sight through (x, y, Lz), times the surface's transmission.

    Times a factor, too.
    """
    if bent(geometry):
        add_along_sight_in_bent_light(found, factor, geometry, x, y, liquids, edges, rule)
        return
    vx, vy, vz, transmission = sight_line(geometry, x, y)
    low, high = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    low, high = _clip_to_beam(geometry, Ray(x, y, geometry.height, vx, vy, vz), edges, low, high)
    along = vx  # cosine between light and sight; from a pinhole it falls with the depth
    if geometry.light_pinhole:
        ax, ay, az = x - vx * low - geometry.light_x, y - vy * low - geometry.light_y, geometry.height - vz * low
        az -= geometry.light_z
        along = (ax * vx + ay * vy + az * vz) / math.sqrt(ax * ax + ay * ay + az * az)
    # The way to a point and up to the surface grows by 1 − cos per mm of depth.
    high = min(high, low + FAINT / (liquids.thinnest * max(1.0 - along, 1e-3)))
    if high <= low:
        return
    nodes, weights = rule
    apex = geometry.light_x
    panels = 1 + int(liquids.densest * (high - low) / PANEL)
    if geometry.light_pinhole:
        panels = max(panels, 1 + int((high - low) / max(TURNING * -geometry.light_x, SHORTEST_MM)))
    half = 0.5 * (high - low) / panels
    for panel in range(panels):
        for k in range(nodes.size):
            depth = low + half * (2 * panel + 1.0 + nodes[k])
            px, py, pz = x - vx * depth, y - vy * depth, geometry.height - vz * depth
            if geometry.light_pinhole:
                dx, dy, dz = px - apex, py - geometry.light_y, pz - geometry.light_z
                distance = math.sqrt(dx * dx + dy * dy + dz * dz)
                cosine = (dx * vx + dy * vy + dz * vz) / distance
                spread = (apex / dx) ** 2 * distance / dx * light_kept(geometry, dz / distance)
                path = distance * px / dx
            else:
                cosine, spread, path = vx, 1.0, px
            light = factor * transmission * weights[k] * half * spread
            add_scattered(found, light, cosine, path + depth, liquids)


@kernel
def _clip_to_beam(geometry: Geometry, sight: Ray, edges: Edges, low: float, high: float) -> tuple[float, float]:
    """The part of [low, high] of a line of sight that lies between a beam's four faces.

    Its point at the depth t is C(t) = (x, y, Lz) − t v. From a pinhole at A, a face through an edge e of the plane
    x = 0 has (C_y − A_y)(−A_x) = (e − A_y)(C_x − A_x), and so for z; both sides are linear in t.
    """
    for k in range(4):
        side = 1.0 if k % 2 == 0 else -1.0
        if k < 2:
            origin, slope, centre = sight.y, -sight.dy, geometry.light_y
        else:
            origin, slope, centre = sight.z, -sight.dz, geometry.light_z
        if geometry.light_pinhole:  # (coordinate − apex)·(−apex_x) ≥ (edge − apex)·(x − apex_x)
            reach = -geometry.light_x
            value = side * ((origin - centre) * reach - (edges[k] - centre) * (sight.x + reach))
            change = side * (slope * reach + (edges[k] - centre) * sight.dx)
        else:
            value, change = side * (origin - edges[k]), side * slope
        if abs(change) < 1e-14:
            if value < 0.0:
                return 0.0, -1.0
        elif change > 0.0:
            low = max(low, -value / change)
        else:
            high = min(high, -value / change)
    return low, high

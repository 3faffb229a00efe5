"""Order 1 along one line of sight where the light is bent at the wall: the faces of a beam are then no planes.

Heights at which the light came in grow along the line of sight, so the line is cut at the lower and upper edge of the
beam by a search. Its other two edges are straight enough over short stretches, and where the projector is near they are
searched for within them.
"""

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.liquids import Liquids, add_scattered
from tankrig.light.quadrature import PANEL, Rule
from tankrig.light.rays import Edges, Geometry, Ray, bent, bent_light, light_kept, path_inside, sight_line

Array = NDArray[np.float64]

STRETCH_MM, STRETCH_SHARE, SHORTEST_MM = 20.0, 0.2, 1.0
"""Longest stretch of a line of sight, the share of the projector's distance from the wall that it may be, and a length
that it may always have: from 400 mm a beam's side faces bulge by less than 0.05 mm over 20, from 25 mm by so much that
images were 2 % off."""
FAR_MM = 300.0
"""From the wall, from which on a search for a beam's side faces would change images by less than 2e-4."""
EDGE_MM, SECANTS = 1e-5, 6
"""How near to a beam's lower or upper edge a search ends, and its steps before one that is slower and never fails."""
CLOSE_MM = 0.02
"""So near to a side face, the next step of a search is there to a thousandth of a mm."""


@kernel
def add_along_sight_in_bent_light(
    found: Array, factor: float, geometry: Geometry, x: float, y: float, liquids: Liquids, edges: Edges, rule: Rule
) -> None:
    """Add ∫ p exp(−σt (d₁ + d₂)) E/E₀ ds along the line of sight through (x, y, Lz), times the surface's transmission.

    Parameters
    ----------
    found, factor
        (liquids,) that it is added to, times a factor.
    geometry
        Numbers of the scene.
    x, y
        Where the line of sight leaves the surface, mm.
    liquids
        Whose order 1 is asked for.
    edges
        Of the beam.
    rule
        Gauss–Legendre.
    """
    vx, vy, vz, transmission = sight_line(geometry, x, y)
    low, high = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    if high <= low:
        return
    sight = Ray(x, y, geometry.height, vx, vy, vz)
    start, before = _entered_at(geometry, sight, edges[3], low, high)
    end, at_end = _entered_at(geometry, sight, edges[2], start, high)
    if end <= start:
        return
    nodes, weights = rule
    stretches = 1 + int((end - start) / min(STRETCH_MM, max(STRETCH_SHARE * -geometry.light_x, SHORTEST_MM)))
    step = (end - start) / stretches
    after = before
    for stretch in range(stretches):
        before = after
        after = at_end if stretch == stretches - 1 else entry_seen(geometry, sight, start + (stretch + 1) * step)[0]
        first, last = _lit_share(before, after, edges[0], edges[1])
        if last <= first:
            continue
        rising, from_mm, near = after > before, start + stretch * step, -geometry.light_x < FAR_MM
        if near and first > 0.0:
            first = _share_at(geometry, sight, edges[0 if rising else 1], from_mm, step, before, after)
        if near and last < 1.0:
            last = _share_at(geometry, sight, edges[1 if rising else 0], from_mm, step, before, after)
        panels = 1 + int(liquids.densest * step * (last - first) / PANEL)
        half = 0.5 * step * (last - first) / panels
        for panel in range(panels):
            for k in range(nodes.size):
                depth = start + (stretch + first) * step + half * (2 * panel + 1.0 + nodes[k])
                px, py, pz = x - vx * depth, y - vy * depth, geometry.height - vz * depth
                ux, uy, uz, spread, _ = bent_light(geometry, px, py, pz)
                light = factor * transmission * weights[k] * half * spread * light_kept(geometry, uz)
                add_scattered(found, light, ux * vx + uy * vy + uz * vz, px / ux + depth, liquids)


@kernel
def entry_seen(geometry: Geometry, sight: Ray, depth: float) -> tuple[float, float]:
    """The y and z at which a pinhole's light at some depth of a line of sight came through x = 0."""
    px, py, pz = max(sight.x - sight.dx * depth, 0.0), sight.y - sight.dy * depth, sight.z - sight.dz * depth
    share = bent_light(geometry, px, py, pz)[4] if bent(geometry) else geometry.light_x / (geometry.light_x - px)
    return geometry.light_y + share * (py - geometry.light_y), geometry.light_z + share * (pz - geometry.light_z)


@kernel
def _entered_at(geometry: Geometry, sight: Ray, level: float, low: float, high: float) -> tuple[float, float]:
    """Depth t of a line of sight at which the light came in at a level, z₀(t) = level, and the y there.

    Begun at the paraxial ray, from which secants find it in two or three steps. Of low and high the nearer is taken
    where it lies beyond them.
    """
    height = -geometry.light_x - geometry.pane
    per_mm = 1.0 / (geometry.entry_index * height)
    at_wall = 1.0 + geometry.pane / (geometry.pane_index * height)
    # Paraxial light came in at at_wall / (at_wall + per_mm x) of its distance from the normal.
    here, above, aside = at_wall + per_mm * sight.x, sight.z - geometry.light_z, level - geometry.light_z
    depth = (above * at_wall - aside * here) / (sight.dz * at_wall - aside * per_mm * sight.dx)
    depth = min(max(depth, low), high)
    y, z = entry_seen(geometry, sight, depth)
    here -= per_mm * sight.dx * depth
    slope = at_wall * (per_mm * sight.dx * (above - sight.dz * depth) / here - sight.dz) / here
    for _ in range(SECANTS):
        miss = z - level
        if abs(miss) < EDGE_MM:
            break
        step = -miss / slope
        y, z = entry_seen(geometry, sight, depth + step)
        depth += step
        slope = (z - level - miss) / step
        if slope >= 0.0:
            break
    if abs(z - level) < EDGE_MM and low <= depth <= high:
        return depth, y
    return _entered_between(geometry, sight, level, low, high)


@kernel
def _entered_between(geometry: Geometry, sight: Ray, level: float, low: float, high: float) -> tuple[float, float]:
    """The same by false position, the Illinois way, which needs no good start."""
    y, z = entry_seen(geometry, sight, low)
    above = z - level
    if above <= 0.0:
        return low, y
    y, z = entry_seen(geometry, sight, high)
    below = z - level
    if below >= 0.0:
        return high, y
    side, depth = 0, 0.5 * (low + high)
    for _ in range(30):
        depth = (low * below - high * above) / (below - above)
        y, z = entry_seen(geometry, sight, depth)
        miss = z - level
        if abs(miss) < EDGE_MM:
            break
        if miss > 0.0:
            low, above = depth, miss
            below *= 0.5 if side == 1 else 1.0
            side = 1
        else:
            high, below = depth, miss
            above *= 0.5 if side == -1 else 1.0
            side = -1
    return depth, y


@kernel
def _lit_share(before: float, after: float, low: float, high: float) -> tuple[float, float]:
    """The part of a stretch, in shares of it, over which a coordinate that goes evenly is between two edges."""
    change = after - before
    if abs(change) < 1e-12:
        return 0.0, 1.0 if low <= before <= high else 0.0
    one, other = (low - before) / change, (high - before) / change
    return max(min(one, other), 0.0), min(max(one, other), 1.0)


@kernel
def _share_at(
    geometry: Geometry, sight: Ray, level: float, from_mm: float, step: float, before: float, after: float
) -> float:
    """The share of a stretch after which the light came in at a y that lies between those at its ends."""
    low, high, below, above = 0.0, 1.0, before - level, after - level
    share = below / (below - above)
    for _ in range(30):
        miss = entry_seen(geometry, sight, from_mm + share * step)[0] - level
        if miss == 0.0:
            break
        if (miss > 0.0) == (above > 0.0):
            high, above = share, miss
        else:
            low, below = share, miss
        share = low + (high - low) * below / (below - above)
        if abs(miss) < CLOSE_MM:
            break
    return share

"""How a column of a camera's pixels is cut along x, so that order 1 is smooth in each part of it.

Where an end wall, x = 0 or x = Lx, comes to an edge of a beam as the camera sees it, what is lit on a line of sight
begins to be cut off at once. Columns are cut at the very x at which that happens to a beam's corners.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.quadrature import Rule
from tankrig.light.rays import Edges, Geometry, light_ray, sight_line, sighting_row
from tankrig.light.sorting import put_in_order

Array = NDArray[np.float64]

MOST_PARTS = 64
"""Parts that a pixel is cut into along x at most; in larger ones, counted in free paths, order 1 is a guess."""
MOST_BREAKS, BREAK_STEPS = 10, 3
"""Places at most that a column is cut at, both sides counted: one for each of four corners and two walls; and steps
that find one, as what is lit moves nearly in proportion to x."""
MOST_NODES = 2 * (MOST_PARTS + MOST_BREAKS)
"""Along x in a pixel, two in each part."""
BESIDE = 0.1
"""Share of a column's width, beside which a wall still counts as cutting off some lines of sight through it."""


@kernel
def kinked(geometry: Geometry, x_left: float, width: float, edges: Edges) -> bool:
    """Whether a wall, the surface or the floor begins to cut off what is lit on lines of sight between two x.

    There a wall comes to an edge of the beam: where it cuts all lines off within the beam, light changes smoothly.
    """
    for k in range(2):
        near, far = lit_between(geometry, x_left, width, edges, edges[2 + k])
        margin = BESIDE * (far - near)  # rows between these two differ a little
        for wall in (0.0, geometry.length):  # looking straight down, a wall is a pixel's edge or outside
            if geometry.camera_pinhole and near - margin < wall < far + margin:
                return True
        # Where the light meets the surface or the floor.
        ux, _, uz = light_ray(geometry, 0.5 * (edges[0] + edges[1]), edges[2 + k])
        left, right = edges[2 + k] + uz / ux * x_left, edges[2 + k] + uz / ux * (x_left + width)
        if (left - geometry.height) * (right - geometry.height) < 0.0 or left * right < 0.0:
            return True
    return False


@kernel
def fill_breaks(breaks: Array, geometry: Geometry, left: float, right: float, edges: Edges) -> int:
    """Write two x and those between them where an end wall comes to a corner of a beam as it is seen: how many.

    Parameters
    ----------
    breaks
        (`MOST_BREAKS`,) written to, in order.
    geometry
        Numbers of the scene.
    left, right
        The two x, on the surface.
    edges
        Of the beam.
    """
    breaks[0], breaks[1], count = left, right, 2
    for corner in range(4 if geometry.camera_pinhole else 0):  # looking straight down, a wall is a pixel's edge
        y0, z0 = edges[corner // 2], edges[2 + corner % 2]
        first, last = _lit_at(geometry, left, y0, z0), _lit_at(geometry, right, y0, z0)
        for wall in (0.0, geometry.length):
            if (first - wall) * (last - wall) < 0.0:
                low, high, before, after, x = left, right, first - wall, last - wall, left
                for _ in range(BREAK_STEPS):
                    x = low - before * (high - low) / (after - before)
                    here = _lit_at(geometry, x, y0, z0) - wall
                    if here * after > 0.0:
                        high, after = x, here
                    else:
                        low, before = x, here
                breaks[count] = x
                count += 1
    put_in_order(breaks[:count])
    return count


@kernel
def fill_nodes(at: Array, weights: Array, breaks: Array, parts: int, rule: Rule) -> int:
    """Write where to integrate between ascending breaks, and weights, mm: how many nodes.

    Parameters
    ----------
    at, weights
        (`MOST_NODES`,) written to.
    breaks
        Of `fill_breaks`.
    parts
        That all between the first and the last would be cut into evenly; there is one at least between two.
    rule
        In each part.
    """
    nodes, shares = rule
    whole, count = breaks[-1] - breaks[0], 0
    for piece in range(breaks.size - 1):
        wide = breaks[piece + 1] - breaks[piece]
        many = max(1, math.ceil(parts * wide / whole - 1e-9))
        for step in range(many):
            for i in range(nodes.size):
                at[count] = breaks[piece] + wide * (step + 0.5 + 0.5 * nodes[i]) / many
                weights[count] = 0.5 * shares[i] * wide / many
                count += 1
    return count


@kernel
def lit_between(geometry: Geometry, x_left: float, width: float, edges: Edges, z0: float) -> tuple[float, float]:
    """Between which x light of a beam that entered at a height is seen along lines of sight between two x."""
    near, far = 1e30, -1e30
    for corner in range(4):
        lit = _lit_at(geometry, x_left + width * (corner // 2), edges[corner % 2], z0)
        near, far = min(near, lit), max(far, lit)
    return near, far


@kernel
def _lit_at(geometry: Geometry, x: float, y0: float, z0: float) -> float:
    """The x of the point in the water at which a line of sight through some x of the surface meets a light ray."""
    ux, _, uz = light_ray(geometry, y0, z0)
    vx, _, vz, _ = sight_line(geometry, x, sighting_row(geometry, x, y0, z0))
    aslant, rising = vx / vz, uz / ux
    lit = (x - aslant * (geometry.height - z0)) / (1.0 - aslant * rising)
    return x - aslant * (geometry.height - min(max(z0 + rising * lit, 0.0), geometry.height))

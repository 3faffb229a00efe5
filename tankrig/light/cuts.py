"""Where the light of a beam ends along y, as lines of sight through one x see it.

Between these rows what is seen changes smoothly, so that a quadrature over y is cut at them. There are two kinds: rows
from which a corner of the beam is seen, and rows from which the beam's upper or lower edge is seen just where it leaves
the tank through a side wall. Left whole across one of the latter, the row of pixels beside a wall that a pinhole's
light runs into was 15 % too bright.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.paths.record import seen_from
from tankrig.light.rays import Edges, Geometry, bent, bent_light, light_ray, sighting_row
from tankrig.light.sorting import put_in_order

CUTS = 8
"""Rows at which light may end: of four corners, and of two edges at two walls."""
NEAREST, MOST_STEPS = 1e-9, 12
"""Where the search for a point of a wall ends, mm, and its steps at most: two or three in any bench's scene."""


@kernel
def rows_of_ends(geometry: Geometry, x: float, edges: Edges, rows: NDArray[np.float64]) -> None:
    """Write to (`CUTS`,) rows where the light of a beam ends, in order, mm: all that is lit lies between the outer two.

    Parameters
    ----------
    geometry
        Numbers of the scene.
    x
        Of the lines of sight on the surface, mm.
    edges
        Of the beam.
    rows
        Written to.
    """
    first, last = 1e30, -1e30
    for k in range(4):
        rows[k] = sighting_row(geometry, x, edges[k // 2], edges[2 + k % 2])
        first, last = min(first, rows[k]), max(last, rows[k])
    for k in range(4):
        row, side = first, 1.0 if k < 2 else -1.0
        # Looking straight down, a wall is a pixel's edge.
        if geometry.camera_pinhole and _meets_side_wall(geometry, edges, side):
            row = _row_of_wall(geometry, x, side * geometry.half_width, edges[2 + k % 2])
        rows[4 + k] = min(max(row, first), last)
    put_in_order(rows)


@kernel
def _meets_side_wall(geometry: Geometry, edges: Edges, side: float) -> bool:
    """Whether light of a beam gets to the wall on one side of the tank, ±1."""
    for k in range(4):
        ux, uy, _ = light_ray(geometry, edges[k // 2], edges[2 + k % 2])
        if side * (edges[k // 2] + uy / ux * geometry.length) > geometry.half_width:
            return True
    return False


@kernel
def _row_of_wall(geometry: Geometry, x: float, wall: float, level: float) -> float:
    """The y at the surface of the line of sight through x that meets the plane y = wall where light came in at a level.

    The point is looked for along x: lines of sight lie in vertical planes through the camera, so that their x and their
    y, as seen from it, shrink alike from the point to the surface.
    """
    at, height, row = x, level, wall
    for _ in range(MOST_STEPS):
        if geometry.light_pinhole:
            if bent(geometry):
                share = bent_light(geometry, max(at, 0.0), wall, height)[4]
            else:
                share = geometry.light_x / (geometry.light_x - at)
            height = geometry.light_z + (level - geometry.light_z) / share
        height = min(max(height, 0.0), geometry.height)
        seen_x, seen_y, _, _, _, _, _ = seen_from(geometry, at, wall, height, geometry.refractive_index)
        row, before = seen_y, at
        aside = math.hypot(at - geometry.camera_x, wall - geometry.camera_y)
        nearer = math.hypot(seen_x - geometry.camera_x, seen_y - geometry.camera_y) / aside if aside > 1e-9 else 1.0
        at = max(geometry.camera_x + (x - geometry.camera_x) / nearer, 0.0)
        if abs(at - before) < NEAREST:
            break
    return row

"""Order 1 in a calibrated camera's pixels, which are quadrangles of the plane z = Lz.

Each is cut along x at its corners; at every node in x the integral along y runs between its edges, exactly as that over
a square pixel does. Where a beam's light ends, as lines of sight through some x see it, is the same for all media and
all pixels: it is found once for each beam, at even steps of x, and taken from between them.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.columns import MOST_BREAKS, MOST_NODES, MOST_PARTS, fill_breaks, fill_nodes, kinked
from tankrig.light.cuts import CUTS, rows_of_ends
from tankrig.light.line_of_sight import (
    MOST_ROWS,
    SharpBeam,
    add_across_sights,
    course,
    cut_off,
    ever_cut_off,
    rows_cut_off,
    strays,
)
from tankrig.light.liquids import Liquids, liquids_of
from tankrig.light.quadrature import PixelRules, pixel_rules
from tankrig.light.rays import Edges, Geometry, light_sources
from tankrig.scene import Medium, Scene
from tankrig.scene.footprint import footprints
from tankrig.threads import THREADS

Array = NDArray[np.float64]

KINKED_PARTS = 12
"""Parts a pixel is cut into along x where the near or far wall cuts the lit part of its lines of sight."""
KINKED_SHARE = 1 / 1200
"""Of the tank's height, and wide enough for such a part: the lit part of a line is cut off within ten such widths."""
BROKEN_PARTS = 6
"""The same where it is known at which x the wall comes to a corner of the beam."""
SLANTED_PARTS = 5
"""The same where an edge of the beam runs from one row of pixels into the next."""
STEPS = 512
"""Along the tank, at whose ends rows are found: between them they are within 0.01 mm of a line."""
SLIVER = 0.05
"""Share of a pixel's width below which one line in the middle of a slice does: most are cut off by a slight turn."""
MARGIN_MM = 0.5
"""More than a beam's edges bulge between its corners."""


def single_scattering_in_quadrangles(scene: Scene, media: Sequence[Medium]) -> Array:
    """`single_scattering_of` for a calibrated camera, W/mm²/sr; 0 where a pixel looks elsewhere."""
    seen = footprints(scene.camera, scene.tank)
    images = np.zeros((*scene.camera.shape, len(media)))
    liquids, rules = liquids_of(media), pixel_rules()
    lit = [
        _of_source(geometry, SharpBeam((*beam.y_mm, *beam.z_mm), beam.irradiance))
        for geometry, beams in light_sources(scene)
        for beam in beams
        if beam.irradiance > 0.0
    ]

    def add_rows(part: int) -> None:
        for one in lit:
            _add_beam(images, seen.corners_mm, one, liquids, rules, part, THREADS)

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(add_rows, range(THREADS)))
    images *= np.array([one.sigma_s for one in media])
    whole = np.moveaxis(images, 2, 0)
    return np.where(seen.areas_mm2 > 0.0, whole / seen.areas_mm2, 0.0)


class _LitBeam(NamedTuple):
    """A beam, the numbers of the scene for its source, where its light ends (`_ends_along`), and how faces cut it off.

    See `ever_cut_off` and `strays`.
    """

    geometry: Geometry
    beam: SharpBeam
    along: Array
    cut_off: bool
    anywhere: bool


def _of_source(geometry: Geometry, beam: SharpBeam) -> _LitBeam:
    cut = bool(ever_cut_off(geometry, beam.edges))
    return _LitBeam(geometry, beam, _ends_along(geometry, beam.edges), cut, cut and bool(strays(geometry, beam.edges)))


@lru_cache(maxsize=128)
def _ends_along(geometry: Geometry, edges: Edges) -> Array:
    """(`STEPS` + 1, `CUTS`) rows where a beam's light ends, in order, mm, at even steps of x along the tank."""
    ends = np.empty((STEPS + 1, CUTS))
    _fill_ends(geometry, edges, ends)
    ends.setflags(write=False)
    return ends


@kernel
def _fill_ends(geometry: Geometry, edges: Edges, ends: Array) -> None:
    for step in range(ends.shape[0]):
        rows_of_ends(geometry, step * geometry.length / (ends.shape[0] - 1), edges, ends[step])


@kernel
def _ends_at(along: Array, x: float, length: float, ends: Array) -> None:
    """Write to (`CUTS`,) rows where light ends at some x of the tank."""
    steps = along.shape[0] - 1
    place = min(max(x / length * steps, 0.0), float(steps))
    step = min(int(place), steps - 1)
    share = place - step
    for k in range(ends.size):
        ends[k] = along[step, k] + share * (along[step + 1, k] - along[step, k])


@kernel
def _add_beam(
    images: Array, grid: Array, lit: _LitBeam, liquids: Liquids, rules: PixelRules, part: int, parts: int
) -> None:
    """Add ∫ I₁(x, y) dx dy of one beam, over each pixel's area, to one of so many parts of the rows."""
    geometry, along = lit.geometry, lit.along
    xs, ys, ends = np.empty(4), np.empty(4), np.empty((2, CUTS))
    for row in range(part, images.shape[0], parts):
        for column in range(images.shape[1]):
            for k in range(4):  # in turn around the pixel
                i, j = row + k // 2, column + (k == 1 or k == 2)
                xs[k], ys[k] = grid[i, j, 0], grid[i, j, 1]
            if not (xs.max() > 0.0 and xs.min() < geometry.length):
                continue  # beside the tank, or NaN
            if not (ys.max() > -geometry.half_width and ys.min() < geometry.half_width):
                continue
            slices = np.sort(np.minimum(np.maximum(xs, 0.0), geometry.length))
            _ends_at(along, slices[0], geometry.length, ends[0])
            _ends_at(along, slices[3], geometry.length, ends[1])
            outside = ys.max() < min(ends[0, 0], ends[1, 0]) - MARGIN_MM or ys.min() > ends[:, -1].max() + MARGIN_MM
            if outside and not lit.anywhere:
                continue
            for k in range(3):
                if slices[k + 1] > slices[k]:
                    _add_slice(images[row, column], lit, liquids, rules, xs, ys, (slices[k], slices[k + 1]), ends)


@kernel
def _add_slice(
    found: Array, lit: _LitBeam, liquids: Liquids, rules: PixelRules, xs: Array, ys: Array,
    between: tuple[float, float], ends: Array,
) -> None:  # fmt: skip
    """Add ∫ dx ∫ dy I₁/σs over the part of a pixel between two x, with no corner of it between them."""
    geometry, along, edges = lit.geometry, lit.along, lit.beam.edges
    sights, strength = rules.sights, lit.beam.strength
    left, right = between
    width = right - left
    low_left, high_left = _span(geometry, xs, ys, left + 1e-9 * width)
    low_right, high_right = _span(geometry, xs, ys, right - 1e-9 * width)
    _ends_at(along, left, geometry.length, ends[0])
    _ends_at(along, right, geometry.length, ends[1])
    outside = ends[:, -1].max() < min(low_left, low_right) or ends[:, 0].min() > max(high_left, high_right)
    if outside and not lit.anywhere:
        return
    parts = min(1 + int(liquids.densest * width), MOST_PARTS)
    whole = xs.max() - xs.min()  # a narrow slice needs fewer parts
    for k in range(CUTS):
        if (ends[0, k] < low_left) != (ends[1, k] < low_right) or (ends[0, k] < high_left) != (ends[1, k] < high_right):
            parts = max(parts, math.ceil(SLANTED_PARTS * width / whole))
    beside_faces = lit.cut_off and cut_off(geometry, left, width, edges)
    if beside_faces:
        for y_left, y_right in ((low_left, low_right), (high_left, high_right)):
            if course(geometry, left, y_left, edges) != course(geometry, right, y_right, edges):
                parts = max(parts, math.ceil(SLANTED_PARTS * width / whole))
    breaks, at_x, over_x = np.empty(MOST_BREAKS), np.empty(MOST_NODES), np.empty(MOST_NODES)
    breaks[0], breaks[1], count = left, right, 2
    if kinked(geometry, left, width, edges):
        count = fill_breaks(breaks, geometry, left, right, edges)
        enough = math.ceil(width / (KINKED_SHARE * geometry.height))
        many = KINKED_PARTS if count == 2 else BROKEN_PARTS
        parts = max(parts, min(math.ceil(many * width / whole), enough))
    nodes = fill_nodes(at_x, over_x, breaks[:count], parts, rules.x)
    if width < SLIVER * whole:
        at_x[0], over_x[0], nodes = 0.5 * (left + right), width, 1
    cuts, rows_found = ends[0], np.empty(MOST_ROWS if beside_faces else 0)
    for node in range(nodes):
        low, high = _span(geometry, xs, ys, at_x[node])
        if high <= low:
            continue
        _ends_at(along, at_x[node], geometry.length, cuts)
        if (cuts[-1] <= low or cuts[0] >= high) and not lit.anywhere:
            continue
        span, at = (at_x[node], low, high), cuts
        if beside_faces:
            at = rows_found[: rows_cut_off(geometry, span, cuts, edges, rows_found)]
        add_across_sights(found, strength * over_x[node], geometry, span, at, liquids, edges, sights)


@kernel
def _span(geometry: Geometry, xs: Array, ys: Array, x: float) -> tuple[float, float]:
    """The y between which a pixel, within the tank, has an x."""
    low, high = 1e30, -1e30
    for k in range(4):
        other = (k + 1) % 4
        if (xs[k] - x) * (xs[other] - x) <= 0.0 and xs[k] != xs[other]:
            y = ys[k] + (x - xs[k]) / (xs[other] - xs[k]) * (ys[other] - ys[k])
            low, high = min(low, y), max(high, y)
    return max(low, -geometry.half_width), min(high, geometry.half_width)

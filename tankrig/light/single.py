"""Order 1: light scattered exactly once, averaged over each pixel.

Pixels are cut into parts along x where light begins or ends; at every node in x the integral along y runs over the
pixel's width, along lines of sight (`line_of_sight`). A calibrated camera's pixels are quadrangles (`quadrangles`).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.columns import MOST_BREAKS, MOST_NODES, MOST_PARTS, fill_breaks, fill_nodes, kinked
from tankrig.light.cuts import CUTS, rows_of_ends
from tankrig.light.line_of_sight import (
    FAINT,
    MOST_ROWS,
    SHORT,
    SharpBeam,
    add_across_sights,
    course,
    cut_off,
    ever_cut_off,
    rows_cut_off,
    strays,
)
from tankrig.light.liquids import Liquids, liquids_of
from tankrig.light.quadrangles import BROKEN_PARTS, KINKED_PARTS, SLANTED_PARTS, single_scattering_in_quadrangles
from tankrig.light.quadrature import PixelRules, pixel_rules
from tankrig.light.rays import Edges, Geometry, light_sources
from tankrig.scene import Medium, Scene

THIN = 0.1
"""Free paths along a column of small pixels, in the middle of which one node does: 4e-4 of its light."""
ASIDE = 1e-6
"""Of a pixel, beside its edges, where lines of sight are looked at: beams like to end at edges, and tanks do."""


def single_scattering(scene: Scene) -> NDArray[np.float64]:
    """Image of the light scattered exactly once, W/mm²/sr.

    Parameters
    ----------
    scene
        Any scene.

    Returns
    -------
    (rows, columns) array

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> image = single_scattering(scene)
    >>> expected = 0.01 / (4 * np.pi) * 4 * np.exp(-0.01 * (1 + 60))  # first pixel of the beam, to leading order
    >>> bool(abs(image[40, 0] / expected - 1) < 1e-4)
    True
    """
    return np.asarray(single_scattering_of(scene, [scene.medium])[0])


def single_scattering_of(scene: Scene, media: Sequence[Medium]) -> NDArray[np.float64]:
    """The same of several liquids, (media, rows, columns), for little more than of one."""
    if all(one.sigma_s == 0.0 for one in media):
        return np.zeros((len(media), *scene.camera.shape))
    if scene.camera.kind == "calibrated":
        return single_scattering_in_quadrangles(scene, media)
    images = np.zeros((*scene.camera.shape, len(media)))
    liquids, rules = liquids_of(media), pixel_rules()
    for geometry, beams in light_sources(scene):
        for beam in beams:
            lit = SharpBeam((*beam.y_mm, *beam.z_mm), beam.irradiance)
            _add_beam(images, scene.camera.pixel_mm, geometry, liquids, lit, rules)
    return np.moveaxis(images * np.array([one.sigma_s for one in media]), 2, 0)


@kernel
def _add_beam(
    images: NDArray[np.float64],
    pixel_mm: float,
    geometry: Geometry,
    liquids: Liquids,
    beam: SharpBeam,
    rules: PixelRules,
) -> None:
    """Add one beam's order 1 for σs of 1/mm to (rows, columns, liquids) images.

    ⟨I₁⟩ = 1/(Δx Δy) ∫ dx ∫ dy I₁(x, y)   over each pixel, I₁ as in `line_of_sight`
    """
    (edges, strength), sights, x_nodes = beam, rules.sights, rules.x[0].size
    rows, columns, _ = images.shape
    grid, y_first = (rows, pixel_mm), -geometry.half_width
    ends, rows_found, parts_of = np.empty(CUTS), np.empty(MOST_ROWS), np.empty(rows, np.int64)
    breaks, at_x, over_x = np.empty(MOST_BREAKS), np.empty(MOST_NODES), np.empty(MOST_NODES)
    sometimes = ever_cut_off(geometry, edges)
    anywhere = sometimes and strays(geometry, edges)
    for column in range(columns):
        x_left = column * pixel_mm
        if x_left >= geometry.length:
            break
        # Of the pixel lies in the tank, and looking straight down, light fades with x as it does on its way.
        reach = min(pixel_mm, geometry.length - x_left)
        reach = reach if geometry.camera_pinhole else min(reach, FAINT / liquids.thinnest)
        between = breaks[: fill_breaks(breaks, geometry, x_left, x_left + reach, edges)]
        _fill_parts(parts_of, geometry, x_left, reach, edges, liquids.densest, pixel_mm, between.size - 1)
        beside_faces = sometimes and cut_off(geometry, x_left, reach, edges)
        if beside_faces:
            _fill_parts_beside_faces(parts_of, geometry, x_left, reach, edges, grid)
        for parts in np.unique(parts_of):
            nodes = fill_nodes(at_x, over_x, between, parts, rules.x)
            if nodes == x_nodes and reach <= 2.0 * SHORT * geometry.height and liquids.densest * reach < THIN:
                at_x[0], over_x[0], nodes = x_left + 0.5 * reach, reach, 1
            for node in range(nodes):
                x, share = at_x[node], strength * over_x[node] / (pixel_mm * pixel_mm)
                rows_of_ends(geometry, x, edges, ends)
                top = min(max((ends[0] - y_first) / pixel_mm, 0.0), float(rows))
                bottom = min(max((ends[-1] - y_first) / pixel_mm, -1.0), rows - 1.0)
                if anywhere:
                    top, bottom = 0.0, min(rows, math.ceil(2.0 * geometry.half_width / pixel_mm)) - 1.0
                for row in range(math.floor(top), math.floor(bottom) + 1):
                    if parts_of[row] != parts:
                        continue
                    low = y_first + row * pixel_mm
                    at, span = ends, (x, low, min(low + pixel_mm, geometry.half_width))
                    if beside_faces:
                        at = rows_found[: rows_cut_off(geometry, span, ends, edges, rows_found)]
                    add_across_sights(images[row, column], share, geometry, span, at, liquids, edges, sights)


@kernel
def _fill_parts(
    parts: NDArray[np.int64], geometry: Geometry, x_left: float, width: float, edges: Edges, sigma_t: float,
    pixel_mm: float, pieces: int,
) -> None:  # fmt: skip
    """Write to (rows,) how many parts of a column of pixels to integrate separately along x.

    More where there are kinks, where light ends in one row on the left and in another on the right, or in dense water.
    """
    parts[:] = min(1 + int(sigma_t * width), MOST_PARTS)
    if kinked(geometry, x_left, width, edges):
        parts[:] = np.maximum(parts, KINKED_PARTS if pieces == 1 else BROKEN_PARTS)
    left, right = np.empty(CUTS), np.empty(CUTS)
    rows_of_ends(geometry, x_left, edges, left)
    rows_of_ends(geometry, x_left + width, edges, right)
    for k in range(CUTS):
        one = math.floor((left[k] + geometry.half_width) / pixel_mm)
        other = math.floor((right[k] + geometry.half_width) / pixel_mm)
        if one != other:
            for row in range(max(min(one, other), 0), min(max(one, other), parts.size - 1) + 1):
                parts[row] = max(parts[row], SLANTED_PARTS)


@kernel
def _fill_parts_beside_faces(
    parts: NDArray[np.int64], geometry: Geometry, x_left: float, width: float, edges: Edges, grid: tuple[int, float]
) -> None:
    """The same where lines of sight between two rows of a grid (rows, pixel) run unlike at both sides of a column."""
    rows, pixel_mm = grid
    for row in range(rows + 1):
        y = row * pixel_mm - geometry.half_width + ASIDE * pixel_mm
        if y >= geometry.half_width:
            break
        if course(geometry, x_left + ASIDE * width, y, edges) != course(geometry, x_left + width, y, edges):
            for beside in range(max(row - 1, 0), min(row, rows - 1) + 1):
                parts[beside] = max(parts[beside], SLANTED_PARTS)

"""Order 1 in the pixels of a calibrated camera, which are quadrangles of the plane z = Lz.

Each pixel is cut along x at its corners; at every node in x the integral along y runs between its edges, exactly as
that over a square pixel does.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.rays import Geometry, light_sources, sighting_row
from tankrig.light.sights import KINKED_PARTS, SLANTED_PARTS, Rule, across_sights, kinked
from tankrig.scene import Scene
from tankrig.scene.footprint import footprints
from tankrig.threads import THREADS

STEPS = 64
MARGIN_MM = 0.5
"""More than a beam's edges bulge between its corners and between the ends of a stretch."""


def single_scattering_in_quadrangles(scene: Scene) -> NDArray[np.float64]:
    """`single_scattering` for a calibrated camera: (rows, columns), W/mm²/sr; 0 where a pixel looks elsewhere."""
    medium, seen = scene.medium, footprints(scene.camera, scene.tank)
    image = np.zeros(scene.camera.shape)
    x_rule, y_rule, depth_rule = (np.polynomial.legendre.leggauss(count) for count in (2, 3, 4))
    lit = [(geometry, beam) for geometry, beams in light_sources(scene) for beam in beams if beam.irradiance > 0.0]

    def add_rows(part: int) -> None:
        for geometry, beam in lit:
            strength, edges = medium.sigma_s * beam.irradiance, (*beam.y_mm, *beam.z_mm)
            _add_beam(
                image, geometry, seen.corners_mm, medium.sigma_t, strength, medium.g, edges, x_rule, y_rule, depth_rule,
                part, THREADS,
            )  # fmt: skip

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(add_rows, range(THREADS)))
    return np.where(seen.areas_mm2 > 0.0, image / seen.areas_mm2, 0.0)


@kernel
def _add_beam(
    image: NDArray[np.float64], geometry: Geometry, grid: NDArray[np.float64], sigma_t: float, strength: float,
    g: float, edges: tuple[float, float, float, float], x_rule: Rule, y_rule: Rule, depth_rule: Rule,
    part: int, parts: int,
) -> None:  # fmt: skip
    """Add one beam's order 1, integrated over each pixel's area, to one of so many parts of the rows."""
    xs, ys, corners = np.empty(4), np.empty(4), np.empty(4)
    first, last = _rows_seen(geometry, edges)
    per_mm = first.size / geometry.length
    for row in range(part, image.shape[0], parts):
        for column in range(image.shape[1]):
            for k in range(4):  # in turn around the pixel
                i, j = row + k // 2, column + (k == 1 or k == 2)
                xs[k], ys[k] = grid[i, j, 0], grid[i, j, 1]
            if not (xs.max() > 0.0 and xs.min() < geometry.length):
                continue  # beside the tank, or NaN
            if not (ys.max() > -geometry.half_width and ys.min() < geometry.half_width):
                continue
            here = min(int(max(xs.min(), 0.0) * per_mm), first.size - 1)
            there = min(int(xs.max() * per_mm), first.size - 1)
            if ys.max() < first[here : there + 1].min() or ys.min() > last[here : there + 1].max():
                continue
            ends = np.sort(np.minimum(np.maximum(xs, 0.0), geometry.length))
            total = 0.0
            for k in range(3):
                if ends[k + 1] > ends[k]:
                    total += _slice(
                        geometry, xs, ys, ends[k], ends[k + 1], corners, sigma_t, g, edges, x_rule, y_rule, depth_rule
                    )
            image[row, column] += strength * total


@kernel
def _rows_seen(
    geometry: Geometry, edges: tuple[float, float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest y at which a beam may be seen, in `STEPS` stretches of x."""
    first, last = np.full(STEPS, 1e30), np.full(STEPS, -1e30)
    for step in range(STEPS + 1):
        for k in range(4):
            y = sighting_row(geometry, step * geometry.length / STEPS, edges[k // 2], edges[2 + k % 2])
            for i in range(max(step - 1, 0), min(step + 1, STEPS)):
                first[i], last[i] = min(first[i], y - MARGIN_MM), max(last[i], y + MARGIN_MM)
    return first, last


@kernel
def _slice(
    geometry: Geometry, xs: NDArray[np.float64], ys: NDArray[np.float64], left: float, right: float,
    corners: NDArray[np.float64], sigma_t: float, g: float, edges: tuple[float, float, float, float],
    x_rule: Rule, y_rule: Rule, depth_rule: Rule,
) -> float:  # fmt: skip
    """Integral over the part of a pixel between two x, with no corner of it between them."""
    width = right - left
    low_left, high_left = _span(geometry, xs, ys, left + 1e-9 * width)
    low_right, high_right = _span(geometry, xs, ys, right - 1e-9 * width)
    parts, first, last = 1 + int(sigma_t * width), 1e30, -1e30
    whole = xs.max() - xs.min()  # a narrow slice needs fewer parts
    for k in range(4):
        at_left = sighting_row(geometry, left, edges[k // 2], edges[2 + k % 2])
        at_right = sighting_row(geometry, right, edges[k // 2], edges[2 + k % 2])
        first, last = min(first, at_left, at_right), max(last, at_left, at_right)
        if (at_left < low_left) != (at_right < low_right) or (at_left < high_left) != (at_right < high_right):
            parts = max(parts, math.ceil(SLANTED_PARTS * width / whole))
    if last < min(low_left, low_right) or first > max(high_left, high_right):
        return 0.0
    if kinked(geometry, left, width, edges):
        parts = max(parts, math.ceil(KINKED_PARTS * width / whole))
    nodes, weights = x_rule
    total = 0.0
    for part in range(parts):
        for i in range(nodes.size):
            x = left + width * (part + 0.5 + 0.5 * nodes[i]) / parts
            low, high = _span(geometry, xs, ys, x)
            if high <= low:
                continue
            for k in range(4):
                corners[k] = sighting_row(geometry, x, edges[k // 2], edges[2 + k % 2])
            corners.sort()
            if corners[3] <= low or corners[0] >= high:
                continue
            along = across_sights(geometry, x, low, high, corners, sigma_t, g, edges, y_rule, depth_rule)
            total += 0.5 * width / parts * weights[i] * along
    return total


@kernel
def _span(geometry: Geometry, xs: NDArray[np.float64], ys: NDArray[np.float64], x: float) -> tuple[float, float]:
    """The y between which a pixel, within the tank, has an x."""
    low, high = 1e30, -1e30
    for k in range(4):
        other = (k + 1) % 4
        if (xs[k] - x) * (xs[other] - x) <= 0.0 and xs[k] != xs[other]:
            y = ys[k] + (x - xs[k]) / (xs[other] - xs[k]) * (ys[other] - ys[k])
            low, high = min(low, y), max(high, y)
    return max(low, -geometry.half_width), min(high, geometry.half_width)

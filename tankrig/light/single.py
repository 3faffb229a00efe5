"""Order 1: light scattered exactly once, without noise (the paper's Eq. 7, corrected).

    I₁ = T ∫ ds σs p(cos θ) exp(−σt (d₁ + d₂)) E₀(y₀, z₀) (a/(x + a))²/c

along the line of sight, averaged over the pixel; d₁ is the path from the wall x = 0, d₂ the path to the surface, a the
distance of a pinhole projector from the wall and c the x-component of its ray (the factor is 1 for collimated light),
T = (1 − F)/n² at a Fresnel surface. The paper's equation has no integral along the line of sight.

The integrand is smooth between the lines where a line of sight crosses an edge of a beam, or meets a side wall there,
so each pixel is cut along those lines and every piece is integrated by Gauss–Legendre: the error is that of smooth
functions, whatever the edges.

A calibrated camera's pixels are quadrangles of the plane z = Lz. Each is cut along x at its corners; at every node in x
the integral along y runs between its edges, exactly as that over a square pixel does.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.bent_light import along_sight_in_bent_light
from tankrig.light.cuts import CUTS, rows_of_ends
from tankrig.light.rays import (
    Geometry,
    bent,
    light_kept,
    light_ray,
    light_sources,
    path_inside,
    sight_line,
    sighting_row,
)
from tankrig.scene import Scene
from tankrig.scene.footprint import footprints
from tankrig.scene.phase import phase_density
from tankrig.scene.phase_table import PhaseRecord
from tankrig.threads import THREADS

Rule = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Nodes and weights of a quadrature on [−1, 1]."""

KINKED_PARTS = 12
"""Parts a pixel is cut into along x where the near or far wall cuts the lit part of its lines of sight."""
SLANTED_PARTS = 5
"""The same where an edge of the beam runs from one row of pixels into the next."""


MOST_PARTS = 64
"""Along x; in larger pixels, counted in free paths, order 1 is a guess."""
FAINT = 60.0
"""Free paths after which light is fainter than any rounding."""


@kernel
def across_sights(
    geometry: Geometry, x: float, low: float, high: float, ends: NDArray[np.float64], sigma_t: float,
    phase: PhaseRecord, edges: tuple[float, float, float, float], y_rule: Rule, depth_rule: Rule,
) -> float:  # fmt: skip
    """∫ dy of what is seen along the lines through (x, low … high, Lz), cut at rows where light ends, in order."""
    nodes, weights = y_rule
    total, start = 0.0, low
    for k in range(ends.size + 1):
        end = min(max(ends[k], low), high) if k < ends.size else high
        half = 0.5 * (end - start)
        if half > 0.0:
            for j in range(nodes.size):
                y = start + half * (1.0 + nodes[j])
                total += half * weights[j] * _along_sight(geometry, x, y, sigma_t, phase, edges, depth_rule)
        start = max(start, end)
    return total


@kernel
def kinked(geometry: Geometry, x_left: float, width: float, edges: tuple[float, float, float, float]) -> bool:
    """Whether a wall, the surface or the floor cuts what is lit on some lines of sight between two x, not on others."""
    near, far = 1e30, -1e30
    middle = 0.5 * (edges[0] + edges[1])
    for k in range(4):
        x = x_left + width * (k // 2)
        vx, _, vz, _ = sight_line(geometry, x, middle)
        lit = x - vx / vz * (geometry.height - edges[2 + k % 2])
        near, far = min(near, lit), max(far, lit)
    for k in range(2):  # where the light meets the surface or the floor
        ux, _, uz = light_ray(geometry, middle, edges[2 + k])
        left, right = edges[2 + k] + uz / ux * x_left, edges[2 + k] + uz / ux * (x_left + width)
        if (left - geometry.height) * (right - geometry.height) < 0.0 or left * right < 0.0:
            return True
    inside = near > 1e-9 and far < geometry.length - 1e-9
    straight = far - near <= width * (1.0 + 1e-9)  # looking straight down, a wall is a pixel's edge or outside
    return not (inside or straight)


@kernel
def _along_sight(
    geometry: Geometry,
    x: float,
    y: float,
    sigma_t: float,
    phase: PhaseRecord,
    edges: tuple[float, float, float, float],
    rule: Rule,
) -> float:
    """∫ p exp(−σt (d₁ + d₂)) E/E₀ ds along the line of sight through (x, y, Lz), times the surface's transmission."""
    if bent(geometry):
        return along_sight_in_bent_light(geometry, x, y, sigma_t, phase, edges, rule)
    vx, vy, vz, transmission = sight_line(geometry, x, y)
    low, high = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    low, high = _clip_to_beam(geometry, x, y, vx, vy, vz, edges, low, high)
    along = vx  # cosine between light and sight; from a pinhole it falls with the depth
    if geometry.light_pinhole:
        ax, ay, az = x - vx * low - geometry.light_x, y - vy * low - geometry.light_y, geometry.height - vz * low
        az -= geometry.light_z
        along = (ax * vx + ay * vy + az * vz) / math.sqrt(ax * ax + ay * ay + az * az)
    # The way to a point and up to the surface grows by 1 − cos per mm of depth.
    high = min(high, low + FAINT / (sigma_t * max(1.0 - along, 1e-3)))
    if high <= low:
        return 0.0
    nodes, weights = rule
    apex = geometry.light_x
    panels = 1 + int(sigma_t * (high - low) / 2.0)
    half = 0.5 * (high - low) / panels
    total = 0.0
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
            total += weights[k] * half * phase_density(cosine, phase) * spread * math.exp(-sigma_t * (path + depth))
    return transmission * total


@kernel
def _clip_to_beam(
    geometry: Geometry,
    x: float,
    y: float,
    vx: float,
    vy: float,
    vz: float,
    edges: tuple[float, float, float, float],
    low: float,
    high: float,
) -> tuple[float, float]:
    """The part of [low, high] of a line of sight that lies between a beam's four faces."""
    for k in range(4):
        side = 1.0 if k % 2 == 0 else -1.0
        if k < 2:
            origin, slope, centre = y, -vy, geometry.light_y
        else:
            origin, slope, centre = geometry.height, -vz, geometry.light_z
        if geometry.light_pinhole:  # (coordinate − apex)·(−apex_x) ≥ (edge − apex)·(x − apex_x)
            reach = -geometry.light_x
            value = side * ((origin - centre) * reach - (edges[k] - centre) * (x + reach))
            change = side * (slope * reach + (edges[k] - centre) * vx)
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
    medium, camera = scene.medium, scene.camera
    phase = medium.phase_function.record
    image = np.zeros(camera.shape)
    if medium.sigma_s == 0.0:
        return image
    if camera.kind == "calibrated":
        return single_scattering_in_quadrangles(scene)
    rules = [np.polynomial.legendre.leggauss(count) for count in (2, 3, 4)]  # along x, along y, along the line of sight
    for geometry, beams in light_sources(scene):
        for beam in beams:
            _add_beam(
                image, geometry, camera.pixel_mm, medium.sigma_t, medium.sigma_s * beam.irradiance, phase,
                (*beam.y_mm, *beam.z_mm), *rules,
            )  # fmt: skip
    return image


@kernel
def _add_beam(
    image: NDArray[np.float64],
    geometry: Geometry,
    pixel_mm: float,
    sigma_t: float,
    strength: float,
    phase: PhaseRecord,
    edges: tuple[float, float, float, float],
    x_rule: Rule,
    y_rule: Rule,
    depth_rule: Rule,
) -> None:
    """Add one beam's order-1 image; `edges` are (y low, y high, z low, z high) on the plane x = 0."""
    x_nodes, x_weights = x_rule
    rows, columns = image.shape
    y_first = -geometry.half_width
    ends = np.empty(CUTS)
    for column in range(columns):
        x_left = column * pixel_mm
        if x_left >= geometry.length:
            break
        # Looking straight down, light fades with x as it does on its way.
        reach = pixel_mm if geometry.camera_pinhole else min(pixel_mm, FAINT / sigma_t)
        parts = _parts_along_x(geometry, x_left, reach, edges, sigma_t)
        for part in range(parts):
            for i in range(x_nodes.size):
                x = x_left + reach * (part + 0.5 + 0.5 * x_nodes[i]) / parts
                if x >= geometry.length:
                    continue
                rows_of_ends(geometry, x, edges, ends)
                top = min(max((ends[0] - y_first) / pixel_mm, 0.0), float(rows))
                bottom = min(max((ends[-1] - y_first) / pixel_mm, -1.0), rows - 1.0)
                for row in range(math.floor(top), math.floor(bottom) + 1):
                    low = y_first + row * pixel_mm
                    high = min(low + pixel_mm, geometry.half_width)
                    total = across_sights(geometry, x, low, high, ends, sigma_t, phase, edges, y_rule, depth_rule)
                    image[row, column] += strength * total / pixel_mm * 0.5 * x_weights[i] / parts * reach / pixel_mm


@kernel
def _parts_along_x(
    geometry: Geometry, x_left: float, pixel_mm: float, edges: tuple[float, float, float, float], sigma_t: float
) -> int:
    """How many parts of a column of pixels to integrate separately along x: more where there are kinks, or dense."""
    parts = min(1 + int(sigma_t * pixel_mm), MOST_PARTS)
    left, right = np.empty(CUTS), np.empty(CUTS)
    rows_of_ends(geometry, x_left, edges, left)
    rows_of_ends(geometry, x_left + pixel_mm, edges, right)
    shift = geometry.half_width / pixel_mm
    for k in range(CUTS):
        if math.floor(left[k] / pixel_mm + shift) != math.floor(right[k] / pixel_mm + shift):
            parts = max(parts, SLANTED_PARTS)
    return max(parts, KINKED_PARTS) if kinked(geometry, x_left, pixel_mm, edges) else parts


STEPS = 64
MARGIN_MM = 0.5
"""More than a beam's edges bulge between its corners and between the ends of a stretch."""


def single_scattering_in_quadrangles(scene: Scene) -> NDArray[np.float64]:
    """`single_scattering` for a calibrated camera: (rows, columns), W/mm²/sr; 0 where a pixel looks elsewhere."""
    medium, seen = scene.medium, footprints(scene.camera, scene.tank)
    phase = medium.phase_function.record
    image = np.zeros(scene.camera.shape)
    x_rule, y_rule, depth_rule = (np.polynomial.legendre.leggauss(count) for count in (2, 3, 4))
    lit = [(geometry, beam) for geometry, beams in light_sources(scene) for beam in beams if beam.irradiance > 0.0]

    def add_rows(part: int) -> None:
        for geometry, beam in lit:
            strength, edges = medium.sigma_s * beam.irradiance, (*beam.y_mm, *beam.z_mm)
            _add_beam_in_quadrangles(
                image, geometry, seen.corners_mm, medium.sigma_t, strength, phase, edges, x_rule, y_rule, depth_rule,
                part, THREADS,
            )  # fmt: skip

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(add_rows, range(THREADS)))
    return np.where(seen.areas_mm2 > 0.0, image / seen.areas_mm2, 0.0)


@kernel
def _add_beam_in_quadrangles(
    image: NDArray[np.float64], geometry: Geometry, grid: NDArray[np.float64], sigma_t: float, strength: float,
    phase: PhaseRecord, edges: tuple[float, float, float, float], x_rule: Rule, y_rule: Rule, depth_rule: Rule,
    part: int, parts: int,
) -> None:  # fmt: skip
    """Add one beam's order 1, integrated over each pixel's area, to one of so many parts of the rows."""
    xs, ys, ends_y = np.empty(4), np.empty(4), np.empty(CUTS)
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
                        geometry,
                        xs,
                        ys,
                        ends[k],
                        ends[k + 1],
                        ends_y,
                        sigma_t,
                        phase,
                        edges,
                        x_rule,
                        y_rule,
                        depth_rule,
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
    ends: NDArray[np.float64], sigma_t: float, phase: PhaseRecord, edges: tuple[float, float, float, float],
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
            rows_of_ends(geometry, x, edges, ends)
            if ends[-1] <= low or ends[0] >= high:
                continue
            along = across_sights(geometry, x, low, high, ends, sigma_t, phase, edges, y_rule, depth_rule)
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

"""The light's first scatterings, followed along paths and left on the cells as moments over direction."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.moments.cells import Cells
from tankrig.light.moments.harmonics import degrees, fill_harmonics
from tankrig.light.rays import Geometry, geometry_of
from tankrig.light.tank.flight import fly, scattered
from tankrig.light.tank.lattice import LARGE, coordinate
from tankrig.light.tank.record import image_of_edges
from tankrig.scene import Scene

Array = NDArray[np.float64]

THREADS = 2
FLIGHT_COORDINATES = 3


def emission_moments(scene: Scene, cells: Cells, degree: int, order: int, batches: int, seed: int = 0) -> Array:
    """Moments of the emission Q after `order` scatterings: Q_lm = g^l ∫ Y_lm(ω) σs L(ω) dω, averaged over cells.

    A path stands for all that begin anywhere on the beams, as in `tankrig.light.tank.paths`; here every direction is
    drawn from the phase function.

    Parameters
    ----------
    scene
        Collimated projector, σs > 0.
    cells
        Of the tank.
    degree
        Highest degree.
    order
        Number of scatterings, 2 or more.
    batches
        Number of shifted lattices.
    seed
        Of their shifts.

    Returns
    -------
    (moments, nx, ny, nz) array, W/mm³/sr^½
    """
    medium, geometry = scene.medium, geometry_of(scene)
    moments = (degree + 1) ** 2
    across, along, up = cells.counts

    def batch(number: int) -> Array:
        shifted = LARGE.shifted((seed, number))
        total = np.zeros((moments, up, along, across))
        for z_mm in sorted({beam.z_mm for beam in scene.projector.beams}):
            beams = np.array(
                [(*beam.y_mm, *beam.z_mm, beam.irradiance) for beam in scene.projector.beams if beam.z_mm == z_mm]
            )
            edges = np.zeros((up, 2, along + 2, across + 2, moments))
            _follow(
                edges, geometry, cells.size_mm, medium.sigma_t, medium.albedo, medium.g, beams, shifted, LARGE.points,
                order, degree,
            )  # fmt: skip
            averages = image_of_edges(np.moveaxis(edges, -1, 0), medium.sigma_t, cells.size_mm[0])
            total += averages * ((z_mm[1] - z_mm[0]) / LARGE.points)
        return total

    with ThreadPoolExecutor(THREADS) as pool:
        mean = sum(pool.map(batch, range(batches)), np.zeros(())) / batches
    scale = medium.g ** degrees(degree) / cells.size_mm[2]
    result: Array = mean.transpose(0, 3, 2, 1) * scale[:, None, None, None]
    return result


@kernel
def _follow(
    edges: Array, geometry: Geometry, cell_mm: tuple[float, float, float], sigma_t: float, albedo: float, g: float,
    beams: Array, lattice: Array, points: int, last: int, degree: int,
) -> None:  # fmt: skip
    """Follow paths to their scattering number `last` and record weight · Y_lm of their direction before it.

    `edges` is (nz, 2, ny + 2, nx + 2, moments); `beams` (n, 5): y low, y high, z low, z high, irradiance.
    """
    length, half_width, height = geometry.length, geometry.half_width, geometry.height
    hull_low, hull_high = beams[:, 0].min(), beams[:, 1].max()
    values = np.empty((degree + 1) ** 2)
    for point in range(points):
        x_low, x_high, y_low, y_high = 0.0, min(length, 40.0 / sigma_t), hull_low, hull_high
        x = y = 0.0
        z = beams[0, 2] + coordinate(point, 0, lattice) * (beams[0, 3] - beams[0, 2])
        dx, dy, dz, ex, ey, ez = 1.0, 0.0, 0.0, 0.0, 0.0, 1.0
        weight = albedo * sigma_t
        for order in range(1, last):
            first = 1 + (order - 1) * FLIGHT_COORDINATES
            u, v, w = (
                coordinate(point, first, lattice),
                coordinate(point, first + 1, lattice),
                coordinate(point, first + 2, lattice),
            )
            dx, dy, dz, ex, ey, ez = scattered(dx, dy, dz, ex, ey, ez, g, u, v)
            walls = (-x_high, length - x_low, -half_width - y_high, half_width - y_low)
            x, y, z, after, chance = fly(
                walls, height, geometry.refractive_index, sigma_t, x, y, z, dx, dy, dz, w
            )  # fmt: skip
            if after != dz:  # reflected at the surface
                dz, ez = after, -ez
            weight *= chance * albedo
            x_low, x_high = max(x_low, -x), min(x_high, length - x)
            y_low, y_high = max(y_low, -half_width - y), min(y_high, half_width - y)
        layer = min(max(math.floor(z / cell_mm[2]), 0), edges.shape[0] - 1)
        fill_harmonics(degree, dx, dy, dz, values)
        values *= weight
        if x_high > x_low and y_high > y_low:
            _record(
                edges[layer], values, sigma_t, x, y + half_width, x_low, x_high, y_low, y_high, beams,
                cell_mm[0], cell_mm[1],
            )  # fmt: skip


@part
def _record(
    edges: Array, values: Array, sigma_t: float, x: float, y: float, x_low: float, x_high: float, y_low: float,
    y_high: float, beams: Array, cell_x: float, cell_y: float,
) -> None:  # fmt: skip
    """`mark_rectangles` for all moments at once; `y` counts from the tank's side."""
    for beam in range(beams.shape[0]):
        low, high = max(beams[beam, 0], y_low), min(beams[beam, 1], y_high)
        for corner in range(4):
            if high <= low:
                continue
            start = x_low if corner < 2 else x_high
            place = max(start + x, 0.0) / cell_x
            column = int(place)
            change = beams[beam, 4] * math.exp(-sigma_t * start) * (1.0 if corner == 0 or corner == 3 else -1.0)
            on = math.exp(-sigma_t * cell_x * (column + 1.0 - place))
            here = change * (1.0 - on) / (sigma_t * cell_x)
            there = change * on
            place = ((low if corner % 2 == 0 else high) + y) / cell_y
            row = int(place)
            after = place - row
            for moment in range(values.size):
                edges[0, row, column, moment] += values[moment] * here * (1.0 - after)
                edges[0, row + 1, column, moment] += values[moment] * here * after
                edges[1, row, column + 1, moment] += values[moment] * there * (1.0 - after)
                edges[1, row + 1, column + 1, moment] += values[moment] * there * after

"""The light's first scatterings, followed along paths and left on the cells as moments over direction."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.moments.cells import Cells
from tankrig.light.moments.harmonics import degrees, fill_harmonics
from tankrig.light.paths.block import (
    BLOCK,
    LARGE,
    Block,
    PathSampling,
    Points,
    Step,
    alive,
    begin,
    begin_at_origin,
    begin_on_beams,
    draw_step,
    empty_block,
)
from tankrig.light.paths.lattices import beam_table
from tankrig.light.paths.record import column_of, image_of_edges
from tankrig.light.paths.trace import advance, narrow, scatter
from tankrig.light.rays import Geometry, geometry_of
from tankrig.light.water import Water, water_for_paths
from tankrig.scene import Scene
from tankrig.threads import THREADS

Array = NDArray[np.float64]

START_COORDINATES, FLIGHT_COORDINATES = 3, 3
"""Of the lattice, for a path that begins on a beam, and for each scattering."""


def emission_moments(scene: Scene, cells: Cells, degree: int, order: int, batches: int, seed: int = 0) -> Array:
    """Moments of the emission Q after `order` scatterings: Q_lm = g^l ∫ Y_lm(ω) σs L(ω) dω, averaged over cells.

    Where light is collimated a path stands for all that begin anywhere on the beams, as in `tankrig.light.paths.trace`;
    here every direction is drawn from the phase function.

    Parameters
    ----------
    scene
        Any scene with σs > 0.
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

    def from_beams(number: int) -> Array:
        water, points = water_for_paths(medium), Points(LARGE.shifted((seed, number)), LARGE.points)
        total = np.zeros((up, along, across, moments))
        lit = [beam for beam in scene.projector.beams if beam.irradiance > 0.0]
        if not lit:
            return total.transpose(3, 0, 1, 2)
        table, power = beam_table(lit)
        _follow_from_beams(total, cells.size_mm, geometry, water, table, points, order, degree)
        result: Array = np.moveaxis(total, -1, 0) * (power / (LARGE.points * math.prod(cells.size_mm[:2])))
        return result

    def from_anywhere(number: int) -> Array:
        water, points = water_for_paths(medium), Points(LARGE.shifted((seed, number)), LARGE.points)
        total = np.zeros((moments, up, along, across))
        for z_mm in sorted({beam.z_mm for beam in scene.projector.beams}):
            beams = np.array(
                [(*beam.y_mm, *beam.z_mm, beam.irradiance) for beam in scene.projector.beams if beam.z_mm == z_mm]
            )
            edges = np.zeros((up, 2, along + 2, across + 2, moments))
            _follow(edges, cells.size_mm, geometry, water, beams, points, order, degree)
            averages = image_of_edges(np.moveaxis(edges, -1, 0), medium.sigma_t, cells.size_mm[0])
            total += averages * ((z_mm[1] - z_mm[0]) / LARGE.points)
        return total

    with ThreadPoolExecutor(THREADS) as pool:
        batch = from_anywhere if scene.projector.kind == "collimated" else from_beams
        mean = sum(pool.map(batch, range(batches)), np.zeros(())) / batches
    scale = medium.phase_function.moments(degree)[degrees(degree)] / cells.size_mm[2]
    result: Array = mean.transpose(0, 3, 2, 1) * scale[:, None, None, None]
    return result


@kernel
def _follow(
    edges: Array, cell_mm: tuple[float, float, float], geometry: Geometry, water: Water, beams: Array,
    points: Points, last: int, degree: int,
) -> None:  # fmt: skip
    """Follow paths to their scattering number `last` and record weight · Y_lm of their direction before it.

    `edges` is (nz, 2, ny + 2, nx + 2, moments); `beams` (n, 5): y low, y high, z low, z high, irradiance.
    """
    lattice, count = points
    sampling = PathSampling(water.sigma_t, water.albedo, water.phase, False, 0.0)
    block, values = empty_block(), np.empty((degree + 1) ** 2)
    u, v, w = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, count, BLOCK):
        n = min(BLOCK, count - start)
        begin_at_origin(block, n, start, geometry, sampling, beams, lattice)
        begin(block, n, start, sampling, lattice, 0.0)
        for order in range(1, last):
            dimension = 1 + (order - 1) * FLIGHT_COORDINATES
            step = Step(order, 1.0, u, v, w)
            draw_step(step, block.point, n, dimension, lattice)
            scatter(block, step, n, sampling)
            advance(block, step, n, geometry, sampling)
            narrow(block, n, geometry)
            n = alive(block, n, True)
        for i in range(n):
            if block.weight[i] > 0.0:
                layer = min(max(math.floor(block.z[i] / cell_mm[2]), 0), edges.shape[0] - 1)
                fill_harmonics(degree, block.dx[i], block.dy[i], block.dz[i], values)
                values *= block.weight[i]
                _record(edges[layer], values, block, i, geometry.half_width, sampling.sigma_t, beams, cell_mm)


@kernel
def _follow_from_beams(
    cells: Array, cell_mm: tuple[float, float, float], geometry: Geometry, water: Water, beams: Array,
    points: Points, last: int, degree: int,
) -> None:  # fmt: skip
    """Follow paths from beams whose light slants, and leave weight · Y_lm in the cell of their last scattering.

    `cells` is (nz, ny, nx, moments); `beams` (n, 6), as for `tankrig.light.paths.trace`.
    """
    lattice, count = points
    sampling = PathSampling(water.sigma_t, water.albedo, water.phase, False, 0.0)
    block, values = empty_block(), np.empty((degree + 1) ** 2)
    u, v, w = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    up, along, across, _ = cells.shape
    for start in range(0, count, BLOCK):
        n = min(BLOCK, count - start)
        begin_on_beams(block, n, start, geometry, sampling, beams, lattice)
        block.sx[:n], block.sz[:n] = 0.0, 1.0  # no path turns to the camera
        begin(block, n, start, sampling, lattice, 0.0)
        for order in range(1, last):
            dimension = START_COORDINATES + (order - 1) * FLIGHT_COORDINATES
            step = Step(order, 1.0, u, v, w)
            draw_step(step, block.point, n, dimension, lattice)
            scatter(block, step, n, sampling)
            advance(block, step, n, geometry, sampling)
            n = alive(block, n, False)
        for i in range(n):
            if block.weight[i] > 0.0:
                layer = min(max(math.floor(block.z[i] / cell_mm[2]), 0), up - 1)
                row = min(max(math.floor((block.y[i] + geometry.half_width) / cell_mm[1]), 0), along - 1)
                column = min(max(math.floor(block.x[i] / cell_mm[0]), 0), across - 1)
                fill_harmonics(degree, block.dx[i], block.dy[i], block.dz[i], values)
                for moment in range(values.size):
                    cells[layer, row, column, moment] += block.weight[i] * values[moment]


@part
def _record(
    edges: Array, values: Array, block: Block, i: int, half_width: float, sigma_t: float, beams: Array,
    cell_mm: tuple[float, float, float],
) -> None:  # fmt: skip
    """`tally_rectangles` for all moments of one path at once."""
    x, y = block.x[i], block.y[i] + half_width
    x_low, x_high, y_low, y_high = block.x_low[i], block.x_high[i], block.y_low[i], block.y_high[i]
    cell_x, cell_y, _ = cell_mm
    for side in range(2):
        start = x_low if side == 0 else x_high
        column, here, there = column_of(start, x, sigma_t, 1.0 if side == 0 else -1.0, cell_x)
        column = int(column)
        for beam in range(beams.shape[0]):
            low, high = max(beams[beam, 0], y_low), min(beams[beam, 1], y_high)
            if high <= low:
                continue
            for end in range(2):
                place = ((low if end == 0 else high) + y) / cell_y
                row = int(place)
                change = beams[beam, 4] if end == 0 else -beams[beam, 4]
                after = (place - row) * change
                before = change - after
                for moment in range(values.size):
                    value = values[moment]
                    edges[0, row, column, moment] += value * here * before
                    edges[0, row + 1, column, moment] += value * here * after
                    edges[1, row, column + 1, moment] += value * there * before
                    edges[1, row + 1, column + 1, moment] += value * there * after

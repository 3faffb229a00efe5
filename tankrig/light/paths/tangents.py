"""Derivatives of what paths send to the camera by σa, σs and the phase function, along the very same paths.

A path of n scatterings and of the length ℓ from x = 0 to the surface brings light in proportion to

    σsⁿ exp(−(σa + σs) ℓ) Π p(cos θₖ),

so that, with its places held and the density that it was drawn with, its light changes by

    −ℓ by σa,   n/σs − ℓ by σs,   Σ ∂ ln p(cos θₖ)/∂g by g

of itself (the score, or likelihood ratio; Glynn 1990). Of another phase function than Henyey–Greenstein's the last is
Σ (q(cos θₖ)/p(cos θₖ) − 1) by the share of the way to a phase function q, for any number of them. All come with the
image for two or three times its price, and have no step: differences between two media have the noise of both images
over the step, because paths take other ways in another medium.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.elementary import exponential
from tankrig.light.paths.block import (
    BLOCK,
    FLIGHT_COORDINATES,
    LARGE,
    START_COORDINATES,
    UNTURNED,
    Block,
    Ends,
    Lattice,
    PathLimits,
    PathSampling,
    Points,
    Step,
    begin,
    begin_at_origin,
    begin_on_beams,
    draw_step,
    empty_block,
    going_on,
)
from tankrig.light.paths.lattices import THINNING
from tankrig.light.paths.record import TallyRecord, cell_averages, empty_record, image_of_edges, seen_from
from tankrig.light.paths.trace import advance, arrive, cover, look, narrow, probed, scatter
from tankrig.light.rays import Geometry, geometry_of, sight_line
from tankrig.light.water import Water, water_for_paths
from tankrig.scene import Scene
from tankrig.scene.phase import phase_density
from tankrig.scene.phase_table import PhaseFunction, PhaseRecord

if TYPE_CHECKING:
    from tankrig.light.paths.cells import CellGrid

Array = NDArray[np.float64]

LAYERS = 3
"""Of an image: its light, and the light times n and times ℓ; then the light times each score of turning."""
NO_SCORES = np.zeros((1, 1))
"""Henyey–Greenstein's one score is a formula."""


class Scores(NamedTuple):
    """What the light of each path is multiplied by for the layers after the first."""

    scatterings: float
    """n."""
    way_mm: Array
    """ℓ."""
    turning: Array
    """(n, k) scores of turning."""


class SoFar(NamedTuple):
    """What of ℓ and the scores of turning is behind each path, by the number of its lattice point after `first`."""

    first: int
    way_mm: Array
    turning: Array
    scores: Array


@part
def by_asymmetry(cosine: float, g: float) -> float:
    """∂ ln p/∂g of Henyey–Greenstein's phase function, −2g/(1 − g²) − 3 (g − cos θ)/(1 + g² − 2 g cos θ).

    Examples
    --------
    >>> from tankrig.scene.phase import henyey_greenstein
    >>> above, below = (math.log(henyey_greenstein(0.3, 0.6 + step)) for step in (1e-6, -1e-6))
    >>> round(by_asymmetry(0.3, 0.6) - (above - below) / 2e-6, 6) + 0.0
    0.0
    """
    spread = (1.0 - abs(g)) ** 2 + 2.0 * abs(g) * (1.0 - cosine if g >= 0.0 else 1.0 + cosine)
    return -2.0 * g / ((1.0 - g) * (1.0 + g)) - 3.0 * (g - cosine) / spread


@part
def count_turn(turning: Array, at: int, cosine: float, phase: PhaseRecord, scores: Array) -> None:
    """Add one scattering's scores to those of a path.

    Parameters
    ----------
    turning
        (n, k) of paths.
    at
        Number of the path.
    cosine
        cos θ.
    phase
        Phase function.
    scores
        (nodes, k) at even steps of sin(θ/2), of any other phase function than Henyey–Greenstein's.
    """
    if len(phase) == 2:
        turning[at, 0] += by_asymmetry(cosine, phase.g)
    else:
        steps = scores.shape[0] - 1
        place = math.sqrt(max(0.5 - 0.5 * cosine, 0.0)) * steps
        step = min(int(place), steps - 1)
        share = place - step
        for k in range(scores.shape[1]):
            turning[at, k] += (1.0 - share) * scores[step, k] + share * scores[step + 1, k]


@kernel
def trace_tangents(
    image: Array, cell_mm: tuple[float, float], geometry: Geometry, water: Water, beams: Array, points: Points,
    limits: PathLimits, scores: Array,
) -> None:  # fmt: skip
    """Follow the paths of lattice points as `trace` does, with the scores of the module's heading.

    Parameters
    ----------
    image
        Added to: (2, rows + 2, columns + 2, `LAYERS` + k) for paths that begin anywhere, ℓ less the place where it is
        seen along x; (rows, columns, `LAYERS` + k) for others.
    cell_mm, geometry, water, beams, points, limits
        As for `trace`.
    scores
        (nodes, k) of turning, see `count_turn`; `NO_SCORES` of Henyey–Greenstein's phase function.
    """
    sigma_t, albedo, phase = water
    lattice, stop = points
    max_order, faintest, first_thinning, turns, _, lowest = limits
    sampling = PathSampling(sigma_t, albedo, phase, phase.g > 0.3, (1.0 - UNTURNED) / turns)
    block, tally = empty_block(), empty_record(BLOCK)
    u, v, w = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    probes = Ends(np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK))
    before = np.empty((6, BLOCK))
    way_mm, turning = np.empty(BLOCK), np.empty((BLOCK, scores.shape[1]))  # of each path, by its lattice point
    seen_way, seen_turning = np.empty(BLOCK), np.empty((BLOCK, scores.shape[1]))
    for first in range(0, stop, BLOCK):
        n = min(BLOCK, stop - first)
        so_far = SoFar(first, way_mm, turning, scores)
        if image.ndim == 4:
            begin_at_origin(block, n, first, geometry, sampling, beams, lattice)
        else:
            begin_on_beams(block, n, first, geometry, sampling, beams, lattice)
            look(block, n, geometry, sigma_t)
        begin(block, n, first, sampling, lattice, faintest)
        for i in range(n):
            way_mm[i] = block.x[i] / block.dx[i]
            for k in range(scores.shape[1]):
                turning[i, k] = 0.0
        for order in range(1, max_order):
            n = going_on(block, n, order, first_thinning, lattice, image.ndim == 4)
            if n == 0:
                break
            remaining = 1.0 - sampling.per_turn * min(order - 1, turns) if sampling.guided else 1.0
            dimension = START_COORDINATES + (order - 1) * FLIGHT_COORDINATES
            step, seen = Step(order, remaining, u, v, w), Scores(order + 1.0, seen_way, seen_turning)
            if sampling.guided and order >= 2:
                draw_step(step, block.point, n, dimension + 3, lattice)
                _probe(probes, seen, block, so_far, step, n, geometry, sampling)
                if image.ndim == 4:
                    cover(tally, probes, block, n, geometry, sampling, cell_mm[0])
                    _end_up(seen, probes, n, geometry, sampling, scores)
                    _tally_rectangles(image, tally, seen, n, beams, geometry.half_width, cell_mm[1])
                else:
                    _tally_cells(image, probes.x, probes.y, probes.weight, seen, n, geometry.half_width, cell_mm)
            draw_step(step, block.point, n, dimension, lattice)
            for i in range(n):
                before[0, i], before[1, i], before[2, i] = block.dx[i], block.dy[i], block.dz[i]
                before[3, i], before[4, i], before[5, i] = block.x[i], block.y[i], block.z[i]
            scatter(block, step, n, sampling)
            _turn(block, before, so_far, n, sampling)
            advance(block, step, n, geometry, sampling)
            _go(block, before, so_far, n, geometry)
            if image.ndim == 4:
                narrow(block, n, geometry)
            else:
                look(block, n, geometry, sigma_t)
            if order + 1 < lowest:
                continue
            for i in range(n):
                at = int(block.point[i]) - first
                seen_way[i] = way_mm[at]
                for k in range(scores.shape[1]):
                    seen_turning[i, k] = turning[at, k]
            if image.ndim == 4:
                ends = Ends(block.x, block.y, block.z, block.dz, block.seen)
                cover(tally, ends, block, n, geometry, sampling, cell_mm[0])
                _end_up(seen, ends, n, geometry, sampling, scores)
                _tally_rectangles(image, tally, seen, n, beams, geometry.half_width, cell_mm[1])
            else:
                arrive(tally, block, n, sampling)
                for i in range(n):
                    ahead = block.dx[i] * block.sx[i] + block.dy[i] * block.sy[i] + block.dz[i] * block.sz[i]
                    count_turn(seen_turning, i, ahead, sampling.phase, scores)
                    seen_way[i] += (geometry.height - block.z[i]) / block.sz[i]
                _tally_cells(image, block.seen_x, block.seen_y, tally.value, seen, n, geometry.half_width, cell_mm)


@kernel
def _turn(block: Block, before: Array, so_far: SoFar, n: int, sampling: PathSampling) -> None:
    """Count the scattering that has just turned paths; their vertical directions are kept for the flight."""
    first, _, turning, scores = so_far
    for i in range(n):
        cosine = block.dx[i] * before[0, i] + block.dy[i] * before[1, i] + block.dz[i] * before[2, i]
        count_turn(turning, int(block.point[i]) - first, cosine, sampling.phase, scores)
        before[2, i] = block.dz[i]


@kernel
def _go(block: Block, before: Array, so_far: SoFar, n: int, geometry: Geometry) -> None:
    """Count the flight that paths have just made."""
    first, way_mm, _, _ = so_far
    for i in range(n):
        reflected = block.dz[i] != before[2, i]
        way_mm[int(block.point[i]) - first] += _length(
            block.x[i] - before[3, i], block.y[i] - before[4, i], before[5, i], block.z[i],
            (block.dx[i], block.dy[i], block.dz[i]), reflected, geometry.height,
        )  # fmt: skip


@part
def _length(
    across: float, along: float, low: float, high: float, direction: tuple[float, float, float], reflected: bool,
    surface: float,
) -> float:  # fmt: skip
    """Length of a flight, by way of the surface or not, from where it leads in x and y and both heights.

    ℓ = Δx d_x + Δy d_y + |Δz| |d_z|, with Δz = (Lz − z) + (Lz − z') by way of the surface.
    """
    dx, dy, dz = direction
    rise = 2.0 * surface - low - high if reflected else abs(high - low)
    return across * dx + along * dy + rise * abs(dz)


@kernel
def _probe(
    probes: Ends, seen: Scores, block: Block, so_far: SoFar, step: Step, n: int, geometry: Geometry,
    sampling: PathSampling,
) -> None:  # fmt: skip
    """Probes with their scores: of paths that may begin anywhere up to the probe's end, of others as they are seen.

    Of the latter x, y and weight are those that the camera sees.
    """
    _, seen_way, seen_turning = seen
    first, way_mm, turning, scores = so_far
    shiftable, index = block.x_high[0] > block.x_low[0], geometry.refractive_index
    for i in range(n):
        x, y, z, dx, dy, dz, weight = probed(block, step, i, geometry, sampling, index)
        across, along, up = x - block.x[i], y - block.y[i], z - block.z[i]
        straight = math.sqrt(across * across + along * along + up * up)
        reflected = index > 1.0 and dz < 0.0 and across * dx + along * dy + up * dz < straight * (1.0 - 1e-9)
        left = -dz if reflected else dz
        cosine = dx * block.dx[i] + dy * block.dy[i] + left * block.dz[i]
        at = int(block.point[i]) - first
        seen_way[i] = way_mm[at] + _length(across, along, block.z[i], z, (dx, dy, dz), reflected, geometry.height)
        for k in range(scores.shape[1]):
            seen_turning[i, k] = turning[at, k]
        count_turn(seen_turning, i, cosine, sampling.phase, scores)
        if shiftable:
            probes.x[i], probes.y[i], probes.z[i], probes.dz[i], probes.weight[i] = x, y, z, dz, weight
        else:
            probes.x[i], probes.y[i], sx, sy, sz, path, factor = seen_from(geometry, x, y, z, index)
            ahead = dx * sx + dy * sy + dz * sz
            probes.weight[i] = weight * phase_density(ahead, sampling.phase) * factor
            probes.weight[i] *= exponential(-sampling.sigma_t * path)
            seen_way[i] += path
            count_turn(seen_turning, i, ahead, sampling.phase, scores)


@kernel
def _end_up(seen: Scores, ends: Ends, n: int, geometry: Geometry, sampling: PathSampling, scores: Array) -> None:
    """The last scattering, into the camera above, and the way up; less the place, which starts add."""
    _, way_mm, turning = seen
    for i in range(n):
        way_mm[i] += geometry.height - ends.z[i] - ends.x[i]
        count_turn(turning, i, ends.dz[i], sampling.phase, scores)


@kernel
def _tally_rectangles(
    edges: Array, tally: TallyRecord, scores: Scores, n: int, beams: Array, half_width: float, cell_mm: float
) -> None:
    """As `tally_rectangles`, in all layers."""
    scatterings, way_mm, turning = scores
    factors = np.empty(LAYERS + turning.shape[1])
    for i in range(n):
        if not tally.value[i] > 0.0:  # nor NaN, whose place is no index
            continue
        first, last = int(tally.first[i]), int(tally.last[i])
        factors[0], factors[1], factors[2] = 1.0, scatterings, way_mm[i]
        for k in range(turning.shape[1]):
            factors[LAYERS + k] = turning[i, k]
        for beam in range(beams.shape[0]):
            low, high = max(beams[beam, 0], tally.y_low[i]), min(beams[beam, 1], tally.y_high[i])
            if high <= low:
                continue
            for side in range(2):
                place = ((low if side == 0 else high) + tally.y[i] + half_width) / cell_mm
                row = int(place)
                change = beams[beam, 4] if side == 0 else -beams[beam, 4]
                after = (place - row) * change
                before = change - after
                for k in range(factors.size):
                    here, below = before * factors[k], after * factors[k]
                    edges[0, row, first, k] += here * tally.first_part[i]
                    edges[0, row + 1, first, k] += below * tally.first_part[i]
                    edges[1, row, first + 1, k] += here * tally.first_on[i]
                    edges[1, row + 1, first + 1, k] += below * tally.first_on[i]
                    edges[0, row, last, k] -= here * tally.last_part[i]
                    edges[0, row + 1, last, k] -= below * tally.last_part[i]
                    edges[1, row, last + 1, k] -= here * tally.last_on[i]
                    edges[1, row + 1, last + 1, k] -= below * tally.last_on[i]


@kernel
def _tally_cells(
    cells: Array, x: Array, y: Array, value: Array, scores: Scores, n: int, half_width: float,
    cell_mm: tuple[float, float],
) -> None:  # fmt: skip
    """As `tally_cells`, in all layers."""
    scatterings, way_mm, turning = scores
    rows, columns, _ = cells.shape
    factors = np.empty(LAYERS + turning.shape[1])
    for i in range(n):
        across, along = x[i] / cell_mm[0], (y[i] + half_width) / cell_mm[1]
        if not (value[i] > 0.0 and 0.0 <= across <= columns and 0.0 <= along <= rows):
            continue
        across, along = min(max(across - 0.5, 0.0), columns - 1.0), min(max(along - 0.5, 0.0), rows - 1.0)
        column, row = int(across), int(along)
        after, below = min(column + 1, columns - 1), min(row + 1, rows - 1)
        lower = value[i] * (along - row)
        upper = value[i] - lower
        right = across - column
        factors[0], factors[1], factors[2] = 1.0, scatterings, way_mm[i]
        for k in range(turning.shape[1]):
            factors[LAYERS + k] = turning[i, k]
        for k in range(factors.size):
            cells[row, column, k] += upper * (1.0 - right) * factors[k]
            cells[row, after, k] += upper * right * factors[k]
            cells[below, column, k] += lower * (1.0 - right) * factors[k]
            cells[below, after, k] += lower * right * factors[k]


def traced_tangents(
    scene: Scene, grid: "CellGrid", seed: tuple[int, int], max_order: int, faintest: float,
    lattice: Lattice = LARGE, lowest: int = 3, others: Sequence[PhaseFunction] = (),
) -> Array:  # fmt: skip
    """Image of one shifted lattice of paths, and its derivatives by σa, σs and the phase function.

    Parameters
    ----------
    scene, grid, seed, max_order, faintest, lattice
        As for `traced`.
    lowest
        Order that is recorded first, 2 or 3.
    others
        Phase functions that there is a derivative towards, see `tank_tangent`; none of them where the medium's is
        Henyey–Greenstein's, of which there is one by g.

    Returns
    -------
    (3 + k, rows, columns) array
        Orders from `lowest` in W/mm²/sr, from 3 the same as `traced` gives; their derivatives by
        σa, σs (times mm) and g, or by the share of the way to each of k others.
    """
    medium, geometry = scene.medium, geometry_of(scene)
    water, points, shiftable = water_for_paths(medium), Points(lattice.shifted(seed), lattice.points), grid.shiftable
    limits = PathLimits(max_order, faintest, THINNING, lowest=lowest)
    middles = (np.arange(grid.columns) + 0.5) * grid.cell_mm[0]
    scores = NO_SCORES if medium.phase is None else scores_towards(others, medium.phase)
    layers = LAYERS + scores.shape[1]
    cells = np.zeros((grid.rows, grid.columns, layers))
    found = np.zeros((layers, grid.rows, grid.columns))
    lit = [beam for beam in scene.projector.beams if beam.irradiance > 0.0]
    for z_mm in sorted({beam.z_mm for beam in lit}) if shiftable else [None]:
        beams = [beam for beam in lit if z_mm in (None, beam.z_mm)]
        power = np.array([beam.power for beam in beams])
        table = np.column_stack(
            [np.array([(*beam.y_mm, *beam.z_mm, beam.irradiance) for beam in beams]), np.cumsum(power) / power.sum()]
        )
        edges = np.zeros((2, grid.rows + 2, grid.columns + 2, layers) if shiftable else (0,) * 4)
        light = edges if shiftable else cells
        trace_tangents(light, grid.cell_mm, geometry, water, table, points, limits, scores)
        if z_mm is None:
            scale = power.sum() / (lattice.points * grid.cell_mm[0] * grid.cell_mm[1])
            found += cell_averages(np.moveaxis(cells, 2, 0) * scale)
            break
        image = image_of_edges(np.moveaxis(edges, 3, 0), medium.sigma_t, grid.cell_mm[0])
        image[2] += image[0] * middles  # a start's own way is where its light is seen, less where the path leads
        found += image * (sight_line(geometry, 0.0, 0.0)[3] * (z_mm[1] - z_mm[0]) / lattice.points)
    light, scattered, far = found[:LAYERS]
    return np.array([light, -far, scattered / medium.sigma_s - far, *found[LAYERS:]])


def scores_towards(others: Sequence[PhaseFunction], phase: PhaseFunction) -> Array:
    """(nodes, k) q/p − 1 at the nodes of a table, for k phase functions q; those of a node lie side by side.

    Examples
    --------
    >>> from tankrig.scene.phase_functions import TwoTerm
    >>> scores_towards([TwoTerm(0.8, -0.3, 0.9)], TwoTerm(0.8, -0.3, 0.9)).any()
    np.False_
    """
    table = np.maximum(phase.blunted, 1e-300)
    return np.array([other.blunted / table - 1.0 for other in others]).reshape(len(others), table.size).T.copy()

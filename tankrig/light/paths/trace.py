"""Light paths with many scatterings, started at the projector and seen by the camera at every scattering.

A path is a function of one lattice point and of the medium: every flight ends inside the tank (the chance that it does
is a factor of the path's weight) and nothing that depends on the medium is left to chance. So with the same points the
image is a smooth function of the medium.

Where light is scattered forward, few paths would ever turn towards the camera. Two further ways of drawing a direction
mend that, and the balance heuristic weighs the three so that none can make a contribution large:

* a share of the paths turns once, at an order fixed by its lattice point, into a wide lobe about the line of sight;
* at every scattering a probe for the last flight is drawn from a lobe about the line of sight.

The lobes are Henyey–Greenstein's with the phase function's mean cosine, whatever the phase function is.

`remaining + turned` below is the density of all ways to draw the path's directions, over that of plain scattering.

Paths are followed a block at a time, order by order, in loops that compilers vectorise (measured: 4× faster than path
by path).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.elementary import exponential
from tankrig.light.paths.block import (
    BLOCK,
    FLIGHT_COORDINATES,
    START_COORDINATES,
    UNTURNED,
    Block,
    Ends,
    PathLimits,
    PathSampling,
    Points,
    Step,
    across,
    begin,
    begin_at_origin,
    begin_on_beams,
    coordinate,
    draw_step,
    empty_block,
    fly,
    going_on,
    scattered,
    turns_at,
)
from tankrig.light.paths.record import (
    Bins,
    TallyRecord,
    column_of,
    empty_record,
    seen_from,
    tally_cells,
    tally_rectangles,
)
from tankrig.light.rays import Geometry, Ray
from tankrig.light.water import Water
from tankrig.scene.phase import (
    densities,
    drawn_cosines,
    henyey_greenstein,
    henyey_greenstein_cosine,
    phase_density,
)

Array = NDArray[np.float64]

PROBE_CHANCES, END_CHANCES = 2_000_000, 3_000_000
"""Coordinates of the lattice, far beyond its own and those of any order, that faint marks are chosen by."""


class Chances(NamedTuple):
    """By which some of the faint marks stand for all."""

    share: float
    """Of the usual mark: what is below is faint."""
    dimension: int
    """Of the lattice's coordinate."""
    lattice: Array
    usual: Array
    """Sum of all marks of this order in the blocks before, faint or not, and their number; added to."""


@kernel
def trace(
    images: Array, bins: Bins, cell_mm: tuple[float, float], geometry: Geometry, water: Water, beams: Array,
    points: Points, limits: PathLimits,
) -> None:  # fmt: skip
    """Follow the paths of lattice points and record their orders ≥ 3, or from another on.

        I_n = 1/N Σ_paths w_n p(cos θ) e^{−σt s} T J / (area of a cell),   w_n = w_{n−1} ϖ (chance to collide) p/q

    with s the way to the surface, T J `seen_from`'s factor, and q the density that the direction is drawn with.

    Where light is collimated and the camera orthographic, a path may be drawn relative to its first collision and
    stand for all that begin anywhere on the beams and stay between the walls. Which of the two is done, and compiled,
    the number of axes of `images` says.

    Parameters
    ----------
    images
        Added to: (images, 2, rows + 2, columns + 2) by `tally_rectangles` for paths that begin anywhere,
        (images, rows, columns) by `tally_cells` for others.
    bins
        Index of the image that each order goes to.
    cell_mm
        Size of the cells along x and y, mm.
    geometry, water
        Numbers of the scene.
    beams
        (n, 6): y low, y high, z low, z high on the plane x = 0, irradiance, and the share of the power up to and
        including this beam. Of paths that begin anywhere all have the same z.
    points
        That paths are functions of.
    limits
        Where they end.
    """
    sigma_t, albedo, phase = water
    lattice, stop = points
    max_order, faintest, first_thinning, turns, faintest_mark, lowest = limits
    sampling = PathSampling(sigma_t, albedo, phase, phase.g > 0.3, (1.0 - UNTURNED) / turns)
    block, tally = empty_block(), empty_record(BLOCK)
    usual = np.zeros((2, max_order))
    u, v, w = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    probes = Ends(np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK))
    for first in range(0, stop, BLOCK):
        n = min(BLOCK, stop - first)
        if images.ndim == 4:
            begin_at_origin(block, n, first, geometry, sampling, beams, lattice)
        else:
            begin_on_beams(block, n, first, geometry, sampling, beams, lattice)
            look(block, n, geometry, sigma_t)
        begin(block, n, first, sampling, lattice, faintest)
        for order in range(1, max_order):
            n = going_on(block, n, order, first_thinning, lattice, images.ndim == 4)
            if n == 0:
                break
            remaining = 1.0 - sampling.per_turn * min(order - 1, turns) if sampling.guided else 1.0
            dimension = START_COORDINATES + (order - 1) * FLIGHT_COORDINATES
            image = bins[min(order + 1, bins.size - 1)]
            step = Step(order, remaining, u, v, w)
            if sampling.guided and order >= 2:
                draw_step(step, block.point, n, dimension + 3, lattice)
                if images.ndim == 4:
                    _probe_anywhere(probes, block, step, n, geometry, sampling)
                    chances = Chances(faintest_mark, PROBE_CHANCES + order, lattice, usual[:, order])
                    marks = _mark(tally, probes, block, n, geometry, sampling, cell_mm[0], chances)
                    tally_rectangles(images[image], tally, marks, beams, geometry.half_width, cell_mm[1])
                else:
                    _probe(tally, block, step, n, geometry, sampling)
                    tally_cells(images[image], tally.x, tally.y, tally.value, n, geometry.half_width, cell_mm)
            draw_step(step, block.point, n, dimension, lattice)
            scatter(block, step, n, sampling)
            advance(block, step, n, geometry, sampling)
            if images.ndim == 4:
                narrow(block, n, geometry)
            else:
                look(block, n, geometry, sigma_t)
            if order + 1 < lowest:
                continue
            if images.ndim == 4:
                ends = Ends(block.x, block.y, block.z, block.dz, block.seen)
                chances = Chances(faintest_mark, END_CHANCES + order, lattice, usual[:, order])
                marks = _mark(tally, ends, block, n, geometry, sampling, cell_mm[0], chances)
                tally_rectangles(images[image], tally, marks, beams, geometry.half_width, cell_mm[1])
            else:
                arrive(tally, block, n, sampling)
                tally_cells(images[image], block.seen_x, block.seen_y, tally.value, n, geometry.half_width, cell_mm)


@kernel
def look(block: Block, n: int, geometry: Geometry, sigma_t: float) -> None:
    """Lines of sight through the ends of paths."""
    if geometry.refractive_index == 1.0:
        for i in range(n):
            _look_from(block, i, geometry, 1.0, sigma_t)
    else:
        for i in range(n):
            _look_from(block, i, geometry, geometry.refractive_index, sigma_t)


@part
def _look_from(block: Block, i: int, geometry: Geometry, index: float, sigma_t: float) -> None:
    seen_x, seen_y, sx, sy, sz, path, factor = seen_from(geometry, block.x[i], block.y[i], block.z[i], index)
    block.seen_x[i], block.seen_y[i], block.sx[i], block.sy[i], block.sz[i] = seen_x, seen_y, sx, sy, sz
    block.reaches[i] = factor * exponential(-sigma_t * path)


@kernel
def narrow(block: Block, n: int, geometry: Geometry) -> None:
    """Leave out the starts for which the path has left the tank."""
    for i in range(n):
        block.x_low[i] = max(block.x_low[i], -block.x[i])
        block.x_high[i] = min(block.x_high[i], geometry.length - block.x[i])
        block.y_low[i] = max(block.y_low[i], -geometry.half_width - block.y[i])
        block.y_high[i] = min(block.y_high[i], geometry.half_width - block.y[i])


@part
def probe_way(
    block: Block, step: Step, i: int, geometry: Geometry, sampling: PathSampling, index: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """A last flight in a direction from the lobe about the line of sight.

    Returns
    -------
    x, y, z, dx, dy, dz, chance
        Where it leads, its direction there, and the chance that it collides inside.
    turn, ahead
        Cosines of its direction with the path's before, and with the line of sight.
    """
    dx, dy, dz = block.dx[i], block.dy[i], block.dz[i]
    sx, sy, sz = block.sx[i], block.sy[i], block.sz[i]
    rx, ry, rz = across(sx, sz)
    px, py, pz, _, _, _ = scattered(
        sx, sy, sz, rx, ry, rz, henyey_greenstein_cosine(step.u[i], sampling.phase.g), step.v[i]
    )  # fmt: skip
    turn = px * dx + py * dy + pz * dz
    ahead = px * sx + py * sy + pz * sz
    qx, qy, qz, pz, chance = fly(
        _walls(block, i, geometry), geometry.height, index, sampling.sigma_t,
        Ray(block.x[i], block.y[i], block.z[i], px, py, pz), step.w[i],
    )  # fmt: skip
    return qx, qy, qz, px, py, pz, chance, turn, ahead


@part
def probe_weight(
    block: Block, step: Step, i: int, sampling: PathSampling, chance: float, plain: float, ahead: float
) -> float:
    """The weight that is scattered at the end of `probe_way`, `plain` being p of its turn.

    Scattering has yet to turn the light into the camera. With h the lobe, q the wide one, and r what has remained and
    turned, the weight grows by ϖ (chance to collide) p/(r (h + p) + (share that turns here) (q − p)).
    """
    before = step.remaining + block.turned[i]
    per_turn = sampling.per_turn if turns_at(step.order, sampling) else 0.0
    density = before * (henyey_greenstein(ahead, sampling.phase.g) + plain) + per_turn * (
        _wide_lobe(ahead, sampling.phase.g) - plain
    )
    weight: float = block.weight[i] * chance * sampling.albedo * plain / density
    return weight


@part
def probed(
    block: Block, step: Step, i: int, geometry: Geometry, sampling: PathSampling, index: float
) -> tuple[float, float, float, float, float, float, float]:
    """A probe: where it leads, its direction there, and the weight that is scattered there."""
    x, y, z, dx, dy, dz, chance, turn, ahead = probe_way(block, step, i, geometry, sampling, index)
    weight = probe_weight(block, step, i, sampling, chance, phase_density(turn, sampling.phase), ahead)
    return x, y, z, dx, dy, dz, weight


@part
def _walls(block: Block, i: int, geometry: Geometry) -> tuple[float, float, float, float]:
    """Side walls for a path that may be moved: beyond them it has left the tank wherever it began."""
    return (
        -block.x_high[i], geometry.length - block.x_low[i],
        -geometry.half_width - block.y_high[i], geometry.half_width - block.y_low[i],
    )  # fmt: skip


@kernel
def _probe(tally: TallyRecord, block: Block, step: Step, n: int, geometry: Geometry, sampling: PathSampling) -> None:
    """What probes send to the camera."""
    if geometry.refractive_index == 1.0:
        for i in range(n):
            _probe_from(tally, block, step, i, geometry, 1.0, sampling)
    else:
        for i in range(n):
            _probe_from(tally, block, step, i, geometry, geometry.refractive_index, sampling)


@part
def _probe_from(
    tally: TallyRecord, block: Block, step: Step, i: int, geometry: Geometry, index: float, sampling: PathSampling
) -> None:
    x, y, z, dx, dy, dz, weight = probed(block, step, i, geometry, sampling, index)
    tally.x[i], tally.y[i], sx, sy, sz, path, factor = seen_from(geometry, x, y, z, index)
    phase = phase_density(dx * sx + dy * sy + dz * sz, sampling.phase)
    tally.value[i] = weight * phase * factor * exponential(-sampling.sigma_t * path)


@kernel
def arrive(tally: TallyRecord, block: Block, n: int, sampling: PathSampling) -> None:
    """What the ends of paths send to the camera."""
    for i in range(n):
        tally.value[i] = block.dx[i] * block.sx[i] + block.dy[i] * block.sy[i] + block.dz[i] * block.sz[i]
    densities(tally.value, tally.value, n, sampling.phase)
    for i in range(n):
        tally.value[i] *= block.seen[i] * block.reaches[i]


@kernel
def _probe_anywhere(probes: Ends, block: Block, step: Step, n: int, geometry: Geometry, sampling: PathSampling) -> None:
    """Probes of paths that may begin anywhere."""
    if len(sampling.phase) == 2:
        if geometry.refractive_index == 1.0:
            for i in range(n):
                _probe_from_anywhere(probes, block, step, i, geometry, 1.0, sampling)
        else:
            for i in range(n):
                _probe_from_anywhere(probes, block, step, i, geometry, geometry.refractive_index, sampling)
    else:  # see `densities`
        cosines = np.empty((2, n))
        if geometry.refractive_index == 1.0:
            for i in range(n):
                _send_probe(probes, cosines, block, step, i, geometry, 1.0, sampling)
        else:
            for i in range(n):
                _send_probe(probes, cosines, block, step, i, geometry, geometry.refractive_index, sampling)
        plain, ahead = cosines
        densities(plain, plain, n, sampling.phase)
        for i in range(n):
            probes.weight[i] = probe_weight(block, step, i, sampling, probes.weight[i], plain[i], ahead[i])


@part
def _probe_from_anywhere(
    probes: Ends, block: Block, step: Step, i: int, geometry: Geometry, index: float, sampling: PathSampling
) -> None:
    x, y, z, _, _, dz, weight = probed(block, step, i, geometry, sampling, index)
    probes.x[i], probes.y[i], probes.z[i], probes.dz[i], probes.weight[i] = x, y, z, dz, weight


@part
def _send_probe(
    probes: Ends, cosines: Array, block: Block, step: Step, i: int, geometry: Geometry, index: float,
    sampling: PathSampling,
) -> None:  # fmt: skip
    """A probe whose weight is no more than its chance so far, and the cosines (2, n) that the rest depends on."""
    x, y, z, _, _, dz, chance, cosines[0, i], cosines[1, i] = probe_way(block, step, i, geometry, sampling, index)
    probes.x[i], probes.y[i], probes.z[i], probes.dz[i], probes.weight[i] = x, y, z, dz, chance


@kernel
def cover(
    tally: TallyRecord, ends: Ends, block: Block, n: int, geometry: Geometry, sampling: PathSampling, cell_mm: float
) -> None:
    """What paths send to the camera, for all their starts x', whose light goes with exp(−σt x')."""
    up = np.empty(n)
    densities(up, ends.dz, n, sampling.phase)
    for i in range(n):
        x = ends.x[i]
        low, high = max(block.x_low[i], -x), min(block.x_high[i], geometry.length - x)
        value = ends.weight[i] * up[i]
        value = value * exponential(-sampling.sigma_t * (geometry.height - ends.z[i])) if high > low else 0.0
        tally.value[i] = value
        tally.first[i], tally.first_part[i], tally.first_on[i] = column_of(low, x, sampling.sigma_t, value, cell_mm)
        tally.last[i], tally.last_part[i], tally.last_on[i] = column_of(high, x, sampling.sigma_t, value, cell_mm)
    for i in range(n):
        y = ends.y[i]
        tally.y[i] = y
        tally.y_low[i] = max(block.y_low[i], -geometry.half_width - y)
        tally.y_high[i] = min(block.y_high[i], geometry.half_width - y)


@kernel
def _mark(
    tally: TallyRecord, ends: Ends, block: Block, n: int, geometry: Geometry, sampling: PathSampling, cell_mm: float,
    chances: Chances,
) -> int:  # fmt: skip
    """The same, where faint marks may be left by chance: how many there are to leave."""
    if chances.share > 0.0:
        return _cover_some(tally, ends, block, n, geometry, sampling, cell_mm, chances)
    cover(tally, ends, block, n, geometry, sampling, cell_mm)
    return n


@kernel
def _cover_some(
    tally: TallyRecord, ends: Ends, block: Block, n: int, geometry: Geometry, sampling: PathSampling, cell_mm: float,
    chances: Chances,
) -> int:  # fmt: skip
    """All bright marks, and of the faint ones some, each as bright as is usual: a mark takes longer than a step.

    A mark of the value v is left with the chance v/faint, so that nothing is lost on average.
    """
    light, marks = chances.usual
    faint = chances.share * light / marks if marks > 0.0 else 0.0
    densities(tally.value, ends.dz, n, sampling.phase)
    for i in range(n):
        value = ends.weight[i] * tally.value[i]
        tally.value[i] = value * exponential(-sampling.sigma_t * (geometry.height - ends.z[i]))
    k = 0
    for i in range(n):
        x, y, value = ends.x[i], ends.y[i], tally.value[i]
        low, high = max(block.x_low[i], -x), min(block.x_high[i], geometry.length - x)
        if high <= low:
            continue
        chances.usual[0] += value
        if value < faint:
            if coordinate(int(block.point[i]), chances.dimension, chances.lattice) * faint >= value:
                continue
            value = faint
        tally.value[k] = value
        tally.first[k], tally.first_part[k], tally.first_on[k] = column_of(low, x, sampling.sigma_t, value, cell_mm)
        tally.last[k], tally.last_part[k], tally.last_on[k] = column_of(high, x, sampling.sigma_t, value, cell_mm)
        tally.y[k] = y
        tally.y_low[k] = max(block.y_low[i], -geometry.half_width - y)
        tally.y_high[k] = min(block.y_high[i], geometry.half_width - y)
        k += 1
    chances.usual[1] += n
    return k


@kernel
def scatter(block: Block, step: Step, n: int, sampling: PathSampling) -> None:
    """Draw new directions."""
    phase = sampling.phase
    if len(phase) == 2:
        for i in range(n):
            ox, oy, oz = block.dx[i], block.dy[i], block.dz[i]
            _turn(block, step, i, henyey_greenstein_cosine(step.u[i], phase.g), phase.g)
            cosine = block.dx[i] * ox + block.dy[i] * oy + block.dz[i] * oz
            _count_ways(block, step, i, henyey_greenstein(cosine, phase.g), sampling)
    else:  # see `densities`
        drawn, plain = np.empty(n), np.empty(n)
        drawn_cosines(drawn, step.u, n, phase)
        for i in range(n):
            ox, oy, oz = block.dx[i], block.dy[i], block.dz[i]
            _turn(block, step, i, drawn[i], phase.g)
            plain[i] = block.dx[i] * ox + block.dy[i] * oy + block.dz[i] * oz
        densities(plain, plain, n, phase)
        for i in range(n):
            _count_ways(block, step, i, plain[i], sampling)


@part
def _turn(block: Block, step: Step, i: int, drawn: float, g: float) -> None:
    """A new direction, at an angle of the cosine `drawn` unless the path turns into a lobe."""
    sx, sy, sz = block.sx[i], block.sy[i], block.sz[i]
    turns, wide = block.turn[i] == step.order, step.v[i] < 0.5
    rx, ry, rz = across(sx, sz)
    block.dx[i], block.dy[i], block.dz[i], block.ex[i], block.ey[i], block.ez[i] = scattered(
        sx if turns else block.dx[i], sy if turns else block.dy[i], sz if turns else block.dz[i],
        rx if turns else block.ex[i], ry if turns else block.ey[i], rz if turns else block.ez[i],
        henyey_greenstein_cosine(step.u[i], g**2 if wide else g**4) if turns else drawn,
        (2.0 * step.v[i] - (0.0 if wide else 1.0)) if turns else step.v[i],
    )  # fmt: skip


@part
def _count_ways(block: Block, step: Step, i: int, plain: float, sampling: PathSampling) -> None:
    """All ways to draw the new direction, `plain` being p of its turn."""
    g = sampling.phase.g
    per_turn = sampling.per_turn if sampling.guided and turns_at(step.order, sampling) else 0.0
    probed = 1.0 if sampling.guided and step.order >= 2 else 0.0
    ahead = block.dx[i] * block.sx[i] + block.dy[i] * block.sy[i] + block.dz[i] * block.sz[i]
    before = step.remaining + block.turned[i]
    after = before + per_turn * (_wide_lobe(ahead, g) / plain - 1.0)
    block.turned[i] = after - (step.remaining - per_turn)
    block.share[i] = 1.0 / (after + probed * before * henyey_greenstein(ahead, g) / plain)


@kernel
def advance(block: Block, step: Step, n: int, geometry: Geometry, sampling: PathSampling) -> None:
    """Follow paths to their next collision."""
    if geometry.refractive_index == 1.0:
        for i in range(n):
            _advance_path(block, step.w, i, geometry, 1.0, sampling)
    else:
        for i in range(n):
            _advance_path(block, step.w, i, geometry, geometry.refractive_index, sampling)


@part
def _advance_path(block: Block, w: Array, i: int, geometry: Geometry, index: float, sampling: PathSampling) -> None:
    dz = block.dz[i]
    block.x[i], block.y[i], block.z[i], after, chance = fly(
        _walls(block, i, geometry), geometry.height, index, sampling.sigma_t,
        Ray(block.x[i], block.y[i], block.z[i], block.dx[i], block.dy[i], dz), w[i],
    )  # fmt: skip
    block.dz[i], block.ez[i] = after, block.ez[i] if after == dz else -block.ez[i]  # reflected at the surface
    weight = block.weight[i] * chance * sampling.albedo
    block.weight[i], block.seen[i] = weight, weight * block.share[i]


@part
def _wide_lobe(cosine: float, g: float) -> float:
    """Density of the directions of a turn: lobes as wide as after two and after four scatterings."""
    return 0.5 * (henyey_greenstein(cosine, g**2) + henyey_greenstein(cosine, g**4))

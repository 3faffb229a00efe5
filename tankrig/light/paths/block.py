"""Blocks of light paths: what is known of each path, how they begin, and which are still to be followed."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.paths.flight import fly
from tankrig.light.paths.lattice import coordinate
from tankrig.light.rays import Geometry, light_ray

Array = NDArray[np.float64]

START_COORDINATES = 4
FLIGHT_COORDINATES = 6
UNTURNED = 0.4
"""Share of the paths that are scattered by the phase function alone."""
TURNS = 12
"""The other paths turn at one of this many first scatterings."""
BLOCK = 1024
"""Paths that are followed together."""


class Block(NamedTuple):
    """Paths that are followed together; of each array the first n are in use."""

    all: Array
    """(rows, BLOCK): the arrays below."""
    point: Array
    """Of the lattice."""
    x: Array
    y: Array
    z: Array
    dx: Array
    dy: Array
    dz: Array
    ex: Array
    """Reference across the direction, from which azimuths are counted."""
    ey: Array
    ez: Array
    weight: Array
    limit: Array
    """Weight at which the path ends."""
    turn: Array
    """Order at which the path turns, or 0."""
    turned: Array
    share: Array
    """1 over the density of all ways to draw the path and its last flight."""
    seen: Array
    """Weight times share: what counts for the camera."""
    x_low: Array
    """Starts for which the path is inside the tank, where it may be moved; else 0."""
    x_high: Array
    y_low: Array
    y_high: Array
    sx: Array
    """Line of sight through the path's end."""
    sy: Array
    sz: Array
    seen_x: Array
    """Where it leaves the surface."""
    seen_y: Array
    reaches: Array
    """What of the light along it reaches the camera, 1/sr per W: attenuation and `seen_from`'s factor."""


ROWS = len(Block._fields) - 1


class Ends(NamedTuple):
    """Where paths, or probes, end."""

    x: Array
    y: Array
    z: Array
    dz: Array
    """Of the direction in which they come."""
    weight: Array


class PathSampling(NamedTuple):
    """Of the water, and how directions are drawn in it."""

    sigma_t: float
    albedo: float
    g: float
    guided: bool
    per_turn: float
    """Share of the paths that turn at one given order."""


@part
def empty_block() -> Block:
    """Room for a block of paths."""
    rows = np.zeros((ROWS, BLOCK))
    return Block(
        rows, rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7], rows[8], rows[9], rows[10],
        rows[11], rows[12], rows[13], rows[14], rows[15], rows[16], rows[17], rows[18], rows[19], rows[20], rows[21],
        rows[22], rows[23], rows[24], rows[25],
    )  # fmt: skip


@kernel
def begin_at_origin(
    block: Block, n: int, first: int, geometry: Geometry, sampling: PathSampling, beams: Array, lattice: Array
) -> None:
    """Paths relative to their first collision, which may be anywhere on the beams."""
    farthest = min(geometry.length, 40.0 / sampling.sigma_t)  # what begins deeper is fainter than any rounding
    low, high = beams[0, 0], beams[0, 1]
    for beam in range(beams.shape[0]):
        low, high = min(low, beams[beam, 0]), max(high, beams[beam, 1])
    for i in range(n):
        block.x[i] = block.y[i] = 0.0
        block.z[i] = beams[0, 2] + coordinate(first + i, 0, lattice) * (beams[0, 3] - beams[0, 2])
        block.dx[i], block.dy[i], block.dz[i] = 1.0, 0.0, 0.0
        block.weight[i] = sampling.albedo * sampling.sigma_t
        block.x_low[i], block.x_high[i], block.y_low[i], block.y_high[i] = 0.0, farthest, low, high
        block.sx[i], block.sy[i], block.sz[i] = 0.0, 0.0, 1.0


@kernel
def begin_on_beams(
    block: Block, n: int, first: int, geometry: Geometry, sampling: PathSampling, beams: Array, lattice: Array
) -> None:
    """Paths at their first collision."""
    for i in range(n):
        beam, across = _beam_of(beams, coordinate(first + i, 1, lattice))
        block.y[i] = beams[beam, 0] + across * (beams[beam, 1] - beams[beam, 0])
        block.z[i] = beams[beam, 2] + coordinate(first + i, 0, lattice) * (beams[beam, 3] - beams[beam, 2])
        block.x_low[i] = block.x_high[i] = block.y_low[i] = block.y_high[i] = 0.0
    walls = (0.0, geometry.length, -geometry.half_width, geometry.half_width)
    for i in range(n):
        y0, z0 = block.y[i], block.z[i]
        dx, dy, dz = light_ray(geometry, y0, z0)
        block.x[i], block.y[i], block.z[i], dz, chance = fly(
            walls, geometry.height, geometry.refractive_index, sampling.sigma_t, 0.0, y0, z0, dx, dy, dz,
            coordinate(first + i, 2, lattice),
        )  # fmt: skip
        block.dx[i], block.dy[i], block.dz[i] = dx, dy, dz
        block.weight[i] = sampling.albedo * chance


@kernel
def begin(block: Block, n: int, first: int, sampling: PathSampling, lattice: Array, faintest: float) -> None:
    """What all paths begin with besides place, direction and weight."""
    for i in range(n):
        block.point[i] = first + i
        block.ex[i], block.ey[i], block.ez[i] = across(block.dx[i], block.dz[i])
        block.limit[i] = faintest * block.weight[i]
        choice = (coordinate(first + i, 3, lattice) - UNTURNED) / sampling.per_turn
        block.turn[i] = 1.0 + math.floor(choice) if sampling.guided and choice >= 0.0 else 0.0
        block.turned[i] = 0.0


@kernel
def thin(block: Block, n: int, every: int) -> None:
    """End every other path, by its lattice point, and let the others stand for them."""
    for i in range(n):
        stays = (int(block.point[i]) // every) % 2 == 0
        block.weight[i] *= 2.0 if stays else 0.0
        block.limit[i] *= 2.0


@kernel
def alive(block: Block, n: int, shiftable: bool) -> int:
    """Mark paths that have ended by the weight 0, and move up the others when they have become few: how many to follow.

    Ended are faint paths and those that leave the tank wherever they may begin.
    """
    moved = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        inside = not shiftable or (block.x_high[i] > block.x_low[i] and block.y_high[i] > block.y_low[i])
        if block.weight[i] > block.limit[i] and inside:
            moved[count] = i
            count += 1
        else:
            block.weight[i] = 0.0
    if count > 0.8 * n:
        return n
    for row in block.all:
        for i in range(count):
            row[i] = row[moved[i]]
    return count


@kernel
def draw(coordinates: Array, points: Array, n: int, dimension: int, lattice: Array) -> None:
    """One coordinate of all paths."""
    for i in range(n):
        coordinates[i] = coordinate(int(points[i]), dimension, lattice)


@part
def across(dx: float, dz: float) -> tuple[float, float, float]:
    """A unit vector across a direction that is not along y, from its x and z."""
    scale = math.sqrt(dx * dx + dz * dz)
    return -dz / scale, 0.0, dx / scale


@part
def _beam_of(beams: Array, u: float) -> tuple[int, float]:
    """The beam that a number of [0, 1) falls on, and how far across it."""
    beam, before = 0, 0.0
    while beam < beams.shape[0] - 1 and u >= beams[beam, 5]:
        before = beams[beam, 5]
        beam += 1
    return beam, min(max((u - before) / (beams[beam, 5] - before), 0.0), 1.0)

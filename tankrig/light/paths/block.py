"""Light paths: the points of a lattice that they are drawn from, their steps, and blocks of them.

A lattice is of rank 1 and shifted at random. The generating vectors were found component by component for smooth
periodic functions (Korobov space of smoothness 1, product weights 0.6 · 0.85^j); shifting a lattice at random makes
averages unbiased and shows their error.

A step is a new direction, and a flight to the next collision inside the tank; it is free of branches and calls, so
that loops over the paths of a block are vectorised. Of a block it is known where each path is, how it began, and
whether it is still to be followed.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import reflectance
from tankrig.light.elementary import circle, log_one_minus, one_minus_exponential
from tankrig.light.rays import Geometry, Ray, light_ray
from tankrig.scene.phase_table import PhaseRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lattice:
    """A rank-1 lattice.

    Parameters
    ----------
    points
        How many, a prime.
    vector
        Its generating vector; dimensions beyond it are random.
    """

    points: int
    vector: tuple[int, ...]

    def shifted(self, seed: tuple[int, int]) -> Array:
        """(2, dimensions) array for `coordinate`: steps from point to point, and the shift drawn from `seed`."""
        return np.array([np.array(self.vector) / self.points, np.random.default_rng(seed).random(len(self.vector))])


LARGE = Lattice(
    16381,
    (1, 3711, 5711, 13060, 7766, 9236, 14053, 1873, 7793, 8459, 3605, 2582, 6806, 4796, 8934, 9442, 11037, 5041, 1034,
     15372, 15617, 11275, 2991, 7961, 11101, 4158, 15912, 7644, 5777, 4623, 15818, 75, 4123, 13920, 9562, 1969, 4133,
     1954, 7938, 6556, 2194, 242, 14941, 6825, 5944, 8057, 785, 8667),
)  # fmt: skip
"""A tenth less noise per path."""

SMALL = Lattice(
    4093,
    (1, 2378, 3641, 3804, 509, 328, 3086, 2973, 768, 925, 2864, 1490, 536, 897, 2883, 3511, 3998, 3406, 3919, 311, 3717,
     2054, 3575, 3016, 1354, 400, 3689, 1174, 2209, 2952, 382, 3817, 1697, 296, 2515, 1248, 3239, 1463, 3080, 746, 2071,
     2592, 3368, 914, 1576, 653, 3820, 3658),
)  # fmt: skip
"""Finer steps in time where few paths do."""


@part
def coordinate(point: int, dimension: int, lattice: Array) -> float:
    """Coordinate in [0, 1) of a point of a shifted lattice; beyond the lattice's dimensions a hash of all that."""
    if dimension < lattice.shape[1]:
        value: float = point * lattice[0, dimension] + lattice[1, dimension]
        return value - math.floor(value)
    state = np.uint64(point) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(dimension) * np.uint64(0xD1B54A32D192ED03)
    state += np.uint64(lattice[1, 0] * 9007199254740992.0)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    state ^= state >> np.uint64(31)
    return float(state >> np.uint64(11)) / 9007199254740992.0


@part
def scattered(
    dx: float, dy: float, dz: float, ex: float, ey: float, ez: float, cosine: float, v: float
) -> tuple[float, float, float, float, float, float]:
    """A direction at a drawn angle from another one, and the reference it takes along.

    The azimuth is counted from a reference that is carried from scattering to scattering. A frame made anew from each
    direction would jump somewhere on the sphere, and the image with it as the medium changes.

    Parameters
    ----------
    dx, dy, dz
        Direction before, a unit vector.
    ex, ey, ez
        Unit vector across it that the azimuth is counted from.
    cosine
        Of the angle.
    v
        Coordinate in [0, 1) for the azimuth.

    Returns
    -------
    dx, dy, dz, ex, ey, ez
        Direction after, and its reference.
    """
    sine = math.sqrt(1.0 - cosine * cosine)
    a, b = circle(v)
    ax = a * ex + b * (dy * ez - dz * ey)
    ay = a * ey + b * (dz * ex - dx * ez)
    az = a * ez + b * (dx * ey - dy * ex)
    # Rounding would grow by a third with every scattering, and be all there is after some 150: one Newton step each
    # makes the lengths 1 again, and the reference one across the direction.
    nx, ny, nz = cosine * dx + sine * ax, cosine * dy + sine * ay, cosine * dz + sine * az
    scale = 1.5 - 0.5 * (nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    fx, fy, fz = cosine * ax - sine * dx, cosine * ay - sine * dy, cosine * az - sine * dz
    along = fx * nx + fy * ny + fz * nz
    fx, fy, fz = fx - along * nx, fy - along * ny, fz - along * nz
    scale = 1.5 - 0.5 * (fx * fx + fy * fy + fz * fz)
    return nx, ny, nz, fx * scale, fy * scale, fz * scale


@part
def fly(
    walls: tuple[float, float, float, float], height: float, index: float, sigma_t: float, ray: Ray, u: float
) -> tuple[float, float, float, float, float]:
    """The next collision inside the tank.

    It collides after the way s with the density σt e^{−σt s}; a Fresnel surface sends light back with R(ξ), and the way
    goes on below it. With a the way to the first wall, and b the way on from the surface to the next,

        chance = (1 − e^{−σt a}) + R e^{−σt a} (1 − e^{−σt b}).

    Parameters
    ----------
    walls
        x low, x high, y low, y high of the tank's side walls, mm; its floor is z = 0.
    height, index
        Of the surface: z, and the refractive index that it shows.
    sigma_t
        Extinction, 1/mm.
    ray
        Where the light is and its direction.
    u
        Coordinate in [0, 1) that picks the place.

    Returns
    -------
    x, y, z, dz, chance
        Where it collides, its vertical direction there, and the chance that it collides inside.
    """
    x, y, z, dx, dy, dz = ray
    ux = dx if abs(dx) > 1e-12 else 1e-12
    uy = dy if abs(dy) > 1e-12 else 1e-12
    uz = dz if abs(dz) > 1e-12 else 1e-12
    across = ((walls[1] if ux > 0.0 else walls[0]) - x) / ux
    along = ((walls[3] if uy > 0.0 else walls[2]) - y) / uy
    rise = max(((height if uz > 0.0 else 0.0) - z) / uz, 0.0)
    sides = max(min(across, along), 0.0)
    leave = min(sides, rise)
    inside = one_minus_exponential(-sigma_t * leave)
    meets = index > 1.0 and dz > 0.0 and rise < sides
    further = min(sides - rise, height / uz) if meets else 0.0
    back = (1.0 - inside) * reflectance(dz, index) if meets else 0.0
    chance = inside + back * one_minus_exponential(-sigma_t * further)
    wanted = u * chance
    turns = wanted > inside
    part_way = (wanted - inside) / back if turns else min(wanted, inside)
    depth = min(-log_one_minus(min(part_way, 1.0)) / sigma_t, further if turns else leave)
    way = rise + depth if turns else depth
    end = height - dz * depth if turns else z + dz * depth
    return x + dx * way, y + dy * way, end, -dz if turns else dz, chance


START_COORDINATES = 4
FLIGHT_COORDINATES = 6
UNTURNED = 0.4
"""Share of the paths that are scattered by the phase function alone."""
TURNS = 12
"""The other paths turn at one of this many first scatterings, unless another number is asked for."""
BLOCK = 1024
"""Paths that are followed together."""


class Block(NamedTuple):
    """Paths that are followed together; of each array the first n are in use."""

    all: Array
    """(rows, BLOCK): the arrays below."""
    point: Array
    """Number of the path's point in the lattice."""
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
    phase: PhaseRecord
    guided: bool
    per_turn: float
    """Share of the paths that turn at one given order."""


class Step(NamedTuple):
    """A new direction and a flight of all paths of a block: which step it is, and what it is drawn by."""

    order: int
    remaining: float
    """Share of the paths that have not turned before it."""
    u: Array
    """Coordinates in [0, 1): two of a direction, and one of a flight's length."""
    v: Array
    w: Array


class PathLimits(NamedTuple):
    """How far paths are followed, how many of them, and where they turn."""

    max_order: int
    """Highest order to follow."""
    faintest: float
    """Share of its starting weight below which a path ends by chance, and stands for others where it doesn't."""
    first_thinning: int
    """From this order on, every doubling of the order halves the paths: later orders are smoother."""
    turns: int = TURNS
    """Paths that turn to the camera do so at one of this many first scatterings."""
    faintest_mark: float = 0.0
    """Share of the usual mark of its order below which a mark is left by chance and stands for others, where paths may
    begin anywhere; with 0 all are left, and the image is a smooth function of the medium."""
    lowest: int = 3
    """Order that is recorded first."""


class Points(NamedTuple):
    """The first points of a shifted lattice, as `Lattice.shifted` gives it."""

    lattice: Array
    number: int


@part
def turns_at(order: int, sampling: PathSampling) -> bool:
    """Whether some paths turn at this order."""
    return order * sampling.per_turn < 1.0 - UNTURNED + 0.5 * sampling.per_turn


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
            walls, geometry.height, geometry.refractive_index, sampling.sigma_t, Ray(0.0, y0, z0, dx, dy, dz),
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


SPARED = 0.25
"""Share of the faint paths that go on, for all of them."""
CHANCE_COORDINATES = 1_000_000
"""Of the lattice, far beyond its own and those of any order: what paths are spared by."""


@kernel
def spare_some(block: Block, n: int, order: int, lattice: Array) -> None:
    """Let some paths that have become faint stand for all of them, so that no light is lost where paths end."""
    for i in range(n):
        if (
            0.0 < block.weight[i] <= block.limit[i]
            and coordinate(int(block.point[i]), CHANCE_COORDINATES + order, lattice) < SPARED
        ):
            block.weight[i] *= 1.0 / SPARED


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
def going_on(block: Block, n: int, order: int, first_thinning: int, lattice: Array, shiftable: bool) -> int:
    """Thin out, spare and end paths before they are scattered once more: how many are left to follow.

    At `first_thinning` and at each order twice as high half of the paths are left out.
    """
    times = order // first_thinning
    if times > 0 and times * first_thinning == order and times & (times - 1) == 0:
        thin(block, n, times)
    spare_some(block, n, order, lattice)
    return alive(block, n, shiftable)


@kernel
def draw_step(step: Step, points: Array, n: int, dimension: int, lattice: Array) -> None:
    """Three coordinates of all paths, from one on."""
    _draw(step.u, points, n, dimension, lattice)
    _draw(step.v, points, n, dimension + 1, lattice)
    _draw(step.w, points, n, dimension + 2, lattice)


@kernel
def _draw(coordinates: Array, points: Array, n: int, dimension: int, lattice: Array) -> None:
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

"""Light paths that meet a wall or the floor: what all that is scattered on them adds to the image.

A path is a function of one point of a lattice and of the medium, as those of `tankrig.light.paths` are, and what is
left to chance does not depend on the medium. Light that meets a clear face goes on with the share that comes back;
what meets a diffuse face comes back in all directions. At every scattering, and on diffuse faces, a path is seen by
the camera: directly if it has met a face before, and mirrored in clear faces.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import reflectance
from tankrig.light.elementary import exponential, log_one_minus, one_minus_exponential
from tankrig.light.paths.block import CHANCE_COORDINATES, LARGE, SPARED, Points, across, coordinate, scattered
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.record import Bins, cell_averages, seen_from
from tankrig.light.rays import Ray, geometry_of, light_ray
from tankrig.light.walls.faces import (
    DIFFUSE,
    ENTRY,
    FAR,
    FLOOR,
    LEFT,
    RIGHT,
    ReflectingTank,
    face_table,
    sent_back,
    steepest_sights,
)
from tankrig.light.water import Water, water_for_paths
from tankrig.scene import Scene
from tankrig.scene.phase import drawn_cosine, phase_density

Array = NDArray[np.float64]

LATTICES = 4
"""Of these paths for one of the others: they are a small part of the image, and take as little time."""
STRETCHES = 12
"""Straight stretches of one flight at most; light that has met so many faces is faint."""
FAINT = 1e-4
"""Share of a flight's light that is left when the flight ends."""
FLIGHT_COORDINATES = 3
START_COORDINATES = 3
ROUNDING_MM = 1e-9
SIDE_COORDINATES = 2_000_000
"""Of the lattice, beyond its own: whether light goes to the outer side of panes."""
SURFACE = 5
NONE = -1


class CellImages(NamedTuple):
    """What is added to: images on cells of the tank's surface, and which of them the light of an order goes to; all of
    it, or only what has met a diffuse face."""

    images: Array
    bins: Bins
    cell_mm: tuple[float, float]
    diffuse_only: bool


def wall_images(
    scene: Scene, grid: CellGrid, seed: tuple[int, int], bins: Bins, highest: int, faintest: float,
    lattices: int = LATTICES, diffuse_only: bool = False,
) -> Array:  # fmt: skip
    """What faces add to the image, but for order 1 by way of clear ones, W/mm²/sr.

    Parameters
    ----------
    scene
        With sharp beams from a pinhole or collimated, and an ideal plain camera's cells.
    grid
        Cells over the tank's surface.
    seed
        Of the lattices' shifts.
    bins
        Index of the image that each order 0, 1, 2, … goes to; order 0 is light that a diffuse face shows by itself.
    highest
        Order to follow paths to.
    faintest
        Share of its weight from which on a path ends by chance. Where images are differenced it has to be small: paths
        that end at one liquid and not at the next one are noise that grows as the liquids come near.
    lattices
        To average.
    diffuse_only
        Whether only light that has met a diffuse face counts: what such a face adds, without the noise of the others.

    Returns
    -------
    (images, rows, columns) array
    """
    cells = np.zeros((int(bins.max()) + 1, grid.rows, grid.columns))
    beams = [beam for beam in scene.projector.beams if beam.irradiance > 0.0]
    power = np.array([beam.power for beam in beams])
    table = np.column_stack([np.array([(*beam.y_mm, *beam.z_mm) for beam in beams]), np.cumsum(power) / power.sum()])
    geometry, water = geometry_of(scene), water_for_paths(scene.medium)
    faces = face_table(scene.tank)
    kept = np.ones(len(faces))
    if diffuse_only:  # as many paths go to such faces as if they sent back all light, and keep what these do send back
        scatters = faces[:, 0] == DIFFUSE
        kept[scatters], faces[scatters, 1] = faces[scatters, 1], 1.0
    tank = ReflectingTank(geometry, faces, steepest_sights(geometry))
    seen = CellImages(cells, bins, grid.cell_mm, diffuse_only)
    for number in range(lattices):
        shifted = LARGE.shifted((seed[0] + WALLS_APART, seed[1] * lattices + number))
        points = Points(shifted, LARGE.points)
        _trace(seen, tank, water, table, points, highest, faintest, kept)
    return cell_averages(cells * (float(power.sum()) / (lattices * LARGE.points * grid.cell_mm[0] * grid.cell_mm[1])))


WALLS_APART = 2**30
"""Added to a seed: these paths know nothing of the others."""


@kernel
def _trace(
    seen: CellImages, tank: ReflectingTank, water: Water, beams: Array, points: Points, highest: int, faintest: float,
    kept: Array,
) -> None:  # fmt: skip
    """Follow the paths of a lattice; `beams` are edges and the share of the power up to and including each, `kept` the
    share of its light that is left where it meets a diffuse face.

        I = 1/N Σ_paths Σ_events w p(cos θ) R e^{−σt s} T J / (area of a cell),   w ← w (chance of an event) ϖ

    with s the way to the surface, R what faces send back on it, and T J `seen_from`'s factor; diffuse faces have
    cos θ/π for p, and no ϖ.
    """
    cells, bins, cell_mm, diffuse_only = seen
    sigma_t, albedo, phase = water
    lattice, count = points
    geometry = tank.geometry
    ends, weights = np.empty((STRETCHES + 1, 7)), np.empty(STRETCHES + 1)
    for point in range(count):
        y, z = _start(beams, coordinate(point, 0, lattice), coordinate(point, 1, lattice))
        dx, dy, dz = light_ray(geometry, y, z)
        ex, ey, ez = across(dx, dz)
        x, weight, order, flights, met, diffuse = 0.0, 1.0, 0, 0, False, False
        while True:
            first = 2 if flights == 0 else START_COORDINATES + (flights - 1) * FLIGHT_COORDINATES + 2
            u, v = coordinate(point, first, lattice), coordinate(point, SIDE_COORDINATES + flights, lattice)
            ray = Ray(x, y, z, dx, dy, dz)
            x, y, z, dx, dy, dz, chance, hits, face = _fly(tank, sigma_t, ray, u, v, ends, weights)
            flights += 1
            weight *= chance
            met = met or hits > 0
            if weight <= 0.0 or chance <= 0.0:
                break
            u = coordinate(point, START_COORDINATES + (flights - 1) * FLIGHT_COORDINATES, lattice)
            v = coordinate(point, START_COORDINATES + (flights - 1) * FLIGHT_COORDINATES + 1, lattice)
            if face != NONE:
                met = diffuse = True
                weight *= kept[face]
                image = cells[bins[min(order, bins.size - 1)]]
                _show(image, cell_mm, tank, water, Ray(x, y, z, dx, dy, dz), weight, True, face)
                dx, dy, dz = _lambert(face, u, v)
            else:
                order += 1
                if order > highest:  # what has been scattered so often still goes to faces
                    break
                weight *= albedo
                if diffuse or (order >= 2 and not diffuse_only):
                    image = cells[bins[min(order, bins.size - 1)]]
                    _show(image, cell_mm, tank, water, Ray(x, y, z, dx, dy, dz), weight, met, NONE)
                ex, ey, ez = across(dx, dz) if abs(dx) + abs(dz) > 1e-9 else (1.0, 0.0, 0.0)
                dx, dy, dz, ex, ey, ez = scattered(dx, dy, dz, ex, ey, ez, drawn_cosine(u, phase), v)
            if weight < faintest:
                if coordinate(point, CHANCE_COORDINATES + flights, lattice) >= SPARED:
                    break
                weight *= 1.0 / SPARED


@part
def _start(beams: Array, u: float, v: float) -> tuple[float, float]:
    """Where a path enters: as much light everywhere."""
    beam, before = 0, 0.0
    while beam < beams.shape[0] - 1 and u >= beams[beam, 4]:
        before = beams[beam, 4]
        beam += 1
    share = min(max((u - before) / (beams[beam, 4] - before), 0.0), 1.0)
    return (
        beams[beam, 0] + share * (beams[beam, 1] - beams[beam, 0]),
        beams[beam, 2] + v * (beams[beam, 3] - beams[beam, 2]),
    )


@kernel
def _fly(
    tank: ReflectingTank, sigma_t: float, ray: Ray, u: float, v: float, ends: Array, weights: Array
) -> tuple[float, float, float, float, float, float, float, int, int]:
    """A flight to its next event, which is a collision or a diffuse face.

    The coordinate u picks the place, and v whether light goes to the outer sides of the panes that it meets. Of the
    light, 1 − e^{−σt way} collides on each stretch between faces, and of what is left a face sends back its share.

    Returns
    -------
    x, y, z, dx, dy, dz
        Where it is, and in which direction light comes there.
    chance
        That there is one.
    hits
        Faces and surfaces met before; the surface does not count.
    face
        The diffuse face, or −1.
    """
    geometry, faces, _ = tank
    x, y, z, dx, dy, dz = ray
    length, half_width, height, index = (
        geometry.length, geometry.half_width, geometry.height, geometry.refractive_index,
    )  # fmt: skip
    total, left, count, hits, diffuse = 0.0, 1.0, 0, 0, -1
    while count < STRETCHES:
        to_x = ((length if dx > 0.0 else 0.0) - x) / dx if abs(dx) > 1e-12 else 1e30
        to_y = ((half_width if dy > 0.0 else -half_width) - y) / dy if abs(dy) > 1e-12 else 1e30
        to_z = ((height if dz > 0.0 else 0.0) - z) / dz if abs(dz) > 1e-12 else 1e30
        way = max(min(to_x, to_y, to_z), 0.0)
        ends[count, 0], ends[count, 1], ends[count, 2] = x, y, z
        ends[count, 3], ends[count, 4], ends[count, 5] = dx, dy, dz
        ends[count, 6] = hits
        weights[count] = left * one_minus_exponential(-sigma_t * way)
        total += weights[count]
        left *= exponential(-sigma_t * way)
        x, y, z = x + dx * way, y + dy * way, z + dz * way
        count += 1
        if to_z <= min(to_x, to_y) and dz > 0.0:
            back, along, face, cosine = reflectance(dz, index) if index > 1.0 else 0.0, 0.0, SURFACE, dz
        else:
            if to_z <= min(to_x, to_y):
                face, cosine = FLOOR, -dz
            elif to_x <= to_y:
                face, cosine = (FAR if dx > 0.0 else ENTRY), abs(dx)
            else:
                face, cosine = (RIGHT if dy > 0.0 else LEFT), abs(dy)
            if int(faces[face, 0]) == DIFFUSE:
                left *= faces[face, 1]
                total += left
                diffuse = face
                break
            back, along, at_once = sent_back(faces, face, cosine)
            along = along if v >= at_once else 0.0
            hits += 1
        left *= back
        if left < FAINT:
            break
        tangent = math.sqrt(max(1.0 - cosine * cosine, 1e-18))
        if along > 0.0:
            if face in (ENTRY, FAR):
                y, z = y + along * dy / tangent, z + along * dz / tangent
            elif face in (LEFT, RIGHT):
                x, z = x + along * dx / tangent, z + along * dz / tangent
            else:
                x, y = x + along * dx / tangent, y + along * dy / tangent
            if min(x, length - x, half_width - abs(y), z, height - z) < -ROUNDING_MM:
                break  # into the pane's edge
        if face in (SURFACE, FLOOR):
            dz = -dz
        elif face in (ENTRY, FAR):
            dx = -dx
        else:
            dy = -dy
    wanted, stretch = u * total, 0
    while stretch < count and wanted > weights[stretch]:
        wanted -= weights[stretch]
        stretch += 1
    if stretch == count:
        if diffuse >= 0:
            return x, y, z, dx, dy, dz, total, hits, diffuse
        stretch, wanted = count - 1, weights[count - 1]
    before = 1.0
    x, y, z, dx, dy, dz = (
        ends[stretch, 0], ends[stretch, 1], ends[stretch, 2], ends[stretch, 3], ends[stretch, 4], ends[stretch, 5],
    )  # fmt: skip
    to_x = ((length if dx > 0.0 else 0.0) - x) / dx if abs(dx) > 1e-12 else 1e30
    to_y = ((half_width if dy > 0.0 else -half_width) - y) / dy if abs(dy) > 1e-12 else 1e30
    to_z = ((height if dz > 0.0 else 0.0) - z) / dz if abs(dz) > 1e-12 else 1e30
    way = max(min(to_x, to_y, to_z), 0.0)
    before = one_minus_exponential(-sigma_t * way)
    share = min(wanted / max(weights[stretch], 1e-300), 1.0)
    depth = min(-log_one_minus(share * before) / sigma_t, way)
    return x + dx * depth, y + dy * depth, z + dz * depth, dx, dy, dz, total, int(ends[stretch, 6]), -1


@part
def _lambert(face: int, u: float, v: float) -> tuple[float, float, float]:
    """A direction off a diffuse face, by the cosine law."""
    cosine, sine = math.sqrt(1.0 - u), math.sqrt(u)
    a, b = sine * math.cos(2.0 * math.pi * v), sine * math.sin(2.0 * math.pi * v)
    if face == ENTRY:
        return cosine, a, b
    if face == FAR:
        return -cosine, a, b
    if face == LEFT:
        return a, cosine, b
    if face == RIGHT:
        return a, -cosine, b
    return a, b, cosine


@kernel
def _show(
    image: Array, cell_mm: tuple[float, float], tank: ReflectingTank, water: Water, ray: Ray, weight: float,
    directly: bool, face: int,
) -> None:  # fmt: skip
    """Show the camera what water, or a diffuse face, scatters of light: w p(cos θ) R e^{−σt s} T J."""
    geometry, faces, steepest = tank
    sigma_t, _, phase = water
    x, y, z, dx, dy, dz = ray
    index = geometry.refractive_index
    to_faces = x, geometry.length - x, geometry.half_width + y, geometry.half_width - y
    for across_x in range(3):
        if across_x > 0 and not (geometry.camera_pinhole and _clear(faces, across_x - 1)):
            continue
        for across_y in range(3):
            if across_y > 0 and not (geometry.camera_pinhole and _clear(faces, across_y + 1)):
                continue
            for floor in range(2):
                if floor == 1 and not _clear(faces, FLOOR):
                    continue
                if across_x == 0 and across_y == 0 and floor == 0 and not directly:
                    continue
                px = x if across_x == 0 else -x if across_x == 1 else 2.0 * geometry.length - x
                py = y if across_y == 0 else (-2.0 if across_y == 1 else 2.0) * geometry.half_width - y
                pz = z if floor == 0 else -z
                depth = geometry.height - pz
                if across_x > 0 and to_faces[across_x - 1] > depth * steepest[across_x - 1]:
                    continue
                if across_y > 0 and to_faces[across_y + 1] > depth * steepest[across_y + 1]:
                    continue
                for outer in range(2):  # at the inner sides of panes, or by their outer sides
                    seen_x, seen_y, sx, sy, sz, path, factor = seen_from(geometry, px, py, pz, index)
                    if across_x + across_y + floor > 0:
                        share, mx, my, mz = _panes(faces, across_x, across_y, floor, sx, sy, sz, outer == 1)
                        if share <= 0.0 or pz + mz > geometry.height:
                            continue  # nothing, or it comes out of the pane above the water
                        if outer == 1:  # the pane's thickness moves the mirror image
                            seen_x, seen_y, sx, sy, sz, path, factor = seen_from(
                                geometry, px + mx, py + my, pz + mz, index
                            )
                        factor *= share
                    elif outer == 1:
                        continue
                    if not (0.0 <= seen_x <= geometry.length and abs(seen_y) <= geometry.half_width):
                        continue
                    ax, ay, az = (
                        sx if across_x == 0 else -sx, sy if across_y == 0 else -sy, sz if floor == 0 else -sz,
                    )  # fmt: skip
                    if face == NONE:
                        lobe = phase_density(dx * ax + dy * ay + dz * az, phase)
                    else:
                        lobe = max(_from_face(face, ax, ay, az), 0.0) / math.pi
                    value = weight * lobe * factor * exponential(-sigma_t * path)
                    _add(image, seen_x / cell_mm[0], (seen_y + geometry.half_width) / cell_mm[1], value)


@part
def _clear(faces: Array, face: int) -> bool:
    return bool(0.0 < faces[face, 0] < DIFFUSE)


@part
def _from_face(face: int, ax: float, ay: float, az: float) -> float:
    """Cosine of a direction to the inward normal of a face."""
    if face == ENTRY:
        return ax
    if face == FAR:
        return -ax
    if face == LEFT:
        return ay
    return -ay if face == RIGHT else az


@kernel
def _panes(
    faces: Array, across_x: int, across_y: int, floor: int, sx: float, sy: float, sz: float, outer: bool
) -> tuple[float, float, float, float]:
    """What comes back on a line of sight by way of faces, and where the panes' thickness moves the mirrored point.

    `outer` is of light that has been to the outer side of a pane, the other part has not been in any.
    """
    share, at_once, mx, my, mz = 1.0, 1.0, 0.0, 0.0, 0.0
    if across_x > 0:
        back, along, inner = sent_back(faces, across_x - 1, abs(sx))
        along /= math.sqrt(max(1.0 - sx * sx, 1e-18))
        share, at_once = share * (back if (sx > 0.0) == (across_x == 1) else 0.0), at_once * inner
        my, mz = my + along * sy, mz + along * sz
    if across_y > 0:
        back, along, inner = sent_back(faces, across_y + 1, abs(sy))
        along /= math.sqrt(max(1.0 - sy * sy, 1e-18))
        share, at_once = share * (back if (sy > 0.0) == (across_y == 1) else 0.0), at_once * inner
        mx, mz = mx + along * sx, mz + along * sz
    if floor > 0:
        back, along, inner = sent_back(faces, FLOOR, sz)
        along /= math.sqrt(max(1.0 - sz * sz, 1e-18))
        share, at_once = share * back, at_once * inner
        mx, my = mx + along * sx, my + along * sy
    if not outer:
        return share * at_once, 0.0, 0.0, 0.0
    return share * (1.0 - at_once), mx, my, mz


@part
def _add(image: Array, across: float, along: float, value: float) -> None:
    """Share a value out between the four nearest cells."""
    rows, columns = image.shape
    across, along = min(max(across - 0.5, 0.0), columns - 1.0), min(max(along - 0.5, 0.0), rows - 1.0)
    column, row = int(across), int(along)
    after, below = min(column + 1, columns - 1), min(row + 1, rows - 1)
    lower = value * (along - row)
    upper = value - lower
    right = across - column
    image[row, column] += upper * (1.0 - right)
    image[row, after] += upper * right
    image[below, column] += lower * (1.0 - right)
    image[below, after] += lower * right

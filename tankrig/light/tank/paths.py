"""Light paths with many scatterings, started at the projector and seen by the camera at every scattering.

A path is a function of one lattice point and of the medium: every flight ends inside the tank (the chance that it does
is a factor of the path's weight) and nothing that depends on the medium is left to chance. So with the same points the
image is a smooth function of the medium.

Where light is scattered forward, few paths would ever turn towards the camera. Two further ways of drawing a direction
mend that, and the balance heuristic weighs the three so that none can make a contribution large:

* a share of the paths turns once, at an order fixed by its lattice point, into a wide lobe about the line of sight;
* at every scattering a probe for the last flight is drawn from the phase function's own lobe about the line of sight.

`remaining + turned` below is the density of all ways to draw the path's directions, over that of plain scattering.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.rays import Geometry, light_ray
from tankrig.light.tank.flight import fly, scattered
from tankrig.light.tank.lattice import coordinate
from tankrig.light.tank.record import Bins, record_point, record_rectangles
from tankrig.light.tank.sighting import seen_from
from tankrig.scene.phase import henyey_greenstein

Array = NDArray[np.float64]

START_COORDINATES = 4
FLIGHT_COORDINATES = 6
UNTURNED = 0.4
"""Share of the paths that are scattered by the phase function alone."""
TURNS = 12
"""The other paths turn at one of this many first scatterings."""


@kernel
def trace(
    edges: Array, cells: Array, bins: Bins, geometry: Geometry, shiftable: bool, cell_mm: tuple[float, float],
    sigma_t: float, albedo: float, g: float, beams: Array, lattice: Array, start: int, stop: int,
    max_order: int, faintest: float, first_thinning: int,
) -> None:  # fmt: skip
    """Follow the paths of lattice points `start` … `stop` − 1 and record their orders ≥ 3.

    Parameters
    ----------
    edges
        Filled by `record_rectangles` where `shiftable`.
    cells
        Filled by `record_point` otherwise.
    bins
        Index of the image that each order goes to.
    geometry
        Numbers of the scene.
    shiftable
        Whether light is collimated and the camera orthographic. Then a path is drawn relative to its first collision
        and stands for all that begin anywhere on the beams and stay between the walls.
    cell_mm
        Size of the cells along x and y, mm.
    sigma_t, albedo, g
        The medium.
    beams
        (n, 6): y low, y high, z low, z high on the plane x = 0, irradiance, and the share of the power up to and
        including this beam. Where `shiftable` all have the same z.
    lattice
        A shifted lattice, as `Lattice.shifted` gives it.
    start, stop
        Lattice points.
    max_order
        Highest order to follow.
    faintest
        Share of its starting weight at which a path ends.
    first_thinning
        From this order on, every doubling of the order halves the paths: later orders are smoother.
    """
    length, half_width, height = geometry.length, geometry.half_width, geometry.height
    index = geometry.refractive_index
    guided = g > 0.3
    per_turn = (1.0 - UNTURNED) / TURNS
    hull_low, hull_high = beams[:, 0].min(), beams[:, 1].max()
    farthest = min(length, 40.0 / sigma_t)  # what begins deeper is fainter than any rounding
    for point in range(start, stop):
        x_low, x_high, y_low, y_high = 0.0, farthest, hull_low, hull_high
        if shiftable:
            x = y = 0.0
            z = beams[0, 2] + coordinate(point, 0, lattice) * (beams[0, 3] - beams[0, 2])
            dx, dy, dz = 1.0, 0.0, 0.0
            weight = albedo * sigma_t
        else:
            x_low, x_high, y_low, y_high = 0.0, 0.0, 0.0, 0.0
            beam, across = _beam_of(beams, coordinate(point, 1, lattice))
            y0 = beams[beam, 0] + across * (beams[beam, 1] - beams[beam, 0])
            z0 = beams[beam, 2] + coordinate(point, 0, lattice) * (beams[beam, 3] - beams[beam, 2])
            dx, dy, dz = light_ray(geometry, y0, z0)
            walls = (0.0, length, -half_width, half_width)
            x, y, z, dz, weight = fly(
                walls, height, index, sigma_t, 0.0, y0, z0, dx, dy, dz, coordinate(point, 2, lattice)
            )
            weight *= albedo
        choice = (coordinate(point, 3, lattice) - UNTURNED) / per_turn
        turn = 1 + int(choice) if guided and choice >= 0.0 else 0
        remaining, turned = 1.0, 0.0
        limit = faintest * weight
        # References across the light's and the line of sight's direction, from which azimuths are counted.
        ex, ey, ez = _across(dx, dz)
        sx, sy, sz = 0.0, 0.0, 1.0
        rx, ry, rz = 1.0, 0.0, 0.0
        order = 1
        thinning = first_thinning
        while order < max_order and weight > limit:
            first = START_COORDINATES + (order - 1) * FLIGHT_COORDINATES
            if order == thinning:
                thinning *= 2
                if (point // (order // first_thinning)) % 2 == 1:
                    break
                weight *= 2.0
                limit *= 2.0
            walls = (-x_high, length - x_low, -half_width - y_high, half_width - y_low)
            if not shiftable:
                walls = (0.0, length, -half_width, half_width)
                _, _, sx, sy, sz, _, _ = seen_from(geometry, x, y, z)
                rx, ry, rz = _across(sx, sz)
            before = remaining + turned
            counted = guided and order <= TURNS
            if guided and order >= 2:
                u, v = coordinate(point, first + 3, lattice), coordinate(point, first + 4, lattice)
                px, py, pz, _, _, _ = scattered(sx, sy, sz, rx, ry, rz, g, u, v)
                plain = henyey_greenstein(px * dx + py * dy + pz * dz, g)
                ahead = px * sx + py * sy + pz * sz
                density = before * henyey_greenstein(ahead, g) + (remaining + turned) * plain
                if counted:
                    density += per_turn * (_wide_lobe(ahead, g) - plain)
                qx, qy, qz, pz, chance = fly(
                    walls, height, index, sigma_t, x, y, z, px, py, pz, coordinate(point, first + 5, lattice)
                )
                value = weight * chance * albedo * plain / density
                if shiftable:
                    value *= henyey_greenstein(pz, g) * math.exp(-sigma_t * (height - qz))
                    record_rectangles(
                        edges, bins, order + 1, value, sigma_t, qx, qy, max(x_low, -qx), min(x_high, length - qx),
                        max(y_low, -half_width - qy), min(y_high, half_width - qy), beams, half_width, cell_mm,
                    )  # fmt: skip
                else:
                    record_point(cells, bins, geometry, order + 1, value, sigma_t, g, qx, qy, qz, px, py, pz, cell_mm)
            dx0, dy0, dz0 = dx, dy, dz
            u, v = coordinate(point, first, lattice), coordinate(point, first + 1, lattice)
            if order == turn:
                asymmetry = g**2 if v < 0.5 else g**4
                v = 2.0 * v if v < 0.5 else 2.0 * v - 1.0
                dx, dy, dz, ex, ey, ez = scattered(sx, sy, sz, rx, ry, rz, asymmetry, u, v)
            else:
                dx, dy, dz, ex, ey, ez = scattered(dx, dy, dz, ex, ey, ez, g, u, v)
            share = 1.0
            if guided:
                plain = henyey_greenstein(dx * dx0 + dy * dy0 + dz * dz0, g)
                ahead = dx * sx + dy * sy + dz * sz
                if counted:
                    remaining -= per_turn
                    turned += per_turn * _wide_lobe(ahead, g) / plain
                share = remaining + turned
                if order >= 2:
                    share += before * henyey_greenstein(ahead, g) / plain
                share = 1.0 / share
            x, y, z, after, chance = fly(
                walls, height, index, sigma_t, x, y, z, dx, dy, dz, coordinate(point, first + 2, lattice)
            )
            if after != dz:  # reflected at the surface
                dz, ez = after, -ez
            weight *= chance * albedo
            order += 1
            if shiftable:
                x_low, x_high = max(x_low, -x), min(x_high, length - x)
                y_low, y_high = max(y_low, -half_width - y), min(y_high, half_width - y)
            if order < 3:
                continue
            if shiftable:
                value = weight * share * henyey_greenstein(dz, g) * math.exp(-sigma_t * (height - z))
                record_rectangles(
                    edges, bins, order, value, sigma_t, x, y, x_low, x_high, y_low, y_high, beams, half_width, cell_mm
                )
            else:
                record_point(cells, bins, geometry, order, weight * share, sigma_t, g, x, y, z, dx, dy, dz, cell_mm)


@part
def _across(dx: float, dz: float) -> tuple[float, float, float]:
    """A unit vector across a direction that is not along y, from its x and z."""
    scale = math.sqrt(dx * dx + dz * dz)
    return -dz / scale, 0.0, dx / scale


@part
def _wide_lobe(cosine: float, g: float) -> float:
    """Density of the directions of a turn: lobes as wide as after two and after four scatterings."""
    return 0.5 * (henyey_greenstein(cosine, g**2) + henyey_greenstein(cosine, g**4))


@part
def _beam_of(beams: Array, u: float) -> tuple[int, float]:
    """The beam that a number of [0, 1) falls on, and how far across it."""
    beam, before = 0, 0.0
    while beam < beams.shape[0] - 1 and u >= beams[beam, 5]:
        before = beams[beam, 5]
        beam += 1
    return beam, min(max((u - before) / (beams[beam, 5] - before), 0.0), 1.0)

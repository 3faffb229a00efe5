"""Light paths with many scatterings, started at the projector and seen by the camera at every scattering.

A path is a function of the coordinates of one lattice point and of the medium: every flight ends inside the tank (the
chance that it does is a factor of the path's weight), nothing is left to chance that depends on the medium. So with the
same points the image is a smooth function of the medium.

Between the last two scatterings the way may be drawn like any other or from the phase function's lobe about the line of
sight (a probe); either sample carries p·p'/(p + p'), the balance heuristic, which neither lobe can make large.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.rays import Geometry, light_ray, path_inside
from tankrig.light.tank.lattice import coordinate
from tankrig.light.tank.sighting import seen_from
from tankrig.scene.optics import reflectance
from tankrig.scene.phase import henyey_greenstein

Array = NDArray[np.float64]

SOURCE_COORDINATES = 3
FLIGHT_COORDINATES = 3
FIRST_THINNING = 8
"""From this order on, every doubling of the order halves the paths: later orders are smoother."""


@kernel
def trace(
    tally: Array, geometry: Geometry, sigma_t: float, albedo: float, g: float, beams: Array, shift: Array,
    start: int, stop: int, max_order: int, probing: bool, faintest: float,
) -> None:  # fmt: skip
    """Add the paths of lattice points `start` … `stop` − 1 to the tally of orders ≥ 3.

    Parameters
    ----------
    tally
        (3, rows, columns) for the order classes 3, 4–20 and > 20 on a grid of cells over the tank's surface: sums of
        power scattered towards the camera, W/sr.
    geometry
        Numbers of the scene.
    sigma_t, albedo, g
        The medium.
    beams
        (n, 6): y low, y high, z low, z high on the plane x = 0, share of the power before this beam, share of this one.
    shift
        Of the lattice, one number a coordinate.
    start, stop
        Lattice points.
    max_order
        Highest order to follow.
    probing
        Whether to draw probes.
    faintest
        Share of its starting weight at which a path ends.
    """
    rows, columns = tally.shape[1:]
    per_x, per_y = columns / geometry.length, rows / (2.0 * geometry.half_width)
    stride = (2 if probing else 1) * FLIGHT_COORDINATES
    for point in range(start, stop):
        beam, across = _beam_of(beams, coordinate(point, 0, shift))
        y0 = beams[beam, 0] + across * (beams[beam, 1] - beams[beam, 0])
        z0 = beams[beam, 2] + coordinate(point, 1, shift) * (beams[beam, 3] - beams[beam, 2])
        dx, dy, dz = light_ray(geometry, y0, z0)
        x, y, z, dz, weight = _fly(geometry, sigma_t, 0.0, y0, z0, dx, dy, dz, coordinate(point, 2, shift))
        weight *= albedo
        order = 1
        thinning = FIRST_THINNING
        while order < max_order and weight > faintest:
            first = SOURCE_COORDINATES + (order - 1) * stride
            if order == thinning:
                thinning *= 2
                if (point // (order // FIRST_THINNING)) % 2 == 1:
                    break
                weight *= 2.0
            # Where the camera would look from here, for the probe's lobe.
            if probing and order >= 2:
                _, _, sx, sy, sz, _, _ = seen_from(geometry, x, y, z)
                px, py, pz = _scattered(sx, sy, sz, g, coordinate(point, first + 3, shift), coordinate(point, first + 4, shift))
                along = henyey_greenstein(px * dx + py * dy + pz * dz, g)
                lobe = henyey_greenstein(px * sx + py * sy + pz * sz, g)
                qx, qy, qz, pz, reached = _fly(geometry, sigma_t, x, y, z, px, py, pz, coordinate(point, first + 5, shift))
                share = weight * reached * albedo * along / (along + lobe)
                _see(tally, geometry, sigma_t, g, per_x, per_y, order + 1, qx, qy, qz, px, py, pz, share)
            dx0, dy0, dz0 = dx, dy, dz
            dx, dy, dz = _scattered(dx, dy, dz, g, coordinate(point, first, shift), coordinate(point, first + 1, shift))
            share = 1.0
            if probing and order >= 2:
                along = henyey_greenstein(dx * dx0 + dy * dy0 + dz * dz0, g)
                share = along / (along + henyey_greenstein(dx * sx + dy * sy + dz * sz, g))
            x, y, z, dz, reached = _fly(geometry, sigma_t, x, y, z, dx, dy, dz, coordinate(point, first + 2, shift))
            weight *= reached * albedo
            order += 1
            if order >= 3:
                _see(tally, geometry, sigma_t, g, per_x, per_y, order, x, y, z, dx, dy, dz, weight * share)


@kernel
def _beam_of(beams: Array, u: float) -> tuple[int, float]:
    """The beam that a number of [0, 1) falls on, and how far across it."""
    beam = 0
    while beam < beams.shape[0] - 1 and u >= beams[beam, 4] + beams[beam, 5]:
        beam += 1
    return beam, min(max((u - beams[beam, 4]) / beams[beam, 5], 0.0), 1.0)


@kernel
def _scattered(dx: float, dy: float, dz: float, g: float, u: float, v: float) -> tuple[float, float, float]:
    """A direction drawn from the phase function about (dx, dy, dz)."""
    if abs(g) < 1e-3:
        cosine = 1.0 - 2.0 * u + 2.0 * g * u * (1.0 - u)
    else:
        root = (1.0 - g * g) / (1.0 + g - 2.0 * g * u)
        cosine = (1.0 + g * g - root * root) / (2.0 * g)
    cosine = min(max(cosine, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    angle = 2.0 * math.pi * v
    a, b = sine * math.cos(angle), sine * math.sin(angle)
    # An orthonormal frame about the direction without a branch that jumps (Duff et al. 2017).
    sign = math.copysign(1.0, dz)
    c = -1.0 / (sign + dz)
    e = dx * dy * c
    return (
        a * (1.0 + sign * dx * dx * c) + b * e + cosine * dx,
        a * sign * e + b * (sign + dy * dy * c) + cosine * dy,
        -a * sign * dx - b * dy + cosine * dz,
    )


@kernel
def _fly(
    geometry: Geometry, sigma_t: float, x: float, y: float, z: float, dx: float, dy: float, dz: float, u: float
) -> tuple[float, float, float, float, float]:
    """The next collision inside the tank: its place, the vertical direction there, and the chance that there is one.

    A Fresnel surface sends light back with R(ξ); the way goes on below it.
    """
    _, leave = path_inside(geometry, x, y, z, dx, dy, dz)
    leave = max(leave, 0.0)
    inside = -math.expm1(-sigma_t * leave)
    if geometry.refractive_index > 1.0 and dz > 0.0 and z + dz * leave > geometry.height - 1e-9:
        sx, sy = x + dx * leave, y + dy * leave
        _, further = path_inside(geometry, sx, sy, geometry.height, dx, dy, -dz)
        back = (1.0 - inside) * reflectance(dz, geometry.refractive_index)
        beyond = back * -math.expm1(-sigma_t * max(further, 0.0))
        chance = inside + beyond
        if u * chance > inside:
            depth = min(-math.log1p(-(u * chance - inside) / back) / sigma_t, further)
            return sx + dx * depth, sy + dy * depth, geometry.height - dz * depth, -dz, chance
        u = u * chance / max(inside, 1e-300)
        inside_only = inside
        depth = min(-math.log1p(-u * inside_only) / sigma_t, leave)
        return x + dx * depth, y + dy * depth, z + dz * depth, dz, chance
    depth = min(-math.log1p(-u * inside) / sigma_t, leave)
    return x + dx * depth, y + dy * depth, z + dz * depth, dz, inside


@kernel
def _see(
    tally: Array, geometry: Geometry, sigma_t: float, g: float, per_x: float, per_y: float, order: int,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float,
) -> None:  # fmt: skip
    """Add what one scattering sends to the camera."""
    seen_x, seen_y, sx, sy, sz, depth, factor = seen_from(geometry, x, y, z)
    column = int(seen_x * per_x)
    row = int((seen_y + geometry.half_width) * per_y)
    if seen_x < 0.0 or seen_y < -geometry.half_width or column >= tally.shape[2] or row >= tally.shape[1]:
        return
    value = weight * factor * henyey_greenstein(dx * sx + dy * sy + dz * sz, g) * math.exp(-sigma_t * depth)
    tally[0 if order == 3 else 1 if order <= 20 else 2, row, column] += value

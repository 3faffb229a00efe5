"""One step of a light path: a new direction, and a flight to the next collision inside the tank.

Free of branches and calls, so that loops over many paths are vectorised.
"""

import math

from tankrig.compiled import part
from tankrig.geometry.optics import reflectance
from tankrig.light.elementary import circle, log_one_minus, one_minus_exponential


@part
def scattered(
    dx: float, dy: float, dz: float, ex: float, ey: float, ez: float, g: float, u: float, v: float
) -> tuple[float, float, float, float, float, float]:
    """A direction drawn from the phase function about a direction, and the reference it takes along.

    The azimuth is counted from a reference that is carried from scattering to scattering. A frame made anew from each
    direction would jump somewhere on the sphere, and the image with it as the medium changes.

    Parameters
    ----------
    dx, dy, dz
        Direction before, a unit vector.
    ex, ey, ez
        Unit vector across it that the azimuth is counted from.
    g
        Asymmetry of the phase function.
    u, v
        Coordinates in [0, 1) for the angle and the azimuth.

    Returns
    -------
    dx, dy, dz, ex, ey, ez
        Direction after, and its reference.
    """
    root = (1.0 - g * g) / (1.0 + g - 2.0 * g * u)
    linear = 1.0 - 2.0 * u + 6.0 * g * u * (1.0 - u)
    cosine = linear if abs(g) < 1e-3 else (1.0 + g * g - root * root) / (2.0 * g)
    cosine = min(max(cosine, -1.0), 1.0)
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
    walls: tuple[float, float, float, float], height: float, index: float, sigma_t: float,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, u: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """The next collision inside the tank.

    A Fresnel surface sends light back with R(ξ); the way goes on below it.

    Parameters
    ----------
    walls
        x low, x high, y low, y high of the tank's side walls, mm; its floor is z = 0.
    height, index
        Of the surface: z, and the refractive index that it shows.
    sigma_t
        Extinction, 1/mm.
    x, y, z, dx, dy, dz
        Where the light is and its direction.
    u
        Coordinate in [0, 1) that picks the place.

    Returns
    -------
    x, y, z, dz, chance
        Where it collides, its vertical direction there, and the chance that it collides inside.
    """
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

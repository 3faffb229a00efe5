"""One step of a light path: a new direction, and a flight to the next collision inside the tank."""

import math

from tankrig.compiled import part
from tankrig.geometry.optics import reflectance


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
    if abs(g) < 1e-3:
        cosine = 1.0 - 2.0 * u + 6.0 * g * u * (1.0 - u)
    else:
        root = (1.0 - g * g) / (1.0 + g - 2.0 * g * u)
        cosine = (1.0 + g * g - root * root) / (2.0 * g)
    cosine = min(max(cosine, -1.0), 1.0)
    sine = math.sqrt(1.0 - cosine * cosine)
    angle = 2.0 * math.pi * v
    a, b = math.cos(angle), math.sin(angle)
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
    sides = 1e30
    if dx > 1e-12:
        sides = (walls[1] - x) / dx
    elif dx < -1e-12:
        sides = (walls[0] - x) / dx
    if dy > 1e-12:
        sides = min(sides, (walls[3] - y) / dy)
    elif dy < -1e-12:
        sides = min(sides, (walls[2] - y) / dy)
    sides = max(sides, 0.0)
    rise = (height - z) / dz if dz > 1e-12 else z / -dz if dz < -1e-12 else 1e30
    leave = min(sides, max(rise, 0.0))
    inside = -math.expm1(-sigma_t * leave)
    chance = inside
    if index > 1.0 and dz > 0.0 and rise < sides:
        further = min(sides - rise, height / dz)
        back = (1.0 - inside) * reflectance(dz, index)
        chance += back * -math.expm1(-sigma_t * further)
        if u * chance > inside:
            depth = min(-math.log1p(-(u * chance - inside) / back) / sigma_t, further)
            way = rise + depth
            return x + dx * way, y + dy * way, height - dz * depth, -dz, chance
    depth = min(-math.log1p(-min(u * chance, inside)) / sigma_t, leave)
    return x + dx * depth, y + dy * depth, z + dz * depth, dz, chance

"""Where on the surface the camera sees a point in the water, and how strongly."""

import math

from tankrig.compiled import part
from tankrig.geometry.optics import reflectance
from tankrig.light.rays import Geometry


@part
def seen_from(
    geometry: Geometry, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float]:
    """The line of sight through a point in the water.

    Returns
    -------
    seen_x, seen_y
        Where it leaves the surface, mm.
    sx, sy, sz
        Its direction in the water, pointing up.
    path_mm
        From the point to the surface.
    factor
        Radiance on the plane z = Lz, summed over its area, per power the point scatters into this direction, per
        steradian: transmission over the surface and over the spreading of lines of sight, 1 when they are vertical and
        the surface is matched.
    """
    index = geometry.refractive_index
    depth = geometry.height - z
    if not geometry.camera_pinhole:
        return x, y, 0.0, 0.0, 1.0, depth, (1.0 - reflectance(1.0, 1.0 / index)) / (index * index)
    to_x, to_y, above = geometry.camera_x - x, geometry.camera_y - y, geometry.camera_z - geometry.height
    offset = math.sqrt(to_x * to_x + to_y * to_y)
    rho = _crossing(offset, depth, above, index)
    ex, ey = (to_x / offset, to_y / offset) if offset > 1e-9 else (1.0, 0.0)
    cosine_air = above / math.sqrt(rho * rho + above * above)
    sine = math.sqrt(max(0.0, 1.0 - cosine_air * cosine_air)) / index
    cosine = math.sqrt(1.0 - sine * sine)
    # A patch of the surface at ρ is seen spread over (offset/ρ)·(d offset/dρ) times its area at the point's depth.
    squared = (index * index - 1.0) * rho * rho + index * index * above * above
    slope = 1.0 + depth * index * index * above * above / (squared * math.sqrt(squared))
    stretch = (1.0 + depth / math.sqrt(squared)) * slope
    factor = (1.0 - reflectance(cosine_air, 1.0 / index)) / (index * index) / (stretch * cosine)
    return (
        geometry.camera_x - ex * rho, geometry.camera_y - ey * rho, ex * sine, ey * sine, cosine, depth / cosine, factor
    )  # fmt: skip


@part
def _crossing(offset: float, depth: float, above: float, index: float) -> float:
    """`crossing_offset` with a fixed number of steps, so that a loop over points is vectorised.

    From the paraxial ray, five of Newton's steps end within rounding, three up to 79° from the normal.
    """
    excess, reach = index * index - 1.0, index * index * above * above
    rho = offset / (1.0 + depth / (index * above))
    rho = _nearer(rho, offset, depth, excess, reach)
    rho = _nearer(rho, offset, depth, excess, reach)
    rho = _nearer(rho, offset, depth, excess, reach)
    rho = _nearer(rho, offset, depth, excess, reach)
    return _nearer(rho, offset, depth, excess, reach)


@part
def _nearer(rho: float, offset: float, depth: float, excess: float, reach: float) -> float:
    """One of Newton's steps for ρ + depth · tan θ_water(ρ) = offset."""
    squared = excess * rho * rho + reach
    root = math.sqrt(squared)
    return rho + (offset - rho - depth * rho / root) / (1.0 + depth * reach / (squared * root))

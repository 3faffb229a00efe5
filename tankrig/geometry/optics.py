"""Light at a plane between two media: how much is reflected (Fresnel), where it goes (Snell).

Scalar kernels are for use inside other kernels; the functions on arrays compute the same.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.compiled import kernel


@kernel
def reflectance(cosine: float, ratio: float) -> float:
    """Fresnel reflectance of unpolarised light at a smooth plane; 1 above the critical angle. Scalar kernel.

    Parameters
    ----------
    cosine
        Of the angle of incidence, 0 … 1.
    ratio
        Refractive index on the side the light comes from over the index behind the plane.

    Examples
    --------
    >>> round(reflectance(1.0, 1.33), 5), reflectance(0.5, 1.33)
    (0.02006, 1.0)
    """
    sine_squared = ratio * ratio * (1.0 - cosine * cosine)
    if sine_squared >= 1.0:
        return 1.0
    behind = math.sqrt(1.0 - sine_squared)
    r_s = (ratio * cosine - behind) / (ratio * cosine + behind)
    r_p = (ratio * behind - cosine) / (ratio * behind + cosine)
    return 0.5 * (r_s * r_s + r_p * r_p)


def fresnel_reflectance(cosine: ArrayLike, ratio: float) -> NDArray[np.float64]:
    """`reflectance` for an array of cosines.

    Examples
    --------
    >>> fresnel_reflectance([1.0, 0.5], 1.33).round(5)
    array([0.02006, 1.     ])
    """
    front = np.asarray(cosine, np.float64)
    behind = np.sqrt(np.maximum(1.0 - ratio * ratio * (1.0 - front * front), 0.0))
    with np.errstate(invalid="ignore"):  # 0/0 at grazing incidence between equal media; total reflection below
        r_s = (ratio * front - behind) / (ratio * front + behind)
        r_p = (ratio * behind - front) / (ratio * behind + front)
    return np.where(behind > 0.0, 0.5 * (r_s**2 + r_p**2), 1.0)


def mirror(directions: ArrayLike, normal: ArrayLike) -> NDArray[np.float64]:
    """Directions of travel after specular reflection at a plane.

    Parameters
    ----------
    directions
        (…, 3) unit vectors.
    normal
        (3,) unit vector across the plane, of either sign.

    Examples
    --------
    >>> mirror([0.6, 0.0, 0.8], [0.0, 0.0, 1.0])
    array([ 0.6,  0. , -0.8])
    """
    travel, across = np.asarray(directions, np.float64), np.asarray(normal, np.float64)
    return travel - 2.0 * (travel @ across)[..., None] * across


def refract(directions: ArrayLike, normal: ArrayLike, ratio: float) -> NDArray[np.float64]:
    """Directions of travel after refraction at a plane (Snell's law); NaN where the light is totally reflected.

    Parameters
    ----------
    directions
        (…, 3) unit vectors.
    normal
        (3,) unit vector across the plane, of either sign.
    ratio
        Refractive index on the side the light comes from over the index behind the plane.

    Examples
    --------
    >>> refract([0.6, 0.0, 0.8], [0.0, 0.0, 1.0], 1.0 / 1.2).round(6)
    array([0.5     , 0.      , 0.866025])
    """
    travel, across = np.asarray(directions, np.float64), np.asarray(normal, np.float64)
    cosine = (travel @ across)[..., None]
    squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    behind = np.sqrt(np.where(squared >= 0.0, squared, np.nan))
    return ratio * (travel - cosine * across) + np.copysign(behind, cosine) * across


@kernel
def crossing_offset(
    offset: float, depth: float, height: float, index: float, pane: float = 0.0, pane_index: float = 1.0
) -> float:
    """Where the ray from a point under water to a point in the air enters the air. Scalar kernel.

    Solves Snell's law ρ + pane · tan θ_glass(ρ) + depth · tan θ_water(ρ) = offset,
    tan θ = ρ / √((n² − 1) ρ² + n² height²), by Newton's method. The left side is increasing and concave in ρ, so that
    from the paraxial ray, which falls short, the iteration climbs to the root without overshooting.

    Parameters
    ----------
    offset
        Distance between the two points along the plane of the surface, mm.
    depth
        Of the point in the water from the surface, mm.
    height
        Of the point in the air from the surface, or from the pane, mm.
    index
        Refractive index n ≥ 1 of the water.
    pane, pane_index
        Thickness in mm and refractive index of a pane between water and air.

    Returns
    -------
    float
        Distance ρ along the plane from the point in the air to where the ray leaves the air, mm.

    Examples
    --------
    >>> crossing_offset(300.0, 100.0, 200.0, 1.0)
    200.0
    >>> rho = crossing_offset(300.0, 100.0, 200.0, 1.33)
    >>> in_air, in_water = math.atan2(rho, 200.0), math.atan2(300.0 - rho, 100.0)
    >>> round(math.sin(in_air) / math.sin(in_water), 12)
    1.33
    >>> round(crossing_offset(300.0, 60.0, 200.0, 1.0, 40.0, 1.0), 9)
    200.0
    """
    rho = offset / (1.0 + depth / (index * height) + pane / (pane_index * height))
    if index == 1.0 and pane == 0.0:
        return rho
    excess, reach = index * index - 1.0, index * index * height * height
    pane_excess, pane_reach = pane_index * pane_index - 1.0, pane_index * pane_index * height * height
    for _ in range(50):
        squared = excess * rho * rho + reach
        root = math.sqrt(squared)
        miss = offset - rho - depth * rho / root
        slope = 1.0 + depth * reach / (squared * root)
        if pane > 0.0:
            squared = pane_excess * rho * rho + pane_reach
            root = math.sqrt(squared)
            miss -= pane * rho / root
            slope += pane * pane_reach / (squared * root)
        step = miss / slope
        rho += step
        if step <= 1e-7 * offset:  # what is left then is about the square of that
            break
    return rho


@kernel
def entry_slope(offset: float, distance: float, index: float, pane: float, pane_index: float) -> float:
    """How steeply light from a point in the air goes on in the water behind a plane wall. Scalar kernel.

    Parameters
    ----------
    offset
        From the foot of the point's normal on the wet side of the wall to where the ray comes through, mm.
    distance
        Of the point from the wet side of the wall, mm.
    index
        Refractive index of the water.
    pane, pane_index
        Thickness of the wall in mm and its refractive index.

    Returns
    -------
    float
        tan θ_water / offset, 1/mm: what the ray moves outward per mm into the water, per mm of offset.

    Examples
    --------
    >>> entry_slope(30.0, 400.0, 1.0, 0.0, 1.0) * 400.0
    1.0
    >>> in_air, in_water = math.atan2(30.0, 400.0), math.atan(30.0 * entry_slope(30.0, 400.0, 1.33, 0.0, 1.0))
    >>> round(math.sin(in_air) / math.sin(in_water), 12)
    1.33
    """
    height = distance - pane
    rho = crossing_offset(offset, 0.0, height, index, pane, pane_index)
    share = rho / offset if offset > 1e-9 else 1.0 / (1.0 + pane / (pane_index * height))
    return share / math.sqrt((index * index - 1.0) * rho * rho + index * index * height * height)


@kernel
def pixel_seen(
    lens: tuple[float, ...],
    turn: tuple[float, ...],
    widest: float,
    dx: float,
    dy: float,
    dz: float,
) -> tuple[float, float]:
    """Pixel of a direction of sight. Scalar kernel; `tankrig.geometry.lens.to_pixels` for one direction.

    Parameters
    ----------
    lens
        fx, fy, cx, cy, k1, k2, p1, p2, k3.
    turn
        Rows of the matrix from the world to the device's frame.
    widest
        Tangent of the angle from the axis beyond which nothing is in the picture: there the distortion may fold back.
    dx, dy, dz
        Direction in the world, of any length.

    Returns
    -------
    u, v
        Both −1e9 for what is not in the picture.
    """
    z = turn[6] * dx + turn[7] * dy + turn[8] * dz
    x, y = turn[0] * dx + turn[1] * dy + turn[2] * dz, turn[3] * dx + turn[4] * dy + turn[5] * dz
    if z <= 0.0 or x * x + y * y > widest * widest * z * z:
        return -1e9, -1e9
    x, y = x / z, y / z
    squared = x * x + y * y
    radial = 1.0 + squared * (lens[4] + squared * (lens[5] + squared * lens[8]))
    u = x * radial + 2.0 * lens[6] * x * y + lens[7] * (squared + 2.0 * x * x)
    v = y * radial + lens[6] * (squared + 2.0 * y * y) + 2.0 * lens[7] * x * y
    return lens[0] * u + lens[2], lens[1] * v + lens[3]

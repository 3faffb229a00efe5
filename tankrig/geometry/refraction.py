"""Light through a flat boundary between air and water: the level surface, or a wall of glass (Snell's law)."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.compiled import kernel
from tankrig.geometry.optics import crossing_offset, fresnel_reflectance, refract

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """A plane across one axis with water on one side and air on the other, and a pane of glass between or not.

    Parameters
    ----------
    axis
        0, 1 or 2: across x, y or z.
    place_mm
        Where on that axis the water ends.
    air
        Side on which the air is: 1 or −1.
    water_index
        Refractive index of the water; 1 for no refraction.
    pane_mm, pane_index
        Thickness and refractive index of the pane.
    """

    axis: int
    place_mm: float
    air: int
    water_index: float
    pane_mm: float = 0.0
    pane_index: float = 1.5


def entry_wall(water_index: float, pane_mm: float = 0.0, pane_index: float = 1.5) -> Window:
    """The tank's wall x = 0, wet on its inside."""
    return Window(0, 0.0, -1, water_index, pane_mm, pane_index)


def water_surface(height_mm: float, water_index: float) -> Window:
    """The level surface z = `height_mm`."""
    return Window(2, height_mm, 1, water_index)


class Sight(NamedTuple):
    """How points in the water are seen from a point in the air; arrays (…, 3)."""

    in_air: Array
    """Unit directions in which the viewpoint looks."""
    entry_mm: Array
    """Where the ray enters the water."""
    in_water: Array
    """Unit directions from there to the points."""


def enter_water(window: Window, origins: ArrayLike, directions: ArrayLike) -> tuple[Array, Array]:
    """Follow rays from the air into the water.

    Parameters
    ----------
    window
        What they go through.
    origins
        (…, 3) or (3,) points in the air, mm.
    directions
        (…, 3) unit directions of travel.

    Returns
    -------
    points, directions
        (…, 3) where they enter the water, mm, and which way they go there; NaN for rays that don't meet the window.

    Examples
    --------
    >>> points, ways = enter_water(water_surface(120.0, 1.33), [0.0, 0.0, 220.0], [0.6, 0.0, -0.8])
    >>> points.round(9).tolist(), round(float(ways[0]), 6) == round(0.6 / 1.33, 6)
    ([75.0, 0.0, 120.0], True)
    """
    start, way = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
    normal = np.eye(3)[window.axis]
    point = _to_plane(window, start, way, window.place_mm + window.air * window.pane_mm)
    if window.pane_mm > 0.0:
        way = refract(way, normal, 1.0 / window.pane_index)
        point = _to_plane(window, point, way, window.place_mm)
        return point, refract(way, normal, window.pane_index / window.water_index)
    return point, refract(way, normal, 1.0 / window.water_index)


def look_into_water(window: Window, viewpoint: ArrayLike, points: ArrayLike) -> Sight:
    """Find the rays by which points in the water are seen from a point in the air.

    Parameters
    ----------
    window
        What they are seen through.
    viewpoint
        (3,) in the air, mm.
    points
        (…, 3) in the water or on its boundary, mm.

    Returns
    -------
    Sight
        NaN for points that are not in the water.

    Raises
    ------
    ValueError
        When the viewpoint is not in the air.

    Examples
    --------
    >>> sight = look_into_water(water_surface(120.0, 1.33), [0.0, 0.0, 220.0], [100.0, 0.0, 70.0])
    >>> entry, way = enter_water(water_surface(120.0, 1.33), [0.0, 0.0, 220.0], sight.in_air)
    >>> bool(np.allclose(entry + way * (50.0 / -way[2]), [100.0, 0.0, 70.0], rtol=0, atol=1e-9))
    True
    """
    start, aims = np.asarray(viewpoint, np.float64), np.asarray(points, np.float64)
    height = window.air * (float(start[window.axis]) - window.place_mm) - window.pane_mm
    if not height > 0.0:
        raise ValueError(f"viewpoint {start.tolist()} is not in the air; give one beyond the surface or the pane")
    along = np.delete(np.arange(3), window.axis)
    depth = window.air * (window.place_mm - aims[..., window.axis])
    depth = np.where(depth >= -1e-9, np.maximum(depth, 0.0), np.nan)
    away = (aims - start)[..., along]
    offset = np.sqrt(np.sum(away * away, axis=-1))
    index, glass = window.water_index, (window.pane_mm, window.pane_index)
    rho = np.empty(offset.shape)
    _offsets(rho.reshape(-1), offset.reshape(-1), depth.reshape(-1), height, index, *glass)
    outward = away / np.where(offset > 0.0, offset, 1.0)[..., None]
    in_glass = rho / np.sqrt((glass[1] ** 2 - 1.0) * rho**2 + (glass[1] * height) ** 2)
    tangent = rho / np.sqrt((index**2 - 1.0) * rho**2 + (index * height) ** 2)
    entry = np.empty(aims.shape)
    entry[..., along] = start[along] + (rho + window.pane_mm * in_glass)[..., None] * outward
    entry[..., window.axis] = np.where(np.isnan(rho), np.nan, window.place_mm)
    return Sight(_unit(window, outward, rho / height), entry, _unit(window, outward, tangent))


def transmitted(window: Window, directions: ArrayLike) -> Array:
    """Share of the flux along directions in air that gets into the water.

    Reflections to and fro within a pane are counted, without interference: T = T₁ T₂ / (1 − R₁ R₂).

    Parameters
    ----------
    window
        What the light goes through.
    directions
        (…, 3) unit directions of travel in the air.

    Examples
    --------
    >>> round(float(transmitted(entry_wall(1.33, 6.0, 1.52), [1.0, 0.0, 0.0])), 4)
    0.9533
    """
    cosine = np.abs(np.asarray(directions, np.float64)[..., window.axis])
    if window.pane_mm == 0.0:
        return 1.0 - fresnel_reflectance(cosine, 1.0 / window.water_index)
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / window.pane_index**2)
    first = fresnel_reflectance(cosine, 1.0 / window.pane_index)
    second = fresnel_reflectance(inside, window.pane_index / window.water_index)
    return np.asarray((1.0 - first) * (1.0 - second) / (1.0 - first * second))


@kernel
def _offsets(
    rho: Array, offset: Array, depth: Array, height: float, index: float, pane: float, pane_index: float
) -> None:
    """`crossing_offset` of every point."""
    for k in range(rho.size):
        rho[k] = crossing_offset(offset[k], depth[k], height, index, pane, pane_index)
        if math.isnan(depth[k]):
            rho[k] = math.nan


def _to_plane(window: Window, start: Array, way: Array, place: float) -> Array:
    """Where rays meet a plane across the window's axis; NaN where they go away from it."""
    into = -window.air * way[..., window.axis]
    reach = window.air * (start[..., window.axis] - place) / np.where(into > 0.0, into, np.nan)
    point = start + np.where(reach >= 0.0, reach, np.nan)[..., None] * way
    point[..., window.axis] = np.where(np.isnan(reach), np.nan, place)
    return point


def _unit(window: Window, outward: Array, tangent: Array) -> Array:
    """Unit directions into the water, by the tangent of their angle from the normal."""
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    along = np.delete(np.arange(3), window.axis)
    result = np.empty((*outward.shape[:-1], 3))
    result[..., along] = (cosine * tangent)[..., None] * outward
    result[..., window.axis] = -window.air * cosine
    return result

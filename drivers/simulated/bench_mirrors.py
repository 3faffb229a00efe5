"""What mirrors light in the tank of a simulated bench: its surface from below, and walls of glass.

A line of sight that meets a wall goes on as the mirror image of itself, and so does a beam. A pane sends light back at
both of its sides; what has been to the outer one comes out farther along the wall.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from tankrig.geometry.optics import fresnel_reflectance

from .bench_truth import TANK_MM, Array, TrueBench

_STEEP = 1e-9
_WALLS = {
    "entry": (0, 0.0),
    "far": (0, TANK_MM[0]),
    "left": (1, -TANK_MM[1] / 2),
    "right": (1, TANK_MM[1] / 2),
}
"""The axis that each wall is across, and where it is on it, mm."""


class Line(NamedTuple):
    """Lines of sight at nodes of the camera's picture.

    Parameters
    ----------
    points
        (planes, rows, columns, 3) at even heights of the water, wherever they are; mm.
    way
        (rows, columns, 3) unit vectors, away from the camera.
    path_mm
        (planes, rows, columns) through water, from the surface on.
    share
        (rows, columns) of the radiance there that comes to the camera.
    """

    points: Array
    way: Array
    path_mm: Array
    share: Array


@dataclass(frozen=True, eq=False)
class Mirror:
    """A plane that sends the projector's light back into the water.

    Parameters
    ----------
    normal, at_mm
        Points x with x · normal = at_mm; the water is on the smaller side.
    share
        Of the light that comes back, by the cosine of its angle to the normal.
    aside_mm
        How far along the plane it comes out, by the same cosine.
    """

    normal: Array
    at_mm: float
    share: Callable[[Array], Array]
    aside_mm: Callable[[Array], Array] | None = None

    def image(self, points: Array, way: Array | None) -> Array:
        """Where points seem to be to light that comes there on a way as if there were no mirror."""
        if self.aside_mm is not None and way is not None:
            meeting = (way @ self.normal)[..., None]
            along = (way - meeting * self.normal) / np.sqrt(np.maximum(1.0 - meeting**2, _STEEP))
            points = points - self.aside_mm(meeting) * along
        return np.asarray(points - 2.0 * (points @ self.normal - self.at_mm)[..., None] * self.normal)


def surface_of(bench: TrueBench) -> Mirror:
    """The water's surface, from below."""
    middle = np.array([TANK_MM[0] / 2, 0.0, bench.level_mm])
    index = bench.water_index
    return Mirror(bench.surface, float(middle @ bench.surface), lambda cosine: fresnel_reflectance(cosine, index))


def sides_of(bench: TrueBench, wall: str) -> tuple[Mirror, ...]:
    """The inner and the outer side of a wall; none where it is not glass."""
    if wall not in bench.stray.glass:
        return ()
    axis, at_mm = _WALLS[wall]
    outwards = 1.0 if at_mm > 0.0 else -1.0
    normal = outwards * np.eye(3)[axis]
    return (
        Mirror(normal, outwards * at_mm, lambda cosine: _sides(bench, cosine)[0]),
        Mirror(normal, outwards * at_mm, lambda cosine: _sides(bench, cosine)[1], lambda one: _aside_mm(bench, one)),
    )


def by_way_of_walls(bench: TrueBench, line: Line) -> tuple[list[Line], list[Line]]:
    """Lines of sight as each glass wall sends them on; and as two do that meet in an edge of the tank."""
    across = [[wall for wall in bench.stray.glass if _WALLS[wall][0] == axis] for axis in (0, 1)]
    once = [[(wall, outer) for wall in walls for outer in (False, True)] for walls in across]
    alone = [_sent_on(bench, line, *one) for one in (*once[0], *once[1])]
    return alone, [_sent_on(bench, _sent_on(bench, line, *one), *other) for one, other in product(*once)]


def _sent_on(bench: TrueBench, line: Line, wall: str, outer: bool) -> Line:
    """Lines of sight beyond where they meet a wall's inner or outer side.

    Before they do, their points are beyond the wall, where there is no water.
    """
    axis, at_mm = _WALLS[wall]
    cosine = np.abs(line.way[..., axis])
    share = line.share * _sides(bench, cosine)[int(outer)]
    points, path_mm = line.points, line.path_mm
    if outer:
        along = line.way.copy()
        along[..., axis] = 0.0
        moved = _aside_mm(bench, cosine)[..., None] * along / np.sqrt(np.maximum(1.0 - cosine**2, _STEEP))[..., None]
        earlier_mm = moved[..., 2] / line.way[..., 2]  # at the same height
        points, path_mm = points + moved - earlier_mm[..., None] * line.way, path_mm - earlier_mm
    points, way = points.copy(), line.way.copy()
    points[..., axis] = 2.0 * at_mm - points[..., axis]
    way[..., axis] = -way[..., axis]
    return Line(points, way, path_mm, share)


def _in_glass(bench: TrueBench, cosine: Array) -> Array:
    """Cosine of the angle to the normal in a pane, by that in the water."""
    return np.asarray(np.sqrt(1.0 - (bench.water_index / bench.pane_index) ** 2 * (1.0 - np.asarray(cosine) ** 2)))


def _aside_mm(bench: TrueBench, cosine: Array) -> Array:
    """How far along a wall light comes out that has been to the outer side of its pane."""
    within = _in_glass(bench, cosine)
    return np.asarray(2.0 * bench.pane_mm * np.sqrt(1.0 - within**2) / within)


def _sides(bench: TrueBench, cosine: Array) -> tuple[Array, Array]:
    """Shares of light in the water that the inner side of a pane sends back, and the outer one: to and fro, F₁ and

    (1 − F₁)² F₂ / (1 − F₁ F₂).
    """
    inner = fresnel_reflectance(cosine, bench.water_index / bench.pane_index)
    outer = fresnel_reflectance(_in_glass(bench, cosine), bench.pane_index)
    return inner, np.asarray((1.0 - inner) ** 2 * outer / np.maximum(1.0 - inner * outer, _STEEP))

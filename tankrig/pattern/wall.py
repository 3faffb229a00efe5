"""The map from the projector's pixels to the wall that the light enters, the plane x = 0."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError, SequenceError
from tankrig.pattern.pattern import Pattern
from tankrig.ranges import require_ranges
from tankrig.scene.checks import picture_shape
from tankrig.scene.description import CLOSED, Beam, Interval, Tank
from tankrig.scene.parts import MOST_MM, Measured

ROUNDING = 1e-9
"""By which a fraction may lie outside 0 … 1: a curve that was computed and written down ends at 1.0000000000000004."""


def fractions_of_white(values: Iterable[float]) -> NDArray[np.float64]:
    """Fractions of level 255's light that the levels 0 … 255 make, without what rounding has put outside of 0 … 1.

    Raises
    ------
    SequenceError
        When they are not 256, or not all of them lie in 0 … 1.

    Examples
    --------
    >>> fractions_of_white([*np.arange(255) / 255.0, 1.0000000000000004])[-1].item()
    1.0
    """
    found = np.array(list(values), float)
    if found.shape != (256,):
        raise SequenceError(f"response has {found.size} entries; give one fraction, 0 to 1, for each level 0 … 255")
    wrong = ~((found >= -ROUNDING) & (found <= 1.0 + ROUNDING))
    if wrong.any():
        level = int(np.flatnonzero(wrong)[0])
        raise SequenceError(f"response has {found[level]:.6g} at level {level}; give a fraction of the light, 0 to 1")
    inside: NDArray[np.float64] = np.clip(found, 0.0, 1.0)
    return inside


@dataclass(frozen=True)
class Wall:
    """Where the projector's pixels fall on the plane x = 0, and how bright they are there.

    Parameters
    ----------
    shape
        (rows, columns) of the projector.
    y_mm
        (y of the left edge of column 0, y of the right edge of the last column); falls when the picture is mirrored.
    z_mm
        (z of the lower edge of the last row, z of the upper edge of row 0).
    irradiance
        Of a pixel at level 255: flux per area of the plane x = 0, W/mm².
    gamma
        A pixel at level v has (v/255)^gamma of it.
    response
        Or, as measured, 256 fractions of it, one for each level, from 0 to 1; gamma then counts for nothing.

    Examples
    --------
    >>> wall = Wall(shape=(60, 80), y_mm=(-80.0, 80.0), z_mm=(0.0, 120.0))
    >>> wall.pixel_mm
    (2.0, 2.0)
    >>> picture = np.zeros(wall.shape, np.uint8)
    >>> picture[29:31, 39:41] = 255
    >>> wall.beams(Pattern("spot", picture))
    (Beam(y_mm=(-2.0, 2.0), z_mm=(58.0, 62.0), irradiance=1.0),)
    """

    __pydantic_config__ = CLOSED
    shape: tuple[int, int]
    y_mm: Interval
    z_mm: Interval
    irradiance: Measured = 1.0
    gamma: Measured = 1.0
    response: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        try:
            picture_shape(self.shape)
        except SceneError as error:
            raise SequenceError(str(error)) from error
        if not max(abs(edge) for edge in (*self.y_mm, *self.z_mm)) <= MOST_MM or (
            self.y_mm[0] == self.y_mm[1] or self.z_mm[0] >= self.z_mm[1]
        ):
            raise SequenceError(
                f"y_mm = {list(self.y_mm)}, z_mm = {list(self.z_mm)} is no area; give the edges of the picture in mm"
            )
        require_ranges(self, SequenceError)
        if self.response:
            object.__setattr__(self, "response", tuple(fractions_of_white(self.response).tolist()))

    @property
    def fractions(self) -> NDArray[np.float64]:
        """(256,) parts of the irradiance that pixels at the levels 0 … 255 have."""
        return np.array(self.response) if self.response else (np.arange(256) / 255.0) ** self.gamma

    @property
    def column_edges_mm(self) -> NDArray[np.float64]:
        """(columns + 1,) y of the edges between columns, from the left."""
        return np.linspace(*self.y_mm, self.shape[1] + 1)

    @property
    def row_edges_mm(self) -> NDArray[np.float64]:
        """(rows + 1,) z of the edges between rows, from the top."""
        return np.linspace(*self.z_mm[::-1], self.shape[0] + 1)

    @property
    def pixel_mm(self) -> tuple[float, float]:
        """(height, width) of a pixel on the wall."""
        rows, columns = self.shape
        return (self.z_mm[1] - self.z_mm[0]) / rows, abs(self.y_mm[1] - self.y_mm[0]) / columns

    @property
    def y_centres_mm(self) -> NDArray[np.float64]:
        """(columns,) y of the columns' centres."""
        return _centres(self.column_edges_mm)

    @property
    def z_centres_mm(self) -> NDArray[np.float64]:
        """(rows,) z of the rows' centres."""
        return _centres(self.row_edges_mm)

    def beams(self, pattern: Pattern, tank: Tank | None = None) -> tuple[Beam, ...]:
        """The rectangles of light that `pattern` makes, for a model.

        Equal neighbours in a row become one rectangle, and equal rows one band of them, so that a sheet is one beam and
        stripes are as many as there are.

        Parameters
        ----------
        pattern
            In the projector's shape.
        tank
            Where given, the light that misses its wall is left out.

        Returns
        -------
        tuple of Beam
            That do not overlap; empty for a dark pattern.

        Raises
        ------
        SequenceError
            When the pattern has another shape.
        """
        if pattern.shape != self.shape:
            raise SequenceError(
                f'pattern "{pattern.name}" has shape {list(pattern.shape)} and the projector {list(self.shape)}; '
                f"draw it in the projector's shape"
            )
        y, z, pixels = self.column_edges_mm, self.row_edges_mm, pattern.pixels
        half_width, height = (tank.size_mm[1] / 2, tank.size_mm[2]) if tank else (np.inf, np.inf)
        floor = 0.0 if tank else -np.inf
        beams, fractions = [], self.fractions
        for top, bottom in _runs((pixels[1:] != pixels[:-1]).any(axis=1)):
            z_mm = _overlap(z[bottom], z[top], floor, height)
            row = pixels[top]
            for left, right in _runs(row[1:] != row[:-1]):
                y_mm = _overlap(y[left], y[right], -half_width, half_width)
                if row[left] and y_mm and z_mm:
                    beams.append(Beam(y_mm, z_mm, self.irradiance * float(fractions[row[left]])))
        return tuple(beams)


def _centres(edges: NDArray[np.float64]) -> NDArray[np.float64]:
    centres: NDArray[np.float64] = (edges[1:] + edges[:-1]) / 2
    return centres


def _runs(changes: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(start, end) of the stretches between `changes`, where changes[i] stands between i and i + 1."""
    edges = [0, *(np.flatnonzero(changes) + 1).tolist(), changes.size + 1]
    return list(pairwise(edges))


def _overlap(start: float, end: float, low: float, high: float) -> Interval | None:
    """The part of the stretch between `start` and `end` that lies in [low, high], if any."""
    first, last = max(low, float(min(start, end))), min(high, float(max(start, end)))
    return (first, last) if first < last else None

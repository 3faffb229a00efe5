"""Strips of a bench's wall, and the image of any pattern put together from those of the strips.

Light is linear in the pattern, and light that enters beside a place makes much the same image, moved with its ray. So
strips are narrow, a few mm apart and at two heights of a band, and the image of a beam is put together from those of
the strips about it: in every column each is moved by as much as the beam's ray is seen beside the strip's, at the ray
itself wholly and the less the nearer a side wall is, which does not move. Images of fixed strips alone would have to be
4 mm apart or less (decision 211).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.sampling import PathImages
from tankrig.light.rays import geometry_of, sighting_rows
from tankrig.scene import Beam, Scene
from tankrig.scene.description import Interval

Array = NDArray[np.float64]
Single = NDArray[np.float32]

STRIP_MM = 2.0
"""Width of a strip, and the widest part of a beam that is moved as one."""
APART_MM = 10.0
"""From strip to strip, at most. Thirteen millimetres leave .6 % of orders ≥ 3 of three rays, 26 leave 2.3 %."""
LAYERS = 2
"""Heights of a band: between them the image is linear."""


@dataclass(frozen=True)
class Strips:
    """Strips of the wall that light enters by, from side wall to side wall.

    Parameters
    ----------
    scene
        Gives tank, projector and camera; its beams do not matter.
    band
        z of the wall, low and high, mm.
    """

    scene: Scene
    band: Interval

    @cached_property
    def y_mm(self) -> Array:
        """Middles of the strips."""
        reach = 0.5 * (self.scene.tank.size_mm[1] - STRIP_MM)
        return np.linspace(-reach, reach, 2 + math.ceil(2.0 * reach / APART_MM))

    @cached_property
    def layers(self) -> Array:
        """Edges of the heights."""
        return np.linspace(*self.band, LAYERS + 1)

    @cached_property
    def scenes(self) -> list[Scene]:
        """Scenes with one strip each: all heights of the first, then of the next."""
        half = 0.5 * STRIP_MM
        beams = [
            Beam((float(y) - half, float(y) + half), (float(low), float(high)))
            for y in self.y_mm
            for low, high in pairwise(self.layers)
        ]
        return [replace(self.scene, projector=replace(self.scene.projector, beams=(beam,))) for beam in beams]

    def weights(self, beams: Sequence[Beam]) -> tuple[NDArray[np.int64], Single]:
        """What of the strips' images the images of beams are.

        Returns
        -------
        used
            Numbers of the strips that count.
        weights
            (columns, rows, used · rows): each row of a column as a sum over the rows of the strips' columns.
        """
        grid, geometry = PathImages(self.scene, ()).grid, geometry_of(self.scene)
        half, cell = geometry.half_width, grid.cell_mm[1]
        x: Array = (np.arange(grid.columns, dtype=float) + 0.5) * grid.cell_mm[0]
        y = (np.arange(grid.rows) + 0.5) * cell - half
        middles = 0.5 * (self.layers[:-1] + self.layers[1:])
        parts = [part for beam in beams for part in _parts(beam)]
        about = [self._about(0.5 * (part.y_mm[0] + part.y_mm[1])) for part in parts]
        used = np.unique([number for numbers, _ in about for number in numbers])
        found = np.zeros((grid.columns, grid.rows, used.size, LAYERS, grid.rows), np.float32)
        columns, rows = np.arange(grid.columns)[:, None], np.arange(grid.rows)[None]
        for part, (numbers, shares) in zip(parts, about, strict=True):
            (low, high), (floor, top) = part.y_mm, part.z_mm
            at, height = 0.5 * (low + high), 0.5 * (floor + top)
            upper = (height - middles[0]) / (middles[1] - middles[0])
            ray = sighting_rows(geometry, x, at, height)[:, None]
            to_wall = np.maximum(np.where(y > ray, half - ray, half + ray), 1e-3)
            moving = np.clip(1.0 - np.abs(y - ray) / to_wall, 0.0, 1.0)
            light = part.irradiance * (high - low) / STRIP_MM * (top - floor) / (middles[1] - middles[0])
            for number, share in zip(numbers, shares, strict=True):
                strip = float(self.y_mm[number])
                beside = sighting_rows(geometry, x, strip, height)[:, None] - ray
                row, between = _between((y + beside * moving + half) / cell - 0.5, grid.rows)
                place = int(np.searchsorted(used, number))
                for layer, weight in enumerate((1.0 - upper, upper)):
                    for step, by_row in enumerate(between):
                        found[columns, rows, place, layer, row + step] += light * share * weight * by_row
        numbers_used = (used[:, None] * LAYERS + np.arange(LAYERS)).ravel()
        return numbers_used, found.reshape(grid.columns, grid.rows, -1)

    def _about(self, y_mm: float) -> tuple[tuple[int, int], tuple[float, float]]:
        """The two strips about a place, and the share of each."""
        first = int(np.clip(np.searchsorted(self.y_mm, y_mm) - 1, 0, self.y_mm.size - 2))
        share = (y_mm - self.y_mm[first]) / (self.y_mm[first + 1] - self.y_mm[first])
        return (first, first + 1), (1.0 - float(share), float(share))


def _parts(beam: Beam) -> list[Beam]:
    """A beam cut into parts that are moved as one."""
    edges = np.linspace(*beam.y_mm, 1 + math.ceil((beam.y_mm[1] - beam.y_mm[0]) / STRIP_MM - 1e-9))
    return [replace(beam, y_mm=(float(low), float(high))) for low, high in pairwise(edges)]


def _between(place: Array, count: int) -> tuple[NDArray[np.int64], tuple[Array, Array, Array, Array]]:
    """Cubic interpolation between rows: the first of four, and their weights; no farther than the outermost."""
    place = np.clip(place, 0.0, count - 1.0)
    first = np.clip(place.astype(np.int64) - 1, 0, count - 4)
    a = place - first
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    return first, (-b * c * d / 6.0, 0.5 * a * c * d, -0.5 * a * b * d, a * b * c / 6.0)


def put_together(weights: Single, learned: Sequence[Single], along: Array) -> list[Array]:
    """Images of a pattern at several media: (albedos, rows, degrees) of each.

    Parameters
    ----------
    weights
        See `Strips.weights`.
    learned
        Images of the strips at each medium, (used strips, albedos, rows, degrees).
    along
        See `PathImages.along`.
    """
    media, (strips, albedos, rows, degrees) = len(learned), learned[0].shape
    columns = len(along)
    # By degree first: images have four times as many columns, and putting numbers in order is most of the work.
    light = np.stack(learned).transpose(4, 1, 3, 0, 2).reshape(degrees, -1)
    by_column = (along.astype(np.float32) @ light).reshape(columns, strips * rows, -1)
    seen = (weights @ by_column).reshape(columns, -1)
    found = (along.T.astype(np.float32) @ seen).reshape(degrees, rows, media, albedos)
    return list(np.asarray(found.transpose(2, 3, 1, 0), float))

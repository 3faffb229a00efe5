"""Why nothing that was learned serves a pattern: what the learned bench that is most like its own has otherwise."""

import math
from collections.abc import Iterator
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.box import Box
from tankrig.light.prepared.cache import Place, cache_folder
from tankrig.light.prepared.sampling import PathImages
from tankrig.light.rays import Geometry, geometry_of
from tankrig.scene import Scene
from tankrig.scene.description import Interval

Arrays = dict[str, NDArray[np.generic]]

BENCH, LIQUIDS, HEIGHT = 4, 2, 1
"""How much a difference counts: one of the bench for more than other liquids and another height together."""
EDGE_MM = 1e-6
"""By which light may be beyond a band."""


@dataclass(frozen=True)
class Conditions:
    """All that what is learned of a bench holds for.

    Parameters
    ----------
    geometry
        Tank, water, projector and camera.
    cells
        Rows, columns and size, mm, of the cells in which light is recorded.
    box, tolerance
        Of the models.
    band
        z of the wall where light enters, low and high, mm.
    """

    geometry: Geometry
    cells: tuple[float, ...]
    box: Box
    tolerance: float
    band: Interval

    @classmethod
    def of(cls, lit: Scene, box: Box, tolerance: float, band: Interval) -> "Conditions":
        """For a bench, as its scene is lit by sharp beams."""
        grid = PathImages(lit, ()).grid
        cells = float(grid.rows), float(grid.columns), *grid.cell_mm
        return cls(geometry_of(lit), cells, box, tolerance, band)

    @classmethod
    def kept(cls) -> "Iterator[Conditions]":
        """Conditions of all benches in the cache that were learned to the end."""
        folder = cache_folder() / "prepared"
        for file in sorted(folder.glob("*_*_*.npz")):
            arrays = Place(folder, file.stem).kept(file)
            found = None if arrays is None else cls._read(arrays)
            if found is not None:
                yield found

    @classmethod
    def _read(cls, arrays: Arrays) -> "Conditions | None":
        try:
            geometry, cells, ends, tolerance, band = (
                arrays[name].astype(float).tolist() for name in ("geometry", "cells", "box", "tolerance", "band")
            )
            box = Box(*((low, high) for low, high in ends))
            return cls(Geometry(*geometry), tuple(cells), box, tolerance, (band[0], band[1]))
        except (KeyError, TypeError, ValueError):
            return None

    @property
    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """The conditions as arrays of a file."""
        given = {"geometry": self.geometry, "cells": self.cells, "tolerance": self.tolerance, "band": self.band}
        return {**{name: np.array(one, float) for name, one in given.items()}, "box": np.array(astuple(self.box))}

    def unlike(self, wanted: "Conditions") -> tuple[tuple[int, float], list[str]]:
        """How unlike what is wanted these conditions are, and in what."""
        below_mm, above_mm = self.band[0] - wanted.band[0], wanted.band[1] - self.band[1]
        beyond_mm = max(below_mm, above_mm, 0.0)
        facts = zip(self.facts, wanted.facts, strict=True)
        found = [(one, other) for one, other in facts if one.numbers != other.numbers]
        found = [(one, other) for one, other in found if one.counts != HEIGHT or beyond_mm > EDGE_MM]
        densities = math.log(math.prod(self.box.sigma_t) / math.prod(wanted.box.sigma_t))
        away = abs(densities) + abs(math.log(self.tolerance / wanted.tolerance)) + beyond_mm / wanted.geometry.height
        return (sum(one.counts for one, _ in found), away), [one.beside(other) for one, other in found]

    @property
    def facts(self) -> "list[Fact]":
        """The conditions one by one, in words and numbers."""
        size = self.geometry.length, 2.0 * self.geometry.half_width, self.geometry.height
        wall = self.geometry.entry_index, self.geometry.pane, self.geometry.pane_index
        return [
            Fact(BENCH, "a tank of", size, " × ", " mm"),
            Fact(BENCH, "a surface of refractive index", (self.geometry.refractive_index,)),
            Fact(BENCH, "an entry wall (index of water, mm, index) of", wall),
            Fact(BENCH, "its projector (x, y, z) at", self.geometry[4:8][1:], ", ", " mm"),
            Fact(BENCH, "its camera (x, y, z) at", self.geometry[8:12][1:], ", ", " mm"),
            Fact(BENCH, "cells (rows, columns, mm, mm) of", self.cells),
            Fact(LIQUIDS, "σt", self.box.sigma_t, " … ", "/mm"),
            Fact(LIQUIDS, "albedo", self.box.albedo, " … "),
            Fact(LIQUIDS, "g", self.box.g, " … "),
            Fact(LIQUIDS, "a tolerance of", (self.tolerance,)),
            Fact(HEIGHT, "light at heights", self.band, " … ", " mm"),
        ]


@dataclass(frozen=True)
class Fact:
    """One of the conditions.

    Parameters
    ----------
    counts
        See `BENCH`.
    what
        It is about.
    numbers
        That must be the same.
    between, unit
        The numbers, and after them, in words.
    """

    counts: int
    what: str
    numbers: tuple[float, ...]
    between: str = ", "
    unit: str = ""

    def beside(self, other: "Fact") -> str:
        """In words, with as many digits as tell both apart."""
        for digits in (4, 7, 17):
            one, here = (self.between.join(f"{x:.{digits}g}" for x in each.numbers) for each in (self, other))
            if one != here:
                break
        return f"{self.what} {one}{self.unit}, not {here}{self.unit}"


def why_not_learned(lit: Scene, box: Box, tolerance: float) -> str:
    """One sentence on what the nearest learned bench has otherwise than a model; empty where none was learned.

    Parameters
    ----------
    lit
        The model's scene, lit by sharp beams.
    box, tolerance
        Of the model.
    """
    heights = [beam.z_mm for beam in lit.projector.beams if beam.power > 0.0]
    if not heights:
        return ""
    band = min(low for low, _ in heights), max(high for _, high in heights)
    wanted = Conditions.of(lit, box, tolerance, band)
    nearest = min((one.unlike(wanted) for one in Conditions.kept()), key=lambda each: each[0], default=None)
    if nearest is None:
        return ""
    _, said = nearest
    if not said:
        return ""
    return f"the bench that was learned has {'; '.join(said)}: this pattern's paths are followed anew"

"""Shifted lattices of light paths: the images that they make, and as many of them as are wanted, kept in groups."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from tankrig.light.paths.block import LARGE, Lattice, PathLimits, Points
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.record import Bins, cell_averages, image_of_edges
from tankrig.light.paths.trace import trace
from tankrig.light.rays import geometry_of, sight_line
from tankrig.light.water import water_for_paths
from tankrig.scene import Beam, Scene
from tankrig.threads import THREADS

Array = NDArray[np.float64]

THINNING = 16
"""Order from which paths are thinned out, where the image shall be a smooth function of the medium."""
MOST_GROUPS = 32
"""Of lattices, whose images are kept apart to see their scatter; more are averaged two by two."""


class Groups:
    """Images of lattices 0, 1, 2, …, averaged in groups of equal size so that they need little memory.

    A smaller tolerance goes on with the same lattices.

    Parameters
    ----------
    image_of
        The images of one lattice, (classes, rows, columns), by its number.
    """

    def __init__(self, image_of: Callable[[int], Array]) -> None:
        self._image_of = image_of
        self._means: list[Array] = []
        self._unfinished: list[Array] = []
        self.size = 1
        """Lattices in a group."""

    @property
    def lattices(self) -> int:
        """How many have been followed."""
        return len(self._means) * self.size + len(self._unfinished)

    @property
    def counted(self) -> int:
        """How many of them are in `means`."""
        return len(self._means) * self.size

    @property
    def means(self) -> Array:
        """(groups, classes, rows, columns)."""
        return np.array(self._means)

    def follow(self, wanted: int, goes_on: Callable[[int], bool]) -> bool:
        """Follow lattices until there are as many as wanted, or there is no time for more: whether there are.

        Parameters
        ----------
        wanted
            Number of lattices.
        goes_on
            Asked after every few lattices, with how many there are, whether there is time for more. An exception that
            it raises ends the work.
        """
        with ThreadPoolExecutor(THREADS) as pool:
            while self.lattices < wanted:
                upto = min(self.lattices + THREADS, wanted)
                for image in pool.map(self._image_of, range(self.lattices, upto)):
                    self._add(image)
                if not goes_on(self.lattices):
                    break
        return self.lattices >= wanted

    def _add(self, image: Array) -> None:
        self._unfinished.append(image)
        if len(self._unfinished) < self.size:
            return
        self._means.append(np.mean(self._unfinished, axis=0))
        self._unfinished.clear()
        if len(self._means) == MOST_GROUPS:
            self._means = [0.5 * (a + b) for a, b in zip(self._means[::2], self._means[1::2], strict=True)]
            self.size *= 2


def beam_table(beams: Sequence[Beam]) -> tuple[Array, float]:
    """Beams as `tankrig.light.paths.trace` takes them, (n, 6), and the power of all."""
    power = np.array([beam.power for beam in beams])
    edges = np.array([(*beam.y_mm, *beam.z_mm, beam.irradiance) for beam in beams])
    return np.column_stack([edges, np.cumsum(power) / power.sum()]), float(power.sum())


def traced(
    scene: Scene, grid: CellGrid, seed: tuple[int, int], bins: Bins, limits: PathLimits, lattice: Lattice = LARGE
) -> Array:
    """Images of one shifted lattice of paths, W/mm²/sr.

    Parameters
    ----------
    scene
        Any scene with σs > 0.
    grid
        Cells over the tank's surface.
    seed
        Of the lattice's shift.
    bins
        Index of the image that each order goes to.
    limits
        How far paths are followed.
    lattice
        Of the paths.

    Returns
    -------
    (images, rows, columns) array
    """
    images = int(bins.max()) + 1
    medium, geometry = scene.medium, geometry_of(scene)
    water, points = water_for_paths(medium), Points(lattice.shifted(seed), lattice.points)
    shiftable = grid.shiftable
    edges = np.zeros((images, 2, grid.rows + 2, grid.columns + 2))
    cells = np.zeros((images, grid.rows, grid.columns))
    heights = sorted({beam.z_mm for beam in scene.projector.beams}) if shiftable else [None]
    for z_mm in heights:
        beams = [beam for beam in scene.projector.beams if z_mm in (None, beam.z_mm) and beam.irradiance > 0.0]
        if not beams:
            continue
        table, power = beam_table(beams)
        if z_mm is not None:
            edges[:] = 0.0
        trace(cells if z_mm is None else edges, bins, grid.cell_mm, geometry, water, table, points, limits)
        if z_mm is None:
            return cell_averages(cells * (power / (lattice.points * grid.cell_mm[0] * grid.cell_mm[1])))
        transmission = sight_line(geometry, 0.0, 0.0)[3]
        image = image_of_edges(edges, medium.sigma_t, grid.cell_mm[0])
        cells += image * (transmission * (z_mm[1] - z_mm[0]) / lattice.points)
    return cells

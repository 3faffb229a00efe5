"""From a picture on a calibrated projector to the beams that it lights on the wall x = 0."""

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.scene.checks import require
from tankrig.scene.description import Beam, Projector, Scene, Tank

Array = NDArray[np.float64]
Alike = Callable[[int, int], bool]
"""Whether cells between two numbers, the latter not counted, may become one."""

ROW_MM, COLUMN_MM = 0.5, 0.25
"""Height and width of the cells of the wall that light is collected in."""
LEVELS = 0.0025
"""By how much of the brightest, seen from above, light within a beam may be brighter or darker than its mean."""
EDGE_MM, EDGE_CELLS = 0.04, 3
"""How far a beam's edges may be from the light's, and how many cells at either end may hold them."""
LIFTED_MM, ASIDE_MM = 0.1, 0.05
"""How far light may be moved along z and along y, on average: from above the former is hardly seen."""
FARTHER_MM = 4.0
"""So far beyond cells that cannot join others it is looked whether the next ones can, together with them."""
MOST_BEAMS = 400


def lit_by(scene: Scene, picture: NDArray[np.generic]) -> Scene:
    """The scene whose projector shows a picture.

    Parameters
    ----------
    scene
        With a calibrated projector; its beams are replaced.
    picture
        (rows, columns) in the projector's shape: levels of an integer type, or shares 0 … 1 of white.

    Returns
    -------
    Scene
        Whose beams carry the picture's light to the wall: what leaves each pixel, less what the wall reflects, on the
        patch of x = 0 that the pixel lights there. What misses the wall is left out.

    Raises
    ------
    SceneError
        When the projector isn't calibrated, the picture has another shape, or none of it reaches the tank.

    Warns
    -----
    UserWarning
        When the picture has so much detail that beams had to differ from it by more than `LEVELS` and `LIFTED_MM`.
    """
    beams = beams_of(scene.tank, scene.projector, picture)
    return replace(scene, projector=replace(scene.projector, beams=beams))


def beams_of(tank: Tank, projector: Projector, picture: NDArray[np.generic]) -> tuple[Beam, ...]:
    """Beams that a picture lights; see `lit_by`."""
    beams, coarser = beams_and_detail(tank, projector, picture)
    warn_of_detail(coarser, stacklevel=4)
    return beams


def beams_and_detail(tank: Tank, projector: Projector, picture: NDArray[np.generic]) -> tuple[tuple[Beam, ...], float]:
    """Beams that a picture lights, and how many times as far from its light as beams otherwise are they had to be."""
    cells = irradiance_on_wall(tank, projector, picture)
    require(bool(cells.any()), "nothing of the picture reaches the tank; check the projector's pose, and the picture")
    _, width, height = tank.size_mm
    coarser = 1.0
    while True:
        beams = tuple(beam for patch in _patches(cells, width, height, coarser) for beam in patch.beams())
        if len(beams) <= MOST_BEAMS:
            break
        coarser *= 1.5
    return tuple(_rounded_inside(beam, width, height) for beam in beams), coarser


def warn_of_detail(coarser: float, stacklevel: int) -> None:
    """Warn when beams had to be farther from a picture's light than they otherwise are."""
    if coarser > 1.0:
        warnings.warn(
            f"the picture has too much detail for {MOST_BEAMS} beams; they were merged where they differ by less than "
            f"{coarser * LEVELS:.1%} of the brightest, or by {coarser * LIFTED_MM:.1g} mm in height",
            stacklevel=stacklevel,
        )


def _rounded_inside(beam: Beam, width: float, height: float) -> Beam:
    """A beam whose edges no rounding has moved out of the wall: n cells of a wall's n-th part may be an ulp larger."""
    (left, right), (low, high) = beam.y_mm, beam.z_mm
    return replace(
        beam, y_mm=(max(left, -0.5 * width), min(right, 0.5 * width)), z_mm=(max(low, 0.0), min(high, height))
    )


def irradiance_on_wall(tank: Tank, projector: Projector, picture: NDArray[np.generic]) -> Array:
    """What a picture lights on the wall, by cells of about `ROW_MM` × `COLUMN_MM`.

    Returns
    -------
    (rows, columns) array
        Flux per area of x = 0, W/mm², mean over cells that fill the wall, z upwards and y from −Ly/2. Every pixel's
        light is spread evenly over the patch that it lights, so that no light is lost but beside the wall; a patch
        counts as an upright rectangle with its variances.
    """
    from tankrig.geometry.refraction import entry_wall, transmitted
    from tankrig.geometry.shading import shading
    from tankrig.geometry.view import rays_of
    from tankrig.scene.spreading import spread_over_cells

    shape = projector.shape
    if projector.kind != "calibrated" or projector.matrix is None or shape is None:
        raise SceneError("a picture needs a calibrated projector, with matrix, rotation, position_mm and shape")
    require(
        picture.shape == shape,
        f"the picture has shape {list(picture.shape)} and the projector {list(shape)}; draw it in its shape",
    )
    share = np.asarray(picture, np.float64)
    if np.issubdtype(picture.dtype, np.integer):
        share = share / np.iinfo(picture.dtype).max  # type: ignore[type-var]
    require(bool((share >= 0.0).all() and (share <= 1.0).all()), "the picture has levels outside 0 … 1; scale them")
    power = projector.pixel_power * share**projector.gamma
    if projector.shading:
        power = power * shading(projector.shading, shape)
    window = entry_wall(*tank.entry_bends)
    rows, columns = shape
    corners = np.stack(np.meshgrid(np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5), axis=-1)
    lens, pose = projector.lens, projector.pose
    patches = rays_of(lens, pose, corners, window)[0][..., 1:]
    if tank.entry == "glass":
        middles = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        power = power * transmitted(window, rays_of(lens, pose, middles)[1])
    _, width, height = tank.size_mm
    cells = np.zeros((max(1, round(height / ROW_MM)), max(1, round(width / COLUMN_MM))))
    cell_area = height / cells.shape[0] * width / cells.shape[1]
    spread_over_cells(cells, patches, power, width, height)
    return cells / cell_area


@dataclass(frozen=True)
class _Patch:
    """Lit cells that touch each other, and how they become few beams.

    They are cut into blocks, and a beam has the light of its block, its middle, and its spread along y and z: no light
    is lost, its first moments stay, and an edge that shares cells with the dark is where it is. There are two ways to
    cut: into bands of columns that begin and end at nearly the same heights, which suits flat light, as a picture that
    is rolled by a degree has it; and into bands of rows, which suits tall light that leans. The one with fewer beams
    is taken (decision 210).

    Parameters
    ----------
    cells
        (rows, columns) irradiance of the patch, W/mm²; 0 where it is not.
    first
        Row and column of the wall where they begin.
    row_mm, column_mm
        Height and width of a cell.
    wall
        Rows and columns of the wall.
    brightest
        Most light of any column of the wall, W/mm.
    coarser
        Times as far from the light as beams may be otherwise.
    """

    cells: Array
    first: tuple[int, int]
    row_mm: float
    column_mm: float
    wall: tuple[int, int]
    brightest: float
    coarser: float

    def beams(self) -> list[Beam]:
        """All of them."""
        return min(self._by_columns(), self._by_rows(), key=len)

    def _by_columns(self) -> list[Beam]:
        light, rising = self.cells.sum(axis=0) * self.row_mm, np.cumsum(self.cells, axis=0).T
        lifted = self.coarser * LIFTED_MM / self.row_mm

        def alike(first: int, end: int) -> bool:
            return self._looks_even(light[first:end]) and _apart(rising[first:end]) <= lifted

        return [
            self._beam((low, high), columns)
            for columns in _groups(light, self.column_mm, alike)
            for low, high in self._even_heights(self.cells[:, slice(*columns)].sum(axis=1))
        ]

    def _by_rows(self) -> list[Beam]:
        light, rising = self.cells.sum(axis=1), np.cumsum(self.cells, axis=1)
        aside, lifted = self.coarser * ASIDE_MM / self.column_mm, self.coarser * LIFTED_MM / self.row_mm

        def alike(low: int, high: int) -> bool:
            return _uneven(light[low:high]) <= lifted and _apart(rising[low:high]) <= aside

        beams = []
        for rows in _groups(light, self.row_mm, alike):
            along = self.cells[slice(*rows)].sum(axis=0) * self.row_mm
            beams += [self._beam(rows, columns) for columns in self._even_widths(along)]
        return beams

    def _even_widths(self, light: Array) -> list[tuple[int, int]]:
        return _groups(light, self.column_mm, lambda first, end: self._looks_even(light[first:end]))

    def _even_heights(self, light: Array) -> list[tuple[int, int]]:
        lifted = self.coarser * LIFTED_MM / self.row_mm
        return _groups(light, self.row_mm, lambda low, high: _uneven(light[low:high]) <= lifted)

    def _looks_even(self, light: Array) -> bool:
        """Whether a beam looks, from above, like columns with so much light, W/mm."""
        inside = light[EDGE_CELLS:-EDGE_CELLS]
        if inside.size and np.abs(inside - inside.mean()).max() > self.coarser * LEVELS * self.brightest:
            return False
        middle, half = _spread(light)
        rising = np.clip((np.arange(light.size + 1) - middle + half) / (2.0 * half), 0.0, 1.0) * light.sum()
        moved_mm = np.abs(rising - np.cumsum(np.pad(light, (1, 0)))).max() * self.column_mm / self.brightest
        return bool(moved_mm <= self.coarser * EDGE_MM)

    def _beam(self, rows: tuple[int, int], columns: tuple[int, int]) -> Beam:
        """Light, middle and spread of a block of cells."""
        block = self.cells[slice(*rows), slice(*columns)]
        z_mm = _edges(block.sum(axis=1), self.first[0] + rows[0], self.row_mm, self.wall[0])
        y_mm = _edges(block.sum(axis=0), self.first[1] + columns[0], self.column_mm, self.wall[1])
        area = (y_mm[1] - y_mm[0]) * (z_mm[1] - z_mm[0])
        half_width = 0.5 * self.wall[1] * self.column_mm
        light = float(block.sum()) * self.row_mm * self.column_mm
        return Beam((y_mm[0] - half_width, y_mm[1] - half_width), z_mm, light / area)


def _patches(cells: Array, width: float, height: float, coarser: float) -> Iterator[_Patch]:
    """Lit cells of a wall, those that touch each other together."""
    from scipy.ndimage import find_objects, label

    rows, columns = cells.shape
    row_mm, column_mm = height / rows, width / columns
    brightest = float(cells.sum(axis=0).max()) * row_mm
    numbers, _ = label(cells > 0.0, np.ones((3, 3)))
    for number, place in enumerate(find_objects(numbers), start=1):
        own = np.where(numbers[place] == number, cells[place], 0.0)
        first = place[0].start, place[1].start
        yield _Patch(own, first, row_mm, column_mm, (rows, columns), brightest, coarser)


def _groups(light: Array, cell_mm: float, alike: Alike) -> list[tuple[int, int]]:
    """Neighbouring lit cells that are alike, as numbers of the first and of the one after the last; dark ones apart."""
    farther = round(FARTHER_MM / cell_mm)
    lit = np.flatnonzero(np.diff(np.pad(light > 0.0, 1).astype(int))).reshape(-1, 2)
    groups: list[tuple[int, int]] = []
    for first, last in lit.tolist():
        while first < last:
            end = beyond = first + 1
            while beyond < min(end + farther, last):
                beyond += 1
                if alike(first, beyond):
                    end = beyond
            groups.append((first, end))
            first = end
    return groups


def _apart(rising: Array) -> float:
    """How far, in cells, light is moved on average when lines of cells all get the mean's shape.

    Parameters
    ----------
    rising
        (lines, cells) sums of each line's light up to each cell.
    """
    own = rising[:, -1:]
    return float(np.abs(rising - own * (rising.sum(axis=0) / own.sum())).sum() / own.sum())


def _uneven(light: Array) -> float:
    """How far, in cells, it is moved on average when it becomes even with its own middle and spread."""
    middle, half = _spread(light)
    even = np.clip((np.arange(light.size + 1) - middle + half) / (2.0 * half), 0.0, 1.0)
    return float(np.abs(even - np.cumsum(np.pad(light, (1, 0))) / light.sum()).sum())


def _spread(light: Array) -> tuple[float, float]:
    """Middle, in cells from the first one's edge, and half the width of even light with the variance of some cells."""
    at = np.arange(light.size) + 0.5
    middle = float(light @ at / light.sum())
    variance = float(light @ (at - middle) ** 2 / light.sum()) + 1.0 / 12.0
    return middle, math.sqrt(3.0 * variance)


def _edges(light: Array, first: int, cell_mm: float, count: int) -> tuple[float, float]:
    """Where even light begins and ends with the middle of cells, and with their spread as far as the wall goes, mm."""
    middle, half = _spread(light)
    at = first + middle
    half = min(half, at, count - at)
    return (at - half) * cell_mm, (at + half) * cell_mm

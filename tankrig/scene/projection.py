"""From a picture on a calibrated projector to the beams that it lights on the wall x = 0."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.scene.checks import require
from tankrig.scene.description import Beam, Projector, Scene, Tank

Array = NDArray[np.float64]
Part = tuple[float, float, Array]
"""Start and end in cells, and mean irradiance, across the other axis or (1,)."""

ROW_MM, COLUMN_MM = 0.5, 0.25
"""Height and width of the cells of the wall that light is collected in."""
ALIKE_MM = 0.3
"""Rows of cells become one band of beams when that moves no light farther across it."""
LEVELS = 0.02
"""Irradiances become one beam within this share of the brightest."""
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
        When the picture has so many levels that beams had to hold more of them than `LEVELS` allows.
    """
    beams = beams_of(scene.tank, scene.projector, picture)
    return replace(scene, projector=replace(scene.projector, beams=beams))


def beams_of(tank: Tank, projector: Projector, picture: NDArray[np.generic]) -> tuple[Beam, ...]:
    """Beams that a picture lights; see `lit_by`."""
    cells = irradiance_on_wall(tank, projector, picture)
    require(bool(cells.any()), "nothing of the picture reaches the tank; check the projector's pose, and the picture")
    _, width, height = tank.size_mm
    levels = LEVELS
    while True:
        beams = tuple(_merged(cells, width, height, levels))
        if len(beams) <= MOST_BEAMS:
            break
        levels *= 1.5
    if levels > LEVELS:
        warnings.warn(
            f"the picture has too many levels for {MOST_BEAMS} beams; they were merged where they differ by less than "
            f"{levels:.0%} of the brightest",
            stacklevel=3,
        )
    return beams


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


def _merged(cells: Array, width: float, height: float, levels: float) -> list[Beam]:
    """Few beams with the light of the cells."""
    rows, columns = cells.shape
    column = width / columns
    tolerance = ALIKE_MM * float(cells.max())
    beams = []
    for low, high, irradiance in _bands(cells, column, tolerance):
        z_mm = (low * height / rows, min(high * height / rows, height))
        if z_mm[1] <= z_mm[0]:
            continue
        for start, end, level in _runs(irradiance, levels * float(cells.max())):
            y_mm = (start * column - 0.5 * width, min(end * column, width) - 0.5 * width)
            if level > 0.0 and y_mm[1] > y_mm[0]:
                beams.append(Beam(y_mm, z_mm, float(level[0])))
    return beams


def _bands(cells: Array, column: float, tolerance: float) -> list[Part]:
    """Bands of rows that are alike: their light, added up across, differs by at most `tolerance` in W per mm of z."""
    sums = np.cumsum(cells, axis=1) * column
    edges = [0]
    for row in range(1, len(cells)):
        band = sums[edges[-1] : row + 1]
        if np.abs(band - band.mean(axis=0)).max() > tolerance:
            edges.append(row)
    bands = [(float(low), float(high), cells[low:high].mean(axis=0)) for low, high in pairwise([*edges, len(cells)])]
    return _without_thin(bands, 1.0, lambda light: np.abs(np.cumsum(light)).max() * column <= tolerance)


def _runs(irradiance: Array, tolerance: float) -> list[Part]:
    """Runs of cells whose irradiances are within `tolerance` of each other, dark ones apart."""
    edges, low, high = [0], irradiance[0], irradiance[0]
    for cell in range(1, irradiance.size):
        value = irradiance[cell]
        low, high = min(low, value), max(high, value)
        if high - low > tolerance or (value == 0.0) != (irradiance[cell - 1] == 0.0):
            edges.append(cell)
            low = high = value
    ends = pairwise([*edges, irradiance.size])
    return _without_thin([(float(a), float(b), irradiance[a:b].mean(keepdims=True)) for a, b in ends], 3.0)


def _without_thin(
    parts: list[Part], thin: float, negligible: Callable[[Array], bool] = lambda light: light.size == 1
) -> list[Part]:
    """The same light without parts that only hold the edge between their neighbours, which is moved instead.

    Parameters
    ----------
    parts
        In order.
    thin
        Size up to which a part may hold an edge.
    negligible
        Whether light may be left where it is not.
    """
    kept = parts[:1]
    for index, (_, end, light) in enumerate(parts[1:], 1):
        first, start, before = kept[-1]  # where the part before ends is where this one starts, moved or not
        if index + 1 < len(parts) and end - start <= thin + 0.5:
            after = parts[index + 1][2]
            step = float(after.sum() - before.sum())
            share = float(light.sum() - before.sum()) / step if step else -1.0
            if 0.0 <= share <= 1.0 and negligible(light - before - share * (after - before)):
                kept[-1] = (first, end - share * (end - start), before)
                continue
        kept.append((start, end, light))
    return kept

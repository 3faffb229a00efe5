"""Between the plane z = Lz and a camera: light of orders ≥ 2 is computed on a plain grid of the plane, then looked up.

A calibrated camera has one viewpoint in the air, so its lines of sight are those of a plain pinhole camera there; only
its pixels lie elsewhere on the plane.
"""

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Camera, Scene, Tank
from tankrig.scene.footprint import footprints

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]

PER_PIXEL = 3.0
"""Cells along a pixel: light scattered twice errs by 0.06 % between them, by 0.13 % with two, by 1–3 % with one."""
FINEST = 360
"""Cells along the longer side of the surface, at most."""


def on_surface(scene: Scene, cell_mm: float | None = None) -> Scene:
    """The scene with a plain camera, on cells no finer than needed, where it has a calibrated one.

    Parameters
    ----------
    scene
        Any scene.
    cell_mm
        Side that cells may have; None: as small as it needs to be for light scattered twice.

    Examples
    --------
    >>> from tankrig.scene import Beam, Medium, Projector
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> camera = Camera("orthographic", (80, 120), 2.0)
    >>> on_surface(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, camera)).camera is camera
    True
    """
    if scene.camera.kind != "calibrated":
        return scene
    length, width, _ = scene.tank.size_mm
    wanted = scene.camera.pixel_mm / PER_PIXEL if cell_mm is None else cell_mm
    rows = math.ceil(width / max(wanted, max(length, width) / FINEST) - 1e-9)
    cell = width / rows  # whole cells across, so that symmetry is kept
    columns = math.ceil(length / cell - 1e-9)
    return replace(scene, camera=Camera("pinhole", (rows, columns), cell, scene.camera.position_mm))


def in_larger_pixels(scene: Scene, most_mm: float) -> tuple[Scene, int]:
    """The scene with a plain camera of larger pixels where its own are small, and how many of its own along their side.

    1 where the camera sees beyond the tank, or no whole larger pixels make it up: `in_own_pixels` knows no edges.

    Parameters
    ----------
    scene
        Any scene.
    most_mm
        Side of the larger pixels at most.

    Examples
    --------
    >>> from tankrig.scene import Beam, Medium, Projector
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> camera = Camera("pinhole", (640, 960), 0.25, (120.0, 0.0, 600.0))
    >>> larger, along = in_larger_pixels(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, camera), 1.0)
    >>> along, larger.camera.shape
    (4, (160, 240))
    """
    camera, (length, width, _) = scene.camera, scene.tank.size_mm
    rows, columns = camera.shape
    beyond = rows * camera.pixel_mm > width + 1e-6 or columns * camera.pixel_mm > length + 1e-6
    most = 1 if camera.kind != "pinhole" or beyond else int(most_mm / camera.pixel_mm + 1e-9)
    for along in range(most, 1, -1):
        if rows % along == 0 and columns % along == 0:
            shape = rows // along, columns // along
            return replace(scene, camera=replace(camera, shape=shape, pixel_mm=along * camera.pixel_mm)), along
    return scene, 1


def in_own_pixels(image: Array, along: int) -> Array:
    """An image of larger pixels in so many small ones along each side: cubics between, whose means over the larger are
    theirs."""
    from scipy.interpolate import make_interp_spline

    for axis in (0, 1) if along > 1 else ():
        rows = np.moveaxis(image, axis, 0)
        summed = np.vstack([np.zeros_like(rows[:1]), np.cumsum(rows, axis=0)])
        fine = make_interp_spline(np.arange(len(summed)), summed, k=3)(np.arange(len(rows) * along + 1) / along)
        image = np.moveaxis(along * np.diff(fine, axis=0), 0, axis)
    return image


def lookup_error(scene: Scene) -> float:
    """What light scattered twice errs by where it is looked up, of its norm; 0 for plain cameras.

    With three cells along a pixel .06 % for pixels of 2 mm and .12 % for pixels of 3.4 mm; no more than .4 % where the
    camera is finer than the cells may be.
    """
    if scene.camera.kind != "calibrated":
        return 0.0
    cells = scene.camera.pixel_mm / on_surface(scene).camera.pixel_mm
    return 0.0015 if cells > PER_PIXEL - 0.5 else 0.004


def to_camera(scene: Scene, cells: Array, cell_mm: tuple[float, float]) -> Array:
    """What a calibrated camera's pixels show of an image on cells of the plane z = Lz.

    Parameters
    ----------
    scene
        With a calibrated camera.
    cells
        (rows, columns) means over cells that start at x = 0, y = −Ly/2 and cover the tank; what the last have beyond it
        is dark.
    cell_mm
        Their sides along x and y.

    Returns
    -------
    (rows, columns) array of the camera
        Cubic interpolation at points of each pixel, about as many along a side as cells and two at least, as far apart
        as it takes for cell and points together to spread like the pixel; times its share over the tank.
    """
    from scipy.interpolate import RectBivariateSpline

    length, width, _ = scene.tank.size_mm
    y, y_cover = _middles(cells.shape[0], cell_mm[1], width)
    x, x_cover = _middles(cells.shape[1], cell_mm[0], length)
    spline = RectBivariateSpline(
        y - 0.5 * width, x, cells / (y_cover[:, None] * x_cover), bbox=[-0.5 * width, 0.5 * width, 0.0, length]
    )
    points, inside = _looked_up(scene.camera, scene.tank, math.sqrt(cell_mm[0] * cell_mm[1]))
    image = np.zeros(scene.camera.shape)
    seen = inside > 0.0
    image[seen] = inside[seen] * np.mean(spline.ev(points[..., 1], points[..., 0]), axis=0)
    return image


def many_to_camera(scene: Scene, images: Array, cell_mm: tuple[float, float]) -> Array:
    """`to_camera` of (n, rows, columns) images, by one sparse matrix, which is kept.

    For a tenth of the time where there are many, or where the same camera looks again.
    """
    from scipy.interpolate import make_interp_spline

    length, width, _ = scene.tank.size_mm
    y, y_cover = _middles(images.shape[1], cell_mm[1], width)
    x, x_cover = _middles(images.shape[2], cell_mm[0], length)
    light = images / (y_cover[:, None] * x_cover)
    down = make_interp_spline(y - 0.5 * width, np.moveaxis(light, 0, 2)).c
    splines = make_interp_spline(x, np.moveaxis(down, 1, 0)).c.swapaxes(0, 1)  # (rows, columns, n)
    seen = _splines_seen(scene.camera, scene.tank, images.shape[1:], cell_mm) @ splines.reshape(-1, len(images))
    return np.asarray(seen.T.reshape(len(images), *scene.camera.shape))


@lru_cache(maxsize=8)  # a lens looks at three parts of its picture, and at cells of several sides
def _splines_seen(camera: Camera, tank: Tank, shape: tuple[int, int], cell_mm: tuple[float, float]) -> "csr_array":
    """(pixels, splines) what the camera's pixels show of each cubic spline through cells."""
    from scipy.interpolate import BSpline, make_interp_spline
    from scipy.sparse import csr_array

    length, width, _ = tank.size_mm
    points, inside = _looked_up(camera, tank, math.sqrt(cell_mm[0] * cell_mm[1]))
    middles = _middles(shape[1], cell_mm[0], length)[0], _middles(shape[0], cell_mm[1], width)[0] - 0.5 * width
    found = []
    for axis, along in enumerate(middles):
        knots = make_interp_spline(along, np.zeros(along.size)).t
        design = BSpline.design_matrix(points[..., axis].ravel(), knots, 3, extrapolate=True)
        found.append((design.indices.reshape(-1, 4), design.data.reshape(-1, 4)))
    (column, by_column), (row, by_row) = found
    pixels = np.flatnonzero(inside.ravel() > 0.0)
    share = np.tile(inside.ravel()[pixels] / len(points), len(points))
    weights = share[:, None, None] * by_row[:, :, None] * by_column[:, None, :]
    splines = row[:, :, None] * shape[1] + column[:, None, :]
    places = np.broadcast_to(np.tile(pixels, len(points))[:, None, None], splines.shape)
    return csr_array((weights.ravel(), (places.ravel(), splines.ravel())), (inside.size, shape[0] * shape[1]))


def noise_to_camera(scene: Scene, cells: Array, cell_mm: tuple[float, float]) -> Array:
    """(n, rows, columns) images of noise as `to_camera` has them, but linear between cells: for a tenth of the time."""
    from scipy.interpolate import RegularGridInterpolator

    length, width, _ = scene.tank.size_mm
    y, y_cover = _middles(cells.shape[1], cell_mm[1], width)
    x, x_cover = _middles(cells.shape[2], cell_mm[0], length)
    light = np.moveaxis(cells / (y_cover[:, None] * x_cover), 0, -1)
    between = RegularGridInterpolator((y - 0.5 * width, x), light, bounds_error=False, fill_value=None)
    points, inside = _looked_up(scene.camera, scene.tank, math.sqrt(cell_mm[0] * cell_mm[1]))
    images = np.zeros((len(cells), *scene.camera.shape))
    seen = inside > 0.0
    images[:, seen] = inside[seen] * np.mean(between(points[..., ::-1]), axis=0).T
    return images


def _middles(count: int, cell: float, size: float) -> tuple[Array, Array]:
    """Middles of what cells have inside the tank, from its edge, and what share of them that is."""
    edges = np.minimum(np.arange(count + 1) * cell, size)
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges) / cell


@lru_cache(maxsize=8)
def _looked_up(camera: Camera, tank: Tank, cell: float) -> tuple[Array, Array]:
    """(points, n, 2) points of the plane for the n pixels that see the tank, and (rows, columns) their shares of it."""
    seen = footprints(camera, tank)
    corners = seen.corners_mm
    quads = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]])
    inside = _share_inside(quads, tank.size_mm[0], 0.5 * tank.size_mm[1])
    quads = quads[:, inside > 0.0]
    areas = seen.areas_mm2[inside > 0.0]
    # A square's second moment is that of m × m even points, the outer ones moved in from its corners by
    # √((m − 1)/(m + 1)); the cells have part of it.
    along = max(2, round(camera.pixel_mm / cell))
    apart = np.sqrt(np.clip(1.0 - cell**2 / areas, 0.0, None) * (along - 1.0) / (along + 1.0))[:, None]
    steps = np.linspace(-1.0, 1.0, along)
    right, down = (part.reshape(-1, 1, 1) for part in np.meshgrid(steps, steps))
    a, b, c, d = quads
    points = 0.25 * (a + b + c + d + apart * (right * (b + c - a - d) + down * (c + d - a - b)))
    points = points + 0.25 * apart**2 * right * down * (a - b + c - d)
    # Pixels that lie over the tank in part look at the middle of that part: light fades towards its walls.
    half = 0.5 * tank.size_mm[1]
    low, high = quads.min(axis=0), quads.max(axis=0)
    inner_low, inner_high = (np.clip(one, (0.0, -half), (tank.size_mm[0], half)) for one in (low, high))
    return inner_low + (points - low) * ((inner_high - inner_low) / (high - low)), inside


def _share_inside(quads: Array, length: float, half_width: float) -> Array:
    """Share of each quadrangle's area over the tank; 0 where a corner is NaN."""
    x, y = quads[..., 0], quads[..., 1]
    corner_inside = (x >= 0.0) & (x <= length) & (np.abs(y) <= half_width)
    share = corner_inside.all(axis=0).astype(float)
    near = (x.max(axis=0) > 0.0) & (x.min(axis=0) < length)
    near &= (y.max(axis=0) > -half_width) & (y.min(axis=0) < half_width)
    for at in np.argwhere(near & (share == 0.0)):
        whole = quads[:, *at]
        part = whole
        for axis, sign, limit in ((0, 1, 0.0), (0, -1, -length), (1, 1, -half_width), (1, -1, -half_width)):
            part = _cut(part, sign * part[:, axis] - limit)
        share[tuple(at)] = _area(part) / _area(whole)
    return share


def _cut(polygon: Array, height: Array) -> Array:
    """The part of a convex polygon where `height`, given at its corners, is positive (Sutherland and Hodgman)."""
    corners = []
    for here, there, low, high in zip(polygon, np.roll(polygon, -1, 0), height, np.roll(height, -1), strict=True):
        if low >= 0.0:
            corners.append(here)
        if (low >= 0.0) != (high >= 0.0):
            corners.append(here + low / (low - high) * (there - here))
    return np.array(corners).reshape(-1, 2)


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return float(0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))

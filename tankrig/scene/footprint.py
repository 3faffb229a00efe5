"""Which part of the plane z = Lz each pixel of a camera looks through."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.geometry.lens import to_rays
from tankrig.geometry.pose import directions_to_world
from tankrig.scene.parts import Camera, Tank

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Footprints:
    """Quadrangles of the plane z = Lz.

    Parameters
    ----------
    corners_mm
        (rows + 1, columns + 1, 2) x and y of the corners that neighbours share; NaN where a pixel looks elsewhere.
    """

    corners_mm: Array

    @property
    def areas_mm2(self) -> Array:
        """(rows, columns) area of each pixel; NaN where it doesn't look at the plane."""
        c = self.corners_mm
        across, along = c[1:, 1:] - c[:-1, :-1], c[1:, :-1] - c[:-1, 1:]  # diagonals
        return np.asarray(0.5 * np.abs(across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]))

    @property
    def centres_mm(self) -> Array:
        """(rows, columns, 2) mean of the corners."""
        c = self.corners_mm
        return np.asarray(0.25 * (c[1:, 1:] + c[:-1, :-1] + c[1:, :-1] + c[:-1, 1:]))


@lru_cache(maxsize=16)
def footprints(camera: Camera, tank: Tank) -> Footprints:
    """What the pixels of a camera look through; for a plain camera the squares of its grid.

    The pixels' edges are followed as straight lines between corners; rays from one viewpoint keep lines straight, but
    for the lens's distortion within one pixel.

    Examples
    --------
    >>> camera = Camera("orthographic", (2, 3), 10.0)
    >>> footprints(camera, Tank()).corners_mm[0].tolist()
    [[0.0, -80.0], [10.0, -80.0], [20.0, -80.0], [30.0, -80.0]]
    >>> bool((footprints(camera, Tank()).areas_mm2 == 100.0).all())
    True
    """
    rows, columns = camera.shape
    if camera.kind != "calibrated":
        x = np.arange(columns + 1) * camera.pixel_mm
        y = np.arange(rows + 1) * camera.pixel_mm - tank.size_mm[1] / 2.0
        return Footprints(np.stack(np.meshgrid(x, y), axis=-1))
    pixels = np.stack(np.meshgrid(np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5), axis=-1)
    pose = camera.pose
    way = directions_to_world(pose, to_rays(camera.lens, pixels))
    centre = pose.centre_mm
    down = np.where(way[..., 2] < 0.0, way[..., 2], np.nan)
    return Footprints(centre[:2] + (tank.size_mm[2] - centre[2]) / down[..., None] * way[..., :2])


@lru_cache(maxsize=16)
def picture_corners_mm(camera: Camera, tank: Tank) -> Array:
    """(4, 2) x and y on the plane z = Lz of the picture's corners: of its first row, then of its last from the right.

    Examples
    --------
    >>> picture_corners_mm(Camera("orthographic", (2, 3), 10.0), Tank()).tolist()
    [[0.0, -80.0], [30.0, -80.0], [30.0, -60.0], [0.0, -60.0]]
    """
    rows, columns = camera.shape
    if camera.kind != "calibrated":
        c = footprints(camera, tank).corners_mm
        return np.stack([c[0, 0], c[0, -1], c[-1, -1], c[-1, 0]])
    ends = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) - 0.5
    pose = camera.pose
    way = directions_to_world(pose, to_rays(camera.lens, ends))
    centre = pose.centre_mm
    down = np.where(way[..., 2] < 0.0, way[..., 2], np.nan)
    return np.asarray(centre[:2] + ((tank.size_mm[2] - centre[2]) / down)[..., None] * way[..., :2])


@lru_cache(maxsize=16)
def typical_pixel_mm(camera: Camera, tank: Tank) -> float:
    """Side of a square as large as the median of the pixels that look into the tank, mm.

    Raises
    ------
    SceneError
        When none does.
    """
    seen = footprints(camera, tank)
    x, y = np.moveaxis(seen.centres_mm, -1, 0)
    inside = (x > 0.0) & (x < tank.size_mm[0]) & (np.abs(y) < tank.size_mm[1] / 2.0)
    if not inside.any():
        raise SceneError(
            "no pixel of the camera looks into the tank; check matrix, rotation and position_mm, "
            "which are OpenCV's: the world in the camera's frame, z forward"
        )
    return float(np.sqrt(np.median(seen.areas_mm2[inside])))

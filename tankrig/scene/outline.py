"""Where each beam should be in the camera's picture."""

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.description import Scene

Polygon = NDArray[np.float64]


def beam_outlines(scene: Scene) -> list[Polygon]:
    """Outline of the lit volume of each beam, as the camera sees it.

    The middle height of a beam is followed from the wall x = 0 to the far wall, along straight rays, and projected on
    the plane z = Lz, on which pixels lie.

    Parameters
    ----------
    scene
        Its medium does not matter.

    Returns
    -------
    list of (4, 2) float64
        x and y in mm of the corners, in turn.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> beam_outlines(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0)))[0].tolist()
    [[0.0, -2.0], [240.0, -2.0], [240.0, 2.0], [0.0, 2.0]]
    """
    outlines = []
    for beam in scene.projector.beams:
        z_mm = sum(beam.z_mm) / 2.0
        low, high = beam.y_mm
        edges = [_ray(scene, low, z_mm), _ray(scene, high, z_mm)]
        outlines.append(np.array([edges[0][0], edges[0][1], edges[1][1], edges[1][0]]))
    return outlines


def _ray(scene: Scene, y_mm: float, z_mm: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where the ray through (0, y, z) enters and where it leaves, as the camera sees it."""
    length, width, height = scene.tank.size_mm
    start = np.array([0.0, y_mm, z_mm])
    along = np.array([1.0, 0.0, 0.0])
    if scene.projector.kind == "pinhole" and scene.projector.position_mm is not None:
        along = start - np.array(scene.projector.position_mm)
    limits = np.array([length, width / 2.0 if along[1] > 0 else -width / 2.0, height if along[2] > 0 else 0.0])
    reaches = [(limit - begin) / by for limit, begin, by in zip(limits, start, along, strict=True) if by != 0.0]
    end = start + min(reaches) * along
    return _seen(scene, start), _seen(scene, end)


def _seen(scene: Scene, point: Polygon) -> tuple[float, float]:
    """Where on the plane z = Lz the camera sees a point below it."""
    x_mm, y_mm, z_mm = (float(value) for value in point)
    camera, height = scene.camera, scene.tank.size_mm[2]
    if camera.kind == "orthographic" or camera.position_mm is None:
        return x_mm, y_mm
    x_c, y_c, z_c = camera.position_mm
    by = (z_c - height) / (z_c - z_mm)
    return x_c + by * (x_mm - x_c), y_c + by * (y_mm - y_c)

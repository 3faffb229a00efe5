"""Where each beam should be in the camera's picture."""

import numpy as np
from numpy.typing import NDArray

from tankrig.geometry.lens import to_pixels
from tankrig.geometry.pose import directions_to_device
from tankrig.scene.description import Scene

Polygon = NDArray[np.float64]

_FINE = 8
"""Parts of a pixel in which edges are drawn."""


def beam_outlines(scene: Scene) -> list[Polygon]:
    """Outline of the lit volume of each beam, as the camera sees it.

    The middle height of a beam is followed from the wall x = 0 to the far wall, bent as the light is, and projected on
    the plane z = Lz, on which pixels lie; for a calibrated camera, on its picture.

    Parameters
    ----------
    scene
        Its medium does not matter.

    Returns
    -------
    list of (4, 2) float64
        x and y in mm of the corners, in turn. A calibrated camera's picture is taken as one of square pixels of its
        `pixel_mm` that starts at x = 0, y = −Ly/2, as pictures are drawn.

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
    along = _entering(scene, start)
    limits = np.array([length, width / 2.0 if along[1] > 0 else -width / 2.0, height if along[2] > 0 else 0.0])
    reaches = [(limit - begin) / by for limit, begin, by in zip(limits, start, along, strict=True) if by != 0.0]
    end = start + min(reaches) * along
    return _seen(scene, start), _seen(scene, end)


def _entering(scene: Scene, start: Polygon) -> Polygon:
    """Direction in which light enters at a point of x = 0."""
    if scene.projector.kind == "collimated" or scene.projector.position_mm is None:
        return np.array([1.0, 0.0, 0.0])
    index, wall_mm, wall_index = scene.tank.entry_bends
    if index == 1.0 and wall_mm == 0.0:
        return np.asarray(start - np.array(scene.projector.position_mm))
    from tankrig.geometry.refraction import entry_wall, look_into_water

    return look_into_water(entry_wall(index, wall_mm, wall_index), scene.projector.position_mm, start).in_water


def _seen(scene: Scene, point: Polygon) -> tuple[float, float]:
    """Where the camera's picture shows a point, in mm as `beam_outlines` says."""
    x_mm, y_mm, z_mm = (float(value) for value in point)
    camera, height = scene.camera, scene.tank.size_mm[2]
    if camera.kind == "orthographic" or camera.position_mm is None:
        return x_mm, y_mm
    if scene.tank.surface_index == 1.0 and camera.kind == "pinhole":
        x_c, y_c, z_c = camera.position_mm
        by = (z_c - height) / (z_c - z_mm)
        return x_c + by * (x_mm - x_c), y_c + by * (y_mm - y_c)
    from tankrig.geometry.refraction import look_into_water, water_surface

    sight = look_into_water(water_surface(height, scene.tank.surface_index), camera.position_mm, point)
    if camera.kind == "pinhole":
        return float(sight.entry_mm[0]), float(sight.entry_mm[1])
    column, row = to_pixels(camera.lens, directions_to_device(camera.pose, sight.in_air))
    return (float(column) + 0.5) * camera.pixel_mm, (float(row) + 0.5) * camera.pixel_mm - scene.tank.size_mm[1] / 2.0


def edges_of_light(scene: Scene, reach_mm: float = 1.2) -> NDArray[np.bool_]:
    """Pixels that look at the sides of beams: there, lenses' blur is not in the model.

    Blur spreads light to where only scattered light should be, and a fit takes it for scattering: with a projector that
    blurs by 0.3 mm, σs of thin ink came out 5 % too high. `tankrig.estimate` leaves out what its `mask` names.

    Parameters
    ----------
    scene
        Its medium does not matter.
    reach_mm
        To either side of an edge, on the plane z = Lz.

    Returns
    -------
    (rows, columns) bool

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-20.0, 20.0), (58.0, 62.0)),))
    >>> mask = edges_of_light(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0)))
    >>> np.flatnonzero(mask[:, 60]).tolist()
    [29, 30, 49, 50]
    """
    import cv2

    camera, half_width = scene.camera, scene.tank.size_mm[1] / 2.0
    rows, columns = camera.shape
    canvas = np.zeros((rows * _FINE, columns * _FINE), np.uint8)
    for beam in scene.projector.beams:
        for y_mm in beam.y_mm:
            ends = np.array([_ray(scene, y_mm, z_mm) for z_mm in beam.z_mm])
            corners = ends[[0, 0, 1, 1], [0, 1, 1, 0]] + [0.0, half_width]
            cv2.fillConvexPoly(canvas, np.rint(corners * (_FINE / camera.pixel_mm) - 0.5).astype(np.int32), 1)
    reach = round(reach_mm * _FINE / camera.pixel_mm)
    near = cv2.dilate(canvas, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1)))
    return np.asarray(near.reshape(rows, _FINE, columns, _FINE).any(axis=(1, 3)))

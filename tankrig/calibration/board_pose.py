"""Where a board stands, from its corners in a picture, in air or under water."""

import numpy as np
from numpy.typing import ArrayLike

from tankrig.calibration.board import Board, BoardView, Points
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, rotation_matrix, rotation_vector, to_world
from tankrig.geometry.refraction import Window
from tankrig.geometry.view import pixels_of

NOWHERE_PX = 1e3
"""Stands in for the distance to a corner that cannot be seen, in fits that have gone astray."""


def placed(pose: ArrayLike, points_mm: ArrayLike) -> Points:
    """Points (…, 3) of a board in the frame it stands in.

    Parameters
    ----------
    pose
        (6,) rotation vector, and the place of the board's origin in mm.
    points_mm
        On the board.

    Examples
    --------
    >>> placed([0.0, 0.0, np.pi / 2, 5.0, 0.0, 0.0], [10.0, 0.0, 0.0]).round(9).tolist()
    [5.0, 10.0, 0.0]
    """
    numbers = np.asarray(pose, float)
    return np.asarray(np.asarray(points_mm, float) @ rotation_matrix(numbers[:3]).T + numbers[3:])


def misses_px(lens: Lens, camera: Pose, view: BoardView, points_mm: Points, window: Window | None = None) -> Points:
    """(n, 2) how far corners were seen from where points of the tank should be."""
    return np.nan_to_num(pixels_of(lens, camera, points_mm, window) - view.corners_px, nan=NOWHERE_PX)


def before_camera(view: BoardView, board: Board, lens: Lens) -> Points:
    """(6,) pose of a board in the camera's frame when nothing bends the light (OpenCV's `solvePnP`)."""
    import cv2

    points, corners = view.points_mm(board), view.corners_px.reshape(-1, 1, 2)
    _, rotation, shift = cv2.solvePnP(points, corners, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_IPPE)
    rotation, shift = cv2.solvePnPRefineLM(points, corners, lens.matrix, lens.distortion, rotation, shift)
    return np.concatenate([np.ravel(rotation), np.ravel(shift)])


def in_tank(view: BoardView, board: Board, lens: Lens, camera: Pose, window: Window | None = None) -> Points:
    """(6,) pose of a board in the tank's frame.

    Parameters
    ----------
    view, board
        What was seen.
    lens, camera
        Of the camera.
    window
        The water's surface where the board is under it.

    Notes
    -----
    Under water it begins with the board that would be seen there without it, whose depth is about n times too small.
    """
    from scipy.optimize import least_squares

    points = view.points_mm(board)
    seen = to_world(camera, placed(before_camera(view, board, lens), points))
    if window is not None:
        seen[:, 2] = window.place_mm - window.water_index * np.maximum(window.place_mm - seen[:, 2], 0.1)
    start = _rigid(points, seen)

    def misses(pose: Points) -> Points:
        return misses_px(lens, camera, view, placed(pose, points), window).ravel()

    return np.asarray(least_squares(misses, start, x_scale=np.array([1e-2] * 3 + [1.0] * 3)).x)


def _rigid(points: Points, seen: Points) -> Points:
    """The (6,) pose that brings points nearest to where they were seen (Kabsch 1976)."""
    middle, there = points.mean(axis=0), seen.mean(axis=0)
    u, _, vt = np.linalg.svd((seen - there).T @ (points - middle))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.array([*rotation_vector(rotation), *(there - rotation @ middle)])

"""Where the tank stands before the camera, and how high its water, from a board on its floor and in the water."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tankrig.calibration.board import Board, BoardView, Points, rms_length
from tankrig.calibration.board_pose import before_camera, in_tank, misses_px, placed
from tankrig.calibration.file import Calibration
from tankrig.errors import CalibrationError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, rotation_matrix, rotation_vector
from tankrig.geometry.refraction import Window, water_surface

Place = Literal["floor", "flooded", "water"]

MOST_RMS_PX = 0.5
MOST_MOVED_PX = 1.0
MOST_TILT_DEG = 0.3


@dataclass(frozen=True, eq=False)
class TankFound:
    """The camera in the tank's frame, and the water.

    Parameters
    ----------
    camera
        Its pose in the tank's frame.
    level_mm
        Height of the water over the floor.
    water_index
        That was taken for the water's.
    sd
        Standard deviations of `camera_rotation` (3, rad), `camera_position_mm` (3) and `level_mm`.
    tilt_deg, tilt_sd_deg
        Of the water's surface from the floor; the rest takes it for level.
    view_rms_px
        Of each view, root mean square distance of corners from where they should be.
    corners_px, residuals_px
        (n, 2) of all corners.
    shape
        (rows, columns) of the pictures.
    """

    camera: Pose
    level_mm: float
    water_index: float
    sd: dict[str, float | list[float]]
    tilt_deg: float
    tilt_sd_deg: float
    view_rms_px: tuple[float, ...]
    corners_px: Points
    residuals_px: Points
    shape: tuple[int, int]

    @property
    def rms_px(self) -> float:
        """Root mean square distance of corners from where they should be."""
        return rms_length(self.residuals_px)

    @property
    def surface(self) -> Window:
        """What the camera looks through."""
        return water_surface(self.level_mm, self.water_index)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to believe it, and what to do."""
        found = []
        if self.rms_px > MOST_RMS_PX:
            found.append(
                f"corners lie {self.rms_px:.2f} px from where they should be, more than {MOST_RMS_PX:g}; let the water "
                f"settle, keep the board flat, and calibrate the camera if it was touched"
            )
        if self.tilt_deg > max(MOST_TILT_DEG, 3.0 * self.tilt_sd_deg):
            found.append(
                f"the water's surface leans {self.tilt_deg:.2f} ± {self.tilt_sd_deg:.2f}° from the floor; level it"
            )
        return tuple(found)

    def calibration(self, device: str, rests_on: dict[str, str]) -> Calibration:
        """To be kept in a file; `rests_on` holds the hash of the camera's."""
        result = {
            "camera_rotation": list(self.camera.rotation),
            "camera_translation_mm": list(self.camera.translation_mm),
            "camera_position_mm": self.camera.centre_mm,
            "level_mm": self.level_mm,
            "water_index": self.water_index,
        }
        how_well = {"rms_px": self.rms_px, "tilt_deg": self.tilt_deg, "tilt_sd_deg": self.tilt_sd_deg}
        arrays = {"corners_px": self.corners_px, "residuals_px": self.residuals_px}
        return Calibration(
            "tank", device, self.shape, result, self.sd, how_well, self.doubts, rests_on=rests_on, arrays=arrays
        )


def calibrate_tank(
    views: Sequence[tuple[Place, BoardView]],
    board: Board,
    lens: Lens,
    size_mm: tuple[float, float, float],
    water_index: float = 1.33,
) -> TankFound:
    """Find the tank and its water before the camera.

    Parameters
    ----------
    views
        The board on the "floor" of the empty tank, the same "flooded", and held anywhere in the "water".
    board
        It lies with its first corner in the corner of the walls x = 0 and y = Ly/2, its x along the tank's, printed
        side up.
    lens
        Of the camera.
    size_mm
        Inside of the tank; its height is the most that the water's can be.
    water_index
        Refractive index of the water.

    Raises
    ------
    CalibrationError
        When there is no view of the floor or none through water, or the board was moved while the tank was filled.

    Notes
    -----
    One least-squares fit (bundle adjustment) of the camera's pose, the water's level and the poses of boards in the
    water to all corners, each traced by Snell's law. The floor's view alone fixes the pose; the same board through
    water appears nearer by 1 − 1/n of its depth, which fixes the level to about 0.1 mm; boards at other depths add to
    both and show in their residuals whether refraction is understood.
    """
    floors = [view for place, view in views if place == "floor"]
    if not floors or not any(place != "floor" for place, _ in views):
        raise CalibrationError(
            "the tank takes one view of the board on the floor of the empty tank, and one at least through the water"
        )
    start = _camera(floors[0], board, lens, size_mm)
    level = _first_level(
        [view for place, view in views if place == "flooded"], board, lens, start, size_mm, water_index
    )
    fit = _Bundle(views, board, lens, size_mm, water_index)
    known, covariance = fit.solve(start, level, tilted=False)
    leaning, leaning_covariance = fit.solve(start, level, tilted=True)
    lean = leaning[7:9]
    tilt = float(np.linalg.norm(lean))
    tilt_sd = float(np.sqrt(np.trace(leaning_covariance[7:9, 7:9])))
    misses = fit.misses(known)
    pose = _pose(known)
    turned = -pose.matrix.T  # of the position with the translation, the rotation held
    sd: dict[str, float | list[float]] = {
        "camera_rotation": np.sqrt(np.diag(covariance)[:3]).tolist(),
        "camera_position_mm": np.sqrt(np.diag(turned @ covariance[3:6, 3:6] @ turned.T)).tolist(),
        "level_mm": float(np.sqrt(covariance[6, 6])),
    }
    return TankFound(
        camera=pose,
        level_mm=float(known[6]),
        water_index=water_index,
        sd=sd,
        tilt_deg=float(np.rad2deg(tilt)),
        tilt_sd_deg=float(np.rad2deg(tilt_sd)),
        view_rms_px=tuple(rms_length(miss) for miss in misses),
        corners_px=np.concatenate([view.corners_px for _, view in views]),
        residuals_px=-np.concatenate(misses),
        shape=floors[0].shape,
    )


def on_floor(board: Board, size_mm: tuple[float, float, float]) -> Points:
    """(6,) pose of the board that lies in the corner of the floor."""
    corner = [board.margin_mm, size_mm[1] / 2 - board.margin_mm, board.thickness_mm]
    return np.array([np.pi, 0.0, 0.0, *corner])


def _pose(numbers: Points) -> Pose:
    a, b, c, x, y, z = (float(value) for value in numbers[:6])
    return Pose((a, b, c), (x, y, z))


def _camera(floor: BoardView, board: Board, lens: Lens, size_mm: tuple[float, float, float]) -> Pose:
    """Its pose, from the view of the floor alone: board → camera after tank → board."""
    seen, laid = before_camera(floor, board, lens), on_floor(board, size_mm)
    rotation = rotation_matrix(seen[:3]) @ rotation_matrix(laid[:3]).T
    return _pose(np.array([*rotation_vector(rotation), *(seen[3:] - rotation @ laid[3:])]))


def _first_level(
    flooded: Sequence[BoardView],
    board: Board,
    lens: Lens,
    camera: Pose,
    size_mm: tuple[float, float, float],
    water_index: float,
) -> float:
    """By trial; half the tank's height where no view says."""
    if not flooded:
        return 0.5 * size_mm[2]
    points = placed(on_floor(board, size_mm), flooded[0].points_mm(board))

    def miss_px(level: float) -> float:
        through = misses_px(lens, camera, flooded[0], points, water_surface(level, water_index))
        return rms_length(through)

    levels = np.linspace(board.thickness_mm + 1.0, size_mm[2], 120)
    misses = [miss_px(float(level)) for level in levels]
    best = int(np.argmin(misses))
    if misses[best] > MOST_MOVED_PX + 0.002 * max(flooded[0].shape):
        raise CalibrationError(
            f"no water level explains the flooded board, whose corners stay {misses[best]:.1f} px off; fill the tank "
            f"without moving board, tank or camera, and take both views again"
        )
    return float(levels[best])


class _Bundle:
    """Corners of all views as a function of camera pose (6), level (1), lean of the surface (2), boards (6 each).

    Parameters
    ----------
    views, board, lens, size_mm, water_index
        See `calibrate_tank`.
    """

    def __init__(
        self,
        views: Sequence[tuple[Place, BoardView]],
        board: Board,
        lens: Lens,
        size_mm: tuple[float, float, float],
        water_index: float,
    ) -> None:
        self._views, self._board, self._lens, self._index = views, board, lens, water_index
        self._laid = on_floor(board, size_mm)
        self._middle = (size_mm[0] / 2, 0.0)

    def misses(self, numbers: Points) -> list[Points]:
        """(n, 2) of each view."""
        boards = iter(numbers[9:].reshape(-1, 6))
        found = []
        for place, view in self._views:
            pose = next(boards) if place == "water" else self._laid
            points = placed(pose, view.points_mm(self._board))
            if place == "floor":
                found.append(misses_px(self._lens, _pose(numbers), view, points))
            else:
                camera, points = self._levelled(numbers, points)
                surface = water_surface(float(numbers[6]), self._index)
                found.append(misses_px(self._lens, camera, view, points, surface))
        return found

    def solve(self, camera: Pose, level: float, tilted: bool) -> tuple[Points, Points]:
        """Best numbers and their covariance; with a level surface unless `tilted`."""
        from scipy.optimize import least_squares

        surface = water_surface(level, self._index)
        boards = [
            in_tank(view, self._board, self._lens, camera, surface) for where, view in self._views if where == "water"
        ]
        start = np.concatenate([[*camera.rotation, *camera.translation_mm, level, 0.0, 0.0], *boards])
        free = np.ones(start.size, bool)
        free[7:9] = tilted

        def misses(numbers: Points) -> Points:
            return np.concatenate(self.misses(_filled(start, free, numbers))).ravel()

        scale = np.array(([1e-3] * 3 + [1.0] * 3) + [1.0] + [1e-3] * 2 + ([1e-2] * 3 + [1.0] * 3) * len(boards))
        found = least_squares(misses, start[free], x_scale=scale[free])
        covariance = np.zeros((start.size, start.size))
        noise = 2.0 * found.cost / max(found.fun.size - found.x.size, 1)
        jacobian = np.asarray(found.jac)
        covariance[np.ix_(free, free)] = noise * np.linalg.inv(jacobian.T @ jacobian)
        return _filled(start, free, found.x), covariance

    def _levelled(self, numbers: Points, points: Points) -> tuple[Pose, Points]:
        """Camera and points in a frame whose z is across the surface, turned about the middle of the tank."""
        if not numbers[7:9].any():
            return _pose(numbers), points
        rotation, camera = rotation_matrix([*numbers[7:9], 0.0]), _pose(numbers)
        pivot = np.array([*self._middle, numbers[6]])
        matrix = camera.matrix @ rotation.T
        shift = np.array(camera.translation_mm) + camera.matrix @ pivot - matrix @ pivot
        return _pose(np.array([*rotation_vector(matrix), *shift])), (points - pivot) @ rotation.T + pivot


def _filled(start: Points, free: Points, numbers: Points) -> Points:
    whole = start.copy()
    whole[free] = numbers
    return whole

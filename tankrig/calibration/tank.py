"""Where the tank stands before the camera, and how high its water, from a board on its floor and in the water."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tankrig.calibration.board import Board, BoardView, Points, rms_length
from tankrig.calibration.board_pose import before_camera, in_tank, misses_px, placed
from tankrig.calibration.camera import LENS
from tankrig.calibration.file import Calibration
from tankrig.calibration.tolerances import USUAL, WITHIN, Tolerances
from tankrig.calibration.uncertainty import (
    Named,
    corner_pairs,
    found_covariance,
    independent,
    noise_covariance,
    slopes,
)
from tankrig.errors import CalibrationError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, Vector, rotation_matrix, rotation_vector
from tankrig.geometry.refraction import Window, water_surface

Place = Literal["floor", "flooded", "water"]

MOST_RMS_PX = 0.5
MOST_MOVED_PX = 1.0
MOST_TILT_DEG = 0.3
FOUND = (*(f"camera.rotation_{axis}" for axis in "xyz"), *(f"camera.{axis}_mm" for axis in "xyz"), "level_mm")
"""What is sought but for the boards, by the names of its covariance; rotations are the parts of the vector, in rad."""
_OWN = len(FOUND)
_POSE_STEPS = [1e-5] * 3 + [1e-3] * 3
_STEPS = np.array([1e-2] * 4 + [1e-4] * 2 + [1e-5] * 2 + [1e-5, 1e-6, 1e-3, 1e-3] + [1e-5] * 3)
"""Of lens, index, scale, the board's place and turn, and lean: small beside what they are known to, for derivatives."""


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
    known
        `FOUND`, then what was held, with their covariance.
    tilt_deg, tilt_sd_deg
        Of the water's surface from the floor; the rest takes it for level.
    view_rms_px
        Of each view, root mean square distance of corners from where they should be.
    corners_px, residuals_px
        (n, 2) of all corners.
    shape
        (rows, columns) of the pictures.
    sd_without
        Kinds of calibration whose errors the covariance leaves out, since those files know none.
    """

    camera: Pose
    level_mm: float
    water_index: float
    known: Named
    tilt_deg: float
    tilt_sd_deg: float
    view_rms_px: tuple[float, ...]
    corners_px: Points
    residuals_px: Points
    shape: tuple[int, int]
    sd_without: tuple[str, ...] = ()

    @property
    def sd(self) -> dict[str, float | list[float]]:
        """Standard deviations of `camera_rotation` (3, rad), `camera_position_mm` (3) and `level_mm`."""
        each = [self.known.sd(name) for name in FOUND]
        return {"camera_rotation": each[:3], "camera_position_mm": each[3:6], "level_mm": each[6]}

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
        result: dict[str, Any] = {
            "camera_rotation": list(self.camera.rotation),
            "camera_translation_mm": list(self.camera.translation_mm),
            "camera_position_mm": self.camera.centre_mm,
            "level_mm": self.level_mm,
            "water_index": self.water_index,
            **self.known.table(),
        }
        if self.sd_without:
            result["sd_without"] = list(self.sd_without)
        how_well = {"rms_px": self.rms_px, "tilt_deg": self.tilt_deg, "tilt_sd_deg": self.tilt_sd_deg}
        arrays = {"corners_px": self.corners_px, "residuals_px": self.residuals_px, **self.known.array()}
        return Calibration(
            "tank", device, self.shape, result, self.sd, how_well, self.doubts, rests_on=rests_on, arrays=arrays
        )


def calibrate_tank(
    views: Sequence[tuple[Place, BoardView]],
    board: Board,
    lens: Lens,
    size_mm: Vector,
    water_index: float = 1.33,
    lens_covariance: Points | None = None,
    tolerances: Tolerances = USUAL,
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
    lens_covariance
        (8, 8) of the lens's fx, fy, cx, cy, k1, k2, p1, p2; None where it is not known, and then left out.
    tolerances
        By how much what is taken for granted may be off.

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

    Lens, index of the water, scale of the print, place of the board on the floor and lean of the surface are held, and
    their uncertainties carried over (`tankrig.calibration.uncertainty`): lens and camera then belong together.
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
    held = _held(lens, lens_covariance, water_index, board, tolerances)
    fit = _Bundle(views, board, size_mm)
    found, slope = fit.solve(fit.start(start, level, held.values), held.values)
    lean, lean_covariance = fit.lean(found, held.values)
    misses = fit.misses(found, held.values)
    return TankFound(
        camera=pose_of(found),
        level_mm=float(found[6]),
        water_index=water_index,
        known=fit.known(found, slope, held),
        tilt_deg=float(np.rad2deg(np.linalg.norm(lean))),
        tilt_sd_deg=float(np.rad2deg(np.sqrt(np.trace(lean_covariance)))),
        view_rms_px=tuple(rms_length(miss) for miss in misses),
        corners_px=np.concatenate([view.corners_px for _, view in views]),
        residuals_px=-np.concatenate(misses),
        shape=floors[0].shape,
        sd_without=() if lens_covariance is not None else ("camera",),
    )


def _held(
    lens: Lens, lens_covariance: Points | None, water_index: float, board: Board, tolerances: Tolerances
) -> Named:
    """What the fit takes for granted, and how uncertain it is, in the order of `_STEPS`."""
    numbers = np.array([getattr(lens, name) for name in LENS])
    covariance = np.zeros((len(LENS), len(LENS))) if lens_covariance is None else lens_covariance
    sds = {
        "water_index": WITHIN * tolerances.water_index,
        "board_scale": board.square_sd_mm / board.square_mm,
        "laid_x_mm": WITHIN * tolerances.laid_mm,
        "laid_y_mm": WITHIN * tolerances.laid_mm,
        "laid_rad": WITHIN * float(np.deg2rad(tolerances.laid_deg)),
        "lean_x_rad": WITHIN * float(np.deg2rad(tolerances.surface_deg)),
        "lean_y_rad": WITHIN * float(np.deg2rad(tolerances.surface_deg)),
    }
    return (
        Named(tuple(LENS), numbers, covariance)
        .prefixed("camera.")
        .beside(independent(sds, {"water_index": water_index}))
    )


def on_floor(
    board: Board, size_mm: Vector, off_x_mm: float = 0.0, off_y_mm: float = 0.0, turned_rad: float = 0.0
) -> Points:
    """(6,) pose of the board that lies in the corner of the floor, or so far from the walls, and turned by so much."""
    corner = [board.margin_mm + off_x_mm, size_mm[1] / 2 - board.margin_mm - off_y_mm, board.thickness_mm]
    turned = rotation_matrix([0.0, 0.0, turned_rad]) @ rotation_matrix([np.pi, 0.0, 0.0])
    return np.array([*rotation_vector(turned), *corner])


def pose_of(numbers: Points) -> Pose:
    """From (6,) its rotation vector and then its place."""
    a, b, c = (float(value) for value in numbers[:3])
    return Pose.at(numbers[3:6], (a, b, c))


def _camera(floor: BoardView, board: Board, lens: Lens, size_mm: Vector) -> Pose:
    """Its pose, from the view of the floor alone: board → camera after tank → board."""
    seen, laid = before_camera(floor, board, lens), on_floor(board, size_mm)
    rotation = rotation_matrix(seen[:3]) @ rotation_matrix(laid[:3]).T
    x, y, z = (float(one) for one in seen[3:] - rotation @ laid[3:])
    return Pose(rotation_vector(rotation), (x, y, z))


def _first_level(
    flooded: Sequence[BoardView],
    board: Board,
    lens: Lens,
    camera: Pose,
    size_mm: Vector,
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
    """Corners of all views as a function of what is sought and of what is held.

    Sought are the camera's rotation (3) and place (3), the water's level (1), and the poses of boards (6 each); held is
    what `_held` names.

    Parameters
    ----------
    views, board, size_mm
        See `calibrate_tank`.
    """

    def __init__(self, views: Sequence[tuple[Place, BoardView]], board: Board, size_mm: Vector) -> None:
        self._views, self._board = views, board
        self._size_mm = size_mm

    def misses(self, sought: Points, held: Points) -> list[Points]:
        """(n, 2) of each view."""
        lens, (index, scale, *laid), lean = Lens(*held[:8].tolist()), held[8:13], held[13:15]
        camera, level = pose_of(sought), float(sought[6])
        boards = iter(sought[_OWN:].reshape(-1, 6))
        lying = on_floor(self._board, self._size_mm, *(float(one) for one in laid))
        found = []
        for place, view in self._views:
            pose = next(boards) if place == "water" else lying
            points = placed(pose, (1.0 + scale) * view.points_mm(self._board))
            if place == "floor":
                found.append(misses_px(lens, camera, view, points))
            else:
                seen_from, seen = levelled(camera, points, lean, level, self._size_mm)
                found.append(misses_px(lens, seen_from, view, seen, water_surface(level, float(index))))
        return found

    def all_misses(self, sought: Points, held: Points) -> Points:
        """Of all views, one after the other: x and y of each corner in turn."""
        return np.concatenate(self.misses(sought, held)).ravel()

    def start(self, camera: Pose, level: float, held: Points) -> Points:
        """What is sought, as each view alone says."""
        lens, surface = Lens(*held[:8].tolist()), water_surface(level, float(held[8]))
        boards = [in_tank(view, self._board, lens, camera, surface) for where, view in self._views if where == "water"]
        return np.concatenate([camera.rotation, camera.centre_mm, [level], *boards])

    def solve(self, start: Points, held: Points) -> tuple[Points, Points]:
        """What is sought, and the derivatives of the misses by it."""
        from scipy.optimize import least_squares

        sought = np.asarray(least_squares(self.all_misses, start, x_scale="jac", args=(held,)).x)
        steps = np.array(_POSE_STEPS + [1e-3] + _POSE_STEPS * ((sought.size - _OWN) // 6))
        return sought, slopes(lambda numbers: self.all_misses(numbers, held), sought, steps)

    def lean(self, sought: Points, held: Points) -> tuple[Points, Points]:
        """(2,) how the surface leans about x and y when that is sought, too, and its covariance by noise."""
        from scipy.optimize import least_squares

        def misses(numbers: Points) -> Points:
            return self.all_misses(numbers[2:], np.concatenate([held[:13], numbers[:2]]))

        found = least_squares(misses, np.concatenate([[0.0, 0.0], sought]), x_scale="jac")
        noise = 2.0 * found.cost / max(found.fun.size - found.x.size, 1)
        covariance, _ = found_covariance(np.asarray(found.jac), noise * np.eye(found.fun.size))
        return found.x[:2], covariance[:2, :2]

    def known(self, sought: Points, slope: Points, held: Named) -> Named:
        """Camera and level, then what was held, with their covariance."""
        held_slope = slopes(lambda numbers: self.all_misses(sought, numbers), held.values, _STEPS)
        views = [view for _, view in self._views]
        lying = [place != "water" for place, _ in self._views]  # along the pixels, whose grid pulls corners more
        of_kinds = lying, [not one for one in lying]
        kinds = [corner_pairs(views, self._board, which) for which in of_kinds if any(which)]
        misses = self.all_misses(sought, held.values)
        noise = noise_covariance(misses, np.hstack([slope, held_slope]), kinds)
        covariance, across = found_covariance(slope, noise, held_slope, held.covariance)
        return held.after(FOUND, sought[:_OWN], covariance[:_OWN, :_OWN], across[:_OWN])


def levelled(camera: Pose, points: Points, lean: Points, level_mm: float, size_mm: Vector) -> tuple[Pose, Points]:
    """Camera and points in a frame whose z is across the surface, turned about the middle of the tank.

    Parameters
    ----------
    camera, points
        In the tank's frame.
    lean
        (2,) angles in rad by which the frame is turned about x and then y.
    level_mm, size_mm
        Of the water, inside of the tank.
    """
    if not lean.any():
        return camera, points
    rotation = rotation_matrix([*lean, 0.0])
    pivot = np.array([size_mm[0] / 2, 0.0, level_mm])
    turned = Pose.at((camera.centre_mm - pivot) @ rotation.T + pivot, rotation_vector(camera.matrix @ rotation.T))
    return turned, (points - pivot) @ rotation.T + pivot

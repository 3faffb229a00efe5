"""A projector's lens and pose, from boards that its light is decoded on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tankrig.calibration.board import Board, Points, rms_length
from tankrig.calibration.board_pose import NOWHERE_PX, in_tank, placed
from tankrig.calibration.camera import INTRINSICS
from tankrig.calibration.evenness import Evenness, measure_evenness
from tankrig.calibration.file import Calibration
from tankrig.calibration.lit_corners import LitBoard
from tankrig.errors import CalibrationError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, rotation_vector
from tankrig.geometry.refraction import Window
from tankrig.geometry.view import pixels_of

LEAST_VIEWS = 4
LEAST_COVERAGE = 0.12
MOST_RMS_PX = 0.8
MOST_UNEVEN = 0.03
"""Scatter of the light of points about the smooth fall-off that is fitted to them."""
_LENS = len(INTRINSICS) - 1  # k3 is held at zero
_OWN = _LENS + 6
_USUAL = np.array([0.3, 0.1, 0.003, 0.003])
"""Standard deviation of k1, k2, p1, p2 from projector to projector: what corners that reach no edge leave open."""
_NOISE_PX = 0.05


@dataclass(frozen=True, eq=False)
class ProjectorFound:
    """What decoded boards say about a projector.

    Parameters
    ----------
    lens, pose
        Its own, in the tank's frame.
    wall
        What its light went through.
    shape
        (rows, columns) of its picture.
    sd
        Standard deviations of the lens's numbers by name, of `rotation` (3, rad) and `position_mm` (3).
    view_rms_px
        Of each view, root mean square distance of corners from where they should be, in projector pixels.
    corners_px, residuals_px
        (n, 2) in the projector's picture.
    coverage
        Part of the projector's picture that lies between corners.
    evenness
        Of its light; None where that was not measured.
    """

    lens: Lens
    pose: Pose
    wall: Window
    shape: tuple[int, int]
    sd: dict[str, float | list[float]]
    view_rms_px: tuple[float, ...]
    corners_px: Points
    residuals_px: Points
    coverage: float
    evenness: Evenness | None = None

    @property
    def rms_px(self) -> float:
        """Root mean square distance of corners from where they should be."""
        return rms_length(self.residuals_px)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to believe it, and what to do."""
        found = []
        if self.rms_px > MOST_RMS_PX:
            found.append(
                f"corners lie {self.rms_px:.2f} projector px from where they should be, more than {MOST_RMS_PX:g}; "
                f"hold the board still, and calibrate camera and tank if they were touched"
            )
        if self.coverage < LEAST_COVERAGE:
            found.append(
                f"the board was in {100 * self.coverage:.0f} % of the projector's picture; show it elsewhere, too"
            )
        if self.evenness and self.evenness.scatter > MOST_UNEVEN:
            found.append(
                f"the white of the board is unlike a smooth light by {self.evenness.scatter:.1%}; use a clean, matt "
                f"board, and calibrate the radiometry anew if the camera's lens was touched"
            )
        return tuple(found)

    def calibration(self, device: str, rests_on: dict[str, str]) -> Calibration:
        """To be kept in a file; `rests_on` holds the hashes of the camera's and the tank's."""
        result = {
            **{name: getattr(self.lens, name) for name in INTRINSICS},
            "rotation": list(self.pose.rotation),
            "translation_mm": list(self.pose.translation_mm),
            "position_mm": self.pose.centre_mm,
            "pane_mm": self.wall.pane_mm,
            "pane_index": self.wall.pane_index,
        }
        how_well = {"rms_px": self.rms_px, "coverage": self.coverage, "views": len(self.view_rms_px)}
        sd = dict(self.sd)
        if self.evenness:
            result["shading"], sd["shading"] = list(self.evenness.coefficients), list(self.evenness.sd)
            how_well["light_scatter_percent"] = 100.0 * self.evenness.scatter
        arrays = {"corners_px": self.corners_px, "residuals_px": self.residuals_px}
        return Calibration(
            "projector", device, self.shape, result, sd, how_well, self.doubts, rests_on=rests_on, arrays=arrays
        )


def calibrate_projector(
    views: Sequence[LitBoard],
    board: Board,
    lens: Lens,
    camera: Pose,
    surface: Window | None,
    wall: Window,
    shape: tuple[int, int],
) -> ProjectorFound:
    """Find a projector's lens, and where it stands.

    Parameters
    ----------
    views
        Of the board in the tank, at different depths and slants. Where all have their light, its evenness is measured.
    board
        That was held.
    lens, camera
        Of the camera, its pose in the tank's frame.
    surface
        What the camera sees the board through; None in the empty tank.
    wall
        What the projector's light goes through; with water of index 1 in the empty tank.
    shape
        (rows, columns) of the projector.

    Raises
    ------
    CalibrationError
        When there are too few views, or they lie in one plane.

    Notes
    -----
    One least-squares fit (bundle adjustment) of the projector's lens (k3 held at zero) and pose and of all boards'
    poses, to the corners in the camera's pictures and in the projector's, each traced by Snell's law. Distortion that
    the corners leave open is held near none, since it would run away in the parts beyond them. It begins with
    the linear camera (DLT) through the points that would be seen without water, x/n instead of x.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(f"{len(views)} good views are too few; take at least {LEAST_VIEWS}, better eight")
    boards = [in_tank(one.view, board, lens, camera, surface) for one in views]
    points = [placed(pose, one.view.points_mm(board)) for pose, one in zip(boards, views, strict=True)]
    start = _linear(np.concatenate(points), np.concatenate([one.projector_px for one in views]), wall.water_index)
    bundle = _Bundle(views, board, lens, camera, surface, wall)
    known, covariance = bundle.solve(np.concatenate([start, *boards]))
    pose, found = _own(known)
    misses = bundle.projector_misses(known)
    of_views = np.split(misses, np.cumsum([len(one.projector_px) for one in views])[:-1])
    if not np.isfinite(covariance).all() or np.sqrt(covariance[0, 0]) > 0.05 * found.fx:
        raise CalibrationError(
            "the boards lie too nearly in one plane to tell the projector's distance from its focal length; hold the "
            "board at different depths and slants"
        )
    spread = np.sqrt(np.diag(covariance))
    turned = pose.matrix.T @ covariance[_OWN - 3 : _OWN, _OWN - 3 : _OWN] @ pose.matrix
    sd: dict[str, float | list[float]] = dict(zip(INTRINSICS, [*spread[:_LENS].tolist(), 0.0], strict=True))
    sd |= {"rotation": spread[_LENS : _LENS + 3].tolist(), "position_mm": np.sqrt(np.diag(turned)).tolist()}
    corners = np.concatenate([one.projector_px for one in views])
    projector = ProjectorFound(
        lens=found,
        pose=pose,
        wall=wall,
        shape=shape,
        sd=sd,
        view_rms_px=tuple(rms_length(miss) for miss in of_views),
        corners_px=corners,
        residuals_px=-misses,
        coverage=_between(corners, shape),
    )
    if any(one.light is None for one in views):
        return projector
    return replace(
        projector, evenness=measure_evenness(views, board, (lens, camera, surface), (found, pose, wall), shape)
    )


def _own(numbers: Points) -> tuple[Pose, Lens]:
    values = [float(value) for value in numbers[:_OWN]]
    a, b, c, x, y, z = values[_LENS:]
    return Pose((a, b, c), (x, y, z)), Lens(*values[:_LENS])


class _Bundle:
    """Corners in both pictures as a function of the projector's own numbers (14) and the boards' poses (6 each).

    Parameters
    ----------
    views, board, lens, camera, surface, wall
        See `calibrate_projector`.
    """

    def __init__(
        self,
        views: Sequence[LitBoard],
        board: Board,
        lens: Lens,
        camera: Pose,
        surface: Window | None,
        wall: Window,
    ) -> None:
        self._camera, self._wall = (lens, camera, surface), wall
        self._points = [one.view.points_mm(board) for one in views]
        self._seen = np.concatenate([one.view.corners_px for one in views])
        self._lit = np.concatenate([one.projector_px for one in views])

    def projector_misses(self, numbers: Points) -> Points:
        """(n, 2) projector pixels."""
        pose, lens = _own(numbers)
        return _off(pixels_of(lens, pose, self._placed(numbers), self._wall), self._lit)

    def misses(self, numbers: Points) -> Points:
        """Of both, projector pixels and camera pixels; and of the distortion from none, by how unusual it is."""
        pose, lens = _own(numbers)
        points = self._placed(numbers)
        lit = _off(pixels_of(lens, pose, points, self._wall), self._lit)
        lens, pose, surface = self._camera
        seen = _off(pixels_of(lens, pose, points, surface), self._seen)
        return np.concatenate([lit.ravel(), seen.ravel(), _NOISE_PX * numbers[4:_LENS] / _USUAL])

    def solve(self, start: Points) -> tuple[Points, Points]:
        """Best numbers and their covariance."""
        from scipy.optimize import least_squares

        found = least_squares(self.misses, start, x_scale="jac", max_nfev=100)
        noise = 2.0 * found.cost / max(found.fun.size - found.x.size, 1)
        jacobian = np.asarray(found.jac)
        return found.x, noise * np.linalg.pinv(jacobian.T @ jacobian)

    def _placed(self, numbers: Points) -> Points:
        boards = numbers[_OWN:].reshape(-1, 6)
        return np.concatenate([placed(pose, points) for pose, points in zip(boards, self._points, strict=True)])


def _off(expected: Points, found: Points) -> Points:
    return np.nan_to_num(expected - found, nan=NOWHERE_PX)


def _between(corners_px: Points, shape: tuple[int, int]) -> float:
    """Part of a picture that the corners' convex hull covers."""
    import cv2

    return float(cv2.contourArea(cv2.convexHull(corners_px.astype(np.float32)))) / (shape[0] * shape[1])


def _linear(points_mm: Points, pixels: Points, water_index: float) -> Points:
    """First guess of lens and pose, (14,)."""
    import cv2

    seen = points_mm / np.array([water_index, 1.0, 1.0])
    middle, size = seen.mean(axis=0), seen.std()
    centre, spread = pixels.mean(axis=0), pixels.std()
    x = np.column_stack([(seen - middle) / size, np.ones(len(seen))])
    u, v = ((pixels - centre) / spread).T
    none = np.zeros_like(x)
    rows = np.concatenate([np.hstack([x, none, -u[:, None] * x]), np.hstack([none, x, -v[:, None] * x])])
    solution = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 4)
    shrink = np.vstack([np.column_stack([np.eye(3) / size, -middle / size]), [0.0, 0.0, 0.0, 1.0]])
    grow = np.array([[spread, 0.0, centre[0]], [0.0, spread, centre[1]], [0.0, 0.0, 1.0]])
    projection = grow @ solution @ shrink
    if (projection[2] @ np.append(middle, 1.0)) < 0.0:
        projection = -projection
    matrix, rotation, place = cv2.decomposeProjectionMatrix(projection)[:3]
    signs = np.diag(np.sign(np.diag(matrix)))
    matrix, rotation = matrix @ signs / matrix[2, 2] * signs[2, 2], signs @ rotation
    if np.linalg.det(rotation) < 0.0:
        raise CalibrationError("the projector's picture comes out mirrored; check its mirroring and the board's place")
    shift = -rotation @ (place[:3, 0] / place[3, 0])
    lens = [abs(matrix[0, 0]), abs(matrix[1, 1]), matrix[0, 2], matrix[1, 2], 0.0, 0.0, 0.0, 0.0]
    return np.array([*lens, *rotation_vector(rotation), *shift])

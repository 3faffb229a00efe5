"""A camera's lens, from pictures of a ChArUco board in air."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import Board, BoardView, Points, rms_length
from tankrig.calibration.edge_blur import PIXEL_VARIANCE, Blur, BlurOverPicture
from tankrig.calibration.file import Calibration
from tankrig.calibration.uncertainty import Named, corner_pairs, found_covariance, noise_covariance
from tankrig.errors import CalibrationError
from tankrig.geometry.lens import Lens

LEAST_VIEWS = 6
LEAST_TILT_DEG = 15.0
LEAST_COVERAGE = 0.5
MOST_RMS_PX = 0.5
MOST_FOCAL_SD = 0.01
_OUTLIER = 3.0
_CELLS = (6, 8)
INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
LENS = INTRINSICS[:-1]
"""What is fitted; k3 is held at zero."""


@dataclass(frozen=True, eq=False)
class CameraFound:
    """What pictures of a board say about a lens.

    Parameters
    ----------
    lens
        Its numbers; k3 is held at zero.
    known
        Its numbers but k3 with their covariance.
    shape
        (rows, columns) of the pictures.
    view_rms_px
        Of each view that was used, root mean square distance of its corners from where the lens has them.
    left_out
        Numbers of the views, from 0, that did not fit with the rest.
    corners_px, residuals_px
        (n, 2) of all corners used, and how far each was seen from where the lens has it.
    coverage
        Part of the picture, in 8 × 6 cells, that corners were seen in.
    tilt_deg
        Largest angle between two views of the board.
    blur
        Of the lens; None where too few edges were seen.
    blur_over_picture
        The same from the middle to the corners; None likewise.
    """

    lens: Lens
    known: Named
    shape: tuple[int, int]
    view_rms_px: tuple[float, ...]
    left_out: tuple[int, ...]
    corners_px: Points
    residuals_px: Points
    coverage: float
    tilt_deg: float
    blur: Blur | None = None
    blur_over_picture: BlurOverPicture | None = None

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviations, by name."""
        return {**{name: self.known.sd(name) for name in LENS}, "k3": 0.0}

    @property
    def rms_px(self) -> float:
        """Root mean square distance of corners from where the lens has them."""
        return rms_length(self.residuals_px)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to believe it, and what to do."""
        found = []
        if self.rms_px > MOST_RMS_PX:
            found.append(
                f"corners lie {self.rms_px:.2f} px from where the lens has them, more than {MOST_RMS_PX:g}; use a flat "
                f"board, hold it still, and check its description"
            )
        if self.coverage < LEAST_COVERAGE:
            found.append(
                f"the board was seen in {100 * self.coverage:.0f} % of the picture; show it along its edges, too"
            )
        return tuple(found)

    def calibration(self, device: str) -> Calibration:
        """To be kept in a file."""
        result: dict[str, Any] = {**{name: getattr(self.lens, name) for name in INTRINSICS}, **self.known.table()}
        sd = dict(self.sd)
        if self.blur:
            result["blur_px"], sd["blur_px"] = self.blur.px, self.blur.sd_px
        if self.blur and self.blur_over_picture and self.blur_over_picture.varies:
            over = self.blur_over_picture
            result |= {"blur_middle_px": over.middle_px, "blur_corner_px": over.corner_px}
            sd |= dict(zip(("blur_middle_px", "blur_corner_px"), over.sd_px, strict=True))
        how_well = {"rms_px": self.rms_px, "coverage": self.coverage, "tilt_deg": self.tilt_deg}
        return Calibration(
            "camera",
            device,
            self.shape,
            result,
            sd,
            {**how_well, "views": len(self.view_rms_px)},
            self.doubts,
            arrays={"corners_px": self.corners_px, "residuals_px": self.residuals_px, **self.known.array()},
        )


def calibrate_camera(views: Sequence[BoardView], board: Board) -> CameraFound:
    """Find a camera's lens.

    Parameters
    ----------
    views
        Of the board in air, near and far, tilted all ways, all over the picture; views with a fault are not for this.
    board
        That was held.

    Raises
    ------
    CalibrationError
        When there are too few views, they are not of one resolution, or too much alike to tell a focal length from a
        distance.

    Notes
    -----
    Zhang's method as in OpenCV (`calibrateCameraExtended`) with k1, k2, p1, p2; views whose error is more than three
    times that of the median view are left out, and the rest fitted again. The covariance takes the residuals
    for the corners' noise, alike or opposed from neighbour to neighbour as they show.
    """
    _refuse(views)
    used, left_out = list(views), tuple[int, ...]()
    lens, errors, poses = _fit(used, board)
    good = errors <= max(_OUTLIER * float(np.median(errors)), 0.1)
    if not good.all() and good.sum() >= LEAST_VIEWS:
        left_out = tuple(np.flatnonzero(~good).tolist())
        used = [view for view, fits in zip(views, good, strict=True) if fits]
        lens, errors, poses = _fit(used, board)
    known = _known(lens, poses, used, board)
    tilt = _largest_angle_deg(poses)
    if tilt < LEAST_TILT_DEG or not known.sd("fx") < MOST_FOCAL_SD * lens.fx:
        raise CalibrationError(
            f"the views are too much alike: the board was tilted by {tilt:.0f}° between them, and the focal length is "
            f"known to {100 * known.sd('fx') / lens.fx:.1f} %; tilt it by 30° to all four sides"
        )
    corners = np.concatenate([view.corners_px for view in used])
    residuals = np.concatenate([_residuals(lens, pose, view, board) for pose, view in zip(poses, used, strict=True)])
    coverage = covered(corners, views[0].shape)
    return CameraFound(
        lens,
        known,
        views[0].shape,
        tuple(errors.tolist()),
        left_out,
        corners,
        residuals,
        float(coverage.mean()),
        tilt,
        Blur.of([view.edge_px**2 - PIXEL_VARIANCE for view in used]),
        BlurOverPicture.of([view.edges for view in used], views[0].shape),
    )


def covered(corners_px: Points, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(6, 8) which cells of the picture have a corner in them.

    >>> float(covered(np.array([[0.0, 0.0], [79.0, 59.0]]), (60, 80)).sum())
    2.0
    """
    rows, columns = _CELLS
    down = np.clip(corners_px[:, 1] / shape[0] * rows, 0, rows - 1).astype(int)
    across = np.clip(corners_px[:, 0] / shape[1] * columns, 0, columns - 1).astype(int)
    cells = np.zeros(_CELLS, bool)
    cells[down, across] = True
    return cells


def _refuse(views: Sequence[BoardView]) -> None:
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(f"{len(views)} good views are too few; take at least {LEAST_VIEWS}, better fifteen")
    shapes = sorted({view.shape for view in views})
    if len(shapes) > 1:
        raise CalibrationError(
            f"the views are of different resolutions (rows, columns): {', '.join(map(str, shapes))}; use those of one"
        )


_Poses = list[tuple[NDArray[np.float64], NDArray[np.float64]]]


def _fit(views: Sequence[BoardView], board: Board) -> tuple[Lens, NDArray[np.float64], _Poses]:
    import cv2

    points = [view.points_mm(board).astype(np.float32) for view in views]
    corners = [view.corners_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    rows, columns = views[0].shape
    try:
        _, matrix, distortion, rotations, shifts, _, _, errors = cv2.calibrateCameraExtended(
            points, corners, (columns, rows), None, None, flags=cv2.CALIB_FIX_K3
        )
    except cv2.error as error:
        raise CalibrationError(
            f"no lens explains the views ({error.err}); check the board's description, and take new ones"
        ) from error
    matrix[0, 1] = 0.0
    lens = Lens.of(matrix, distortion.ravel()[:5])
    poses = [(np.ravel(rotation), np.ravel(shift)) for rotation, shift in zip(rotations, shifts, strict=True)]
    return lens, np.ravel(errors), poses


def _known(lens: Lens, poses: _Poses, views: Sequence[BoardView], board: Board) -> Named:
    """The lens with its covariance."""
    import cv2

    slope = np.zeros((sum(2 * len(view.ids) for view in views), len(LENS) + 6 * len(views)))
    misses, row = [], 0
    for number, (pose, view) in enumerate(zip(poses, views, strict=True)):
        expected, by = cv2.projectPoints(view.points_mm(board), *pose, lens.matrix, lens.distortion)
        rows, first = slice(row, row + len(by)), len(LENS) + 6 * number
        slope[rows, : len(LENS)] = by[
            :, 6 : 6 + len(LENS)
        ]  # after rotation and shift, in OpenCV's order, which is ours
        slope[rows, first : first + 6] = by[:, :6]
        misses.append((expected.reshape(-1, 2) - view.corners_px).ravel())
        row += len(by)
    noise = noise_covariance(np.concatenate(misses), slope, [corner_pairs(views, board)])
    covariance, _ = found_covariance(slope, noise)
    values = np.array([getattr(lens, name) for name in LENS])
    return Named(LENS, values, covariance[: len(LENS), : len(LENS)])


def _residuals(
    lens: Lens, pose: tuple[NDArray[np.float64], NDArray[np.float64]], view: BoardView, board: Board
) -> Points:
    import cv2

    expected, _ = cv2.projectPoints(view.points_mm(board), *pose, lens.matrix, lens.distortion)
    return np.asarray(view.corners_px - expected.reshape(-1, 2))


def _largest_angle_deg(poses: _Poses) -> float:
    """Between the board's normals."""
    import cv2

    normals = np.array([cv2.Rodrigues(rotation)[0][:, 2] for rotation, _ in poses])
    return float(np.rad2deg(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0))).max())


def blur_of(calibration: Calibration) -> BlurOverPicture | None:
    """What a camera's file says of its blur over the picture; None where it was written before that was measured."""
    told, sd = calibration.result, calibration.sd
    if "blur_px" not in told:
        return None
    middle, corner = (name if name in told else "blur_px" for name in ("blur_middle_px", "blur_corner_px"))
    return BlurOverPicture(
        float(told[middle]), float(told[corner]), (float(sd.get(middle, 0.0)), float(sd.get(corner, 0.0)))
    )

"""A projector's lens and pose, from boards that its light is decoded on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tankrig.calibration.blur_in_depth import BlurInDepth, Way, find_blur_in_depth
from tankrig.calibration.board import Board, Points, rms_length
from tankrig.calibration.board_pose import NOWHERE_PX, in_tank, placed
from tankrig.calibration.camera import INTRINSICS, LENS
from tankrig.calibration.edge_blur import OF_STRIPES, PIXEL_VARIANCE, Blur, BlurOverPicture
from tankrig.calibration.evenness import Evenness, measure_evenness
from tankrig.calibration.file import Calibration
from tankrig.calibration.lit_corners import LitBoard
from tankrig.calibration.projector_halo import ProjectorHalo, find_halo
from tankrig.calibration.tank import FOUND as TANK_FOUND
from tankrig.calibration.tank import levelled, pose_of
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
from tankrig.geometry.pose import Pose, Vector, rotation_vector
from tankrig.geometry.refraction import Window, water_surface
from tankrig.geometry.view import pixels_of

LEAST_VIEWS = 4
LEAST_COVERAGE = 0.12
MOST_RMS_PX = 0.8
MOST_UNEVEN = 0.03
"""Scatter of the light of points about the smooth fall-off that is fitted to them."""
_LENS = len(LENS)
_OWN = _LENS + 6
FOUND = (*LENS, *(f"rotation_{axis}" for axis in "xyz"), *(f"{axis}_mm" for axis in "xyz"))
"""What is sought but for the boards, by the names of its covariance."""
HELD = (
    *(f"camera.{name}" for name in LENS),
    *TANK_FOUND,
    "water_index",
    "board_scale",
    "lean_x_rad",
    "lean_y_rad",
    "wall_mm",
    "wall_index",
)
HELD_STEPS = np.array(
    [1e-2] * 4 + [1e-4] * 2 + [1e-5] * 2 + [1e-5] * 3 + [1e-3] * 4 + [1e-5, 1e-6] + [1e-5] * 2 + [1e-3, 1e-4]
)
"""Of `HELD`: small beside what they are known to, for derivatives."""
_USUAL = np.array([0.3, 0.1, 0.003, 0.003])
"""Standard deviation of k1, k2, p1, p2 from projector to projector: what corners that reach no edge leave open."""
FIRST_NOISE_PX = 0.05
"""Of corners in either picture, before they have told it."""


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
    known
        `FOUND`, then what was held, with their covariance.
    view_rms_px
        Of each view, root mean square distance of corners from where they should be, in projector pixels.
    corners_px, residuals_px
        (n, 2) in the projector's picture.
    coverage
        Part of the projector's picture that lies between corners.
    evenness
        Of its light; None where that was not measured.
    blur
        Of the lens; None where too little was seen of its stripes.
    blur_in_depth
        How that changes with depth; None where too little was seen to tell.
    halo
        Of the lens; None where halves of its picture were not thrown.
    sd_without
        Kinds of calibration whose errors the covariance leaves out, since those files know none.
    """

    lens: Lens
    pose: Pose
    wall: Window
    shape: tuple[int, int]
    known: Named
    view_rms_px: tuple[float, ...]
    corners_px: Points
    residuals_px: Points
    coverage: float
    evenness: Evenness | None = None
    blur: Blur | None = None
    blur_in_depth: BlurInDepth | None = None
    halo: ProjectorHalo | None = None
    sd_without: tuple[str, ...] = ()

    @property
    def sd(self) -> dict[str, float | list[float]]:
        """Standard deviations of the lens's numbers by name, of `rotation` (3, rad), `position_mm` (3) and the pane."""
        each = [self.known.sd(name) for name in FOUND]
        return {
            **dict(zip(LENS, each, strict=False)),
            "k3": 0.0,
            "rotation": each[_LENS : _LENS + 3],
            "position_mm": each[_LENS + 3 :],
            "pane_mm": self.known.sd("wall_mm"),
            "pane_index": self.known.sd("wall_index"),
        }

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
        return (*found, *(self.blur_in_depth.doubts if self.blur_in_depth else ()))

    def calibration(self, device: str, rests_on: dict[str, str]) -> Calibration:
        """To be kept in a file; `rests_on` holds the hashes of the camera's and the tank's."""
        result: dict[str, Any] = {
            **{name: getattr(self.lens, name) for name in INTRINSICS},
            "rotation": list(self.pose.rotation),
            "translation_mm": list(self.pose.translation_mm),
            "position_mm": self.pose.centre_mm,
            "pane_mm": self.wall.pane_mm,
            "pane_index": self.wall.pane_index,
            **self.known.table(),
        }
        if self.sd_without:
            result["sd_without"] = list(self.sd_without)
        how_well = {"rms_px": self.rms_px, "coverage": self.coverage, "views": len(self.view_rms_px)}
        sd = dict(self.sd)
        arrays = {"corners_px": self.corners_px, "residuals_px": self.residuals_px, **self.known.array()}
        if self.evenness:
            result["shading"], sd["shading"] = list(self.evenness.coefficients), list(self.evenness.sd)
            how_well["light_scatter_percent"] = 100.0 * self.evenness.scatter
        if self.blur:
            result["blur_px"], sd["blur_px"] = self.blur.px, self.blur.sd_px
        if self.blur_in_depth:
            told = self.blur_in_depth
            result |= {"blur_focus_px": told.blur_px, "lens_mm": told.lens_mm, "in_tank_index": self.wall.water_index}
            sd |= {"blur_focus_px": told.sd[0], "lens_mm": told.sd[1]}
            if told.lens_mm > 0.0:
                result["focus_mm"], sd["focus_mm"] = told.focus_mm, told.sd[2]
            how_well["blur_scatter_percent"], arrays["blur_in_depth"] = 100.0 * told.misfit, told.parts
        if self.halo:
            result |= {"halo_share": self.halo.share, "halo_sigma_px": self.halo.sigma_px}
            sd |= dict(zip(("halo_share", "halo_sigma_px"), self.halo.sd, strict=True))
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
    size_mm: Vector,
    seen_by: Named | None = None,
    tolerances: Tolerances = USUAL,
    seen_blur: BlurOverPicture | None = None,
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
    size_mm
        Inside of the tank.
    seen_by
        Camera and water with their covariance, as `TankFound.known`; None where it is not known, and then left out.
    tolerances
        By how much what is taken for granted may be off.
    seen_blur
        Of the camera, over its picture; None: that of the edges of boards in the same pictures, which comes out 4 %
        too wide where boards are seen at so steep a slant that markers lie three pixels from the edges.

    Raises
    ------
    CalibrationError
        When there are too few views, or they lie in one plane.

    Notes
    -----
    One least-squares fit (bundle adjustment) of the projector's lens (k3 held at zero) and pose and of all boards'
    poses, to the corners in the camera's pictures and in the projector's, each traced by Snell's law. Camera, water,
    wall and the print's scale are held, and their uncertainties carried over. Distortion that
    the corners leave open is held near none, since it would run away in the parts beyond them. It begins with
    the linear camera (DLT) through the points that would be seen without water, x/n instead of x.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(f"{len(views)} good views are too few; take at least {LEAST_VIEWS}, better eight")
    boards = [in_tank(one.view, board, lens, camera, surface) for one in views]
    points = [placed(pose, one.view.points_mm(board)) for pose, one in zip(boards, views, strict=True)]
    start = _linear(np.concatenate(points), np.concatenate([one.projector_px for one in views]), wall.water_index)
    held = _held(lens, camera, surface, wall, board, seen_by, tolerances)
    bundle = _Bundle(views, board, surface is not None, wall, size_mm)
    sought, weights = bundle.solve(np.concatenate([start, *boards]), held.values)
    known = bundle.known(sought, weights, held)
    pose, found = _own(sought)
    misses = bundle.projector_misses(sought, held.values)
    of_views = np.split(misses, np.cumsum([len(one.projector_px) for one in views])[:-1])
    if not np.isfinite(known.covariance).all() or known.sd("fx") > 0.05 * found.fx:
        raise CalibrationError(
            "the boards lie too nearly in one plane to tell the projector's distance from its focal length; hold the "
            "board at different depths and slants"
        )
    corners = np.concatenate([one.projector_px for one in views])
    parts = _parts(views, bundle.x_mm(sought, held.values), way := _way(pose, wall, size_mm), seen_blur)
    own_px2 = [variance - camera for one in parts for _, variance, camera in one]
    projector = ProjectorFound(
        lens=found,
        pose=pose,
        wall=wall,
        shape=shape,
        known=known,
        view_rms_px=tuple(rms_length(miss) for miss in of_views),
        corners_px=corners,
        residuals_px=-misses,
        coverage=_between(corners, shape),
        blur=Blur.of(own_px2, OF_STRIPES),
        blur_in_depth=find_blur_in_depth(parts, found.fx, way),
        sd_without=() if seen_by is not None else ("camera", "tank"),
    )
    if any(one.light is None for one in views):
        return projector
    evenness = measure_evenness(views, board, (lens, camera, surface), (found, pose, wall), shape)
    halo = find_halo([one.halves for one in views], shape, evenness.coefficients)
    return replace(projector, evenness=evenness, halo=halo)


def _held(
    lens: Lens,
    camera: Pose,
    surface: Window | None,
    wall: Window,
    board: Board,
    seen_by: Named | None,
    tolerances: Tolerances,
) -> Named:
    """What the fit takes for granted, and how uncertain it is, in the order of `HELD`."""
    values = {
        **{f"camera.{name}": getattr(lens, name) for name in LENS},
        **dict(zip(TANK_FOUND[:6], [*camera.rotation, *camera.centre_mm], strict=True)),
        "level_mm": surface.place_mm if surface else 0.0,
        "water_index": wall.water_index,
    }
    if seen_by is None:
        own = {"water_index": WITHIN * tolerances.water_index, "board_scale": board.square_sd_mm / board.square_mm}
        seen = independent({name: own.get(name, 0.0) for name in HELD[:-2]}, values)
    else:
        seen = replace(seen_by.only(HELD[:-2]), values=np.array([values.get(name, 0.0) for name in HELD[:-2]]))
    pane = {"wall_mm": wall.pane_mm, "wall_index": wall.pane_index}
    sds = {
        "wall_mm": WITHIN * tolerances.wall_mm if wall.pane_mm else 0.0,
        "wall_index": WITHIN * tolerances.wall_index,
    }
    return seen.beside(independent(sds, pane))


def _own(numbers: Points) -> tuple[Pose, Lens]:
    values = [float(value) for value in numbers[:_OWN]]
    return pose_of(numbers[_LENS:_OWN]), Lens(*values[:_LENS])


class _Bundle:
    """Corners in both pictures as a function of what is sought and of what is held.

    Sought are the projector's lens (8), rotation (3) and place (3), and the poses of boards (6 each); held is what
    `HELD` names.

    Parameters
    ----------
    views, board, filled, wall, size_mm
        See `calibrate_projector`; whether there is water in the tank.
    """

    def __init__(self, views: Sequence[LitBoard], board: Board, filled: bool, wall: Window, size_mm: Vector) -> None:
        self._filled, self._wall, self._size_mm = filled, wall, size_mm
        self._board_views, self._board = [one.view for one in views], board
        self._points = [one.view.points_mm(board) for one in views]
        self._seen = np.concatenate([one.view.corners_px for one in views])
        self._lit = np.concatenate([one.projector_px for one in views])
        self._slopes = np.concatenate([one.slopes for one in views])

    def x_mm(self, sought: Points, held: Points) -> list[Points]:
        """Of the corners of each view, how far behind the wall they are."""
        ends = np.cumsum([len(points) for points in self._points])[:-1]
        return np.split(self._placed(sought, held)[:, 0], ends)

    def projector_misses(self, sought: Points, held: Points) -> Points:
        """(n, 2) projector pixels."""
        pose, lens = _own(sought)
        return _off(pixels_of(lens, pose, self._placed(sought, held), self._behind_wall(held)), self._lit)

    def misses(self, sought: Points, held: Points) -> Points:
        """Camera pixels; projector pixels; and distortion, from none, by how unusual it is.

        A corner that the camera's picture has beside its true place is decoded there, too, so both would err together.
        What the camera's miss makes of the projector's is therefore taken off.
        """
        seen = self._camera_misses(sought, held)
        lit = self.projector_misses(sought, held) - np.einsum("nij,nj->ni", self._slopes, seen)
        return np.concatenate([seen.ravel(), lit.ravel(), sought[4:_LENS] / _USUAL])

    def solve(self, start: Points, held: Points) -> tuple[Points, Points]:
        """What is sought, and the weight of each miss: one over the noise of its kind."""
        from scipy.optimize import least_squares

        def weighted(numbers: Points, weights: Points) -> Points:
            return weights * self.misses(numbers, held)

        count, sought = self._seen.size, start
        noise_px = np.array([FIRST_NOISE_PX, FIRST_NOISE_PX])
        for _ in range(2):
            weights = np.concatenate([np.repeat(1.0 / noise_px, count), np.ones(_LENS - 4)])
            found = least_squares(weighted, sought, x_scale="jac", args=(weights,))
            sought = np.asarray(found.x)
            misses = self.misses(sought, held)
            boards = 6 * len(self._points)
            degrees = np.maximum(count - np.array([boards, _OWN]), 1)
            noise_px = np.maximum(np.sqrt((misses[: 2 * count].reshape(2, -1) ** 2).sum(axis=1) / degrees), 1e-4)
        return sought, weights

    def known(self, sought: Points, weights: Points, held: Named) -> Named:
        """The projector's numbers, then what was held, with their covariance."""
        pose_steps = [1e-5] * 3 + [1e-3] * 3
        steps = np.array([1e-2] * 4 + [1e-4] * 2 + [1e-5] * 2 + pose_steps * (1 + len(self._points)))
        slope = slopes(lambda numbers: self.misses(numbers, held.values), sought, steps)
        held_slope = slopes(lambda numbers: self.misses(sought, numbers), held.values, HELD_STEPS)
        rows = 2 * self._seen.size
        of_camera, of_projector = self._pairs(0), self._pairs(1)
        explained = np.hstack([slope, held_slope])[:rows]
        noise = np.eye(weights.size)  # what is usual is as uncertain as it is unusual
        noise[:rows, :rows] = noise_covariance(
            self.misses(sought, held.values)[:rows], explained, [of_camera, of_projector]
        )
        weighted = weights[:, None] * noise * weights
        covariance, across = found_covariance(
            weights[:, None] * slope, weighted, weights[:, None] * held_slope, held.covariance
        )
        return held.after(FOUND, sought[:_OWN], covariance[:_OWN, :_OWN], across[:_OWN])

    def _pairs(self, which: int) -> tuple[Points, Points]:
        """`corner_pairs` of the camera's (0) or the projector's (1) part of the misses."""
        count = self._seen.size
        part = slice(which * count, (which + 1) * count)
        same, near = np.zeros((2 * count, 2 * count)), np.zeros((2 * count, 2 * count))
        same[part, part], near[part, part] = corner_pairs(self._board_views, self._board)
        return same, near

    def _camera_misses(self, sought: Points, held: Points) -> Points:
        lens, camera, level = Lens(*held[:8].tolist()), pose_of(held[8:14]), float(held[14])
        points = self._placed(sought, held)
        surface = None
        if self._filled:
            camera, points = levelled(camera, points, held[17:19], level, self._size_mm)
            surface = water_surface(level, float(held[15]))
        return _off(pixels_of(lens, camera, points, surface), self._seen)

    def _behind_wall(self, held: Points) -> Window:
        index = float(held[15]) if self._filled else 1.0
        return replace(self._wall, water_index=index, pane_mm=float(held[19]), pane_index=float(held[20]))

    def _placed(self, sought: Points, held: Points) -> Points:
        boards, size = sought[_OWN:].reshape(-1, 6), 1.0 + held[16]
        return np.concatenate([placed(pose, size * points) for pose, points in zip(boards, self._points, strict=True)])


def _off(expected: Points, found: Points) -> Points:
    return np.nan_to_num(expected - found, nan=NOWHERE_PX)


def _way(pose: Pose, wall: Window, size_mm: Vector) -> Way:
    """Of the light, from the lens to places in the tank."""
    return Way(-pose.centre_mm[0] - wall.pane_mm + wall.pane_mm / wall.pane_index, wall.water_index, size_mm[0])


def _parts(
    views: Sequence[LitBoard], x_mm: Sequence[Points], way: Way, seen_blur: BlurOverPicture | None
) -> list[Points]:
    """What stripes tell of the blur on each board, as `find_blur_in_depth` wants it.

    On a plane one over the distance is linear in the picture's coordinates; so it is found from the corners about.
    """
    found = []
    for view, depths in zip(views, x_mm, strict=True):
        design = np.column_stack([view.projector_px, np.ones(len(depths))])
        plane = np.linalg.lstsq(design, way.nearness(depths), rcond=None)[0]
        lit = np.array([[*one.lit_px, 1.0] for one in view.stripes]).reshape(-1, 3)
        at = way.index * (1.0 / (lit @ plane) - way.before_mm)
        seen = [
            seen_blur.at(*one.seen_px, view.view.shape) ** 2 + PIXEL_VARIANCE if seen_blur else view.view.edge_px**2
            for one in view.stripes
        ]
        variances = [(one.variance_px2, one.camera_px2 * two) for one, two in zip(view.stripes, seen, strict=True)]
        found.append(np.column_stack([at, np.array(variances).reshape(-1, 2)]))
    return found


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
    return np.array([*lens, *rotation_vector(rotation), *(-rotation.T @ shift)])

"""How evenly a projector lights its picture, from the white of boards that stood in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import Board, Points
from tankrig.calibration.board_pose import in_tank, placed
from tankrig.errors import CalibrationError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose
from tankrig.geometry.refraction import Window
from tankrig.geometry.shading import TERMS, shading_terms
from tankrig.geometry.view import pixels_of

if TYPE_CHECKING:
    from tankrig.calibration.lit_corners import LitBoard

Light = NDArray[np.float32]

_STEP_MM = 0.1
_ALONG = (-0.25, 0.0, 0.25)
_LEAST_WIDE_PX = 4.0
"""Width of a white stripe in whose middle no black is seen through blur."""
_CLIPPED = 3.0
_SIDES = 4 * len(_ALONG)
"""Points about one marker, which lie near each other."""
_MANY = 10_000
_LEAST_POINTS = 60


@dataclass(frozen=True)
class Evenness:
    """Light of a projector's pixels over that of the one in its middle.

    Parameters
    ----------
    coefficients, sd
        (6,) of `tankrig.geometry.shading.shading_terms`, and their standard deviations.
    scatter
        Standard deviation of a point's light about them, as a share.
    """

    coefficients: tuple[float, ...]
    sd: tuple[float, ...]
    scatter: float


def measure_evenness(
    views: Sequence["LitBoard"],
    board: Board,
    camera: tuple[Lens, Pose, Window | None],
    projector: tuple[Lens, Pose, Window],
    shape: tuple[int, int],
) -> Evenness:
    """Fit the light of a projector's pixels.

    Parameters
    ----------
    views
        Of the board, all with their `light`.
    board
        That was held.
    camera, projector
        Lens, pose in the tank's frame, and what they look and shine through.
    shape
        (rows, columns) of the projector.

    Raises
    ------
    CalibrationError
        When too little of the board was lit.

    Notes
    -----
    White paper's radiance is in proportion to a pixel's light times the pixels per area of the board, which geometry
    knows, |∂(u, v)/∂(x, y)|. Each placing has a factor of its own: paper is no ideal diffuser, and lamps drift; what
    differs within a placing is the projector's. What wall and surface reflect differs by 0.1 % within a picture. Points
    about one marker are off together, and the standard deviations say so.
    """
    designs, logs, groups = [], [], []
    for number, view in enumerate(views):
        assert view.light is not None
        pixels, light, group = _white(view, board, camera, projector, shape)
        which = np.zeros((len(light), len(views)))
        which[:, number] = 1.0
        designs.append(np.hstack([shading_terms(pixels, shape), which]))
        logs.append(np.log(light))
        groups.append(group + number * _MANY)
    group = np.concatenate(groups)
    design, value = np.concatenate(designs), np.concatenate(logs)
    kept = np.ones(value.size, bool)
    for _ in range(3):
        if kept.sum() < _LEAST_POINTS:
            raise CalibrationError("too little of the board's white was in the projector's light; expose longer")
        solution = np.linalg.lstsq(design[kept], value[kept], rcond=None)[0]
        off = value - design @ solution
        scatter = 1.4826 * float(np.median(np.abs(off[kept])))
        kept = np.abs(off) <= _CLIPPED * scatter
    covariance = _grouped(design[kept], off[kept], group[kept])
    sd = np.sqrt(np.maximum(np.diag(covariance)[:TERMS], 0.0))
    return Evenness(tuple(solution[:TERMS].tolist()), tuple(sd.tolist()), scatter)


def _grouped(design: Points, off: Points, group: NDArray[np.int64]) -> Points:
    """Covariance of a fit to points that are off together where they are near (CR3; Bell and McCaffrey 2002)."""
    inverse = np.linalg.pinv(design.T @ design)
    pulls = []
    for one in np.unique(group):
        rows = design[group == one]
        without = np.eye(len(rows)) - rows @ inverse @ rows.T  # as if the fit had not known the group
        pulls.append(rows.T @ np.linalg.lstsq(without, off[group == one], rcond=1e-6)[0])
    return np.asarray(inverse @ (np.transpose(pulls) @ np.array(pulls)) @ inverse)


def _white(
    view: "LitBoard",
    board: Board,
    camera: tuple[Lens, Pose, Window | None],
    projector: tuple[Lens, Pose, Window],
    shape: tuple[int, int],
) -> tuple[Points, Points, NDArray[np.int64]]:
    """Projector pixels of white places of the board, what light those give over their density, and which are near."""
    import cv2

    assert view.light is not None
    on_board, across = _white_places(board)
    lens, pose, surface = camera
    stands = in_tank(view.view, board, lens, pose, surface)
    left, seen, right = (
        pixels_of(lens, pose, placed(stands, on_board + by * across), surface).astype(np.float32) for by in (-1, 0, 1)
    )
    light = cv2.remap(
        view.light, seen[:, 0], seen[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0
    )

    def lit_from(points: Points) -> Points:
        return pixels_of(projector[0], projector[1], placed(stands, points), projector[2])

    steps = _STEP_MM * np.eye(3)[:2]
    (ux, vx), (uy, vy) = ((lit_from(on_board + step) - lit_from(on_board - step)).T for step in steps)
    pixels, density = lit_from(on_board), np.abs(ux * vy - uy * vx)
    rows, columns = shape
    with np.errstate(invalid="ignore"):  # NaN: where nothing is seen
        inside = (np.abs(pixels - [(columns - 1) / 2, (rows - 1) / 2]) < [columns / 2 - 2, rows / 2 - 2]).all(axis=1)
        bright = light.ravel() > 0.2 * np.median(light)
        wide = np.linalg.norm(right - left, axis=1) > _LEAST_WIDE_PX
    good = inside & bright & wide & (density > 0.0)
    white = _seen_white(seen, left, right, view.view.edge_px)
    return pixels[good], (light.ravel() / white / density)[good], np.flatnonzero(good) // _SIDES


def _seen_white(seen: Light, left: Light, right: Light, edge_px: float) -> Points:
    """(n,) share of a white stripe's light in its middle that blur leaves there; `left` and `right` are its edges."""
    from scipy.special import ndtr

    if not np.isfinite(edge_px):
        return np.ones(len(seen))
    apart = (np.linalg.norm(edge - seen, axis=1) / edge_px for edge in (left, right))
    return np.asarray(1.0 - sum(ndtr(-one) for one in apart))


def _white_places(board: Board) -> tuple[Points, Points]:
    """(n, 3) in the white about markers and about all squares, and (n, 3) from each to the edge of its stripe."""
    middles = np.array([np.mean(marker, axis=0) for marker in board.charuco.getObjPoints()])
    squares = np.full(2, board.square_mm)
    rims = _around(squares / 2, (board.square_mm - board.marker_mm) / 2, np.array(_ALONG) * 2.0)
    size = np.array(board.size_mm)
    margin = _around(size / 2 + board.margin_mm, board.margin_mm, np.linspace(-1.0, 1.0, 2 * board.columns + 1))
    middle = np.append(size / 2, 0.0)
    places = np.concatenate([*(rims[0] + one for one in middles), margin[0] + middle])
    return places, np.concatenate([*[rims[1]] * len(middles), margin[1]])


def _around(half: Points, wide: float, along: Points) -> tuple[Points, Points]:
    """Along the middle of a frame `wide` mm inside a rectangle of half sides `half` about 0; and half across it."""
    places, across = [], []
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            for part in along * (1.0 - wide / half[1 - axis]):
                place = np.zeros(3)
                place[axis], place[1 - axis] = side * (half[axis] - wide / 2), part * half[1 - axis]
                places.append(place)
                across.append(np.eye(3)[axis] * wide / 2)
    return np.array(places), np.array(across)

"""At which projector pixel each corner of a board lies, from what camera pixels about it decode to."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import LEAST_CORNERS, Board, BoardView, Points
from tankrig.calibration.gray_code import Decoded
from tankrig.calibration.stripe_blur import StripeBlur, stripe_blurs

LEAST_PIXELS = 24
MOST_SCATTER_PX = 1.0
LEAST_LIT = 0.3
_CLIPPED = 3.0
_MOST_ASIDE_PX = 0.5
"""From where a pixel's light may come beside it; beyond, what blur does is not known well enough."""


@dataclass(frozen=True, eq=False)
class LitBoard:
    """A board that camera and projector both know.

    Parameters
    ----------
    view
        Those corners of it that both know.
    projector_px
        (n, 2) x, y of each in the projector's picture.
    scatter_px
        Median over corners of the scatter of decoded pixels about them.
    lit
        Part of the corners that the camera saw and that are in the projector's light.
    slopes
        (n, 2, 2) by how much those, x and y, change from camera pixel to camera pixel, along x and y.
    stripes
        How edges of the projector's finest stripes are blurred on it.
    light
        (camera rows, camera columns) the projector's white less its black, in proportion to radiance; None where the
        camera's radiometry is not known.
    halves
        (n, 3) what comes where one half of the projector's picture is dark, see
        `tankrig.calibration.projector_halo.seen_of_halves`; none where the camera's stray light is not known.
    """

    view: BoardView
    projector_px: Points
    scatter_px: float
    lit: float
    slopes: Points
    stripes: tuple[StripeBlur, ...] = ()
    light: NDArray[np.float32] | None = None
    halves: Points = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def fault(self) -> str | None:
        """Why it should not be used, and what to do; None where it can be."""
        if len(self.projector_px) < LEAST_CORNERS or self.lit < LEAST_LIT:
            return (
                f"only {100 * self.lit:.0f} % of the corners are in the projector's light; move the board into it, "
                f"facing camera and projector, or expose longer"
            )
        return self.view.fault


def lit_corners(view: BoardView, decoded: Decoded, board: Board, light: NDArray[np.float32] | None = None) -> LitBoard:
    """Find the corners in the projector's picture.

    Parameters
    ----------
    view
        Of the board, with the projector's white.
    decoded
        Of the same placing.
    board
        What was held.
    light
        See `LitBoard`.

    Notes
    -----
    About each corner projector coordinates are a polynomial of second order in camera coordinates, as a homography with
    some distortion is to within 0.01 px over a square; fitted by least squares to all pixels within 0.6 of a square
    that are known, and once more without those beyond three standard deviations (after Moreno and Taubin 2012, who take
    local homographies). What a pixel decodes to is taken for where its light comes from, which blur moves towards the
    white: that leaves 0.005 px of error on the twin rather than 0.009.
    """
    reach = max(4, int(0.6 * _square_px(view, board)))
    seen = _seen_from(decoded, view.edge_px)
    found = [_at(x, y, decoded, seen, reach) for x, y in view.corners_px]
    known = np.array([one is not None for one in found], bool)
    kept = [one for one in found if one is not None]
    pixels = np.array([one.place for one in kept]).reshape(-1, 2)
    slopes = np.array([one.slope for one in kept]).reshape(-1, 2, 2)
    scatter = float(np.median([one.scatter for one in kept])) if kept else 0.0
    corners = replace(view, ids=view.ids[known], corners_px=view.corners_px[known])
    return LitBoard(corners, pixels, scatter, float(known.mean()), slopes, stripe_blurs(decoded), light)


class _Decoded(NamedTuple):
    """A place of the camera's picture."""

    place: Points
    """(2,) its projector pixel."""
    slope: Points
    """(2, 2) change of that along x and y of the camera."""
    scatter: float
    """Of the pixels about it."""


def _seen_from(decoded: Decoded, edge_px: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """By how much, along x and y, the light of each camera pixel comes from beside it, in pixels.

    Between white and black a blurred pixel gets more light from its white side. What it decodes to belongs to the mean
    place of its light: with a Gaussian blur of standard deviation s, the gradient of ln(light) times s² away.
    """
    if not np.isfinite(edge_px):
        none = np.zeros_like(decoded.contrast)
        return none, none
    down, across = np.gradient(decoded.contrast)
    share = np.float32(edge_px**2) / np.maximum(decoded.contrast, np.float32(1.0))
    return (across * share).astype(np.float32), (down * share).astype(np.float32)


def _at(
    x: float, y: float, decoded: Decoded, seen: tuple[NDArray[np.float32], NDArray[np.float32]], reach: int
) -> _Decoded | None:
    """What a place in the camera's picture decodes to; None where too little is known."""
    rows, columns = decoded.known.shape
    row, column = round(y), round(x)
    box = (
        slice(max(row - reach, 0), min(row + reach + 1, rows)),
        slice(max(column - reach, 0), min(column + reach + 1, columns)),
    )
    down, across = np.nonzero(decoded.known[box])
    if down.size < LEAST_PIXELS:
        return None
    dy = (down + box[0].start + seen[1][box][down, across] - y) / reach
    dx = (across + box[1].start + seen[0][box][down, across] - x) / reach
    design = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    values = np.stack([decoded.columns[box][down, across], decoded.rows[box][down, across]], axis=1).astype(float)
    within: NDArray[np.bool_] = np.hypot(seen[0][box], seen[1][box])[down, across] < _MOST_ASIDE_PX
    if within.sum() < LEAST_PIXELS:
        within = np.ones(down.size, bool)
    for _ in range(3):
        used = design[within]
        solution = np.linalg.solve(used.T @ used + 1e-9 * np.eye(6), used.T @ values[within])
        off = np.linalg.norm(values - design @ solution, axis=1)
        scatter = float(1.4826 * np.median(off[within]) / 1.1774)  # of one coordinate, from the median distance
        within = off < max(_CLIPPED * 1.5 * scatter, 0.05)
        if within.sum() < LEAST_PIXELS:
            return None
    if scatter > MOST_SCATTER_PX:
        return None
    return _Decoded(solution[0], solution[1:3].T / reach, scatter)


def _square_px(view: BoardView, board: Board) -> float:
    """Side of a square in the picture, about."""
    corners = board.corners_mm[view.ids][:, :2]
    spread_mm, spread_px = (np.sqrt(np.abs(np.linalg.det(np.cov(at.T)))) for at in (corners, view.corners_px))
    return float(board.square_mm * np.sqrt(spread_px / spread_mm))

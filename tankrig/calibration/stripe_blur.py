"""How edges of the projector's stripes are blurred on a board, part by part."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.edge_blur import Array, spreads
from tankrig.calibration.gray_code import PERIOD, Decoded

NEAR_PX = 7.0
"""From an edge of the projector's stripes, in its pixels: they are 16 wide, twice as wide as the code's places are, and
half of that is left less what tells the neighbouring edge."""
PARTS = 3
"""Of the board, along columns and along rows, in each of which edges are looked at for themselves."""
_LEAST_PIXELS = 300
_EVEN = 0.25
"""By which light about a pixel may differ where stripes are looked at: no edge of the board is near."""


@dataclass(frozen=True)
class StripeBlur:
    """Edges of the projector's finest stripes on a part of a board, as the camera sees them.

    Parameters
    ----------
    variance_px2
        Of the blur of projector and camera together, in projector pixels².
    camera_px2
        What a variance of one camera pixel² makes of that.
    lit_px, seen_px
        x, y of the part's middle in the projector's and in the camera's picture.
    along
        "columns" or "rows": which of the projector's coordinates goes across the edges.
    """

    variance_px2: float
    camera_px2: float
    lit_px: tuple[float, float] = (0.0, 0.0)
    seen_px: tuple[float, float] = (0.0, 0.0)
    along: str = "columns"


def stripe_blurs(decoded: Decoded) -> tuple[StripeBlur, ...]:
    """Of each part of a board, across columns and across rows; fewer where too little of a part is even.

    Notes
    -----
    The difference between stripes and their inverse, over that between white and black, is free of albedo and of
    ambient light, and of gamma, since only black and white are shown. Where each pixel is across the stripes, the waves
    have told.
    """
    import cv2

    light = cv2.GaussianBlur(decoded.contrast, (0, 0), 1.0)
    around = np.ones((7, 7), np.uint8)
    even = decoded.known & (cv2.dilate(light, around) - cv2.erode(light, around) < _EVEN * light)
    found: list[StripeBlur] = []
    if not even.any():
        return ()
    for along, places, stripes in (
        ("columns", decoded.columns, decoded.fine_columns),
        ("rows", decoded.rows, decoded.fine_rows),
    ):
        down, across = np.gradient(places)
        slope2 = (down**2 + across**2).astype(float)
        away, rising = _from_edges(places)
        used = even & np.isfinite(slope2) & (np.abs(away) < NEAR_PX)
        part = np.where(used, _part(decoded.columns, even) * PARTS + _part(decoded.rows, even), -1)
        for number in range(PARTS * PARTS):
            y, x = np.nonzero(part == number)
            if y.size < _LEAST_PIXELS:
                continue
            value = np.where(rising[y, x], stripes[y, x], -stripes[y, x]).astype(float)
            weight = light[y, x].astype(float)  # one over the variance of photon noise
            spread = float(spreads(away[y, x][None].astype(float), value[None], weight[None] / weight.mean(), 1.0)[0])
            if np.isfinite(spread):
                lit, seen = ((float(one.mean()), float(other.mean())) for one, other in (
                    (decoded.columns[y, x], decoded.rows[y, x]), (x, y)
                ))  # fmt: skip
                found.append(StripeBlur(spread**2, float(np.median(slope2[y, x])), lit, seen, along))
    return tuple(found)


def seen_spreads(gauss_px: Array, disc_px: Array) -> Array:
    """Standard deviations that `stripe_blurs` finds at edges blurred by a Gaussian and by an even disc.

    A lens off its focus spreads light over a disc, whose edges are no Gaussian's: the curve that is fitted to them is a
    little wider than they are. And each edge has another one 16 pixels on, to either side.

    Parameters
    ----------
    gauss_px, disc_px
        (n,) standard deviation of the one, and radius of the other, in projector pixels.

    Examples
    --------
    >>> seen_spreads(np.array([0.7, 0.7, 0.7]), np.array([0.0, 1.0, 4.0])).round(3).tolist()
    [0.7, 0.868, 2.371]
    >>> np.sqrt(0.7**2 + np.array([0.0, 1.0, 4.0]) ** 2 / 4.0).round(3).tolist()
    [0.7, 0.86, 2.119]
    """
    from scipy.special import ndtr

    angles = np.arange(1, 12) * np.pi / 12.0
    shares, moves = np.sin(angles) ** 2 / 6.0, np.cos(angles)  # a disc seen edge on
    away = np.linspace(-NEAR_PX, NEAR_PX, 57)
    value = np.zeros((gauss_px.size, away.size))
    for number in (-2, -1, 0, 1, 2):
        from_edge = away[None, :, None] - PERIOD * number - disc_px[:, None, None] * moves
        value += (-1.0) ** number * (ndtr(from_edge / gauss_px[:, None, None]) @ shares)
    away = np.broadcast_to(away, value.shape)
    return spreads(away, value, np.ones_like(value), 1.0)


def _part(places: NDArray[np.float32], used: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Which of `PARTS` equal parts of the range of places each lies in."""
    low, high = np.quantile(places[used], (0.01, 0.99))
    share = np.nan_to_num((places - low) / max(float(high - low), 1e-6))
    return np.asarray(np.clip((share * PARTS).astype(np.int64), 0, PARTS - 1), np.int64)


def _from_edges(places: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Distance from the nearest edge of the finest stripes, in projector pixels, and whether light begins there.

    The last bit of a Gray code changes at every second edge of stripes: half a period from the left, and then every
    period, to light and to dark in turn.
    """
    place = places + np.float32(0.5)
    number = np.rint(place / np.float32(PERIOD) - np.float32(0.5))
    rising: NDArray[np.bool_] = np.nan_to_num(number) % 2 == 0
    return place - np.float32(PERIOD) * (number + np.float32(0.5)), rising

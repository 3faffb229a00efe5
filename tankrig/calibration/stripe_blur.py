"""How edges of the projector's stripes are blurred on a board."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.edge_blur import spreads
from tankrig.calibration.gray_code import PERIOD, Decoded

_NEAR_PX = 4.0
"""From an edge of the projector's stripes, in its pixels: half of what the narrowest is wide."""
_LEAST_PIXELS = 400
_EVEN = 0.25
"""By which light about a pixel may differ where stripes are looked at: no edge of the board is near."""


@dataclass(frozen=True)
class StripeBlur:
    """Edges of the projector's finest stripes on a board, as the camera sees them.

    Parameters
    ----------
    variance_px2
        Of the blur of projector and camera together, in projector pixels².
    camera_px2
        What a variance of one camera pixel² makes of that.
    """

    variance_px2: float
    camera_px2: float


def stripe_blurs(decoded: Decoded) -> tuple[StripeBlur, ...]:
    """Of columns and of rows; fewer where too little of the board is even.

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
    found = []
    for places, stripes in ((decoded.columns, decoded.fine_columns), (decoded.rows, decoded.fine_rows)):
        down, across = np.gradient(places)
        slope2 = (down**2 + across**2).astype(float)
        away, rising = _from_edges(places)
        used = even & np.isfinite(slope2) & (np.abs(away) < _NEAR_PX)
        if used.sum() < _LEAST_PIXELS:
            continue
        value = np.where(rising, stripes, -stripes)[used].astype(float)
        weight = light[used].astype(float)  # one over the variance of photon noise
        spread = float(spreads(away[used][None].astype(float), value[None], weight[None] / weight.mean(), 1.0)[0])
        if np.isfinite(spread):
            found.append(StripeBlur(spread**2, float(np.median(slope2[used]))))
    return tuple(found)


def _from_edges(places: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Distance from the nearest edge of the finest stripes, in projector pixels, and whether light begins there.

    The last bit of a Gray code changes at every second edge of stripes: half a period from the left, and then every
    period, to light and to dark in turn.
    """
    place = places + np.float32(0.5)
    number = np.rint(place / np.float32(PERIOD) - np.float32(0.5))
    rising: NDArray[np.bool_] = np.nan_to_num(number) % 2 == 0
    return place - np.float32(PERIOD) * (number + np.float32(0.5)), rising

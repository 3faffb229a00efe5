"""How much light a projector's levels make, and the level that makes a wanted part of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.exposed import Array
from tankrig.errors import ImageError
from tankrig.pattern.wall import fractions_of_white

LEVELS = (*range(16), *range(16, 64, 4), *range(64, 255, 8), 255)
"""Levels to measure: dense where the curve is steep in relative terms."""
_STRAIGHTENED = 1.0 / 2.2


@dataclass(frozen=True, eq=False)
class Response:
    """Light of the levels 0 … 255 above that of level 0, as parts of level 255's.

    Parameters
    ----------
    curve, curve_sd
        (256,); rises from 0 to 1. What rounding has put outside of that is taken back.
    leak
        Light at level 0, as a part of level 255's.

    Raises
    ------
    SequenceError
        When the curve leaves 0 … 1 by more than rounding, or has not 256 values.

    Examples
    --------
    >>> square = Response((np.arange(256) / 255.0) ** 2, np.zeros(256), 0.0)
    >>> square.levels_for(np.array([0.0, 0.25, 1.0])).tolist()
    [0, 127, 255]
    """

    curve: Array
    curve_sd: Array
    leak: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "curve", fractions_of_white(self.curve))

    def levels_for(self, wanted: Array) -> NDArray[np.uint8]:
        """The levels that come nearest to the `wanted` parts of the light of level 255: the inverse of the curve."""
        above = np.clip(np.searchsorted(self.curve, wanted), 1, 255)
        nearer = wanted - self.curve[above - 1] < self.curve[above] - wanted
        return np.where(nearer, above - 1, above).astype(np.uint8)

    def gamma(self) -> float:
        """Exponent of the power law that fits best, from level 16 up; for people."""
        levels = np.arange(16, 255)
        x = np.log(levels / 255.0)
        return float(x @ np.log(np.maximum(self.curve[16:255], 1e-9)) / (x @ x))


def fit_response(levels: Sequence[int], radiance: Sequence[float], sd: Sequence[float]) -> Response:
    """Fit the light of some levels: never falling, and smooth between them.

    Isotonic regression, weighted; then a monotone cubic (PCHIP) through its 2.2th root, which is nearly straight for
    displays.

    Parameters
    ----------
    levels
        That were measured, 0 and 255 among them.
    radiance, sd
        Of each, and its standard deviation.

    Raises
    ------
    ImageError
        When 0 or 255 is missing, fewer than 17 levels were measured, or the light does not rise with the level.

    Examples
    --------
    >>> fit = fit_response(LEVELS, [5.0 * (level / 255.0) ** 2.2 + 0.01 for level in LEVELS], [1e-6] * len(LEVELS))
    >>> round(fit.gamma(), 3), round(fit.leak, 4)
    (2.2, 0.002)
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.optimize import isotonic_regression

    order = np.argsort(levels)
    at, light = np.asarray(levels)[order], np.asarray(radiance, float)[order]
    spread = np.maximum(np.asarray(sd, float)[order], 1e-12 * np.abs(light).max())
    if len(at) < 17 or at[0] != 0 or at[-1] != 255:
        raise ImageError(f"{len(at)} levels from {at[0]} to {at[-1]} were measured; take 17 and more, 0 and 255 too")
    rising = isotonic_regression(light, weights=1.0 / spread**2).x
    full = rising[-1] - rising[0]
    if not full > 10.0 * float(np.hypot(spread[0], spread[-1])):
        raise ImageError(
            "the camera sees no more light at level 255 than at level 0; put the projector's light before it"
        )
    fallen = np.abs(rising - light) > 5.0 * spread + 0.01 * full
    if fallen.any():
        raise ImageError(
            f"the light does not rise with the level at {at[fallen][0]}; switch the projector's dynamic contrast, lamp "
            f"saving and colour modes off, and keep other light out"
        )
    parts = (rising - rising[0]) / full
    curve = PchipInterpolator(at, parts**_STRAIGHTENED)(np.arange(256)) ** (1.0 / _STRAIGHTENED)
    curve[[0, -1]] = 0.0, 1.0  # by what they are parts of, whatever the powers round to
    shares = np.stack([spread, parts * spread[-1], (1.0 - parts) * spread[0]])  # brightest and darkest are in all
    relative = np.sqrt((shares**2).sum(axis=0)) / full
    return Response(np.maximum.accumulate(curve), np.interp(np.arange(256), at, relative), float(rising[0] / full))

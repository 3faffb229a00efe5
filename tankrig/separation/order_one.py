"""Order 1 without a model of the liquid: what follows waves of several periods, carried on to a period of 0.

Light that was scattered twice leaves the wave's line on its way, so that it follows a wave of period P the less the
shorter P is: its share falls as P¹ (its spread across the line, seen from above, is logarithmic at small distances),
that of order 3 faster. Order 1 follows every wave. So

    A(P) = Re(M(P) / T(P)) = I₁ + b P − c P²,    b, c ≥ 0

with b, c that vary smoothly over the picture, as light of higher orders does. They are found from blurred pictures, and
I₁ from all periods without blurring. What the curve adds to a straight line through the two finest periods counts as
uncertain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.separation.transfer import Transfer
from tankrig.separation.waves import Array, Waves

SMOOTH_PIXELS = 4.0
"""Standard deviation of the blur along the picture's rows with which b and c are found; half of it across them."""
UNSURE = 0.5
"""Share of what the curve adds that counts as a standard deviation."""
UNSURE_HIGHER = 0.1
"""The same of what is taken off the finest wave as scattered more often."""
POOLED = 4.0 * np.pi * SMOOTH_PIXELS * (0.5 * SMOOTH_PIXELS)
"""Pixels that a blurred one is the mean of, as far as their noise goes."""
BESIDE = 0.15
"""Turns by which waves may lie beside where the geometry says before it is said."""


@dataclass(frozen=True, eq=False)
class OrderOne:
    """Order 1 of a sheet of light, measured.

    Parameters
    ----------
    image
        (rows, columns), in the unit of the pictures; NaN where it cannot be told.
    noise, model
        (rows, columns) standard deviations: by noise, different in each pixel, and by carrying on to period 0, alike in
        neighbours.
    beside
        Turns by which the waves lie beside where the geometry says, in the median; of each period.
    """

    image: Array
    noise: Array
    model: Array
    beside: tuple[float, ...]

    @property
    def sd(self) -> Array:
        """(rows, columns) standard deviation."""
        return np.asarray(np.hypot(self.noise, self.model))

    @property
    def known(self) -> NDArray[np.bool_]:
        """(rows, columns) where it can be told."""
        return np.isfinite(self.image)

    @property
    def doubt(self) -> str:
        """A sentence where the waves are not where the calibration has them; else empty."""
        worst = max(self.beside, key=abs)
        if abs(worst) <= BESIDE:
            return ""
        return f"the waves lie {100.0 * abs(worst):.0f} % of a period beside where the geometry says; calibrate it anew"


def order_one(waves: Sequence[Waves], transfers: Sequence[Transfer]) -> OrderOne:
    """Order 1 of a sheet from waves of two periods or more.

    Parameters
    ----------
    waves
        Of each period.
    transfers
        Of the same.

    Raises
    ------
    ImageError
        With fewer than two periods, or where nothing of the sheet is seen with the finest two.
    """
    if len(waves) < 2 or len(waves) != len(transfers):
        raise ImageError("order 1 needs waves of two periods or more; give periods_mm two or three, such as 8, 16, 32")
    order = np.argsort([one.wave.period_mm for one in transfers])
    waves, transfers = [waves[i] for i in order], [transfers[i] for i in order]
    periods = np.array([one.wave.period_mm for one in transfers])
    known = np.all([one.seen for one in transfers], axis=0)
    if not known.any():
        raise ImageError("nothing of the sheet is seen with all of its waves; make the finest one longer")
    followed, sd, beside = [], [], []
    for one, transfer in zip(waves, transfers, strict=True):
        quotient = np.where(known, one.wave / np.where(known, transfer.factor, 1.0), 0.0)
        weight = np.where(known, np.abs(transfer.factor) ** 2 / np.maximum(one.wave_sd, 1e-300) ** 2, 0.0)
        turn = np.angle(_smooth(quotient.real, weight) + 1j * _smooth(quotient.imag, weight))
        followed.append(np.real(quotient * np.exp(-1j * turn)))
        sd.append(np.where(known, one.wave_sd / np.where(known, np.abs(transfer.factor), 1.0), 0.0))
        beside.append(float(np.median(turn[known])) / (2.0 * np.pi))
    amounts, spread = np.stack(followed), np.stack(sd)
    weights = known / np.square(np.maximum(spread, 1e-3 * spread.max()))
    smooth = np.stack([_smooth(one, weight) for one, weight in zip(amounts, weights, strict=True)])
    to_zero = _to_zero(periods)
    curved = np.tensordot(to_zero, smooth, 1)
    straight = np.tensordot(np.pad(_to_zero(periods[:2]), (0, len(periods) - 2)), smooth, 1)
    # Pixel by pixel, each period tells order 1 when what the smooth curve says of the higher ones is taken off.
    higher = smooth - curved
    image = np.sum(weights * (amounts - higher), axis=0) / np.maximum(weights.sum(axis=0), 1e-300)
    # Of the weighted mean, and of the smooth curve, which is known from many pixels.
    noise = np.sqrt(1.0 / np.maximum(weights.sum(axis=0), 1e-300) + np.tensordot(to_zero**2, spread**2, 1) / POOLED)
    model = UNSURE * np.abs(curved - straight) + UNSURE_HIGHER * np.abs(smooth[0] - curved)
    return OrderOne(*(np.where(known, one, np.nan) for one in (image, noise, model)), tuple(beside))


def _to_zero(periods: Array) -> Array:
    """(periods,) weights of the amounts in what a straight line, or with three periods a parabola, says of period 0."""
    powers = np.vander(periods, min(len(periods), 3), increasing=True)
    return np.asarray(np.linalg.pinv(powers)[0])


def _smooth(image: Array, weight: Array) -> Array:
    """Weighted mean about each pixel, of pixels with any weight."""
    sigma = {"sigmaX": SMOOTH_PIXELS, "sigmaY": 0.5 * SMOOTH_PIXELS, "borderType": cv2.BORDER_CONSTANT}
    scale = 1.0 / max(float(weight.max()), 1e-300)
    total = cv2.GaussianBlur(image * weight * scale, (0, 0), **sigma)
    return np.asarray(total / np.maximum(cv2.GaussianBlur(weight * scale, (0, 0), **sigma), 1e-300))

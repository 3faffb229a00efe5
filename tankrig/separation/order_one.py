"""Order 1 without a model of the liquid: what follows waves of several periods, carried on to a period of 0.

Light that was scattered twice leaves the wave's line on its way, so that it follows a wave of period P the less the
shorter P is: about in proportion to P, and light of higher orders to higher powers. Order 1 follows every wave. So

    A(P) = Re(M(P) / T(P)) = I₁ + b P^q

of which the finest two waves tell I₁ and b. That q is 1.25 ± 0.2 there is what an independent program says of thin,
medium and thick ink (decision 233); that ± is the uncertainty which is told. Finding q from a third wave was tried: its
noise did more harm than its news good.

Beyond the sheet's edge there is no wave, so that near it higher orders follow with another phase: their part turns
against the wave's own once in a period, and a mean over one period along y has none of it. So I₁ is known pixel by
pixel along x, and over one period of the finest wave along y.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tankrig.errors import ImageError
from tankrig.separation.transfer import Transfer
from tankrig.separation.waves import Array, Mask, Waves

SMOOTH_PIXELS = 4.0
"""Standard deviation of the blur along x with which what higher orders add is found."""
WHOLE = 0.95
"""Of a period along y that has to be lit about a pixel."""
POWER, POWER_SD = 1.25, 0.2
"""q, and its standard deviation."""
POOLED = 2.0 * np.sqrt(np.pi) * SMOOTH_PIXELS
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
        (rows, columns) standard deviations: by noise, see `alike`, and by carrying on to period 0, alike in all
        neighbours.
    alike
        How many pixels' noise is as good as one: each is a mean along y, and in part along x.
    beside
        Turns by which the waves lie beside where the geometry says, in the median; of each period.
    """

    image: Array
    noise: Array
    model: Array
    alike: float
    beside: tuple[float, ...]

    @property
    def sd(self) -> Array:
        """(rows, columns) standard deviation."""
        return np.asarray(np.hypot(self.noise, self.model))

    @property
    def known(self) -> Mask:
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
        raise ImageError("order 1 needs waves of two periods or more; give periods_mm two, such as 4, 8")
    order = np.argsort([one.wave.period_mm for one in transfers])[:2]  # the finest
    waves, transfers = [waves[i] for i in order], [transfers[i] for i in order]
    longer = transfers[1].wave.period_mm / transfers[0].wave.period_mm
    seen = np.all([one.seen for one in transfers], axis=0)
    rows = [_rows(one) for one in transfers]
    known = seen & (_mean_along_y(seen.astype(float), rows[0]) > WHOLE)
    if not known.any():
        raise ImageError("nothing of the sheet is seen with all of its waves; make the finest one longer")
    amounts, spread, beside = [], [], []
    for one, transfer, count in zip(waves, transfers, rows, strict=True):
        quotient = np.where(seen, one.wave / np.where(seen, transfer.factor, 1.0), 0.0)
        sd = np.where(seen, one.wave_sd / np.where(seen, np.abs(transfer.factor), 1.0), 0.0)
        weight = np.where(seen, 1.0 / np.square(np.maximum(sd, 1e-3 * sd.max() + 1e-300)), 0.0)
        many = np.maximum(_mean_along_y(weight, count), 1e-300)
        mean = (_mean_along_y(quotient.real * weight, count) + 1j * _mean_along_y(quotient.imag * weight, count)) / many
        turn = np.angle(_smooth(mean.real, seen) + 1j * _smooth(mean.imag, seen))
        amounts.append(np.real(mean * np.exp(-1j * turn)))
        spread.append(1.0 / np.sqrt(np.maximum(count * many, 1e-300)))
        beside.append(float(np.median(turn[known])) / (2.0 * np.pi))
    smooth = [_smooth(one, seen) for one in amounts]
    at_zero, lower, upper = (
        smooth[0] - (smooth[1] - smooth[0]) * _reach(longer, power)
        for power in (POWER, POWER - POWER_SD, POWER + POWER_SD)
    )
    # Pixel by pixel along x, both waves tell order 1 when what the smooth curve says of higher orders is taken off.
    weights = 1.0 / np.square(spread)
    rough = np.sum([weight * (one - mean) for weight, one, mean in zip(weights, amounts, smooth, strict=True)], axis=0)
    reach = _reach(longer, POWER)
    by_curve = (1.0 + reach) ** 2 * spread[0] ** 2 + reach**2 * spread[1] ** 2
    by_pixel = 1.0 / weights.sum(axis=0)
    noise = np.sqrt(by_pixel + by_curve / POOLED)
    alike = rows[0] * float(((by_pixel + by_curve) / np.square(noise))[known].mean())
    image, noise, model = (
        np.where(known, one, np.nan) for one in (at_zero + rough * by_pixel, noise, 0.5 * np.abs(upper - lower))
    )
    return OrderOne(image, noise, model, alike, tuple(beside))


def _reach(longer: float, power: float) -> float:
    """How far period 0 is beyond the finest of two waves, in steps from one to the next, `longer` times as long."""
    return float(1.0 / (longer**power - 1.0))


def _rows(transfer: Transfer) -> int:
    """Of pixels in a period of the wave, in the picture."""
    turn = abs(float(np.angle(np.sum(transfer.factor[1:] * np.conj(transfer.factor[:-1])))))
    return max(1, round(2.0 * np.pi / max(turn, 2.0 * np.pi / len(transfer.factor))))


def _mean_along_y(image: Array, rows: int) -> Array:
    """Mean over `rows` rows about each pixel, of nothing beyond the picture; if they are even, the ends count half."""
    ends = np.ones(rows + 1 - rows % 2)
    if rows % 2 == 0:
        ends[[0, -1]] = 0.5
    return np.asarray(cv2.filter2D(image, -1, ends[:, None] / rows, borderType=cv2.BORDER_CONSTANT))


def _smooth(image: Array, counts: Mask) -> Array:
    """Mean about each pixel along x, of pixels that count."""
    weight = counts.astype(float)
    return np.asarray(_blurred(image * weight) / np.maximum(_blurred(weight), 1e-300))


def _blurred(image: Array) -> Array:
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), sigmaX=SMOOTH_PIXELS, sigmaY=1e-6, borderType=cv2.BORDER_CONSTANT)
    )

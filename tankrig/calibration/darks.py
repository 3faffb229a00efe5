"""What a camera counts in the dark: level, dark current, read noise, hot pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.exposed import Array, Exposed
from tankrig.errors import ImageError

_LIT = 0.05
"""Part of the way to saturation: a dark with more than this is not dark."""
_HOT = 8.0
"""Standard deviations from the median by which a pixel is hot."""


@dataclass(frozen=True, eq=False)
class Dark:
    """A camera at one gain, in the dark: counts = level + rate · exposure.

    Parameters
    ----------
    level, rate
        (rows, columns) counts without exposure, and counts per ms.
    hot
        (rows, columns) pixels whose level or rate stands out.
    read_variance, read_variance_sd
        Of pixels that are not hot, from frame to frame, at no exposure; counts², rounding included.
    level_sd, rate_sd
        Of one pixel's level and rate.
    """

    level: Array
    rate: Array
    hot: NDArray[np.bool_]
    read_variance: float
    read_variance_sd: float
    level_sd: float
    rate_sd: float

    def at(self, exposure_ms: float) -> Array:
        """(rows, columns) counts in the dark at an exposure."""
        return self.level + self.rate * exposure_ms


def fit_darks(darks: Sequence[Exposed], saturation: int) -> Dark:
    """Fit dark frames of several exposures, pixel by pixel.

    Weighted least squares of a straight line in the exposure; the variance in time is a straight line, too, whose value
    at no exposure is the read noise.

    Parameters
    ----------
    darks
        Of at least two exposures.
    saturation
        The camera's highest count.

    Raises
    ------
    ImageError
        When they are of a single exposure, or not dark.
    """
    times = np.array([dark.exposure_ms for dark in darks])
    if len(set(times.tolist())) < 2:
        raise ImageError("darks of a single exposure tell no dark current; take some at the longest exposure as well")
    lit = max(float(np.median(dark.mean)) for dark in darks) / saturation
    if lit > _LIT + float(np.median(darks[int(times.argmin())].mean)) / saturation or lit > 0.5:
        raise ImageError(f"the darks reach {lit:.0%} of saturation; cap the lens, and darken the room")
    variances = np.array([float(np.median(dark.variance)) for dark in darks])
    counts = np.array([dark.frames for dark in darks], float)
    weights = counts / np.maximum(variances, 1e-3)
    inverse = np.linalg.inv(_normal(times, weights))
    means = np.stack([dark.mean for dark in darks])
    sums = np.stack([np.tensordot(weights, means, 1), np.tensordot(weights * times, means, 1)])
    level, rate = np.tensordot(inverse, sums, 1)
    level_sd, rate_sd = np.sqrt(np.diag(inverse)).tolist()
    hot = _stands_out(rate, rate_sd) | _stands_out(level, level_sd)
    read, read_sd = _read_variance(darks, ~hot)
    return Dark(level, rate, hot, read, read_sd, level_sd, rate_sd)


def _normal(times: Array, weights: Array) -> Array:
    first = float(np.sum(weights * times))
    return np.array([[float(np.sum(weights)), first], [first, float(np.sum(weights * times**2))]])


def _stands_out(values: Array, sd: float) -> NDArray[np.bool_]:
    middle = np.median(values)
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    return np.asarray(np.abs(values - middle) > _HOT * max(spread, sd))


def _read_variance(darks: Sequence[Exposed], good: NDArray[np.bool_]) -> tuple[float, float]:
    """Value at no exposure of the straight line through the variances, and its standard deviation."""
    times = np.array([dark.exposure_ms for dark in darks])
    variances = np.array([float(dark.variance[good].mean()) for dark in darks])
    freedom = np.array([(dark.frames - 1) * int(good.sum()) for dark in darks], float)
    inverse = np.linalg.inv(_normal(times, freedom / (2.0 * variances**2)))
    sums = freedom / (2.0 * variances**2) * variances
    read = inverse @ np.array([float(sums.sum()), float((sums * times).sum())])
    return float(read[0]), float(np.sqrt(inverse[0, 0]))

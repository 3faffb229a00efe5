"""What a prediction states about its error, as a fit counts it."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.prediction import Prediction

Image = NDArray[np.floating]

COARSE, FINE = 0.05, 0.01
"""Tolerance of cheap and of accurate images."""
ERROR_PIXELS = 4.0
"""Standard deviation of the Gaussian over which a stated noise is averaged."""


def stated_error(prediction: Prediction) -> float:
    """What a prediction says about its error, relative L2 of the image: noise, and what it left out with a bound."""
    size = float(np.linalg.norm(prediction.image))
    return float(np.linalg.norm(error_map(prediction))) / size if size > 0.0 else 0.0


def error_map(prediction: Prediction) -> NDArray[np.float64]:
    """The same by pixel, W/mm²/sr: the noise where it is, what was left out in proportion to the image.

    The stated noise is averaged over a few pixels: from few batches of paths it is itself noisy, and a pixel that
    seems free of noise would get a weight it has not earned.
    """
    from scipy.ndimage import gaussian_filter

    left_out = math.hypot(*(part.bound for part in prediction.skipped if math.isfinite(part.bound)))
    error: NDArray[np.float64] = left_out * np.abs(np.asarray(prediction.image, float))
    if prediction.stderr is None:
        return error
    variance: NDArray[np.float64] = gaussian_filter(np.square(np.asarray(prediction.stderr, float)), ERROR_PIXELS)
    whole: NDArray[np.float64] = np.hypot(error, np.sqrt(variance))
    return whole


def smooth_error_map(prediction: Prediction) -> NDArray[np.float64]:
    """The same without the noise whose patterns are known."""
    if prediction.patterns is None or prediction.stderr is None:
        return error_map(prediction)
    known = np.sum(np.square(np.asarray(prediction.patterns, float)), axis=0)
    rest = np.sqrt(np.maximum(np.square(np.asarray(prediction.stderr, float)) - known, 0.0))
    return error_map(replace(prediction, stderr=rest))


def counted_error(prediction: Prediction, gain: float) -> Image:
    """The model's error by pixel in units of the image, which no pixel has more of than of a coarse image."""
    error: Image = abs(gain) * np.minimum(error_map(prediction), COARSE * np.abs(prediction.image).max())
    return error

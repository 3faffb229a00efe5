"""One picture of more range than a frame has: exposure brackets, merged from raw frames by their variance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.exposed import Array
from tankrig.calibration.radiometry import Radiometry
from tankrig.devices import CameraSettings, Pixels
from tankrig.errors import ImageError

_FADE = (0.75, 0.92)
"""Parts of full between which a frame fades out of the mean, so that no edge shows where it ends."""


@dataclass(frozen=True, eq=False)
class Merged:
    """A picture of many exposures.

    Parameters
    ----------
    image, sd
        (rows, columns) linear counts per ms at gain 1, and their standard deviation; infinite where every frame is
        saturated.
    steps, steps_sd
        From each exposure to the next longer one: by how much of its value the picture would jump where one takes over
        from the other; NaN where no pixel is in both.
    """

    image: Array
    sd: Array
    steps: tuple[float, ...]
    steps_sd: tuple[float, ...]

    @property
    def decades(self) -> float:
        """Range between the brightest pixel and the standard deviation of the darkest, log 10."""
        known = np.isfinite(self.sd)
        return float(np.log10(self.image[known].max() / self.sd[known].min()))


def merge(frames: Sequence[tuple[Pixels, CameraSettings]], radiometry: Radiometry) -> Merged:
    """Merge raw frames of one scene taken with different exposures or gains.

    The weight of a pixel of a frame is 1/variance, with the variance (photons and reading out) that the merged value
    predicts for it: weights taken from the noisy counts themselves would favour those that came out low.

    Parameters
    ----------
    frames
        With their settings, as read back.
    radiometry
        Of the camera.

    Raises
    ------
    ImageError
        When there are no frames.
    StoreError
        When the camera was not calibrated at one of the gains.
    """
    if not frames:
        raise ImageError("there are no frames to merge; take at least one")
    ordered = sorted(frames, key=lambda one: one[1].exposure_ms * one[1].gain)
    values = np.stack([radiometry.light(pixels, settings) for pixels, settings in ordered]).astype(float)
    full = np.stack([radiometry.saturated(pixels, settings) | radiometry.hot for pixels, settings in ordered])
    image = _first_guess(values, full, np.array([s.exposure_ms * s.gain for _, s in ordered]))
    variances = np.empty_like(values)
    for _ in range(3):
        weights = np.zeros_like(values)
        for number, (_, settings) in enumerate(ordered):
            variances[number] = radiometry.variance(image, settings)
            fade = np.interp(radiometry.filled(image, settings), _FADE, (1.0, 0.0))
            weights[number] = np.where(full[number], 0.0, np.maximum(fade, 1e-6) / variances[number])
        total = weights.sum(axis=0)
        image = np.where(total > 0.0, (weights * values).sum(axis=0) / np.maximum(total, 1e-300), values[0])
    spread = np.sqrt((weights**2 * variances).sum(axis=0)) / np.maximum(total, 1e-300)
    sd = np.where(total > 0.0, spread, np.inf)
    jumps = [_step(values[n : n + 2], variances[n : n + 2], full[n + 1], image) for n in range(len(ordered) - 1)]
    image, sd = radiometry.mended(image), np.where(radiometry.hot, radiometry.mended(sd), sd)
    return Merged(image, sd, tuple(jump for jump, _ in jumps), tuple(spread for _, spread in jumps))


def _first_guess(values: Array, full: NDArray[np.bool_], exposures: Array) -> Array:
    """Weighted by exposure, which needs no guess."""
    weights = np.where(full, 0.0, exposures[:, None, None])
    weights[0] = np.maximum(weights[0], 1e-9)
    guess: Array = (weights * values).sum(axis=0) / weights.sum(axis=0)
    return guess


def _step(values: Array, variances: Array, full: NDArray[np.bool_], image: Array) -> tuple[float, float]:
    """Relative difference of two frames where both see well: (shorter − longer) / value, and its standard deviation."""
    noise = np.sqrt(variances.sum(axis=0))
    both = ~full & (image > 20.0 * np.sqrt(variances[0]))
    if not both.any():
        return float("nan"), float("nan")
    relative, sd = ((values[0] - values[1]) / image)[both], (noise / image)[both]
    weights = 1.0 / sd**2
    return float((weights * relative).sum() / weights.sum()), float(1.0 / np.sqrt(weights.sum()))

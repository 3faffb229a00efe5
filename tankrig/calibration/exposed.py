"""Frames of one setting, boiled down to what calibration needs of them: their mean and their variance in time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.devices import Pixels
from tankrig.errors import ImageError

Array = NDArray[np.float64]

MOST_SATURATED = 1e-3
"""Part of the pixels."""


@dataclass(frozen=True, eq=False)
class Exposed:
    """What frames with the same settings, of the same steady light, have in common.

    Parameters
    ----------
    exposure_ms
        Of each.
    frames
        How many.
    mean, variance
        (rows, columns) counts, and their variance from frame to frame, counts².
    saturated
        Part of the good pixels that were saturated in any of them.
    """

    exposure_ms: float
    frames: int
    mean: Array
    variance: Array
    saturated: float

    def above(self, dark: Array) -> "Exposed":
        """The same with a (rows, columns) dark subtracted from the mean."""
        return Exposed(self.exposure_ms, self.frames, self.mean - dark, self.variance, self.saturated)


def exposed(
    frames: Sequence[Pixels],
    exposure_ms: float,
    saturation: int,
    black: float | Array = 0.0,
    good: NDArray[np.bool_] | None = None,
) -> Exposed:
    """Mean and variance of at least two frames.

    Flicker of the light, which brightens or darkens a whole frame, is taken out of the variance: each frame is scaled
    to the mean of all, counted from `black`.

    Parameters
    ----------
    frames
        (rows, columns) counts each.
    exposure_ms
        Theirs.
    saturation
        The count at which pixels saturate.
    black
        Counts without light; a number or (rows, columns). None of the light is taken to flicker where it is 0.
    good
        (rows, columns) pixels among which the saturated ones are counted; all where None.

    Raises
    ------
    ImageError
        When there are fewer than two frames, or their shapes differ.

    Examples
    --------
    >>> found = exposed([np.full((2, 2), 10, np.uint8), np.full((2, 2), 12, np.uint8)], 5.0, 255)
    >>> float(found.mean[0, 0]), float(found.variance[0, 0]), found.saturated
    (11.0, 2.0, 0.0)
    """
    if len(frames) < 2 or len({frame.shape for frame in frames}) > 1:
        raise ImageError(f"{len(frames)} frames of shapes {sorted({frame.shape for frame in frames})}; give two alike")
    stack = np.stack(frames).astype(float)
    mean: Array = stack.mean(axis=0)
    full = np.stack(frames).max(axis=0) >= saturation
    saturated = float((full if good is None else full[good]).mean())
    light = stack.mean(axis=(1, 2)) - np.mean(black)
    if np.any(black) and light.min() > 0.2 * light.max():
        stack = black + (stack - black) * (light.mean() / light)[:, None, None]
    return Exposed(exposure_ms, len(frames), mean, stack.var(axis=0, ddof=1), saturated)

"""Has the ink mixed? Pictures say so: what still changes decays towards nothing."""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tankrig.devices import Pixels

_BLOCKS = 16
"""Blocks along the longer side of a picture; their means have little noise and see what mixes last, which is large."""

_FEWEST = 6
_MOST = 400
_SIGMAS = 3.0


@dataclass(frozen=True)
class Mixing:
    """What the pictures say so far.

    Parameters
    ----------
    remaining
        Upper bound (3 standard deviations) on what is still to change, as a part of the picture (root mean square of
        the change over that of the picture); infinite while there are too few pictures.
    time_scale_s
        Time in which the structure falls to 1/e; None where none was seen above the noise.
    seconds
        For how long it has been looked at.
    pictures
        How many of them.
    """

    remaining: float = np.inf
    time_scale_s: float | None = None
    seconds: float = 0.0
    pictures: int = 0


class MixingWatch:
    """Follows pictures of the tank and estimates how far they are from the last one there will ever be.

    To block means b(t) of the later half of the pictures it fits b(t) = b∞ + a·exp(−t/τ), with one τ for all blocks
    (variable projection: for each τ of a grid, b∞ and a are linear). What remains is ‖a‖·exp(−t/τ), for the worst τ
    that the noise allows; so slow mixing does not pass for none.

    Examples
    --------
    >>> watch = MixingWatch()
    >>> plume = np.outer(np.hanning(64), np.hanning(64))
    >>> for t in np.arange(0.0, 8.0, 0.5):
    ...     mixing = watch.look((1000 + 500 * plume * np.exp(-t / 2.0)).astype(np.uint16), t)
    >>> round(mixing.time_scale_s)
    2
    """

    def __init__(self) -> None:
        self._pictures: deque[tuple[float, NDArray[np.float64]]] = deque(maxlen=_MOST)
        self._time_scale_s: float | None = None
        self._start_s = 0.0
        self._count = 0

    def look(self, pixels: Pixels, time_s: float) -> Mixing:
        """Take another picture into account.

        Parameters
        ----------
        pixels
            (rows, columns) counts.
        time_s
            When it was taken; rises from call to call.
        """
        if not self._count:
            self._start_s = time_s
        self._count += 1
        self._pictures.append((time_s, _blocks(pixels)))
        half = time_s - (time_s - self._start_s) / 2
        late = [(t, picture) for t, picture in self._pictures if t >= half]
        late = late if len(late) >= _FEWEST else list(self._pictures)[-_FEWEST:]
        remaining = np.inf
        if len(late) >= _FEWEST:
            remaining, time_scale_s = _still_to_change(
                np.array([t for t, _ in late]) - time_s, np.array([picture for _, picture in late])
            )
            self._time_scale_s = time_scale_s or self._time_scale_s
        return Mixing(remaining, self._time_scale_s, time_s - self._start_s, self._count)


def _blocks(pixels: Pixels) -> NDArray[np.float64]:
    rows, columns = pixels.shape
    scale = min(1.0, _BLOCKS / max(rows, columns))
    size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    blocks: NDArray[np.float64] = cv2.resize(pixels.astype(np.float64), size, interpolation=cv2.INTER_AREA).ravel()
    return blocks


def _still_to_change(times_s: NDArray[np.float64], pictures: NDArray[np.float64]) -> tuple[float, float | None]:
    """Bound on the remaining change and its time scale, from pictures (count, blocks) at times that end at 0."""
    count, blocks = pictures.shape
    span_s = times_s[-1] - times_s[0]
    taus_s = span_s * np.geomspace(0.05, 4.0, 40)
    mean = pictures.mean(axis=0)
    centred = pictures - mean
    decays = np.exp(-times_s / taus_s[:, None])  # 1 now, more before
    shapes = decays - decays.mean(axis=1, keepdims=True)
    power = (shapes**2).sum(axis=1)
    amplitudes = shapes @ centred / power[:, None]  # (taus, blocks): what is to change from now on
    lost = (centred**2).sum() - power * (amplitudes**2).sum(axis=1)
    best = int(np.argmin(lost))
    noise2 = max(float(lost[best]) / (blocks * (count - 2)), 1e-12)  # never below rounding
    seen2 = (amplitudes**2).mean(axis=1)
    own2 = noise2 / power  # what noise alone puts into seen2
    bound2 = np.maximum(seen2 - own2, 0.0) + _SIGMAS * own2 * np.sqrt(2.0 / blocks)
    # Each τ fits an amplitude per block, so noise alone moves the loss from τ to τ by √(2·blocks) of its variance.
    allowed = lost <= lost[best] + noise2 * _SIGMAS * np.sqrt(2.0 * blocks)
    picture2 = ((mean - mean.min()) ** 2).mean()
    significant = seen2[best] > own2[best] * (1.0 + 2 * _SIGMAS * np.sqrt(2.0 / blocks))
    remaining = float(np.sqrt(bound2[allowed].max() / picture2)) if picture2 > 0.0 else np.inf
    return remaining, float(taus_s[best]) if significant else None

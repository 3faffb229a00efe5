"""How much light a projector's lens spreads widely: by halves of its picture, on boards that stand in it.

Each half of the picture is thrown by itself. What comes where the other half is dark, over what white makes there, is
free of the board's albedo: the projector's halo, once what the camera's own lens spreads is taken off, which
`tankrig calibrate stray` has measured in the light of a lamp.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.file import Calibration
from tankrig.calibration.gray_code import Decoded
from tankrig.geometry.shading import shading
from tankrig.pattern import Pattern

Array = NDArray[np.float64]
Light = NDArray[np.float32]

AWAY_PX = 10.0
"""From the edge between the halves, in the projector's pixels, from where on blur does not reach."""
BRIGHT = 0.3
"""Share of the board's brightest part: darker parts, its black squares, show the camera's halo more than their own
light."""
MOST_SAMPLES = 4000
"""Pixels of a placing that are kept."""
LEAST_SAMPLES, LEAST_VIEWS = 200, 3
BLOCK = 4
"""Projector pixels along the side of the blocks in which a halo is reckoned."""
METHOD = 0.03
"""Share by which it may be off besides, mostly by light that goes from board to board and back."""


@dataclass(frozen=True)
class CameraStray:
    """What a camera's lens does to its picture, see `tankrig.calibration.stray_light.StrayFound`.

    Parameters
    ----------
    share, sigma_px, veil
        Of the light, in the camera's pixels, and of the light.
    """

    share: float
    sigma_px: float
    veil: float

    @classmethod
    def of(cls, calibration: Calibration) -> "CameraStray":
        """From its file."""
        told = calibration.result
        return cls(float(told["halo_share"]), float(told["halo_sigma_px"]), float(told["veil"]))

    def taken_off(self, seen: Light) -> Light:
        """(rows, columns) of a picture: without halo and veil, to first order and once more."""
        import cv2

        clean = seen
        for _ in range(2):
            by = max(1, int(self.sigma_px / 4.0))
            small = cv2.resize(clean, None, fx=1.0 / by, fy=1.0 / by, interpolation=cv2.INTER_AREA)
            wide = cv2.GaussianBlur(small, (0, 0), max(self.sigma_px / by, 0.3), borderType=cv2.BORDER_CONSTANT)
            halo = cv2.resize(wide, seen.shape[::-1], interpolation=cv2.INTER_LINEAR)
            astray = self.share * halo + self.veil * float(clean.mean())
            clean = np.asarray((seen - astray) / (1.0 - self.share - self.veil), np.float32)
        return clean


@dataclass(frozen=True)
class ProjectorHalo:
    """Share of a projector's light in its halo, and the halo's standard deviation in its pixels.

    Parameters
    ----------
    share, sigma_px
        As found.
    sd
        Their standard deviations.
    """

    share: float
    sigma_px: float
    sd: tuple[float, float]


def half_patterns(shape: tuple[int, int]) -> tuple[Pattern, Pattern]:
    """The left half of a projector's picture white, and the right one."""
    left = np.zeros(shape, np.uint8)
    left[:, : shape[1] // 2] = 255
    return Pattern("left half", left), Pattern("right half", 255 - left)


def seen_of_halves(lights: tuple[Light, Light, Light], decoded: Decoded, stray: CameraStray, half_px: float) -> Array:
    """What a placing of the board tells of the halo.

    Parameters
    ----------
    lights
        White, left and right half, each less black, in proportion to radiance.
    decoded
        Of the same placing.
    stray
        Of the camera.
    half_px
        Column where the halves meet.

    Returns
    -------
    array (n, 3)
        Column and row of the projector, and the other half's light there over white's.
    """
    white, left, right = (stray.taken_off(one) for one in lights)
    used = decoded.known & (white > BRIGHT * np.quantile(white[decoded.known], 0.9)) if decoded.known.any() else None
    if used is None:
        return np.zeros((0, 3))
    used &= np.abs(decoded.columns - half_px) > AWAY_PX
    down, across = np.nonzero(used)
    every = max(1, down.size // MOST_SAMPLES)
    down, across = down[::every], across[::every]
    columns, rows = decoded.columns[down, across], decoded.rows[down, across]
    other = np.where(columns < half_px, right[down, across], left[down, across])
    return np.column_stack([columns, rows, other / white[down, across]]).astype(float)


def find_halo(
    samples: Sequence[Array], shape: tuple[int, int], evenness: Sequence[float] | None = None
) -> ProjectorHalo | None:
    """A projector's halo from placings of a board; None from too few.

    Parameters
    ----------
    samples
        Of each placing, see `seen_of_halves`.
    shape
        (rows, columns) of the projector.
    evenness
        (6,) coefficients of its light's fall-off, see `tankrig.geometry.shading`; None: even.

    Notes
    -----
    Least squares with a loss that bubbles and reflections do not pull at. Standard deviations are those of placings
    left out one by one (jackknife), and 3 % of method.
    """
    good = [one for one in samples if len(one) >= LEAST_SAMPLES]
    if len(good) < LEAST_VIEWS:
        return None
    fall_off = np.ones(shape) if evenness is None else np.asarray(shading(tuple(evenness), shape))
    expected = _expectation(fall_off)
    start = np.array([0.01, np.log(0.1 * shape[1])])
    found = _fitted(good, expected, start)
    without = np.array([_fitted([*good[:k], *good[k + 1 :]], expected, found) for k in range(len(good))])
    spread = (len(good) - 1) / len(good) * np.sum((without - without.mean(axis=0)) ** 2, axis=0)
    share, sigma = max(float(found[0]), 0.0), float(np.exp(found[1]))
    sd = float(np.hypot(np.sqrt(spread[0]), METHOD * share)), float(sigma * np.hypot(np.sqrt(spread[1]), METHOD))
    return ProjectorHalo(share, sigma, sd)


_Expected = Callable[[Array, float, float], Array]


def _expectation(fall_off: Array) -> _Expected:
    """The other half's light over white's, at pixels, for a halo of a share and a width."""
    rows, columns = (n // BLOCK * BLOCK for n in fall_off.shape)
    even = fall_off[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).mean(axis=(1, 3))
    half = fall_off.shape[1] // 2 / BLOCK
    lit = np.clip(half - np.arange(even.shape[1]), 0.0, 1.0)

    def expected(places: Array, share: float, sigma_px: float) -> Array:
        from scipy.ndimage import gaussian_filter, map_coordinates

        width = max(sigma_px / BLOCK, 0.3)
        left, right = (gaussian_filter(even * part, width, mode="constant", truncate=5.0) for part in (lit, 1.0 - lit))
        at = (places[:, ::-1].T + 0.5) / BLOCK - 0.5
        spread = [map_coordinates(one, at, order=1, mode="nearest") for one in (left, right, even)]
        other = np.where(places[:, 0] < BLOCK * half, spread[1], spread[0])
        return np.asarray(share * other / ((1.0 - share) * spread[2] + share * (spread[0] + spread[1])))

    return expected


def _fitted(samples: Sequence[Array], expected: _Expected, start: Array) -> Array:
    """Share, and logarithm of the width in pixels."""
    from scipy.optimize import least_squares

    every = np.concatenate(samples)
    scale = max(1.4826 * float(np.median(np.abs(every[:, 2] - np.median(every[:, 2])))), 1e-5)

    def misses(values: Array) -> Array:
        return expected(every[:, :2], float(values[0]), float(np.exp(values[1]))) - every[:, 2]

    box = ([-0.05, np.log(6.0)], [0.3, np.log(400.0)])
    begin = np.clip(start, *box)
    found = least_squares(misses, begin, bounds=box, x_scale=[0.01, 0.3], loss="soft_l1", f_scale=scale)
    return np.asarray(found.x)

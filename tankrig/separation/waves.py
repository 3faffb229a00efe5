"""What shifted waves of light tell of each pixel: light that still knows the wave, and light that has forgotten it.

Wave k of N lights the sheet by (1 + cos(2πy/P − 2πk/N))/2 of its full light. Light is linear in the pattern, so that
a pixel sees

    I_k = (S + |M| cos(arg M − 2πk/N)) / 2

where S is its image under the whole sheet and |M| ≤ S what of it still follows the wave (Nayar et al. 2006 take the
largest less the smallest of I_k, which noise and blur move). The sums below are those of least squares:

    S = (2/N) Σ I_k,    M = (4/N) Σ I_k exp(2πik/N)

Waves half a period apart add up to the sheet. That S comes out the same for all pairs is what tells ink that moved, and
light that drifted, from scattering.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

BLOCK_PIXELS = 8
"""Sides of the blocks in which pairs are compared: noise is small in their means, and what changed is not."""
BEYOND_SIGMAS = 5.0
"""Standard deviations of a block from which on a difference is a change."""
CHANGED = 0.005
"""Share of the light below which a change is not worth a word."""


@dataclass(frozen=True, eq=False)
class Waves:
    """All shifts of one wave, put together.

    Parameters
    ----------
    sheet
        (rows, columns) image under the whole sheet, in the unit of the pictures.
    wave
        (rows, columns) complex M: its modulus is the light that follows the wave, its argument where the wave's crest
        lies.
    sheet_sd, wave_sd
        (rows, columns) standard deviations by noise: of `sheet`, and of `wave`'s real and imaginary part each.
    """

    sheet: Array
    wave: Complex
    sheet_sd: Array
    wave_sd: Array

    @property
    def modulated(self) -> Array:
        """(rows, columns) light that follows the wave, without what noise adds to a modulus; 0 where it is all noise.

        E|M|² is larger than the truth's by the variances of both parts.
        """
        squares = np.square(np.abs(self.wave)) - 2.0 * np.square(self.wave_sd)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    @property
    def even(self) -> Array:
        """(rows, columns) light that has forgotten the wave."""
        return np.asarray(self.sheet - self.modulated)


def demodulated(pictures: Array, noise: Array) -> Waves:
    """Separate what follows a wave from what does not.

    Parameters
    ----------
    pictures
        (N, rows, columns) images under waves shifted by k/N of a period, k = 0 … N − 1, the dark subtracted.
    noise
        (N, rows, columns), or what fits it, standard deviations.

    Raises
    ------
    ImageError
        When N is no multiple of 4.

    Examples
    --------
    A pixel that sees 3 of light that follows the wave, and 7 that does not:

    >>> k = np.arange(4).reshape(4, 1, 1)
    >>> waves = demodulated((10.0 + 3.0 * np.cos(0.3 - 2 * np.pi * k / 4)) / 2, np.full((4, 1, 1), 0.001))
    >>> waves.modulated.round(4).item(), waves.even.round(4).item(), np.angle(waves.wave).round(4).item()
    (3.0, 7.0, 0.3)
    """
    count = len(pictures)
    if count < 4 or count % 4:
        raise ImageError(f"a wave in {count} shifts does not light every place equally in pairs; give 4, 8, 12 …")
    turns = np.exp(2j * np.pi * np.arange(count) / count)
    variance = np.broadcast_to(np.square(noise), pictures.shape)
    squares = np.abs(np.real(turns)) ** 2
    real = np.tensordot(squares, variance, 1)
    imaginary = np.tensordot(1.0 - squares, variance, 1)
    return Waves(
        (2.0 / count) * pictures.sum(axis=0),
        np.asarray((4.0 / count) * np.tensordot(turns, pictures, 1), np.complex128),
        (2.0 / count) * np.sqrt(variance.sum(axis=0)),
        (4.0 / count) * np.sqrt(0.5 * (real + imaginary)),
    )


def noise_of_pairs(pictures: Sequence[Array]) -> list[Array]:
    """Standard deviation of a pixel of each picture, from what pairs half a period apart disagree by.

    Pairs add up to the same light, so that their difference is noise alone, but for what changes smoothly over the
    picture. Its variance is a straight line in the brightness: of photons and of reading out.

    Parameters
    ----------
    pictures
        One array (N, rows, columns) for each wave, all with the same exposure.

    Returns
    -------
    list
        One array (N, rows, columns) for each.
    """
    squares, brightness = [], []
    for waves in pictures:
        half = len(waves) // 2
        pairs = waves[:half] + waves[half:]
        rough = _rough(pairs[0::2].mean(axis=0) - pairs[1::2].mean(axis=0))
        # The difference of two means, each over half/2 sums of two pictures.
        scale = half / (8.0 * ROUGH_PART)
        squares.append(scale * np.square(rough).ravel())
        brightness.append(waves.mean(axis=0)[1:-1, 1:-1].ravel())
    light, seen = np.concatenate(brightness), np.concatenate(squares)
    edges = np.quantile(light, np.linspace(0.0, 1.0, 25))
    part = np.clip(np.searchsorted(edges, light) - 1, 0, 23)
    many = np.maximum(np.bincount(part, minlength=24), 1)
    level, spread = (np.bincount(part, one, minlength=24) / many for one in (light, seen))
    least = 0.1 * float(np.average(spread, weights=many))
    if not edges[-1] > edges[0] or least == 0.0:  # a picture that is full or dark all over tells no line
        return [np.full(waves.shape, np.sqrt(10.0 * least)) for waves in pictures]
    # Each mean of squares is known to a share of itself, so faint ones count for as much as bright ones.
    weights = np.sqrt(many) / np.maximum(spread, 1e-6 * least)
    slope, floor = np.polyfit(level, spread, 1, w=weights)
    if slope < 0.0 or floor < 0.0:  # one of the two is all there is
        alone = float(np.average(spread / np.maximum(level, 1e-12 * level.max()), weights=weights * level))
        slope, floor = (0.0, float(np.average(spread, weights=many))) if slope < 0.0 else (alone, 0.0)
    return [np.sqrt(np.maximum(floor + slope * waves, least)) for waves in pictures]


ROUGH_PART = 1.0 + 4 * 0.5**2 + 4 * 0.25**2
"""Sum of the squared weights of `_rough`: what it makes of the variance of white noise."""


def _rough(image: Array) -> Array:
    """(rows − 2, columns − 2) what second differences along both axes leave: noise, and nothing that is smooth."""
    middle = image[1:-1, 1:-1]
    sides = image[:-2, 1:-1] + image[2:, 1:-1] + image[1:-1, :-2] + image[1:-1, 2:]
    corners = image[:-2, :-2] + image[2:, 2:] + image[:-2, 2:] + image[2:, :-2]
    return np.asarray(middle - 0.5 * sides + 0.25 * corners)


@dataclass(frozen=True)
class Changed:
    """What changed while the shifts of a wave were photographed.

    Parameters
    ----------
    share
        Of the light, root mean square over blocks, beyond noise; 0 where nothing changed.
    lamp
        Share of that which is one factor on the whole picture.
    """

    share: float
    lamp: float

    def __bool__(self) -> bool:
        return self.share > CHANGED

    def __str__(self) -> str:
        """In a sentence.

        >>> str(Changed(0.02, 0.9))
        'the light drifted while the waves were shown, by 2 %'
        """
        what = "the light drifted" if self.lamp > 0.5 else "the ink moved"
        return f"{what} while the waves were shown, by {100.0 * self.share:.2g} %"


def what_changed(pictures: Array, noise: Array) -> Changed:
    """Whether pairs of waves that add up to the same light disagree by more than noise.

    Parameters
    ----------
    pictures, noise
        As `demodulated` takes them.

    Examples
    --------
    >>> k = np.arange(4).reshape(4, 1, 1)
    >>> waves = 5.0 + np.cos(0.1 * np.arange(40.0) - 2 * np.pi * k / 4) * np.ones((1, 40, 40))
    >>> bool(what_changed(waves, np.full(waves.shape, 0.01)))
    False
    >>> lamp = np.array([1.0, 1.0, 1.02, 1.02]).reshape(4, 1, 1)
    >>> str(what_changed(lamp[[0, 2, 1, 3]] * waves, np.full(waves.shape, 0.01)))
    'the light drifted while the waves were shown, by 2 %'
    """
    half = len(pictures) // 2
    pairs = pictures[:half] + pictures[half:]
    variance = np.broadcast_to(np.square(noise), pictures.shape)
    worst = Changed(0.0, 0.0)
    sheet, spread = _blocks(pairs.mean(axis=0)), None
    for one in range(1, half):
        change = _blocks(pairs[one] - pairs[0])
        spread = np.sqrt(
            _blocks(variance[one] + variance[one + half] + variance[0] + variance[half]) / _in_block(pairs)
        )
        if not (np.abs(change) > BEYOND_SIGMAS * spread).any():
            continue
        beyond = np.square(change).mean() - np.square(spread).mean()
        share = float(np.sqrt(max(beyond, 0.0) / np.square(sheet).mean()))
        factor = float(np.vdot(sheet, change) / np.vdot(sheet, sheet))
        lamp = min(1.0, float(np.square(factor * sheet).mean() / max(beyond, 1e-300)))
        worst = max(worst, Changed(share, lamp), key=lambda found: found.share)
    return worst


def _side(shape: tuple[int, ...]) -> int:
    return max(1, min(BLOCK_PIXELS, *shape[-2:]))


def _in_block(pictures: Array) -> int:
    return _side(pictures.shape) ** 2


def _blocks(image: Array) -> Array:
    """(rows, columns) means over blocks; what is left over at the ends is in none."""
    side = _side(image.shape)
    rows, columns = image.shape[0] // side, image.shape[1] // side
    whole = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.asarray(whole.mean(axis=(1, 3)))

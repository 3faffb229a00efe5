"""What was observed, checked: the image, which of its pixels count, and how well each is known."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.checked_toml import MOST
from tankrig.errors import ImageError
from tankrig.estimation.outliers import (
    STANDS_OUT,
    beyond_neighbours,
    deviations,
    neighbouring,
    noise_by_level,
    small,
    stand_out,
)

PLATEAU = 4
"""Pixels at exactly the highest value are saturated from so many on, and this times those at any other bright value."""
BRIGHT = 0.9
"""Share of the highest value from which on values are bright."""
MOST_SATURATED = 0.5
"""Share of the image beyond which nothing can be made of it."""
LEAST_BRIGHT = 1e-25
"""Of the highest value: a noise of 10⁻⁵ of it, which is assumed at least, is then a number of those that have a meaning
here, and squares of it are not lost."""
PEAKED = 0.05
"""Share of its own brightness by which a pixel may stand out where the light has a crest."""
MISFITS = 3.0
"""Times its neighbours' residual, beyond the noise, by which a pixel may stand out where the model does not hold."""
BUBBLE = (7, 9)
"""Rows and columns of which a bubble fills less than half."""
SPECK = 40
"""Pixels of a patch that may be a bubble's or a reflection's."""


@dataclass(frozen=True)
class Observation:
    """An image to fit.

    Parameters
    ----------
    image
        (rows, columns), float64, any unit that is linear in radiance.
    noise
        Standard deviation of each pixel, (rows, columns).
    used
        True where a pixel counts, (rows, columns).
    noise_known
        False where `noise` was estimated from the image itself.
    specks
        Pixels left out because they are unlike their neighbours along the light, (rows, columns).
    saturated
        Number of pixels left out because they are saturated.
    ceiling
        The value of saturated pixels; infinite where there are none.
    error
        Standard error of what is no camera's image but computed, (rows, columns), as smooth as a model's own; None of a
        camera's.
    """

    image: NDArray[np.float64]
    noise: NDArray[np.float64]
    used: NDArray[np.bool_]
    noise_known: bool
    specks: NDArray[np.bool_]
    saturated: int = 0
    ceiling: float = np.inf
    error: NDArray[np.float64] | None = None

    def with_noise_of(self, residual: NDArray[np.float64], by_level: bool = False) -> "Observation":
        """The same, its noise estimated anew from a fit's residual; unchanged where the noise is known.

        Parameters
        ----------
        residual
            Observed less fitted.
        by_level
            Whether the noise is a function of the brightness.
        """
        if self.noise_known:
            return self
        if by_level:
            deviation = deviations(residual, self.used, flat=True)
            noise = noise_by_level(deviation, self._level(residual), self.used)
        else:
            noise = np.full(self.image.shape, pixel_noise(residual, self.used))
        # No camera and no model is better than 10⁻⁵ of the peak.
        return replace(self, noise=np.maximum(noise, 1e-5 * float(np.abs(self.image[self.used]).max())))

    def binned(self, by: int) -> "Observation":
        """The same in blocks of `by` × `by` pixels, means of those that are used; blocks of which half are not are out.

        Examples
        --------
        >>> seen = observe(np.arange(1.0, 25.0).reshape(4, 6), (4, 6), 0.2).binned(2)
        >>> seen.image.tolist(), seen.noise[0].tolist()
        ([[4.5, 6.5, 8.5], [16.5, 18.5, 20.5]], [0.1, 0.1, 0.1])
        """
        rows, columns = (count // by for count in self.image.shape)

        def blocks(values: NDArray[np.float64]) -> NDArray[np.float64]:
            cut = values[: rows * by, : columns * by].reshape(rows, by, columns, by)
            return np.asarray(cut.sum(axis=(1, 3)))

        count = blocks(self.used.astype(float))
        many = np.maximum(count, 1.0)
        image, variance = (blocks(np.where(self.used, one, 0.0)) for one in (self.image, self.noise**2))
        used = count >= 0.5 * by * by
        noise = np.where(used, np.sqrt(variance) / many, self.noise.max())
        error = None if self.error is None else blocks(np.where(self.used, self.error, 0.0)) / many
        return replace(self, image=image / many, noise=noise, used=used, specks=np.zeros_like(used), error=error)

    def _level(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Brightness without noise and bubbles: what was fitted, and what is left over there at large."""
        from scipy.ndimage import median_filter

        left: NDArray[np.float64] = np.where(self.used, residual, 0.0)
        return self.image - left + median_filter(left, BUBBLE)

    def cleaned(self, fitted: NDArray[np.floating]) -> "Observation":
        """The same without pixels that a fitted image shows to be outliers, or that noise may have saturated.

        Which of the pixels near the ceiling are below it is up to their noise: leaving out those at it alone would
        keep the darker ones. A model that does not hold is off by as much beside a pixel as in it, and in one piece:
        what does not stand out from that, or is larger than a speck, stays, so that the verdict can tell.
        """
        residual = np.where(self.used, self.image - fitted, 0.0)
        deviation = deviations(residual, self.used, flat=True)
        noise = np.maximum(self.noise, noise_by_level(deviation, self._level(residual), self.used))
        misfit = np.maximum(neighbouring(np.abs(residual), self.used) - noise, 0.0)
        outliers = small(stand_out(deviation, noise, MISFITS * misfit, self.used), SPECK)
        near = self.used & (fitted > self.ceiling - 3.0 * self.noise) & ~outliers
        return replace(
            self, used=self.used & ~outliers & ~near, specks=self.specks | outliers,
            saturated=self.saturated + int(near.sum()),
        )  # fmt: skip


def observe(
    image: ArrayLike, shape: tuple[int, int], noise: ArrayLike | None = None, mask: ArrayLike | None = None,
    error: ArrayLike | None = None,
) -> Observation:  # fmt: skip
    """Check an image and say which of its pixels count.

    Parameters
    ----------
    image
        (rows, columns).
    shape
        What the scene's camera delivers.
    noise
        Standard deviation, scalar or per pixel, in units of the image; None to estimate it.
    mask
        True where a pixel is to be left out.
    error
        Standard error of a computed image, scalar or per pixel, in units of the image; None of a camera's.

    Raises
    ------
    ImageError
        When the image cannot be an observation of the scene, in one sentence.

    Examples
    --------
    >>> observe(np.zeros((2, 3)), (2, 3))
    Traceback (most recent call last):
    tankrig.errors.ImageError: the image is all dark (no value above 0); check the light, the exposure and the lens cap
    """
    values = _real("image", image)
    if values.shape != tuple(shape):
        raise ImageError(
            f"the image has shape {list(values.shape)} but the scene's camera delivers {list(shape)} "
            "(rows, columns); give the scene that belongs to the image, or crop or bin the image"
        )
    used = _used(mask, values.shape)
    _check_values(values, used)
    known = noise is not None
    sigma = _noise(noise, values.shape) if known else np.zeros(values.shape)
    saturated = saturated_pixels(values, used)
    _require_some(~saturated & used, used, "saturated", "shorten the exposure")
    ceiling = float(values[saturated].max()) if saturated.any() else np.inf
    used &= ~saturated
    finite, none = np.where(np.isfinite(values), values, 0.0), np.zeros_like(used)
    own = None if error is None else _error(error, values.shape)
    observed = Observation(finite, sigma, used, known, none, int(saturated.sum()), ceiling, own)
    observed = observed.with_noise_of(np.where(used, values, 0.0))
    return _without_specks(observed)


def _without_specks(observed: Observation) -> Observation:
    """Less the pixels that stand out from their neighbours so far that no light does."""
    used = observed.used
    deviation = deviations(observed.image, used)
    level = observed.image - deviation
    noise = np.maximum(observed.noise, noise_by_level(deviation, level, used))
    specks = stand_out(deviation, noise, PEAKED * np.abs(level), used)
    specks &= beyond_neighbours(observed.image, STANDS_OUT * noise, used & ~specks)
    _require_some(used & ~specks, used, "unlike its neighbours", "check that it is a picture of light in a tank")
    _check_values(observed.image, used & ~specks)
    return replace(observed, used=used & ~specks, specks=specks)


def _require_some(left: NDArray[np.bool_], of: NDArray[np.bool_], what: str, remedy: str) -> None:
    if left.sum() < 16 or left.sum() < (1.0 - MOST_SATURATED) * of.sum():
        raise ImageError(
            f"{int(of.sum() - left.sum())} of the image's {left.size} pixels are {what} and {int(left.sum())} are "
            f"left to fit, which is too few; {remedy} or mask less"
        )


def pixel_noise(image: NDArray[np.float64], used: NDArray[np.bool_]) -> float:
    """Standard deviation of what differs from pixel to pixel, robust against edges: the median of second differences.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :80]
    >>> noisy = np.exp(-columns / 30) + np.random.default_rng(1).normal(0, 0.01, (60, 80))
    >>> round(pixel_noise(noisy, np.ones((60, 80), bool)), 3)
    0.01
    """
    bends = []
    for axis in (0, 1):
        if image.shape[axis] < 3:
            continue
        value, counts = np.moveaxis(image, axis, 0), np.moveaxis(used, axis, 0)
        whole = counts[:-2] & counts[1:-1] & counts[2:]
        bends.append((value[:-2] - 2.0 * value[1:-1] + value[2:])[whole])
    sizes = np.abs(np.concatenate(bends)) if bends else np.zeros(0)
    # The median of |x| is 0.6745 standard deviations; a second difference has √6 times the noise of a pixel.
    return float(np.median(sizes) / 0.6745 / np.sqrt(6.0)) if sizes.size else 0.0


def structure(residual: NDArray[np.float64], used: NDArray[np.bool_]) -> float:
    """RMS of what neighbouring pixels of a residual have in common, which white noise has nothing of.

    The root of the mean product of pixels next but one to each other, where it is beyond three standard deviations of
    chance; else 0.

    Examples
    --------
    >>> rows, columns = np.mgrid[:60, :80]
    >>> noise = np.random.default_rng(1).normal(0, 0.01, (60, 80))
    >>> everywhere = np.ones((60, 80), bool)
    >>> structure(noise, everywhere), round(structure(noise + 0.01 * np.sin(columns / 9), everywhere), 4)
    (0.0, 0.0075)
    """
    products = []
    for axis in (0, 1):
        value, counts = np.moveaxis(residual, axis, 0), np.moveaxis(used, axis, 0)
        products.append((value[:-2] * value[2:])[counts[:-2] & counts[2:]])
    shared = np.concatenate(products)
    chance = 3.0 * float(np.mean(np.square(residual[used]))) / np.sqrt(max(shared.size, 1))
    mean = float(shared.mean()) if shared.size else 0.0
    return float(np.sqrt(mean)) if mean > chance else 0.0


def _real(name: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "buif":
            raise TypeError
        return np.array(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ImageError(f"the {name} is not an array of real numbers; give (rows, columns) of floats") from error


def _used(mask: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(shape, bool)
    left_out = np.asarray(mask)
    if left_out.shape != shape or left_out.dtype.kind not in "bui":
        raise ImageError(
            f"the mask has shape {list(left_out.shape)} and type {left_out.dtype} but the image has shape "
            f"{list(shape)}; give booleans of the image's shape, True where a pixel is to be left out"
        )
    return ~left_out.astype(bool)


def _noise(noise: ArrayLike | None, shape: tuple[int, ...]) -> NDArray[np.float64]:
    sigma = _real("noise", noise if noise is not None else 0.0)
    if sigma.shape not in ((), shape):
        raise ImageError(f"the noise has shape {list(sigma.shape)}; give one number or one for each of {list(shape)}")
    if not ((sigma >= 1.0 / MOST) & (sigma <= MOST)).all():
        raise ImageError("the noise is not a positive finite standard deviation everywhere; give one that is")
    return np.broadcast_to(sigma, shape)


def _error(error: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    values = _real("image_error", error)
    if values.shape not in ((), shape):
        raise ImageError(
            f"image_error has shape {list(values.shape)}; give one number or one for each of {list(shape)}"
        )
    if not ((values >= 0.0) & (values <= MOST)).all():
        raise ImageError("image_error is negative or not finite somewhere; give standard errors")
    return np.broadcast_to(values, shape)


def _check_values(values: NDArray[np.float64], used: NDArray[np.bool_]) -> None:
    bad = int((~np.isfinite(values) & used).sum())
    if bad:
        raise ImageError(f"the image has {bad} pixels that are NaN or infinite; mask them or take the image again")
    seen = values[used]
    if not seen.size:
        raise ImageError("every pixel of the image is masked; mask less")
    if float(np.abs(seen).max()) > MOST:
        raise ImageError(f"the image has a pixel of {np.abs(seen).max():.3g}, above {MOST:g}; give it in another unit")
    low, high = float(seen.min()), float(seen.max())
    if high <= 0.0:
        raise ImageError("the image is all dark (no value above 0); check the light, the exposure and the lens cap")
    if high < LEAST_BRIGHT:
        raise ImageError(
            f"the image is dark: its brightest pixel is {high:.3g}, below {LEAST_BRIGHT:g}; check the light and the "
            "exposure, or give it in another unit"
        )
    if low == high:
        raise ImageError(f"every pixel of the image is {high:g}, which no scattering is; check the exposure")
    if float(np.median(seen)) < -0.05 * high or -low > high:
        raise ImageError(f"the image reaches down to {low:g} below zero; subtract a smaller dark level")


def saturated_pixels(values: NDArray[np.float64], used: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Pixels at the highest value of those used, where they are more than chance brings to one value.

    Examples
    --------
    >>> ramp = np.minimum(np.arange(12.0).reshape(2, 6), 6.0)
    >>> saturated_pixels(ramp).astype(int).tolist(), bool(saturated_pixels(ramp[:1]).any())
    ([[0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]], False)
    """
    used = np.isfinite(values) if used is None else used & np.isfinite(values)
    if not used.any() or values[used].max() == values[used].min():  # dark all over, or cut off: no picture at all
        return np.zeros(values.shape, bool)
    highest = float(values[used].max())
    top: NDArray[np.bool_] = used & (values >= highest - 1e-6 * abs(highest))  # what rounding does to a plateau
    below = values[used & ~top & (values > BRIGHT * highest)]
    others = int(np.unique(below, return_counts=True)[1].max()) if below.size else 0
    beside = (top[:, 1:] & top[:, :-1]).any()  # light fades along x
    if beside and top.sum() >= PLATEAU * max(others, 1):
        return top
    return np.zeros(values.shape, bool)

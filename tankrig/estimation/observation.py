"""What was observed, checked: the image, which of its pixels count, and how well each is known."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import ImageError

SATURATED_SHARE = 0.01
"""Share of pixels at exactly the highest value from which on they are taken for saturated."""


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
    saturated
        Number of pixels left out because they are saturated.
    """

    image: NDArray[np.float64]
    noise: NDArray[np.float64]
    used: NDArray[np.bool_]
    noise_known: bool
    saturated: int = 0

    def with_noise_of(self, residual: NDArray[np.float64]) -> "Observation":
        """The same, its noise estimated anew from a fit's residual; unchanged where the noise is known."""
        if self.noise_known:
            return self
        return replace(self, noise=np.full(self.image.shape, _floored(pixel_noise(residual, self.used), self)))


def observe(
    image: ArrayLike, shape: tuple[int, int], noise: ArrayLike | None = None, mask: ArrayLike | None = None
) -> Observation:
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
    saturated = _saturated(values, used)
    used &= ~saturated
    if used.sum() < 16:
        raise ImageError(
            f"only {int(used.sum())} of the image's {values.size} pixels are neither masked nor saturated; "
            "shorten the exposure or mask less"
        )
    known = noise is not None
    sigma = _noise(noise, values.shape) if known else np.zeros(values.shape)
    observed = Observation(np.where(np.isfinite(values), values, 0.0), sigma, used, known, int(saturated.sum()))
    if known:
        return observed
    return observed.with_noise_of(observed.image)


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


def _floored(noise: float, observation: Observation) -> float:
    """Noise of at least 10⁻⁵ of the peak, below which no camera and no model is."""
    return max(noise, 1e-5 * float(np.abs(observation.image[observation.used]).max()))


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
    if not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
        raise ImageError("the noise is not a positive finite standard deviation everywhere; give one that is")
    return np.broadcast_to(sigma, shape)


def _check_values(values: NDArray[np.float64], used: NDArray[np.bool_]) -> None:
    bad = int((~np.isfinite(values) & used).sum())
    if bad:
        raise ImageError(f"the image has {bad} pixels that are NaN or infinite; mask them or take the image again")
    seen = values[used]
    if not seen.size:
        raise ImageError("every pixel of the image is masked; mask less")
    low, high = float(seen.min()), float(seen.max())
    if high <= 0.0:
        raise ImageError("the image is all dark (no value above 0); check the light, the exposure and the lens cap")
    if low == high:
        raise ImageError(f"every pixel of the image is {high:g}, which no scattering is; check the exposure")
    if float(np.median(seen)) < -0.05 * high or -low > high:
        raise ImageError(f"the image reaches down to {low:g} below zero; subtract a smaller dark level")


def _saturated(values: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels at the highest value, where they are many and lie side by side along x, as no light that decays does."""
    top: NDArray[np.bool_] = used & (values == values[used].max())
    beside = (top[:, 1:] & top[:, :-1]).any() if values.shape[1] > 1 else False
    if beside and top.sum() >= max(4.0, SATURATED_SHARE * used.sum()):
        return top
    return np.zeros(values.shape, bool)

"""What a pixel has that its neighbours along the light have not: noise, and now and then a bubble or a dead pixel.

Light fades along x and the model's image with it, so the median of a few pixels along x is what a pixel should show,
whatever edges the beams have across y; what rises or falls steadily is its own median.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

ALONG = 9
"""Pixels along x whose median is taken: specks up to four pixels long stand out."""
LEVELS, LEAST = 24, 100
"""Levels of brightness at which the noise is told apart, and pixels that each holds at least."""
BULK = 0.9
"""Share of the pixels from which the noise is taken; the rest may be anything."""
STANDS_OUT = 5.0
"""Standard deviations; noise alone gets there once in two million pixels."""


def deviations(image: Array, used: Mask, flat: bool = False) -> Array:
    """Each pixel less the median of the used pixels around it along x; 0 where one isn't used.

    Parameters
    ----------
    image
        (rows, columns).
    used
        Where a pixel counts.
    flat
        The image has no slope, as a residual has none: then the first and last pixels of a row, which have neighbours
        on one side only, are compared with those. Otherwise the first and the last have nothing to deviate from.

    Examples
    --------
    >>> row = np.array([[9.0, 7, 5, 4, 90, 2.5, 2, 1.5, 1]])
    >>> deviations(row, np.ones((1, 9), bool))
    array([[ 0., -2., -2., -1., 86.,  0.,  0.,  0.,  0.]])
    """
    reach = ALONG // 2
    filled, around = np.where(used, image, np.inf), ((0, 0), (reach, reach))
    padded = np.pad(filled, around, constant_values=np.inf) if flat else np.pad(filled, around, "edge")
    ordered = np.sort(np.lib.stride_tricks.sliding_window_view(padded, ALONG, axis=1), axis=2)
    count = np.isfinite(ordered).sum(axis=2)  # what isn't used comes last
    middles = np.maximum(np.stack([(count - 1) // 2, count // 2], axis=2), 0)
    return np.where(used, image - np.take_along_axis(ordered, middles, 2).mean(axis=2), 0.0)


def neighbouring(image: Array, used: Mask) -> Array:
    """Median of the used pixels around each one along x, as `deviations` takes it from a flat image."""
    return np.where(used, image, 0.0) - deviations(image, used, flat=True)


def noise_by_level(deviation: Array, level: Array, used: Mask) -> Array:
    """Standard deviation of what deviates, as a function of the brightness, (rows, columns).

    Parameters
    ----------
    deviation
        See `deviations`.
    level
        Brightness of each pixel, not its own noise: smoothed, or a model's.
    used
        Where a pixel counts.
    """
    size, at = np.abs(deviation[used]), level[used]
    order, levels = np.argsort(at, kind="stable"), int(np.clip(size.size // LEAST, 1, LEVELS))
    longer = size.size % levels  # levels that hold one pixel more
    cut = longer * (size.size // levels + 1)
    parts = [order[:cut].reshape(longer, -1)] if longer else []
    parts.append(order[cut:].reshape(levels - longer, -1))
    # |x| of a normal x is below 1.645 standard deviations in nine of ten cases.
    sds = np.concatenate([np.quantile(size[part], BULK, axis=1) for part in parts]) / 1.645
    return np.interp(level, np.concatenate([np.median(at[part], axis=1) for part in parts]), sds)


def stand_out(deviation: Array, noise: Array, allowed: Array | float, used: Mask) -> Mask:
    """Pixels that deviate by more than noise does and what is allowed besides."""
    return used & (np.abs(deviation) > STANDS_OUT * noise + allowed)


def small(found: Mask, most: int) -> Mask:
    """Pixels whose patch, corners touching, is of so many pixels at most.

    Examples
    --------
    >>> small(np.array([[True, True, True, False, True]]), 2)
    array([[False, False, False, False,  True]])
    """
    from scipy.ndimage import label

    patches, _ = label(found, np.ones((3, 3)))
    sizes = np.bincount(patches.ravel())
    return np.asarray(found & (sizes[patches] <= most))


def beyond_neighbours(image: Array, by: Array, trusted: Mask) -> Mask:
    """Pixels brighter than every trusted one of the eight around them, or darker, by some amount.

    A beam that crosses rows at an angle lights a few pixels of a row, but not more than the rows beside it.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    brightest = maximum_filter(np.where(trusted, image, -np.inf), 3, mode="nearest")
    darkest = minimum_filter(np.where(trusted, image, np.inf), 3, mode="nearest")
    return np.asarray((image > brightest + by) | (image < darkest - by))

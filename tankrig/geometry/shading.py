"""How much light each pixel of a projector gives: less towards the edges of its picture, as its lens has it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

TERMS = 6


def shading_terms(pixels: ArrayLike, shape: tuple[int, int]) -> Array:
    """What the logarithm of a pixel's light is a sum of: x, y, x², xy, y², (x² + y²)².

    Parameters
    ----------
    pixels
        (…, 2) u and v.
    shape
        (rows, columns) of the picture; x and y are measured from its middle, in halves of its diagonal.

    Returns
    -------
    (…, 6) array

    Examples
    --------
    >>> shading_terms([19.5, 14.5], (30, 40)).tolist(), float(shading_terms([39.5, 29.5], (30, 40))[5].round(9))
    ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0)
    """
    rows, columns = shape
    half = 0.5 * np.hypot(rows, columns)
    x, y = np.moveaxis((np.asarray(pixels, np.float64) - [0.5 * (columns - 1), 0.5 * (rows - 1)]) / half, -1, 0)
    return np.stack([x, y, x * x, x * y, y * y, (x * x + y * y) ** 2], axis=-1)


def shading(coefficients: ArrayLike, shape: tuple[int, int]) -> Array:
    """(rows, columns) light of each pixel over that of the one in the middle; `coefficients` (6,) of `shading_terms`.

    Examples
    --------
    >>> shading([0.0, 0.0, -0.3, 0.0, -0.3, 0.0], (3, 5)).round(3)[1].tolist()
    [0.868, 0.965, 1.0, 0.965, 0.868]
    """
    rows, columns = shape
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    return np.asarray(np.exp(shading_terms(pixels, shape) @ np.asarray(coefficients, np.float64)))

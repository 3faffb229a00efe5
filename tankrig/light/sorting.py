"""Sorting of a handful of numbers in a kernel; numba's own, made for any size, takes a second to compile."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import part


@part
def put_in_order(values: NDArray[np.float64]) -> None:
    """Sort an array in place, NaN last.

    Examples
    --------
    >>> values = np.array([2.0, math.nan, -1.0, 2.0, 0.5])
    >>> put_in_order(values)
    >>> values.tolist()
    [-1.0, 0.5, 2.0, 2.0, nan]
    """
    for k in range(1, values.size):
        value, at = values[k], k
        while at > 0 and (values[at - 1] > value or (math.isnan(values[at - 1]) and not math.isnan(value))):
            values[at] = values[at - 1]
            at -= 1
        values[at] = value

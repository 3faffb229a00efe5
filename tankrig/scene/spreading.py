"""Light shared out among the cells that it falls on."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel

Array = NDArray[np.float64]


@kernel
def spread_over_cells(cells: Array, patches: Array, power: Array, width: float, height: float) -> None:
    """Add the light of every pixel to the cells of the wall.

    Parameters
    ----------
    cells
        (rows, columns), added to: W. Rows from z = 0, columns from y = −width/2.
    patches
        (pixel rows + 1, pixel columns + 1, 2) y and z of the pixels' corners on the wall; NaN where they miss it.
    power
        (pixel rows, pixel columns) W.
    width, height
        Of the wall, mm.
    """
    rows, columns = cells.shape
    for i in range(power.shape[0]):
        for j in range(power.shape[1]):
            if not power[i, j] > 0.0:
                continue
            middle, half = np.zeros(2), np.zeros(2)
            for k in range(2):
                a, b, c, d = patches[i, j, k], patches[i, j + 1, k], patches[i + 1, j, k], patches[i + 1, j + 1, k]
                middle[k] = 0.25 * (a + b + c + d)
                half[k] = 0.25 * math.sqrt((b + d - a - c) ** 2 + (c + d - a - b) ** 2)
            if not (half[0] > 0.0 and half[1] > 0.0):
                continue
            left, right = (middle[0] - half[0] + 0.5 * width) / width, (middle[0] + half[0] + 0.5 * width) / width
            low, high = (middle[1] - half[1]) / height, (middle[1] + half[1]) / height
            density = power[i, j] / ((right - left) * columns * (high - low) * rows)
            left, right = max(left, 0.0) * columns, min(right, 1.0) * columns
            low, high = max(low, 0.0) * rows, min(high, 1.0) * rows
            for row in range(int(low), math.ceil(high)):
                overlap = density * (min(high, row + 1.0) - max(low, float(row)))
                for column in range(int(left), math.ceil(right)):
                    cells[row, column] += overlap * (min(right, column + 1.0) - max(left, float(column)))

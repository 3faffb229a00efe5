"""How a path leaves its mark on the image: in one cell, or on a rectangle for each beam."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import part
from tankrig.light.rays import Geometry
from tankrig.light.tank.sighting import seen_from
from tankrig.scene.phase import henyey_greenstein

Array = NDArray[np.float64]
Bins = NDArray[np.int64]
"""Index of the image that each order 0, 1, 2, … is recorded in; orders beyond the last go with it."""

GROUPS = (3, "4-20", ">20")
"""Order classes of an image."""

CLASSES: Bins = np.array([0, 0, 0, 0, *[1] * 17, 2])
"""Bins that are `GROUPS`."""


@part
def record_point(
    cells: Array, bins: Bins, geometry: Geometry, order: int, weight: float, sigma_t: float, g: float,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, cell_mm: tuple[float, float],
) -> None:  # fmt: skip
    """Add what one scattering at (x, y, z) sends to the camera to the cell it is seen through.

    Parameters
    ----------
    cells
        (images, rows, columns), added to: power towards the camera, W/sr; over a cell's area it is the cell's radiance.
    weight
        Power scattered there, W.
    dx, dy, dz
        Direction of the light before.
    """
    seen_x, seen_y, sx, sy, sz, path, factor = seen_from(geometry, x, y, z)
    column = math.floor(seen_x / cell_mm[0])
    row = math.floor((seen_y + geometry.half_width) / cell_mm[1])
    if column < 0 or row < 0 or column >= cells.shape[2] or row >= cells.shape[1]:
        return
    value = weight * factor * henyey_greenstein(dx * sx + dy * sy + dz * sz, g) * math.exp(-sigma_t * path)
    cells[bins[min(order, bins.size - 1)], row, column] += value


@part
def record_rectangles(
    edges: Array, bins: Bins, order: int, value: float, sigma_t: float, x: float, y: float, x_low: float, x_high: float,
    y_low: float, y_high: float, beams: Array, half_width: float, cell_mm: tuple[float, float],
) -> None:  # fmt: skip
    """Add value · exp(−σt x') for all starts x' ∈ [x_low, x_high] on the beams in [y_low, y_high], moved by (x, y).

    Only the changes from cell to cell are written, at the rectangle's corners; `image_of_edges` sums them up.

    Parameters
    ----------
    edges
        (images, 2, rows + 2, columns + 2), added to: [:, 0] what a partly covered column holds, [:, 1] what goes on
        from the next column.
    """
    if x_high <= x_low or y_high <= y_low:
        return
    group = bins[min(order, bins.size - 1)]
    first, first_part, first_on = _edge(x_low, x, sigma_t, value, cell_mm[0])
    last, last_part, last_on = _edge(x_high, x, sigma_t, value, cell_mm[0])
    for beam in range(beams.shape[0]):
        low, high = max(beams[beam, 0], y_low), min(beams[beam, 1], y_high)
        if high <= low:
            continue
        for side in range(2):
            place = ((low if side == 0 else high) + y + half_width) / cell_mm[1]
            row = int(place)
            change = beams[beam, 4] if side == 0 else -beams[beam, 4]
            after = (place - row) * change  # the row is partly covered; the next takes the rest of the step
            before = change - after
            edges[group, 0, row, first] += before * first_part
            edges[group, 0, row + 1, first] += after * first_part
            edges[group, 1, row, first + 1] += before * first_on
            edges[group, 1, row + 1, first + 1] += after * first_on
            edges[group, 0, row, last] -= before * last_part
            edges[group, 0, row + 1, last] -= after * last_part
            edges[group, 1, row, last + 1] -= before * last_on
            edges[group, 1, row + 1, last + 1] -= after * last_on


@part
def _edge(start: float, x: float, sigma_t: float, value: float, cell_mm: float) -> tuple[int, float, float]:
    """The column in which starts begin, what the rest of it holds on average, and what the next begins with."""
    place = max(start + x, 0.0) / cell_mm
    column = int(place)
    amplitude = value * math.exp(-sigma_t * start)
    on = math.exp(-sigma_t * cell_mm * (column + 1.0 - place))
    return column, amplitude * (1.0 - on) / (sigma_t * cell_mm), amplitude * on


def image_of_edges(edges: Array, sigma_t: float, cell_mm: float) -> Array:
    """Averages over cells from the changes that `record_rectangles` wrote.

    Parameters
    ----------
    edges
        (…, 2, rows + 2, columns + 2).
    sigma_t
        Extinction, 1/mm.
    cell_mm
        Size of a cell along x.

    Returns
    -------
    (…, rows, columns) array
    """
    from scipy.signal import lfilter

    rows = np.cumsum(edges, axis=-2)[..., :-2, :]
    depth = sigma_t * cell_mm
    going_on = lfilter([1.0], [1.0, -math.exp(-depth)], rows[..., 1, :, :], axis=-1)
    image: Array = rows[..., 0, :, :] - math.expm1(-depth) / depth * going_on
    return image[..., :-2]

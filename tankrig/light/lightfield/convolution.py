"""The lit volume convolved with the kernel, seen along the camera's rays, both ending at the tank's walls."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.light.lightfield.kernel import Kernel
from tankrig.scene import Beam, Scene

Floats = NDArray[np.float64]


def convolve(scene: Scene, kernel: Kernel, cells: tuple[int, int]) -> Floats:
    """Radiance that leaves z = Lz upwards, averaged over cells of the tank's plan, W/mm²/sr.

    image = ∫₀^{Lz} e^{−σt (Lz − z)} (E ∗ H)(x, y, z) dz with E = E₀(y, z) e^{−σt x} inside the tank and 0 outside: the
    integral over z and the beams' heights is taken first, which leaves a convolution over the plan.

    Parameters
    ----------
    scene
        Collimated projector, orthographic camera, matched surface.
    kernel
        From fluence rate along +x to emission along +z.
    cells
        Numbers of cells along x and along y.

    Returns
    -------
    array (cells along y, cells along x)
    """
    from scipy.interpolate import RectBivariateSpline
    from scipy.signal import fftconvolve

    length, width, height = scene.tank.size_mm
    sigma_t = scene.medium.sigma_t
    columns, rows = cells
    step_x, step_y = length / columns, width / rows
    x, y = _graded(step_x, length, both_sides=True), _graded(step_y, width)
    u = _graded(0.5 * math.sqrt(step_x * step_y), height, both_sides=True)
    heights = kernel(x[:, None, None], y[:, None], u)
    lags_x, lags_y = np.arange(1 - columns, columns) * step_x, np.arange(rows) * step_y
    attenuation = -np.diff(np.exp(-sigma_t * step_x * np.arange(columns + 1))) / (sigma_t * step_x)
    image = np.zeros((rows, columns))
    for levels, beams in _by_height(scene.projector.beams).items():
        plan = RectBivariateSpline(x, y, heights @ _seen_weights(u, levels, height, sigma_t))
        profile = sum(beam.irradiance * _coverage(beam.y_mm, width, rows) for beam in beams)
        source = np.multiply.outer(profile, attenuation)
        lags = plan(lags_x, lags_y).T
        image += fftconvolve(source, np.concatenate([lags[:0:-1], lags]), mode="same") * step_x * step_y
    return image


def _by_height(beams: Sequence[Beam]) -> dict[tuple[float, float], list[Beam]]:
    groups: dict[tuple[float, float], list[Beam]] = {}
    for beam in beams:
        groups.setdefault(beam.z_mm, []).append(beam)
    return groups


def _graded(step: float, end: float, both_sides: bool = False) -> Floats:
    """Separations 0, step, 2 step, … that widen with distance, to beyond `end`."""
    values = [0.0]
    while values[-1] < end:
        values.append(values[-1] + max(step, 0.08 * values[-1]))
    positive = np.array(values)
    return np.concatenate([-positive[:0:-1], positive]) if both_sides else positive


def _coverage(interval: tuple[float, float], width: float, rows: int) -> Floats:
    """Part of each cell along y that a beam covers."""
    edges = np.clip(np.linspace(-width / 2, width / 2, rows + 1), *interval)
    covered: Floats = np.diff(edges) * rows / width
    return covered


def _seen_weights(u: Floats, levels: tuple[float, float], height: float, sigma_t: float) -> Floats:
    """Weights of the kernel's values at height differences u, linear between: ∫∫ dz dz' e^{−σt (Lz − z)} δ(z − z' − u)

    with z along the camera's ray and z' over the beam's height.
    """
    low, high = levels
    step = min(0.25 * (high - low), height / 2000)
    fine = np.arange(-high - step, height - low + step, step) + 0.5 * step
    # ∫ over z' of e^{−σt (Lz − u − z')}, z' within the beam and u + z' within the tank.
    top, bottom = np.minimum(high, height - fine), np.maximum(low, -fine)
    depth_top, depth_bottom = height - fine - top, height - fine - bottom
    seen = np.where(top > bottom, np.exp(-sigma_t * depth_top) - np.exp(-sigma_t * depth_bottom), 0.0)
    seen = seen / sigma_t * step
    place = np.interp(fine, u, np.arange(len(u)))
    index = np.minimum(place, len(u) - 2).astype(np.intp)
    above = place - index
    weights = np.bincount(index, seen * (1.0 - above), len(u)) + np.bincount(index + 1, seen * above, len(u))
    return np.asarray(weights, dtype=np.float64)


def resample(cell_values: Floats, extent_mm: tuple[float, float], shape: tuple[int, int], pixel_mm: float) -> Floats:
    """Averages over cells that fill a rectangle, turned into averages over square pixels that start at its corner.

    Along each axis the running integral of the cells is interpolated by a cubic spline: exact where a pixel's edges are
    cells' edges, smooth between them; beyond the rectangle there is nothing.

    Parameters
    ----------
    cell_values
        (cells along y, cells along x).
    extent_mm
        Sides of the rectangle along y and along x.
    shape
        Rows and columns of pixels.
    pixel_mm
        Side of a pixel.

    Examples
    --------
    >>> resample(np.ones((4, 4)), (4.0, 4.0), (2, 3), 1.6).round(6).tolist()
    [[1.0, 1.0, 0.5], [1.0, 1.0, 0.5]]
    """
    from scipy.interpolate import CubicSpline

    values = cell_values
    for axis in (0, 1):
        edges = np.linspace(0.0, extent_mm[axis], values.shape[axis] + 1)
        zero = np.zeros_like(np.take(values, [0], axis))
        running = np.concatenate([zero, np.cumsum(values, axis)], axis) * edges[1]
        cuts = np.minimum(np.arange(shape[axis] + 1) * pixel_mm, extent_mm[axis])
        values = np.diff(CubicSpline(edges, running, axis)(cuts), axis=axis) / pixel_mm
    return values

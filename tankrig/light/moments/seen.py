"""The camera's image of an emission whose moments over direction are known on cells: ∫ e^{−σt s} E ds along sights."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.moments.cells import Cells
from tankrig.light.moments.harmonics import fill_harmonics, harmonics
from tankrig.light.quadrature import Rule
from tankrig.light.rays import Geometry, geometry_of, sight_line
from tankrig.scene import Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Surface = tuple[tuple[int, int], tuple[float, float]]
"""Rows and columns of cells of the surface, from x = 0, y = −Ly/2, and their sides along x and y in mm."""

NODES, PARTS = 3, 4
"""Where sights slant: points on them in each layer of cells, and points along a cell's side between which the emission
is taken as linear."""


def seen(scene: Scene, cells: Cells, emission: Single, sigma_t: float, surface: Surface) -> Array:
    """Radiance that leaves the water towards the camera.

    Parameters
    ----------
    scene
        Whose tank and camera count.
    cells
        Of the tank.
    emission
        ((degree + 1)², nx, ny, nz) moments, averages over cells, W/mm³/sr^½.
    sigma_t
        Extinction on the way to the surface, 1/mm.
    surface
        Cells that the image is made of.

    Returns
    -------
    (rows, columns) array, W/mm²/sr
    """
    return (_from_above if scene.camera.kind == "orthographic" else _aslant)(scene, cells, emission, sigma_t, surface)


def _from_above(scene: Scene, cells: Cells, emission: Single, sigma_t: float, surface: Surface) -> Array:
    """Sights are vertical: averages over the surface's cells."""
    upward = harmonics(math.isqrt(len(emission)) - 1, np.array([[0.0, 0.0, 1.0]]))[0]
    across, along, up = cells.counts
    image = np.tensordot(upward, emission, 1) @ sight_weights(up, cells.size_mm[2], sigma_t)
    (rows, columns), (along_x, along_y) = surface
    to_rows = _averages(along, cells.size_mm[1], rows, along_y)
    to_columns = _averages(across, cells.size_mm[0], columns, along_x)
    result: Array = sight_line(geometry_of(scene), 0.0, 0.0)[3] * (to_rows @ image.T @ to_columns.T)
    return result


def sight_weights(count: int, height_mm: float, sigma_t: float) -> Array:
    """Weights of layers' averages of the emission in ∫ e^{−σt s} E ds upwards, with E a parabola in each layer."""
    nodes, lengths = np.polynomial.legendre.leggauss(6)
    weights = np.zeros(count)
    for layer in range(count):
        centre = min(max(layer, 1), count - 2)
        depth = (count - 0.5 - layer - 0.5 * nodes) * height_mm
        attenuated = np.exp(-sigma_t * depth) * lengths * (0.5 * height_mm)
        weights[centre - 1 : centre + 2] += attenuated @ _parabola(layer - centre + 0.5 * nodes)
    return weights


def _parabola(t: Array) -> Array:
    """(n, 3) shares of the averages over three cells in the parabola that has them, t cells from the middle."""
    bend = 0.5 * (t * t - 1.0 / 12.0)
    return np.stack([bend - 0.5 * t, 1.0 - 2.0 * bend, bend + 0.5 * t], axis=-1)


def _averages(count: int, size_mm: float, pixels: int, pixel_mm: float) -> Array:
    """(pixels, count) averages over pixels of the spline whose averages over cells are given; 0 beyond the tank."""
    integral = _integrals(count, size_mm)
    at = np.minimum(np.arange(pixels + 1) * pixel_mm, count * size_mm)
    result: Array = np.diff(integral(at), axis=0) / pixel_mm
    return result


def _values(count: int, size_mm: float) -> Array:
    """(PARTS · count + 1, count) the same spline's values at points from wall to wall."""
    result: Array = _integrals(count, size_mm).derivative()(np.linspace(0.0, count * size_mm, PARTS * count + 1))
    return result


def _integrals(count: int, size_mm: float) -> Any:
    """The spline's integral from the first wall on, for each cell's average being 1 and the others 0."""
    from scipy.interpolate import make_interp_spline

    summed = np.vstack([np.zeros(count), np.tril(np.ones((count, count))) * size_mm])
    return make_interp_spline(np.arange(count + 1) * size_mm, summed, k=3)


def _aslant(scene: Scene, cells: Cells, emission: Single, sigma_t: float, surface: Surface) -> Array:
    """Every sight has its own direction: at the centres of the surface's cells."""
    across, along, up = cells.counts
    to_x = _values(across, cells.size_mm[0]).astype(np.float32)
    to_y = _values(along, cells.size_mm[1]).astype(np.float32)
    fine = np.empty((up, len(to_y), len(to_x), len(emission)), np.float32)
    for layer in range(up):
        wide = np.tensordot(to_x, emission[..., layer], (1, 1))  # x, moments, y
        fine[layer] = np.tensordot(to_y, wide, (1, 2)).astype(np.float32)
    shape, cell_mm = surface
    image = np.zeros(shape)
    rule = np.polynomial.legendre.leggauss(NODES)
    layers = np.arange(up)
    shares = _parabola((layers - np.clip(layers, 1, up - 2))[:, None] + 0.5 * rule[0])
    _add_along_sights(image, cell_mm, fine, shares, geometry_of(scene), sigma_t, rule)
    return image


@kernel
def _add_along_sights(
    image: Array, cell_mm: tuple[float, float], emission: Single, shares: Array, geometry: Geometry, sigma_t: float,
    rule: Rule,
) -> None:  # fmt: skip
    """∫ e^{−σt s} Σ Y_lm(v) E_lm ds, times what the surface lets through.

    Parameters
    ----------
    image
        (rows, columns), added to.
    cell_mm
        Sides of its cells along x and y.
    emission
        (layers, ny, nx, moments) values at even points from wall to wall, averages over layers.
    shares
        (layers, nodes, 3) of three layers' averages in what is at a node of a layer.
    geometry, sigma_t
        Numbers of the scene.
    rule
        Nodes and weights on [−1, 1] along a sight in each layer.
    """
    nodes, lengths = rule
    layers, points_y, points_x, moments = emission.shape
    step_x, step_y = geometry.length / (points_x - 1), 2.0 * geometry.half_width / (points_y - 1)
    height = geometry.height / layers
    degree = round(math.sqrt(moments)) - 1
    upward = np.empty(moments)
    for i, j in np.ndindex(image.shape):
        x, y = (j + 0.5) * cell_mm[0], (i + 0.5) * cell_mm[1] - geometry.half_width
        vx, vy, vz, transmission = sight_line(geometry, x, y)
        fill_harmonics(degree, vx, vy, vz, upward)
        total = 0.0
        for layer in range(layers):
            centre = min(max(layer, 1), layers - 2)
            for n in range(nodes.size):
                way = (layers - 0.5 - layer - 0.5 * nodes[n]) * height / vz
                across, along = (x - way * vx) / step_x, (y - way * vy + geometry.half_width) / step_y
                if not (0.0 <= across <= points_x - 1 and 0.0 <= along <= points_y - 1):
                    continue
                column, row = min(int(across), points_x - 2), min(int(along), points_y - 2)
                here = 0.0
                for k, below, beside in np.ndindex(3, 2, 2):
                    share = (along - row if below else 1.0 - along + row) * (
                        across - column if beside else 1.0 - across + column
                    )
                    values = emission[centre - 1 + k, row + below, column + beside]
                    told = 0.0
                    for m in range(moments):
                        told += upward[m] * values[m]
                    here += share * shares[layer, n, k] * told
                total += 0.5 * lengths[n] * height / vz * math.exp(-sigma_t * way) * here
        image[i, j] += transmission * total

"""The image of order 2, put together from tables of J."""

import math
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.double.average import average_rows
from tankrig.light.double.table import COARSE, FINE, Table, fill_table, lagrange, y_weights
from tankrig.light.rays import Geometry, light_sources, shift_invariant
from tankrig.light.surface import on_surface, to_camera
from tankrig.scene import Beam, Scene
from tankrig.scene.description import Interval

Array = NDArray[np.float64]

WIDEST_MM = 5.0
"""Widest part of a beam over which J's slow change with y₀ is taken as linear."""
NARROW_MM = 3.0
"""The same where light leaves through a side wall, and J changes at once."""


MOST_HEIGHTS = 4
"""Of beams that have a table each; more share one, as those of a projector's picture do."""

COARSE_FROM = 0.005
"""Tolerance from which coarse tables do."""


def double_scattering(scene: Scene, tolerance: float = 0.001) -> Array:
    """Image of the light scattered exactly twice, W/mm²/sr.

    Parameters
    ----------
    scene
        Any scene.
    tolerance
        Error of the whole image that is asked for, of which this order takes a tenth.

    Returns
    -------
    (rows, columns) array

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> image = double_scattering(scene)
    >>> bool(np.allclose(image, image[::-1], rtol=1e-6))  # as symmetric as the beam
    True
    """
    if scene.camera.kind == "calibrated":
        plain = on_surface(scene)
        return to_camera(scene, double_scattering(plain, tolerance), (plain.camera.pixel_mm, plain.camera.pixel_mm))
    medium, camera = scene.medium, scene.camera
    image = np.zeros(camera.shape)
    if medium.sigma_s == 0.0:
        return image
    finest = min(camera.pixel_mm, scene.tank.size_mm[0] / 20.0)
    fineness = COARSE if tolerance >= COARSE_FROM else FINE
    for geometry, beams in light_sources(scene):
        ways = (False, True) if geometry.refractive_index > 1.0 else (False,)
        heights = sorted({beam.z_mm for beam in beams})
        shared = len(heights) > MOST_HEIGHTS
        if shared:
            heights = [(heights[0][0], max(top for _, top in heights))]
        for z_mm, mirrored in product(heights, ways):
            table, z0_weights = fill_table(scene, geometry, z_mm, mirrored, finest, fineness, shared)
            rows = np.zeros((camera.shape[0], table.x_mm.size))
            for beam in beams:
                if shared:
                    _add_beam(rows, scene, geometry, beam, table, _integral(table.z0_mm, beam.z_mm))
                elif beam.z_mm == z_mm:
                    _add_beam(rows, scene, geometry, beam, table, z0_weights)
            image += rows @ _columns(table.x_mm, camera.shape[1], camera.pixel_mm, geometry.length).T
    return np.maximum(image, 0.0)  # where it is fainter than its own rounding, an interpolant may dip below


def _add_beam(rows: Array, scene: Scene, geometry: Geometry, beam: Beam, table: Table, z0_weights: Array) -> None:
    """Add one beam, cut into parts narrow enough where J is not shift-invariant."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    for low, high in _parts(beam.y_mm, table.inner_mm, shift_invariant(scene)):
        average_rows(
            rows, geometry, scene.camera.pixel_mm, table.decay, low, high,
            beam.irradiance * scene.medium.sigma_s**2, table.x_mm, table.fractions, table.margin, table.values,
            y_weights(table, 0.5 * (low + high)), table.z0_mm, z0_weights, table.mirrored,
            nodes, weights,
        )  # fmt: skip


def _parts(y_mm: Interval, inner_mm: Interval, whole: bool) -> list[Interval]:
    """A beam cut where its light begins to leave through a side wall, and into parts that are narrow enough."""
    if whole:
        return [y_mm]
    cuts = np.clip([y_mm[0], *inner_mm, y_mm[1]], *y_mm)
    parts: list[Interval] = []
    for low, high, widest in zip(cuts[:-1], cuts[1:], (NARROW_MM, WIDEST_MM, NARROW_MM), strict=True):
        if high > low:
            edges = np.linspace(low, high, 1 + math.ceil((high - low) / widest))
            parts += pairwise(edges.tolist())
    return parts


def _integral(nodes: Array, interval: tuple[float, float]) -> Array:
    """Weights that integrate the polynomial through all `nodes` over an interval."""
    places, weights = np.polynomial.legendre.leggauss(nodes.size // 2 + 1)
    half, middle = 0.5 * (interval[1] - interval[0]), 0.5 * (interval[1] + interval[0])
    return np.asarray(
        sum(half * w * lagrange(nodes, middle + half * at) for at, w in zip(places, weights, strict=True))
    )


def _columns(x: Array, columns: int, pixel_mm: float, length: float) -> Array:
    """(columns, nx) weights that average the cubic interpolant through nodes `x` over each column of pixels."""
    result = np.zeros((columns, x.size))
    edges = np.minimum(np.arange(columns + 1) * pixel_mm, length)
    _fill_columns(result, x, edges, pixel_mm, *np.polynomial.legendre.leggauss(3))
    return result


@kernel
def _fill_columns(result: Array, x: Array, edges: Array, pixel_mm: float, nodes: Array, weights: Array) -> None:
    """Gauss–Legendre between the nodes and the edges of columns, of the cubics through four nodes each."""
    interval = 0
    for column in range(edges.size - 1):
        start = edges[column]
        while start < edges[column + 1]:
            while interval < x.size - 2 and x[interval + 1] <= start:
                interval += 1
            end = min(edges[column + 1], x[interval + 1]) if interval < x.size - 2 else edges[column + 1]
            first = min(max(interval - 1, 0), x.size - 4)
            for n in range(nodes.size):
                at = 0.5 * (start + end) + 0.5 * (end - start) * nodes[n]
                for k in range(first, first + 4):
                    weight = 0.5 * weights[n] * (end - start) / pixel_mm
                    for other in range(first, first + 4):
                        if other != k:
                            weight *= (at - x[other]) / (x[k] - x[other])
                    result[column, k] += weight
            start = end

"""All orders above a few at once, in dense water."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.moments.cells import Cells, averaged_over
from tankrig.light.moments.harmonics import degrees, parities
from tankrig.light.moments.plan import MomentPlan
from tankrig.light.moments.propagation import Single, propagation
from tankrig.light.moments.seen import Surface, seen
from tankrig.light.moments.solution import COARSER, solved
from tankrig.light.moments.source import emission_moments
from tankrig.light.paths.cells import CellGrid
from tankrig.light.rays import mirror_symmetric, shift_invariant
from tankrig.scene import Scene

Array = NDArray[np.float64]

FOR_ORDERS = 1.5
"""Sides of the cells on which light is shared out between orders, over those that it is solved for on."""


@dataclass(frozen=True)
class DenseOrders:
    """Light of all orders above some on the camera's pixels, or on other cells of the surface.

    Parameters
    ----------
    to_20, beyond_20
        (rows, columns), W/mm²/sr, of the orders up to 20 and beyond. Their sum is known to the plan's bound; how it is
        shared out, to some per cent.
    """

    to_20: Array
    beyond_20: Array

    @property
    def image(self) -> Array:
        """Sum of both."""
        return self.to_20 + self.beyond_20


def dense_orders(
    scene: Scene, plan: MomentPlan, seed: int = 0, residual: float = 2e-4, surface: Surface | None = None
) -> DenseOrders:
    """Image of all orders above `plan.above`.

    The emission Q after that many scatterings is followed on in a scaled medium (delta-M: the forward peak g^{L+1}
    counts as light that goes straight on): (ω·∇ + σt') L = S' L + Q is solved for L's moments. Scaled orders are no
    physical ones, so that what is wanted is ∫ e^{−σt' s} (S' L + Q) ds − ∫ e^{−σt s} Q ds along the lines of sight.

    Parameters
    ----------
    scene
        Any scene with σs > 0 and dark walls.
    plan
        As `moment_plan` chooses it.
    seed
        Of the paths that make the source.
    residual
        Of the linear solve, relative.
    surface
        Cells that the image is made of; None for the pixels of a camera whose picture is the surface itself.
    """
    surface = surface or _pixels_of(scene)
    source = _source(scene, plan, seed)
    image = _solved_image(scene, plan, source, residual, surface)
    coarse = Cells.of(scene.tank, FOR_ORDERS * plan.side_mm)
    even = averaged_over(Cells.of(scene.tank, plan.side_mm), coarse, source)
    to_20 = _orders_to(20, scene, coarse, even, plan.above, surface)
    to_20 = np.clip(to_20, 0.0, np.maximum(image, 0.0))
    return DenseOrders(to_20, np.maximum(image, 0.0) - to_20)


def dense_image(scene: Scene, plan: MomentPlan, seed: int = 0, residual: float = 1e-5) -> Array:
    """(rows, columns) image of all orders above `plan.above` in one, on the camera's pixels, W/mm²/sr.

    For one plan and seed it is a smooth function of the medium, whose differences have no noise. Parameters are as for
    `dense_orders`.
    """
    source = _source(scene, plan, seed)
    if shift_invariant(scene):
        return _solved_image(scene, plan, source, residual, _pixels_of(scene))
    grid = CellGrid.of(scene)
    return grid.to_pixels(_solved_image(scene, plan, source, residual, ((grid.rows, grid.columns), grid.cell_mm)))


def _pixels_of(scene: Scene) -> Surface:
    pixel = scene.camera.pixel_mm
    return scene.camera.shape, (pixel, pixel)


def _source(scene: Scene, plan: MomentPlan, seed: int) -> Single:
    """Moments of the emission after `plan.above` scatterings."""
    cells = Cells.of(scene.tank, plan.side_mm)
    emission = emission_moments(scene, cells, plan.degree, plan.above, plan.batches, seed)
    if mirror_symmetric(scene):
        emission = 0.5 * (emission + emission[:, :, ::-1] * parities(plan.degree)[1][:, None, None, None])
    return emission.astype(np.float32)


def _solved_image(scene: Scene, plan: MomentPlan, source: Single, residual: float, surface: Surface) -> Array:
    """Image of what a source's light becomes, without the source itself."""
    medium, cells = scene.medium, Cells.of(scene.tank, plan.side_mm)
    moments = medium.phase_function.moments(plan.degree + 1)
    forward = moments[-1]
    scaled = medium.sigma_t - forward * medium.sigma_s
    scattering_moments = _column(medium.sigma_s * (moments[degrees(plan.degree)] - forward))
    transport, coarse = (
        propagation(plan.degree, these, scaled, scene.tank.surface_index)
        for these in (cells, Cells.of(scene.tank, COARSER * plan.side_mm))
    )
    field = solved(transport, coarse, scattering_moments, transport(source), residual)
    whole = seen(scene, cells, scattering_moments * field + source, scaled, surface)
    return whole - seen(scene, cells, source, medium.sigma_t, surface)


def _orders_to(last: int, scene: Scene, cells: Cells, source: Single, above: int, surface: Surface) -> Array:
    """Image of the orders above + 1 … last, one after the other: forward peaks need all degrees."""
    medium = scene.medium
    degree = math.isqrt(len(source)) - 1
    transport = propagation(degree, cells, medium.sigma_t, scene.tank.surface_index)
    scattered = _column(medium.sigma_s * medium.phase_function.moments(degree)[degrees(degree)])
    emission = source[: (degree + 1) ** 2]
    total = np.zeros_like(emission)
    for _ in range(above, last):
        emission = scattered * transport(emission)
        total += emission
    return seen(scene, cells, total, medium.sigma_t, surface)


def _column(values: NDArray[np.floating]) -> Single:
    """One number per moment, ready to multiply cells."""
    return values.astype(np.float32)[:, None, None, None]

"""Light scattered once: a quadrature without noise, for every kind of projector, camera and surface."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.geometry.optics import reflectance
from tankrig.montecarlo.draws import turning
from tankrig.montecarlo.kernel_scene import (
    KernelScene,
    Ray,
    Vector,
    beam_table,
    departure,
    kernel_scene,
    pixel_at,
    pixel_weights,
    seen,
)
from tankrig.scene import Scene

SHEET_MM = 1.0
"""Largest thickness of the horizontal sheets that a beam is cut into."""
MAX_SHEETS = 1024
OPAQUE = 40.0
"""Optical depth behind which nothing is visible at double precision."""


def first_order(scene: Scene) -> NDArray[np.float64]:
    """Image of the light that was scattered exactly once, averaged over each pixel's area.

    The corrected form of the paper's Eq. 7: I₁ = ∫ σs p(θ) e^{−σt (d₁ + d₂)} E₀ ds, E₀ spread from a pinhole as the
    rays spread, and × (1 − F)/n² at a Fresnel surface, where the beam that is reflected from below is a source too.
    The lit volume is cut along the projector's rays into
    cells of a fraction of a pixel; the light of each is shared out by area among the pixels it covers, so that
    sharp beam edges stay sharp and no light is lost between pixels.

    Parameters
    ----------
    scene
        Any scene.

    Returns
    -------
    array (rows, columns)
        Radiance that leaves z = Lz towards the camera, W/mm²/sr.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> scene = Scene(
    ...     tank=Tank(),
    ...     medium=Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.0),
    ...     projector=Projector("collimated", beams=(Beam((-2.0, 2.0), (58.0, 62.0)),)),
    ...     camera=Camera("orthographic", shape=(80, 120), pixel_mm=2.0),
    ... )
    >>> round(float(first_order(scene)[40, 0]), 6)  # ≈ 4 mm · 0.0198/4π · e^{−0.02 · 61}
    0.001861
    """
    flat = kernel_scene(scene)
    image = np.zeros(scene.camera.shape)
    if scene.medium.sigma_s > 0.0:
        for y_low, y_high, z_low, z_high, irradiance in beam_table(scene):
            _light_beam(flat, y_low, y_high, z_low, z_high, irradiance, image)
    return image * pixel_weights(scene)


@kernel
def _cell(scene: KernelScene) -> float:
    """Side of a cell, mm: a fraction of a pixel, smaller where cells are seen askew (halving it again adds 0.01 %)."""
    return scene.pixel / (4.0 if scene.camera_pinhole or scene.projector_pinhole else 2.0)


@kernel
def _light_beam(
    scene: KernelScene,
    y_low: float,
    y_high: float,
    z_low: float,
    z_high: float,
    irradiance: float,
    image: NDArray[np.float64],
) -> None:
    """Add one beam, cut into rays of rectangular section that spread as the projector's rays do."""
    strips = math.ceil((y_high - y_low) / _cell(scene))
    sheets = min(math.ceil((z_high - z_low) * max(1.0 / SHEET_MM, scene.sigma_t)), MAX_SHEETS)
    width, thickness = (y_high - y_low) / strips, (z_high - z_low) / sheets
    for sheet in range(sheets):
        for strip in range(strips):
            y, z = y_low + (strip + 0.5) * width, z_low + (sheet + 0.5) * thickness
            _light_ray(scene, y, z, width, thickness, irradiance * width * thickness, image)


@kernel
def _light_ray(
    scene: KernelScene, y: float, z: float, width: float, thickness: float, power: float, image: NDArray[np.float64]
) -> None:
    """Add one ray, cell by cell, up to the far wall; behind a Fresnel surface its mirror image goes on below."""
    ux, uy, uz = departure(scene, y, z)
    wider, higher = _spreading(scene, y, z, width, thickness)
    cells = math.ceil(scene.length / ux / min(_cell(scene), 0.2 / scene.sigma_t))
    half = scene.length / ux / (2 * cells)
    height, mirrored = scene.height, 0.0
    if uz > 0.0 and scene.refractive_index != 1.0:
        mirrored = reflectance(uz, scene.refractive_index)
    for cell in range(cells):
        distance = (2 * cell + 1) * half
        if scene.sigma_t * distance > OPAQUE:
            return
        spread, rise = 1.0 + wider * ux * distance, 1.0 + higher * ux * distance
        centre_y, half_y = _cut(y + uy * distance, 0.5 * width * spread, -scene.half_width, scene.half_width)
        if half_y <= 0.0:
            continue
        # Scattered per volume of the cut cell: irradiance times e^{−σt s} averaged over the cell's length, times σs.
        scattered = power * scene.albedo * 2.0 * math.sinh(scene.sigma_t * half) * math.exp(-scene.sigma_t * distance)
        scattered *= 2.0 * half_y / (width * spread)
        level, half_level = z + uz * distance, 0.5 * thickness * rise
        centre_z, half_z = _cut(level, half_level, 0.0, height)
        if half_z > 0.0:
            share = scattered * half_z / half_level
            ray = Ray(ux * distance, centre_y, centre_z, ux, uy, uz)
            _show_cell(scene, ray, (half * ux, half_y, half_z), share, image)
        centre_z, half_z = _cut(2.0 * height - level, half_level, 0.0, height)
        if mirrored > 0.0 and half_z > 0.0:
            share = mirrored * scattered * half_z / half_level
            ray = Ray(ux * distance, centre_y, centre_z, ux, uy, -uz)
            _show_cell(scene, ray, (half * ux, half_y, half_z), share, image)


@kernel
def _spreading(scene: KernelScene, y: float, z: float, width: float, thickness: float) -> tuple[float, float]:
    """How much wider and higher, relative to what it is at the wall, a ray's section grows per mm of x."""
    if not scene.projector_pinhole:
        return 0.0, 0.0
    if scene.bends[0] == 1.0 and scene.bends[1] == 0.0:
        return -1.0 / scene.projector[0], -1.0 / scene.projector[0]
    left, right = departure(scene, y - 0.5 * width, z), departure(scene, y + 0.5 * width, z)
    low, high = departure(scene, y, z - 0.5 * thickness), departure(scene, y, z + 0.5 * thickness)
    return (right[1] / right[0] - left[1] / left[0]) / width, (high[2] / high[0] - low[2] / low[0]) / thickness


@kernel
def _cut(centre: float, half: float, low: float, high: float) -> tuple[float, float]:
    """Centre and half-width of the part of an interval between `low` and `high`."""
    bottom, top = max(centre - half, low), min(centre + half, high)
    return 0.5 * (top + bottom), 0.5 * (top - bottom)


@kernel
def _show_cell(scene: KernelScene, ray: Ray, half: Vector, scattered: float, image: NDArray[np.float64]) -> None:
    """Add what a lit cell of half-widths `half` about a ray's point scatters towards the camera.

    It is scattered · p(cos θ) T J e^{−σt path} sinh(τ)/τ, with τ = σt Δz/2v_z for the path's mean over its height.
    """
    x, y, z, ux, uy, uz = ray
    half_x, half_y, half_z = half
    px, py, vx, vy, vz, path, factor = seen(scene, x, y, z)
    if factor == 0.0:
        return
    edge_x, _, _, _, _, _, _ = seen(scene, x + half_x, y, z)
    _, edge_y, _, _, _, _, _ = seen(scene, x, y + half_y, z)
    tau = scene.sigma_t * half_z / vz  # the way to the surface differs within the cell
    factor *= math.exp(-scene.sigma_t * path) * math.sinh(tau) / tau
    value = scattered * factor * turning(ux * vx + uy * vy + uz * vz, scene.phase)
    _share_out(scene, px, py, abs(edge_x - px), abs(edge_y - py), value, image)


@kernel
def _share_out(
    scene: KernelScene, px: float, py: float, half_x: float, half_y: float, value: float, image: NDArray[np.float64]
) -> None:
    """Add `value`, spread evenly over a rectangle of the surface, to the pixels it overlaps, per area.

    Where pixels are no squares of the surface, the rectangle becomes one in the picture, with the variance of its
    image there: what that blurs is a fraction of a cell, which is a fraction of a pixel.
    """
    half_x, half_y = max(half_x, 1e-9 * scene.pixel), max(half_y, 1e-9 * scene.pixel)
    x_low, x_high = max(px - half_x, 0.0), min(px + half_x, scene.length)
    y_low, y_high = max(py - half_y, -scene.half_width), min(py + half_y, scene.half_width)
    if x_high <= x_low or y_high <= y_low:
        return
    value *= (x_high - x_low) * (y_high - y_low) / (4.0 * half_x * half_y)
    x, y = 0.5 * (x_low + x_high), 0.5 * (y_low + y_high)
    across, along = pixel_at(scene, x, y)
    across_x, along_x = pixel_at(scene, x_high, y)
    across_y, along_y = pixel_at(scene, x, y_high)
    if min(across, across_x, across_y) < -1e8:  # not in the picture
        return
    half_across = math.sqrt((across_x - across) ** 2 + (across_y - across) ** 2)
    half_along = math.sqrt((along_x - along) ** 2 + (along_y - along) ** 2)
    density = value / (4.0 * half_across * half_along * scene.pixel**2)
    left, right = max(across - half_across, 0.0), min(across + half_across, float(scene.columns))
    low, high = max(along - half_along, 0.0), min(along + half_along, float(scene.rows))
    for row in range(int(low), math.ceil(high)):
        overlap_y = min(high, row + 1.0) - max(low, float(row))
        for column in range(int(left), math.ceil(right)):
            overlap_x = min(right, column + 1.0) - max(left, float(column))
            image[row, column] += density * overlap_x * overlap_y

"""What the camera sees of a photon on its way: its next collision, wherever along the flight that may happen."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.montecarlo.draws import turning
from tankrig.montecarlo.kernel_scene import Flight, KernelScene, Ray, pixel_at, seen

CLASSES = 4
"""Orders 2, 3, 4–20 and above 20; order 1 needs no photons."""
NEAR = 4.0
"""Optical depth up to which points are spread evenly; one more stands for all that is behind."""
POINTS_UPRIGHT, POINTS_PINHOLE = 32, 6
"""Points per stretch, at most: where the line of sight is always upright each costs a tenth."""


@part
def score_flight(
    scene: KernelScene, ray: Ray, flight: Flight, weight: float, order: int, u: float, images: NDArray[np.float64]
) -> None:
    """Show a flight to the camera: its stretch to the first wall and, behind a Fresnel surface, the reflected one."""
    first, reflected, second = flight
    _show_stretch(scene, ray, first, weight, order, u, images)
    if reflected > 0.0:
        weight *= reflected * math.exp(-scene.sigma_t * first)
        below = Ray(ray.x + ray.ux * first, ray.y + ray.uy * first, scene.height, ray.ux, ray.uy, -ray.uz)
        _show_stretch(scene, below, second, weight, order, u, images)


@kernel
def _show_stretch(
    scene: KernelScene, ray: Ray, length: float, weight: float, order: int, u: float, images: NDArray[np.float64]
) -> None:
    """Add the expected value of the next collision's estimate, ∫ weight σs e^{−σt s} p(cos θ) … ds, by a few points s.

    The points are one step apart from a start that u, uniform in [0, 1), shifts: without bias, and with far less noise
    than one collision at random, because each point falls into a pixel of its own.
    """
    near = min(length, NEAR / scene.sigma_t)
    most = POINTS_PINHOLE if scene.camera_pinhole else POINTS_UPRIGHT
    points = min(max(int(near / scene.pixel) + 1, 4), most)
    step = near / points
    kind = order - 2 if order < 4 else (2 if order <= 20 else 3)
    weight *= scene.albedo
    shown = 0
    if not scene.camera_pinhole:
        _show_upright(scene, ray, points, u, step, weight * scene.sigma_t * step, kind, images)
        shown = points
    for point in range(shown, points + (1 if length > near else 0)):
        distance, scattered = (point + u) * step, weight * scene.sigma_t * step
        if point == points:  # the one that stands for all light that gets further than `near`
            here, there = math.exp(-NEAR), math.exp(-scene.sigma_t * length)
            left = here - u * (here - there)
            distance, scattered = -math.log(left) / scene.sigma_t, weight * (here - there) / left
        _show_point(scene, ray, distance, scattered, kind, images)


@part
def _show_point(
    scene: KernelScene, ray: Ray, distance: float, scattered: float, kind: int, images: NDArray[np.float64]
) -> None:
    """Add what one point of a stretch sends to the camera, `scattered` p(cos θ) e^{−σt (s + path)} T J (see `seen`)."""
    x, y, z, ux, uy, uz = ray
    px, py, vx, vy, vz, path, factor = seen(scene, x + ux * distance, y + uy * distance, z + uz * distance)
    across, along = pixel_at(scene, px, py)
    column, row = int(across), int(along)
    if factor > 0.0 and across >= 0.0 and column < scene.columns and along >= 0.0 and row < scene.rows:
        lobe = turning(ux * vx + uy * vy + uz * vz, scene.phase)
        images[kind, row, column] += scattered * factor * lobe * math.exp(-scene.sigma_t * (distance + path))


@part
def _show_upright(
    scene: KernelScene, ray: Ray, points: int, u: float, step: float, scattered: float, kind: int,
    images: NDArray[np.float64],
) -> None:  # fmt: skip
    """`_show_point` for evenly spaced points under an orthographic camera, where each is a constant times the last."""
    x, y, z, ux, uy, uz = ray
    _, _, _, _, _, path, factor = seen(scene, x, y, z)
    slope = scene.sigma_t * (1.0 - uz) * step
    value = scattered * factor * turning(uz, scene.phase) * math.exp(-scene.sigma_t * path - u * slope)
    ratio = math.exp(-slope)
    scale = 1.0 / scene.pixel
    column, row = (x + ux * u * step) * scale, (y + uy * u * step + scene.half_width) * scale
    for _ in range(points):
        if column < scene.columns and row < scene.rows:
            images[kind, int(row), int(column)] += value
        column += ux * step * scale
        row += uy * step * scale
        value *= ratio

"""A scene as the flat numbers that kernels read, and what they ask of it.

Which way does the projector's light enter (`departure`), how far does a ray go (`flight`), and where and how does the
camera see a point (`seen`)?
"""

import math
from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.lens import to_rays
from tankrig.geometry.optics import crossing_offset, entry_slope, pixel_seen, reflectance
from tankrig.montecarlo.draws import AnyTable, phase_table
from tankrig.scene import Camera, Scene
from tankrig.scene.footprint import footprints

Nine = tuple[float, ...]
NOTHING: Nine = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


Vector = tuple[float, float, float]


class Ray(NamedTuple):
    """Light at a point of the water and the direction it travels in, a unit vector; mm."""

    x: float
    y: float
    z: float
    ux: float
    uy: float
    uz: float


class Flight(NamedTuple):
    """How far a ray goes."""

    first: float
    """Distance to the first wall, mm."""
    reflected: float
    """Fraction of the light that arrives there and is reflected; 0 unless it is a Fresnel surface."""
    second: float
    """Distance from the surface to the black wall that the reflected light meets; 0 where nothing is reflected. It
    never meets the surface again, because it travels down."""


class KernelScene(NamedTuple):
    """A scene without its beams: numbers only, which pass from kernel to kernel in registers. Lengths in mm."""

    length: float
    half_width: float
    height: float
    refractive_index: float
    """Refractive index that the surface shows; 1 when matched."""
    sigma_t: float
    albedo: float
    phase: AnyTable
    rows: int
    columns: int
    pixel: float
    camera_pinhole: bool
    camera: tuple[float, float, float]
    projector_pinhole: bool
    projector: tuple[float, float, float]
    bends: tuple[float, float, float]
    """At x = 0: index of the water, thickness and index of the wall."""
    calibrated: bool
    """Whether the camera's pixels are quadrangles of the surface; then they are found by its lens and its turn."""
    lens: Nine
    turn: Nine
    widest: float


def kernel_scene(scene: Scene) -> KernelScene:
    """Flatten `scene` for kernels."""
    length, width, height = scene.tank.size_mm
    rows, columns = scene.camera.shape
    calibrated = scene.camera.kind == "calibrated"
    lens, turn, widest = _optics(scene.camera) if calibrated else (NOTHING, NOTHING, 0.0)
    return KernelScene(
        float(length),
        width / 2.0,
        float(height),
        float(scene.tank.surface_index),
        float(scene.medium.sigma_t),
        float(scene.medium.albedo),
        phase_table(scene.medium.phase_function),
        int(rows),
        int(columns),
        float(scene.camera.pixel_mm),
        scene.camera.kind != "orthographic",
        _point(scene.camera.position_mm),
        scene.projector.kind != "collimated",
        _point(scene.projector.position_mm),
        scene.tank.entry_bends,
        calibrated,
        lens,
        turn,
        widest,
    )


def _optics(camera: Camera) -> tuple[Nine, Nine, float]:
    """Lens, turn and the widest angle of a calibrated camera, for kernels."""
    lens, (rows, columns) = camera.lens, camera.shape
    border = [[u, v] for u in np.linspace(-1.0, columns, 33) for v in (-1.0, rows)]
    border += [[u, v] for v in np.linspace(-1.0, rows, 33) for u in (-1.0, columns)]
    rays = to_rays(lens, border)
    widest = float(np.nanmax(np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]))
    return astuple(lens), tuple(camera.pose.matrix.ravel().tolist()), widest


def pixel_weights(scene: Scene) -> NDArray[np.float64] | float:
    """Area of a typical pixel over that of each pixel, 0 where a pixel doesn't look at the surface."""
    if scene.camera.kind != "calibrated":
        return 1.0
    areas = footprints(scene.camera, scene.tank).areas_mm2
    return np.nan_to_num(scene.camera.pixel_mm**2 / areas)


def beam_table(scene: Scene) -> NDArray[np.float64]:
    """Beams for kernels: (beams, 5), y low, y high, z low, z high in mm and irradiance in W/mm²."""
    return np.array([(*beam.y_mm, *beam.z_mm, beam.irradiance) for beam in scene.projector.beams], np.float64)


def _point(position: tuple[float, float, float] | None) -> tuple[float, float, float]:
    x, y, z = position or (0.0, 0.0, 0.0)
    return float(x), float(y), float(z)


@part
def departure(scene: KernelScene, y: float, z: float) -> tuple[float, float, float]:
    """Direction in which the projector's light crosses the wall at (0, y, z)."""
    if not scene.projector_pinhole:
        return 1.0, 0.0, 0.0
    if scene.bends[0] != 1.0 or scene.bends[1] != 0.0:
        return _bent_departure(scene, y - scene.projector[1], z - scene.projector[2])
    apex_x, apex_y, apex_z = scene.projector
    across, up = (y - apex_y) / -apex_x, (z - apex_z) / -apex_x
    forward = 1.0 / math.sqrt(1.0 + across * across + up * up)
    return forward, across * forward, up * forward


@kernel
def _bent_departure(scene: KernelScene, y: float, z: float) -> tuple[float, float, float]:
    slope = entry_slope(math.sqrt(y * y + z * z), -scene.projector[0], *scene.bends)
    forward = 1.0 / math.sqrt(1.0 + slope * slope * (y * y + z * z))
    return forward, slope * y * forward, slope * z * forward


@part
def pixel_at(scene: KernelScene, px: float, py: float) -> tuple[float, float]:
    """Column and row of a point of the plane z = Lz, counted from the first pixel's edge."""
    if scene.calibrated:
        x, y, z = scene.camera
        u, v = pixel_seen(scene.lens, scene.turn, scene.widest, px - x, py - y, scene.height - z)
        return u + 0.5, v + 0.5
    return px / scene.pixel, (py + scene.half_width) / scene.pixel


@part
def _to_wall(position: float, direction: float, low: float, high: float) -> float:
    if direction > 1e-300:
        return max((high - position) / direction, 0.0)
    if direction < -1e-300:
        return max((low - position) / direction, 0.0)
    return math.inf


@part
def flight(scene: KernelScene, ray: Ray) -> Flight:
    """How far a ray goes: to the first wall, and on from there if that is the water surface, which reflects."""
    x, y, z, ux, uy, uz = ray
    sideways = min(_to_wall(x, ux, 0.0, scene.length), _to_wall(y, uy, -scene.half_width, scene.half_width))
    upright = _to_wall(z, uz, 0.0, scene.height)
    if uz <= 0.0 or upright >= sideways or scene.refractive_index == 1.0:
        return Flight(min(sideways, upright), 0.0, 0.0)
    return Flight(upright, reflectance(uz, scene.refractive_index), min(sideways - upright, scene.height / uz))


@part
def seen(scene: KernelScene, x: float, y: float, z: float) -> tuple[float, float, float, float, float, float, float]:
    """Where and how the camera sees a point of the tank.

    A pixel is an area A of the plane z = Lz; its value is the mean radiance that leaves it towards the camera. A point
    that sends I W/sr towards the camera adds e^{−σt path} · factor · I / A, with factor = T J: T = (1 − F)/n² what
    becomes of radiance at the surface, and J = dA ds/dV the surface through which the camera sees one unit of
    cross-section at the point. With ρ and r the horizontal distances of crossing and point from the pinhole,
    J = ρ dρ / (r dr cos θ_water).

    Returns
    -------
    px, py
        x and y of the point of the plane z = Lz through which it is seen, mm.
    vx, vy, vz
        Direction of travel in the water of the light that the camera sees.
    path
        Way through the water to the surface, mm.
    factor
        As above; 0 where the line of sight doesn't come through the surface.
    """
    depth = scene.height - z
    if scene.camera_pinhole:
        return _seen_from_pinhole(scene, x, y, depth)
    return x, y, 0.0, 0.0, 1.0, depth, _transmittance(scene, 1.0)


@part
def _transmittance(scene: KernelScene, cosine_air: float) -> float:
    """(1 − F)/n²: radiance in the air over radiance in the water."""
    if scene.refractive_index == 1.0:
        return 1.0
    return (1.0 - reflectance(cosine_air, 1.0 / scene.refractive_index)) / scene.refractive_index**2


@kernel
def _seen_from_pinhole(
    scene: KernelScene, x: float, y: float, depth: float
) -> tuple[float, float, float, float, float, float, float]:
    toward_x, toward_y, height = scene.camera[0] - x, scene.camera[1] - y, scene.camera[2] - scene.height
    offset = math.sqrt(toward_x * toward_x + toward_y * toward_y)
    rho = crossing_offset(offset, depth, height, scene.refractive_index)
    if offset > 0.0:
        toward_x, toward_y = toward_x / offset, toward_y / offset
    px, py = scene.camera[0] - toward_x * rho, scene.camera[1] - toward_y * rho
    n_squared = scene.refractive_index**2
    reach = n_squared * height * height
    squared = (n_squared - 1.0) * rho * rho + reach
    root = math.sqrt(squared)
    tangent = rho / root
    vz = 1.0 / math.sqrt(1.0 + tangent * tangent)
    vx, vy = toward_x * tangent * vz, toward_y * tangent * vz
    factor = 0.0
    if 0.0 <= px <= scene.length and abs(py) <= scene.half_width:
        factor = _transmittance(scene, height / math.sqrt(rho * rho + height * height))
        factor /= (1.0 + depth / root) * (1.0 + depth * reach / (squared * root)) * vz
    return px, py, vx, vy, vz, depth / vz, factor

"""Straight rays in the tank: where light travels before its first scattering, and along which lines the camera looks.

Every model that follows uncollided light or camera rays exactly is built on these three functions; the geometry they
read is a tuple of numbers, so that compiled kernels can take it.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.geometry.optics import crossing_offset, entry_slope, reflectance
from tankrig.scene import Beam, Scene

Edges = tuple[float, float, float, float]
"""Edges of a beam on the plane x = 0: y low, y high, z low, z high, mm."""


class Ray(NamedTuple):
    """Light at a point of the water and the direction it travels in, a unit vector; mm."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float


class Geometry(NamedTuple):
    """Tank, projector and camera as numbers for kernels; lengths in mm, z up, light enters at x = 0."""

    length: float
    """Lx."""
    half_width: float
    """Ly/2."""
    height: float
    """Lz, the water level."""
    refractive_index: float
    """Refractive index that the surface shows; 1 when matched."""
    light_pinhole: bool
    light_x: float
    light_y: float
    light_z: float
    camera_pinhole: bool
    camera_x: float
    camera_y: float
    camera_z: float
    entry_index: float = 1.0
    """Refractive index of the water as the light sees it that enters at x = 0; 1 when matched."""
    pane: float = 0.0
    """Thickness of the wall that the light enters through."""
    pane_index: float = 1.0
    reflected: bool = False
    """Whether the light is what a Fresnel surface sends back: projector and beams are then mirror images above it."""


def geometry_of(scene: Scene) -> Geometry:
    """Numbers of a scene's tank, projector and camera.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.5), light, Camera("orthographic", (80, 120), 2.0))
    >>> geometry_of(scene).half_width
    80.0
    """
    length, width, height = scene.tank.size_mm
    light, camera = scene.projector, scene.camera
    return Geometry(
        length,
        width / 2,
        height,
        scene.tank.surface_index,
        light.kind != "collimated",
        *(light.position_mm or (-1.0, 0.0, 0.0)),
        camera.kind != "orthographic",
        *(camera.position_mm or (0.0, 0.0, height + 1.0)),
        *scene.tank.entry_bends,
    )


def light_sources(scene: Scene) -> list[tuple[Geometry, tuple[Beam, ...]]]:
    """The projector and its beams, and their mirror images where rising light meets a Fresnel surface inside the tank.

    Unfolded, reflected light runs straight: from the mirror image of the projector, through the mirror image of the
    beam, with the reflectance as a factor.
    """
    geometry, beams = geometry_of(scene), scene.projector.beams
    sources = [(geometry, beams)]
    if geometry.refractive_index > 1.0 and any(_reaches_surface(geometry, beam) for beam in beams):
        twice = 2.0 * geometry.height
        image = geometry._replace(light_z=twice - geometry.light_z, reflected=True)
        mirrored = [replace(beam, z_mm=(twice - beam.z_mm[1], twice - beam.z_mm[0])) for beam in beams]
        sources.append((image, tuple(mirrored)))
    return sources


def _reaches_surface(geometry: Geometry, beam: Beam) -> bool:
    ux, _, uz = light_ray(geometry, 0.5 * (beam.y_mm[0] + beam.y_mm[1]), beam.z_mm[1])
    return bool(beam.z_mm[1] + uz / ux * geometry.length > geometry.height)


def shift_invariant(scene: Scene) -> bool:
    """Whether light and sight run straight, so that only y − y₀ matters."""
    return scene.projector.kind == "collimated" and scene.camera.kind == "orthographic"


def mirror_symmetric(scene: Scene) -> bool:
    """Whether the scene is its own mirror image in the plane y = 0."""
    mirrored = {Beam((-beam.y_mm[1], -beam.y_mm[0]), beam.z_mm, beam.irradiance) for beam in scene.projector.beams}
    light, camera = scene.projector, scene.camera
    return (
        mirrored == set(light.beams)
        and scene.tank.faces.left == scene.tank.faces.right
        and (light.kind == "collimated" or (light.position_mm is not None and light.position_mm[1] == 0.0))
        and (camera.kind == "orthographic" or (camera.position_mm is not None and camera.position_mm[1] == 0.0))
    )


@kernel
def sight_line(geometry: Geometry, x: float, y: float) -> tuple[float, float, float, float]:
    """Direction of travel in the water of the light that leaves (x, y, Lz) towards the camera, and what gets out.

    Returns
    -------
    vx, vy, vz, transmission
        Unit vector pointing up, and radiance in air per radiance just below the surface, (1 − F)/n².
    """
    if not geometry.camera_pinhole:
        return 0.0, 0.0, 1.0, (1.0 - reflectance(1.0, 1.0 / geometry.refractive_index)) / geometry.refractive_index**2
    dx, dy, dz = geometry.camera_x - x, geometry.camera_y - y, geometry.camera_z - geometry.height
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    transmission = (1.0 - reflectance(dz / distance, 1.0 / geometry.refractive_index)) / geometry.refractive_index**2
    vx, vy = (
        dx / (distance * geometry.refractive_index),
        dy / (distance * geometry.refractive_index),
    )
    return vx, vy, math.sqrt(1.0 - vx * vx - vy * vy), transmission


@kernel
def light_ray(geometry: Geometry, y0: float, z0: float) -> tuple[float, float, float]:
    """Unit direction in which light enters at (0, y0, z0)."""
    if not geometry.light_pinhole:
        return 1.0, 0.0, 0.0
    if bent(geometry):
        dy, dz = y0 - geometry.light_y, z0 - geometry.light_z
        offset = math.sqrt(dy * dy + dz * dz)
        slope = entry_slope(offset, -geometry.light_x, geometry.entry_index, geometry.pane, geometry.pane_index)
        ux = 1.0 / math.sqrt(1.0 + slope * slope * offset * offset)
        return ux, ux * slope * dy, ux * slope * dz
    dx, dy, dz = -geometry.light_x, y0 - geometry.light_y, z0 - geometry.light_z
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    return dx / distance, dy / distance, dz / distance


@kernel
def bent(geometry: Geometry) -> bool:
    """Whether light from the projector's pinhole is bent where it enters."""
    return geometry.light_pinhole and (geometry.entry_index != 1.0 or geometry.pane != 0.0)


@kernel
def bent_light(geometry: Geometry, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Bent light at a point in the water.

    Rays of one pinhole behind a plane wall spread evenly about its normal: where a ray has the offset r₀ from the
    normal at x = 0 and the slope t(r₀) in the water, r = r₀ + x t, and areas across x grow by (r/r₀)(dr/dr₀).

    Returns
    -------
    ux, uy, uz
        Its unit direction.
    spread
        Fluence rate, before attenuation, per flux through an area of the plane x = 0.
    share
        Of y − y_pinhole and z − z_pinhole, where the ray came through x = 0.
    """
    dy, dz = y - geometry.light_y, z - geometry.light_z
    offset = math.sqrt(dy * dy + dz * dz)
    n, glass, pane = geometry.entry_index, geometry.pane_index, geometry.pane
    height = -geometry.light_x - pane
    rho = crossing_offset(offset, x, height, n, pane, glass)
    in_water = math.sqrt((n * n - 1.0) * rho * rho + n * n * height * height)
    in_glass = math.sqrt((glass * glass - 1.0) * rho * rho + glass * glass * height * height)
    at_wall = 1.0 + pane / in_glass  # r₀ over ρ, and dr₀/dρ
    at_wall_slope = 1.0 + pane * (glass * height) ** 2 / in_glass**3
    along = 1.0 + x / (in_water * at_wall)
    outward = 1.0 + x * (n * height) ** 2 / (in_water**3 * at_wall_slope)
    tangent = rho / in_water
    ux = 1.0 / math.sqrt(1.0 + tangent * tangent)
    turn = ux * tangent / offset if offset > 1e-9 else 0.0
    return ux, turn * dy, turn * dz, 1.0 / (along * outward * ux), 1.0 / along


@kernel
def light_kept(geometry: Geometry, uz: float) -> float:
    """Share of a light ray's flux that its source still has: R(ξ) when the surface has reflected it."""
    return reflectance(abs(uz), geometry.refractive_index) if geometry.reflected else 1.0


@kernel
def path_inside(
    geometry: Geometry, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Distances (enter, leave) along a straight line through the tank's box; leave ≤ enter when it misses.

    `enter` is not below 0: the line starts at (x, y, z).
    """
    enter, leave = 0.0, 1e30
    for low, high, position, slope in (
        (0.0, geometry.length, x, dx),
        (-geometry.half_width, geometry.half_width, y, dy),
        (0.0, geometry.height, z, dz),
    ):
        if abs(slope) < 1e-14:
            if position < low - 1e-9 or position > high + 1e-9:
                leave = -1.0
            continue
        first, last = (low - position) / slope, (high - position) / slope
        enter = max(enter, min(first, last))
        leave = min(leave, max(first, last))
    return enter, leave


FARTHEST_ROW = 1e6
"""Beyond any tank, mm: where lines of sight and light rays are nearly parallel, they meet at infinity."""


@kernel
def sighting_row(geometry: Geometry, x: float, y0: float, z0: float) -> float:
    """The y at which the line of sight through (x, y, Lz) meets the light ray from (0, y0, z0), both extended.

    Found by secant steps on the lines' triple product, which is linear in y for straight lines of sight and nearly so
    for bent ones. It is finite whatever the scene, so that rows and columns may be counted from it.
    """
    ux, uy, uz = light_ray(geometry, y0, z0)
    before, now = y0, y0 + 1.0
    miss_before = _miss(geometry, x, before, y0, z0, ux, uy, uz)
    for _ in range(12):
        miss_now = _miss(geometry, x, now, y0, z0, ux, uy, uz)
        change = miss_now - miss_before
        if abs(change) < 1e-13 * abs(miss_now) or change == 0.0:
            break
        step = miss_now * (now - before) / change
        before, miss_before, now = now, miss_now, min(max(now - step, -FARTHEST_ROW), FARTHEST_ROW)
        if abs(step) < 1e-11 * (1.0 + abs(now)):
            break
    return now


@kernel
def sighting_rows(geometry: Geometry, x: NDArray[np.float64], y0: float, z0: float) -> NDArray[np.float64]:
    """`sighting_row` at each of several x."""
    rows = np.empty(x.size)
    for i in range(x.size):
        rows[i] = sighting_row(geometry, x[i], y0, z0)
    return rows


@kernel
def _miss(geometry: Geometry, x: float, y: float, y0: float, z0: float, ux: float, uy: float, uz: float) -> float:
    """Triple product (C − A)·(u × v) of a line of sight and a light ray: zero when they meet.

    v is not of length 1: of its own length the product has a kink below a camera that is close to the water.
    """
    vx, vy, vz = 0.0, 0.0, 1.0
    if geometry.camera_pinhole:
        vx, vy, above = geometry.camera_x - x, geometry.camera_y - y, geometry.camera_z - geometry.height
        squared = geometry.refractive_index * geometry.refractive_index
        vz = math.sqrt((squared - 1.0) * (vx * vx + vy * vy) + squared * above * above)
    wy, wz = y - y0, geometry.height - z0
    return x * (uy * vz - uz * vy) + wy * (uz * vx - ux * vz) + wz * (ux * vy - uy * vx)

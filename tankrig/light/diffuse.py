"""The diffuse limit: light that has scattered so often that its direction is nearly lost (the paper's section 2.3).

The fluence rate φ and flux F of the scattered light obey the P1 equations in the tank's box,

    ∇·F + σa φ = σs E,    ∇φ/3 + (σt − g σs) F = g σs E ω_in,

with the attenuated light E of the projector as source: −D ∇²φ + σa φ = σs E − ∇·(3 D g σs E ω_in), 3 D = 1/(σt − g σs).
φ vanishes 0.7104 A/(σt − g σs) outside each face (A = 1 for a black one), which makes the box's solution a sine series.

Part of the forward peak counts as light that has not scattered (as in the delta-Eddington approximation): σs, g and σt
above are those of the rest, with the same σs (1 − g).
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.errors import SceneError
from tankrig.geometry.optics import fresnel_reflectance
from tankrig.light.rays import Geometry, bent, geometry_of, path_inside, sight_line
from tankrig.light.single import single_scattering
from tankrig.light.surface import on_surface, to_camera
from tankrig.scene import Medium, Scene

Floats = NDArray[np.float64]
Axes = tuple[Floats, Floats, Floats]

_MILNE = 0.7104
"""Distance in transport mean free paths at which the fluence rate near a black face extrapolates to zero (exact for a
half-space that doesn't absorb; Marshak's condition has 2/3)."""
_MOST_CELLS = 1_500_000


def diffuse_image(scene: Scene, step_mm: float | None = None) -> Floats:
    """Image of a dense medium: light straight from the beams, and ∫ e^{−σt s} σs (φ + 3 g F·v)/4π ds, W/mm²/sr.

    The integral runs along the line of sight in direction v and is scaled by what the surface lets through. Light from
    the beams is single scattering in closed form, exact for g ≤ 0 and spread by the forward peak otherwise.

    Parameters
    ----------
    scene
        Any scene; both projectors, both cameras, matched or Fresnel surface. Light that meets a Fresnel surface from
        below before its first scattering is not followed.
    step_mm
        Side of a cell; by default an eightieth of the tank's mean side.

    Returns
    -------
    (rows, columns) array
        Holds where light scatters over many transport mean free paths 1/(σt − g σs) before it leaves; measured errors
        stand in docs/models.md.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-60.0, 60.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0005, 0.0995, 0.0), light, Camera("orthographic", (20, 30), 8.0))
    >>> image = diffuse_image(scene)
    >>> bool(image[10, 2] > image[10, 10] > image[10, 25] > 0.0)  # brightest near the projector
    True
    """
    if bent(geometry_of(scene)):
        raise SceneError('tank.entry = "glass" is more than the diffuse limit can treat; use model = "tank"')
    if scene.camera.kind == "calibrated":
        plain = on_surface(scene)
        return to_camera(scene, diffuse_image(plain, step_mm), (plain.camera.pixel_mm, plain.camera.pixel_mm))
    kept = 1.0 - _forward_share(scene.medium.g)
    medium = replace(scene.medium, sigma_s=kept * scene.medium.sigma_s)
    image = single_scattering(replace(scene, medium=medium)) / kept
    if medium.sigma_s == 0.0:
        return image
    medium = _without_forward_peak(scene.medium)
    scene = replace(scene, medium=medium)
    axes, spacing, fields = diffuse_light(scene, step_mm)
    emission = np.ascontiguousarray(medium.sigma_s / (4.0 * math.pi) * np.moveaxis(fields, 0, -1))
    emission[..., 1:] *= 3.0 * medium.g
    first = (float(axes[0][0]), float(axes[1][0]), float(axes[2][0]))
    _add_along_sight(image, geometry_of(scene), scene.camera.pixel_mm, medium.sigma_t, emission, first, spacing)
    return image


def _forward_share(g: float) -> float:
    """Share of all scatterings counted as none; g³ is best by measurement (docs/decisions/0204)."""
    return max(g, 0.0) ** 3


def _without_forward_peak(medium: Medium) -> Medium:
    """The medium whose light goes on unscattered where it turned least, with the same σa and σs (1 − g).

    Examples
    --------
    >>> _without_forward_peak(Medium(0.001, 0.125, 0.6)).g.__round__(6)
    0.489796
    """
    share = _forward_share(medium.g)
    return Medium(medium.sigma_a, (1.0 - share) * medium.sigma_s, (medium.g - share) / (1.0 - share))


def diffuse_light(scene: Scene, step_mm: float | None = None) -> tuple[Axes, tuple[float, float, float], Floats]:
    """Fluence rate and flux of all scattered light in the diffuse limit, for the medium as it stands.

    Returns
    -------
    axes
        Cells' centres along x, y and z in mm; the box reaches beyond the tank to where φ vanishes.
    spacing
        Sides of a cell in mm.
    fields
        (4, x, y, z): φ and the components of F, W/mm².
    """
    from scipy.fft import dstn, idstn

    medium = scene.medium
    transport = medium.sigma_t - medium.g * medium.sigma_s
    diffusivity = 1.0 / (3.0 * transport)
    axes, spacing = _cells(scene, transport, step_mm)
    light, direction = _unscattered(scene, axes, spacing)
    beam = [3.0 * diffusivity * medium.g * medium.sigma_s * light * component for component in direction]
    source = medium.sigma_s * light
    if medium.g != 0.0:
        source = source - sum(np.gradient(beam[i], spacing[i], axis=i) for i in range(3))
    decay = np.full((1, 1, 1), medium.sigma_a)
    for i, centres in enumerate(axes):
        wave_number = math.pi * np.arange(1, len(centres) + 1) / (len(centres) * spacing[i])
        decay = decay + diffusivity * np.expand_dims(wave_number**2, [j for j in range(3) if j != i])
    fluence = idstn(dstn(source, type=2) / decay, type=2)
    flux = [beam[i] - diffusivity * np.gradient(fluence, spacing[i], axis=i) for i in range(3)]
    return axes, spacing, np.stack([fluence, *flux])


def _cells(scene: Scene, transport: float, step_mm: float | None) -> tuple[Axes, tuple[float, float, float]]:
    """Cells of the tank and of the margin around it at whose end φ vanishes."""
    from scipy.fft import next_fast_len

    length, width, height = size = scene.tank.size_mm
    margin = min(_MILNE / transport, max(size))
    above = min(margin * _surface_factor(scene.tank.surface_index), 3.0 * max(size))
    low = np.array([-margin, -width / 2 - margin, -margin])
    span = np.array([length + 2 * margin, width + 2 * margin, height + margin + above])
    step = max(step_mm or float(np.cbrt(np.prod(size))) / 80.0, float(np.cbrt(np.prod(span) / _MOST_CELLS)))
    counts = [next_fast_len(max(8, math.ceil(side / step)), real=True) for side in span]
    spacing = [float(side) / count for side, count in zip(span, counts, strict=True)]
    x, y, z = (low[i] + (np.arange(counts[i]) + 0.5) * spacing[i] for i in range(3))
    return (x, y, z), (spacing[0], spacing[1], spacing[2])


def _surface_factor(index: float) -> float:
    """A: how much farther out φ extrapolates to zero above a surface that throws light back, (1 + R_F)/(1 − R_φ).

    R_φ = ∫ 2 ξ R dξ and R_F = ∫ 3 ξ² R dξ are the reflectances of fluence and of flux at the surface.

    Examples
    --------
    >>> _surface_factor(1.0), round(_surface_factor(1.33), 2)
    (1.0, 2.51)
    """
    if index == 1.0:
        return 1.0
    nodes, weights = np.polynomial.legendre.leggauss(400)
    cosine, weight = 0.5 * (nodes + 1.0), 0.5 * weights
    reflected = weight * fresnel_reflectance(cosine, index)
    return float((1.0 + np.sum(3.0 * cosine**2 * reflected)) / (1.0 - np.sum(2.0 * cosine * reflected)))


def _unscattered(scene: Scene, axes: Axes, spacing: tuple[float, float, float]) -> tuple[Floats, list[Floats]]:
    """Fluence rate of the light on its way to its first scattering, averaged over cells, and its direction."""
    x, y, z = np.ix_(*axes)
    enter, leave = (np.clip(x + side * spacing[0], 0.0, scene.tank.size_mm[0]) for side in (-0.5, 0.5))
    inside = 0.5 * (enter + leave)
    centre = scene.projector.position_mm if scene.projector.kind != "collimated" else None
    # A collimated projector is a pinhole infinitely far away.
    apex_x, apex_y, apex_z = centre or (-1e13, 0.0, 0.0)
    shrink = -apex_x / (inside - apex_x)
    entry_y, entry_z = apex_y + (y - apex_y) * shrink, apex_z + (z - apex_z) * shrink
    distance = np.sqrt(apex_x**2 + (entry_y - apex_y) ** 2 + (entry_z - apex_z) ** 2)
    direction = [-apex_x / distance, (entry_y - apex_y) / distance, (entry_z - apex_z) / distance]
    pattern = np.zeros(np.broadcast_shapes(entry_y.shape, entry_z.shape))
    for beam in scene.projector.beams:
        across = _overlap(entry_y, spacing[1] * shrink, *beam.y_mm)
        pattern = pattern + beam.irradiance * across * _overlap(entry_z, spacing[2] * shrink, *beam.z_mm)
    slant = scene.medium.sigma_t / direction[0]
    attenuated = np.exp(-slant * enter) * -np.expm1(-slant * (leave - enter)) / (slant * spacing[0])
    return pattern * attenuated * shrink**2 / direction[0], direction


def _overlap(centre: Floats, side: Floats | float, low: float, high: float) -> Floats:
    """Part of each cell that lies between two edges."""
    covered = np.minimum(high, centre + 0.5 * side) - np.maximum(low, centre - 0.5 * side)
    return np.asarray(np.clip(covered / side, 0.0, 1.0), np.float64)


@kernel
def _add_along_sight(
    image: Floats,
    geometry: Geometry,
    pixel_mm: float,
    sigma_t: float,
    emission: Floats,
    first: tuple[float, float, float],
    spacing: tuple[float, float, float],
) -> None:
    """Add ∫ e^{−σt s} (emission₀ + v·emission₁₂₃) ds along the line of sight through each pixel's centre."""
    rows, columns = image.shape
    pace = 0.5 * min(spacing)
    for row in range(rows):
        y = (row + 0.5) * pixel_mm - geometry.half_width
        for column in range(columns):
            x = (column + 0.5) * pixel_mm
            if x >= geometry.length or y >= geometry.half_width:
                continue
            vx, vy, vz, transmission = sight_line(geometry, x, y)
            near, far = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
            steps = math.ceil((far - near) / pace)
            step = (far - near) / max(steps, 1)
            # Exact for emission that is constant over a step, however dense the medium.
            share = -math.expm1(-sigma_t * step) / sigma_t
            total = 0.0
            for k in range(steps):
                depth = near + (k + 0.5) * step
                place = (x - vx * depth, y - vy * depth, geometry.height - vz * depth)
                total += math.exp(-sigma_t * (near + k * step)) * _toward(emission, first, spacing, place, (vx, vy, vz))
            image[row, column] += transmission * share * max(total, 0.0)


@kernel
def _toward(
    emission: Floats,
    first: tuple[float, float, float],
    spacing: tuple[float, float, float],
    place: tuple[float, float, float],
    direction: tuple[float, float, float],
) -> float:
    """Emission at a place in a direction, linear between cells' centres."""
    a, b, c = (place[0] - first[0]) / spacing[0], (place[1] - first[1]) / spacing[1], (place[2] - first[2]) / spacing[2]
    i = min(max(int(a), 0), emission.shape[0] - 2)
    j = min(max(int(b), 0), emission.shape[1] - 2)
    k = min(max(int(c), 0), emission.shape[2] - 2)
    total = 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                weight = abs(1 - di - (a - i)) * abs(1 - dj - (b - j)) * abs(1 - dk - (c - k))
                cell = emission[i + di, j + dj, k + dk]
                total += weight * (cell[0] + direction[0] * cell[1] + direction[1] * cell[2] + direction[2] * cell[3])
    return total

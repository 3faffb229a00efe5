"""Photons in a tank whose walls or floor send light back: followed from event to event by chance alone.

Photons fly as far as chance has it; what a face takes is taken off their weight. They are shown to the camera wherever
water or a diffuse face scatters them: directly, and by way of clear faces that mirror them. This is written apart from
`tankrig.light.walls`, which it checks.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import reflectance
from tankrig.montecarlo.draws import draw, draw_azimuth, draw_scattered, scrambled, turning
from tankrig.montecarlo.kernel_scene import KernelScene, Vector, departure, pixel_at, seen
from tankrig.scene import Tank

Image = NDArray[np.float64]

IMAGES = 6
"""By way of faces: what a first event shows, be it of order 1 or on a diffuse face; other light of orders up to 1; then
orders 2, 3, 4–20 and above 20."""
LIGHT, KEPT = 0.05, 0.25
"""Weight below which a photon plays roulette, and the chance that it stays."""
ROUNDING_MM = 1e-9
NOTHING, PANE, MIRROR, MATT = 0, 1, 2, 3
_KINDS = {"black": NOTHING, "glass": PANE, "clear": MIRROR, "diffuse": MATT}


class KernelFaces(NamedTuple):
    """The faces at x = 0, x = Lx, y = −Ly/2, y = Ly/2 and z = 0."""

    kind: NDArray[np.int64]
    share: NDArray[np.float64]
    """That comes back; not of a pane."""
    thick_mm: NDArray[np.float64]
    pane_index: NDArray[np.float64]
    water: float


def kernel_faces(tank: Tank) -> KernelFaces:
    """Flatten a tank's faces."""
    faces = tank.faces.all
    return KernelFaces(
        np.array([_KINDS[face.kind] for face in faces], np.int64),
        np.array([face.reflectance for face in faces], np.float64),
        np.array([tank.wall_mm if face.thickness_mm is None else face.thickness_mm for face in faces], np.float64),
        np.array([tank.wall_index if face.index is None else face.index for face in faces], np.float64),
        float(tank.refractive_index),
    )


class Scattered(NamedTuple):
    """Light that water or a diffuse face scatters."""

    way: Vector
    """Direction in which it comes."""
    matt: int
    """The diffuse face, or −1."""
    power: float


@kernel
def trace_among_faces(
    scene: KernelScene, faces: KernelFaces, beams: Image, powers: Image, photons: int, max_order: int,
    seed: np.uint64, images: Image,
) -> tuple[float, float]:  # fmt: skip
    """Follow photons, and show what is seen by way of faces; what is not, is as if all of them were black.

    Parameters and results as those of `tankrig.montecarlo.transport.trace`, but `IMAGES` images.
    """
    per_photon = powers[-1] / photons / (scene.pixel * scene.pixel)
    absorbed = 0.0
    for photon in range(photons):
        state = scrambled(seed + np.uint64(photon))
        u, state = draw(state)
        beam = min(int(np.searchsorted(powers, u * powers[-1], side="right")), powers.size - 1)
        u, state = draw(state)
        y = beams[beam, 0] + u * (beams[beam, 1] - beams[beam, 0])
        u, state = draw(state)
        place = (0.0, y, beams[beam, 2] + u * (beams[beam, 3] - beams[beam, 2]))
        way = departure(scene, place[1], place[2])
        weight, order, by_face, first = 1.0, 0, False, True
        while weight > 0.0:
            u, state = draw(state)
            free = -math.log(1.0 - u) / scene.sigma_t if scene.sigma_t > 0.0 else math.inf
            place, way, kept, met, matt, state = _flown(scene, faces, place, way, free, state)
            weight *= kept
            by_face = by_face or met
            if weight == 0.0:
                break
            if matt < 0:
                order += 1
                if order > max_order:  # only here, for on its way the last order may have come to a diffuse face
                    break
                absorbed += weight * (1.0 - scene.albedo)
                weight *= scene.albedo
            kind = 0 if first else 1 if order < 2 else order if order < 4 else 4 if order <= 20 else 5
            first = False
            light = Scattered(way, matt, weight * per_photon)
            _show(scene, faces, place, light, by_face, images[kind])
            if weight < LIGHT:
                u, state = draw(state)
                if u >= KEPT:
                    break
                weight /= KEPT
            if matt < 0:
                wx, wy, wz, state = draw_scattered(way[0], way[1], way[2], scene.phase, state)
                way = (wx, wy, wz)
            else:
                way, state = _off(matt, state)
    return absorbed / photons, 1.0 - absorbed / photons


@kernel
def _flown(
    scene: KernelScene, faces: KernelFaces, place: Vector, way: Vector, free: float, state: np.uint64
) -> tuple[Vector, Vector, float, bool, int, np.uint64]:
    """Where a photon is after a free path, on its way from face to face; and what share of it is left.

    Returns
    -------
    place, way
        Where it is, and the direction in which it comes there.
    kept
        Share; 0 where it has left the tank.
    met
        Whether it has met a wall or the floor.
    matt
        The diffuse face that it has come to, or −1.
    state
        Of the random numbers.
    """
    x, y, z = place
    ux, uy, uz = way
    kept, met = 1.0, False
    while True:
        along_x = (scene.length - x) / ux if ux > 0.0 else -x / ux if ux < 0.0 else math.inf
        along_y = (
            (scene.half_width - y) / uy if uy > 0.0 else -(scene.half_width + y) / uy if uy < 0.0 else math.inf
        )  # fmt: skip
        along_z = (scene.height - z) / uz if uz > 0.0 else -z / uz if uz < 0.0 else math.inf
        nearest = max(min(along_x, along_y, along_z), 0.0)
        if free < nearest:
            return (x + ux * free, y + uy * free, z + uz * free), (ux, uy, uz), kept, met, -1, state
        free -= nearest
        x, y, z = x + ux * nearest, y + uy * nearest, z + uz * nearest
        if nearest == along_z and uz > 0.0:
            if scene.refractive_index == 1.0:
                return (x, y, z), (ux, uy, uz), 0.0, met, -1, state
            kept *= reflectance(uz, scene.refractive_index)
            uz = -uz
        else:
            met = True
            face = 4 if nearest == along_z else (1 if ux > 0.0 else 0) if nearest == along_x else (3 if uy > 0.0 else 2)
            if faces.kind[face] == MATT:
                return (x, y, z), (ux, uy, uz), kept * faces.share[face], met, face, state
            normal = abs(uz) if face == 4 else abs(ux) if face < 2 else abs(uy)
            back, inner, aside = _comes_back(faces, face, normal)
            kept *= back
            u, state = draw(state)
            if aside > 0.0 and u >= inner:
                step = aside / math.sqrt(1.0 - normal * normal)
                x, y, z = (
                    x + (step * ux if face >= 2 else 0.0),
                    y + (step * uy if face not in (2, 3) else 0.0),
                    z + (step * uz if face < 4 else 0.0),
                )
                beyond = max(-x, x - scene.length, abs(y) - scene.half_width, -z, z - scene.height)
                if beyond > ROUNDING_MM:  # into the pane's edge
                    kept = 0.0
            if face == 4:
                uz = -uz
            elif face < 2:
                ux = -ux
            else:
                uy = -uy
        if kept < 1e-6:
            return (x, y, z), (ux, uy, uz), 0.0, met, -1, state


@kernel
def _comes_back(faces: KernelFaces, face: int, normal: float) -> tuple[float, float, float]:
    """What a clear face sends back, the part of it that has not been in the pane, and how far aside the rest is, mm."""
    if faces.kind[face] == MIRROR:
        return faces.share[face], 1.0, 0.0
    if faces.kind[face] != PANE:
        return 0.0, 1.0, 0.0
    ratio = faces.water / faces.pane_index[face]
    at_inner = reflectance(normal, ratio)
    squared = 1.0 - ratio * ratio * (1.0 - normal * normal)
    if squared <= 0.0:
        return 1.0, 1.0, 0.0
    in_pane = math.sqrt(squared)
    at_outer = reflectance(in_pane, faces.pane_index[face])
    # To and fro in the pane: a geometric series.
    through = (1.0 - at_inner) * (1.0 - at_inner) * at_outer / (1.0 - at_inner * at_outer)
    back = at_inner + through
    return back, at_inner / back, 2.0 * faces.thick_mm[face] * math.sqrt(1.0 - squared) / in_pane


@part
def _off(face: int, state: np.uint64) -> tuple[Vector, np.uint64]:
    """A direction off a diffuse face."""
    u, state = draw(state)
    a, b, state = draw_azimuth(state)
    out, flat = math.sqrt(u), math.sqrt(1.0 - u)
    a, b = a * flat, b * flat
    if face < 2:
        return (out if face == 0 else -out, a, b), state
    if face < 4:
        return (a, out if face == 2 else -out, b), state
    return (a, b, out), state


@kernel
def _show(
    scene: KernelScene, faces: KernelFaces, place: Vector, light: Scattered, directly: bool, image: Image
) -> None:
    """Add what is scattered at a place, as the camera sees it directly and mirrored."""
    for i in range(-1, 2):  # mirrored in the face at x = 0, in none, at x = Lx
        if i != 0 and not (scene.camera_pinhole and _mirrors(faces, 0 if i < 0 else 1)):
            continue
        x = -place[0] if i < 0 else place[0] if i == 0 else 2.0 * scene.length - place[0]
        for j in range(-1, 2):
            if j != 0 and not (scene.camera_pinhole and _mirrors(faces, 2 if j < 0 else 3)):
                continue
            y = place[1] if j == 0 else 2.0 * j * scene.half_width - place[1]
            for k in range(2):
                if k == 1 and not _mirrors(faces, 4):
                    continue
                at = (x, y, place[2] if k == 0 else -place[2])
                if i != 0 or j != 0 or k != 0:
                    _show_mirrored(scene, faces, at, (i, j, k), True, light, image)
                    _show_mirrored(scene, faces, at, (i, j, k), False, light, image)
                elif directly:
                    _show_mirrored(scene, faces, at, (i, j, k), False, light, image)


@part
def _mirrors(faces: KernelFaces, face: int) -> bool:
    return bool(faces.kind[face] == PANE or faces.kind[face] == MIRROR)


@kernel
def _show_mirrored(
    scene: KernelScene, faces: KernelFaces, at: Vector, mirrored: tuple[int, int, int], outer: bool, light: Scattered,
    image: Image,
) -> None:  # fmt: skip
    """One mirror image; by way of a pane's outer side, or of what its inner side sends back at once.

        power · R · p(cos θ) e^{−σt path} T J,   R what the faces send back (see `seen`)

    Of `mirrored` each number says at which face across x, y and z, if it is not 0.
    """
    (i, j, k), (way, matt, power) = mirrored, light
    px, py, vx, vy, vz, path, factor = seen(scene, at[0], at[1], at[2])
    share, at_once, moved = 1.0, 1.0, at
    for face in ((0 if i < 0 else 1) if i != 0 else -1, (2 if j < 0 else 3) if j != 0 else -1, 4 if k == 1 else -1):
        if face < 0:
            continue
        normal = vz if face == 4 else abs(vx) if face < 2 else abs(vy)
        back, inner, aside = _comes_back(faces, face, normal)
        share, at_once = share * back, at_once * inner
        step = aside / math.sqrt(max(1.0 - normal * normal, 1e-18))
        moved = (
            moved[0] + (step * vx if face >= 2 else 0.0),
            moved[1] + (step * vy if face not in (2, 3) else 0.0),
            moved[2] + (step * vz if face < 4 else 0.0),
        )
    if outer:
        share *= 1.0 - at_once
        if moved[2] > scene.height or share == 0.0:  # it comes out of the pane above the water
            return
        px, py, vx, vy, vz, path, factor = seen(scene, moved[0], moved[1], moved[2])
    else:
        share *= at_once
    factor *= share
    if factor == 0.0:
        return
    ax, ay, az = vx if i == 0 else -vx, vy if j == 0 else -vy, vz if k == 0 else -vz
    if matt < 0:
        lobe = turning(way[0] * ax + way[1] * ay + way[2] * az, scene.phase)
    else:
        out = (ax if matt == 0 else -ax) if matt < 2 else (ay if matt == 2 else -ay) if matt < 4 else az
        lobe = max(out, 0.0) / math.pi
    across, along = pixel_at(scene, px, py)
    if factor > 0.0 and 0.0 <= across < scene.columns and 0.0 <= along < scene.rows:
        image[int(along), int(across)] += power * factor * lobe * math.exp(-scene.sigma_t * path)

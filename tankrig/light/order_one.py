"""Order 1 of a scene: its light as it comes through the wall, seen directly and by way of clear walls.

Three kinds of it are computed as finely as each can be seen: beams whose edges are seen, light that is smooth over many
pixels as the projector's halo and dark picture are, and what clear walls send back, most of it a tenth of all or less.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.light.entering import edged_and_smooth, entering, through_lens
from tankrig.light.leaving import CameraLens
from tankrig.light.single import single_scattering_of
from tankrig.light.surface import many_to_camera, on_surface
from tankrig.scene import Medium, Scene

if TYPE_CHECKING:
    from tankrig.light.walls.once import OnSurface

Array = NDArray[np.float64]

HALO_OFF = 2.2e-4
"""Share of the light in the projector's halo times the square of the cells it is computed on, over its standard
deviation: what that leaves out is half as much of all light, .01 %. Order 1 of three rays with .4 % in a halo of 20 mm,
in a tank of glass on a bench, takes 7 instead of 17 CPU s so."""
FEWEST_CELLS = 16
"""Across the tank."""
HARDLY_ANY = 0.01
"""Share of smooth light up to which what comes back of it from the far wall is left out, 1 % of it."""


def once(scene: Scene) -> Array:
    """Order 1 as an ideal camera sees it, (rows, columns), W/mm²/sr."""
    return np.asarray(once_of(scene, [scene.medium])[0])


def once_of(scene: Scene, media: Sequence[Medium]) -> Array:
    """The same of several liquids, (media, rows, columns)."""
    edged, _ = edged_and_smooth(scene)
    images = _directly(edged, media, None)
    for light in _sent_back(edged, media, None, _smooth_cell_mm(scene)):
        images += light.seen_by(edged)
    smooth = _smooth(scene, media)
    return images if smooth is None else images + smooth


def once_seen(scene: Scene, media: Sequence[Medium]) -> Array:
    """Order 1 of several liquids as the camera's lens shows it, (media, rows, columns)."""
    lens = CameraLens.of(scene)
    return once_of(scene, media) if lens is None else once_through(lens, media)[1]


def once_through(lens: CameraLens, media: Sequence[Medium]) -> tuple[Array, Array]:
    """Order 1 of several liquids before a lens and behind it.

    Parameters
    ----------
    lens
        Of the scene's camera.
    media
        The liquids.

    Returns
    -------
    ideal
        (media, rows, columns) of the lens' wide picture.
    seen
        (media, rows, columns) of the camera.
    """
    edged, _ = edged_and_smooth(lens.scene)
    sharp = replace(lens, scene=edged)
    back = _sent_back(sharp.fine, media, lens.seen_mm, _smooth_cell_mm(edged))
    # Light by way of walls is computed on cells of the surface, which are a plain camera's own pixels.
    fine = back[:1] if lens.scene.camera.kind == "calibrated" else back
    ideal, seen = sharp.order_one(
        lambda one: sum((light.seen_by(one) for light in fine), _directly(one, media, lens.seen_mm))
    )
    without_edges = [light.seen_by(lens.wide) for light in back[len(fine) :]]
    smooth = _smooth(lens.wide, media)
    for wide in (*without_edges, *(() if smooth is None else (smooth,))):
        ideal, seen = ideal + wide, seen + np.array([lens.of_wide(one) for one in wide])
    return ideal, seen


def _directly(scene: Scene, media: Sequence[Medium], seen_mm: float | None) -> Array:
    """Order 1 of beams that no wall sends back, seen straight; `seen_mm` as for `through_lens`."""
    parts = through_lens(entering(scene, fine=True), True, seen_mm)
    return np.asarray(sum(share * single_scattering_of(one, media) for share, one in parts))


def _sent_back(
    scene: Scene, media: Sequence[Medium], seen_mm: float | None, smooth_cell_mm: float
) -> list["OnSurface"]:
    """Order 1 of beams by way of clear walls, on the surface: what has edges, and what is too faint for any.

    The less there is of it, the more coarsely it is computed; nothing at all if no wall is clear. A beam that comes
    back from the far wall has two pinholes for a wide lens. What is seen of it by way of another wall has no soft edges
    either, on cells of a pixel's longer side.
    """
    if scene.tank.faces.dark:
        return []
    from tankrig.light.walls.once import OnSurface, SentBack, by_walls_of

    soft, sharp = entering(scene, fine=True), entering(scene, fine=False)
    found = []
    for light, parts, cell_mm in (
        (SentBack.MIRRORED, through_lens(soft, True, seen_mm), None),
        (SentBack.FROM_FAR, through_lens(soft, False), None),
        (SentBack.FAINT, through_lens(sharp, False), smooth_cell_mm),
    ):
        each = [by_walls_of(one, media, (light,), cell_mm) for _, one in parts]
        image = np.tensordot([share for share, _ in parts], np.array([one.images for one in each]), 1)
        found.append(OnSurface(image, each[0].cell_mm))
    mirrored, from_far, faint = found
    return [mirrored._replace(images=mirrored.images + from_far.images), faint]


def once_sent_back(scene: Scene) -> Array:
    """What clear walls send back of order 1, as an ideal camera sees it, (rows, columns), W/mm²/sr."""
    edged, _ = edged_and_smooth(scene)
    parts = [one.seen_by(edged) for one in _sent_back(edged, [scene.medium], None, _smooth_cell_mm(scene))]
    return np.asarray(sum(parts, _smooth_sent_back(scene, [scene.medium]))[0])


def _smooth(described: Scene, media: Sequence[Medium]) -> Array | None:
    """Order 1 of a scene's smooth light, directly and by way of clear walls; None where it has none.

    A calibrated camera looks it up on cells of the surface, which it may do where light has no edges.
    """
    _, scene = edged_and_smooth(described)
    if scene is None:
        return None
    plain = on_surface(scene, _halo_cell_mm(described))
    images = single_scattering_of(plain, media)
    if scene.camera.kind == "calibrated":
        images = many_to_camera(scene, images, (plain.camera.pixel_mm, plain.camera.pixel_mm))
    return np.asarray(images + _smooth_sent_back(described, media))


def _smooth_sent_back(described: Scene, media: Sequence[Medium]) -> Array:
    """Order 1 of a scene's smooth light by way of clear walls; 0 where it has none."""
    _, scene = edged_and_smooth(described)
    _, coarse = edged_and_smooth(described, fine=False)
    images = np.zeros((len(media), *described.camera.shape))
    if scene is None or coarse is None or scene.tank.faces.dark:
        return images
    from tankrig.light.walls.once import SentBack, by_walls_of

    parts: list[tuple[Scene, tuple[SentBack, ...]]] = [(scene, (SentBack.MIRRORED,))]
    if described.projector.black_level > 0.0 or described.projector.halo.share > HARDLY_ANY:
        parts.append((coarse, (SentBack.FROM_FAR, SentBack.FAINT)))
    for one, light in parts:
        images += by_walls_of(one, media, light, _halo_cell_mm(described)).seen_by(one)
    return images


def _halo_cell_mm(scene: Scene) -> float:
    """Side of cells of the surface that show smooth light: the less there is of a halo, the coarser."""
    light, side_mm = scene.projector, _smooth_cell_mm(scene)
    if light.black_level > 0.0 or light.halo.share == 0.0:
        return side_mm
    widest_mm = scene.tank.size_mm[1] / FEWEST_CELLS
    return max(side_mm, min(widest_mm, light.halo.sigma_mm * math.sqrt(HALO_OFF / light.halo.share)))


def _smooth_cell_mm(scene: Scene) -> float:
    """Side of cells of the surface that show light without edges."""
    return max(scene.camera.sides_mm)

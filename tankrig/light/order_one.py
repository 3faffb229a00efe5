"""Order 1 of a scene: its light as it comes through the wall, seen directly and by way of clear walls.

Three kinds of it are computed as finely as each can be seen: beams whose edges are seen, light that is smooth over many
pixels as the projector's halo and dark picture are, and what clear walls send back, a tenth of all or less.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.light.entering import edged_and_smooth, entering, through_lens
from tankrig.light.leaving import CameraLens
from tankrig.light.single import single_scattering_of
from tankrig.scene import Medium, Scene

if TYPE_CHECKING:
    from tankrig.light.walls.once import OnSurface

Array = NDArray[np.float64]


def once(scene: Scene) -> Array:
    """Order 1 as an ideal camera sees it, (rows, columns), W/mm²/sr."""
    return np.asarray(once_of(scene, [scene.medium])[0])


def once_of(scene: Scene, media: Sequence[Medium]) -> Array:
    """The same of several liquids, (media, rows, columns)."""
    edged, smooth = edged_and_smooth(scene)
    images = _directly(edged, media)
    for light in _sent_back(edged, media, _coarse_mm(scene)):
        images += light.seen_by(edged)
    return images if smooth is None else images + _smooth(smooth, media)


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
    edged, smooth = edged_and_smooth(lens.scene)
    sharp = replace(lens, scene=edged)
    back = _sent_back(sharp.fine, media, _coarse_mm(edged))
    ideal, seen = sharp.order_one(lambda one: sum((light.seen_by(one) for light in back), _directly(one, media)))
    if smooth is not None:
        wide = _smooth(replace(lens, scene=smooth).wide, media)
        ideal, seen = ideal + wide, seen + np.array([lens.of_wide(one) for one in wide])
    return ideal, seen


def _directly(scene: Scene, media: Sequence[Medium]) -> Array:
    """Of beams that no wall has sent back, and lines of sight likewise."""
    parts = through_lens(entering(scene, fine=True), fine=True)
    return np.asarray(sum(share * single_scattering_of(one, media) for share, one in parts))


def _sent_back(scene: Scene, media: Sequence[Medium], coarse_mm: float) -> list["OnSurface"]:
    """Of beams by way of clear walls, on the surface; what is faint is looked at on cells that are coarse."""
    if scene.tank.faces.dark:
        return []
    from tankrig.light.walls.once import OnSurface, by_walls_of

    found = []
    for faint in (False, True):
        shares, parts = zip(*through_lens(entering(scene, not faint), not faint), strict=True)
        lights = [by_walls_of(one, media, faint, coarse_mm if faint else None) for one in parts]
        image = np.tensordot(shares, np.array([light.images for light in lights]), 1)
        found.append(OnSurface(image, lights[0].cell_mm))
    return found


def _smooth(scene: Scene, media: Sequence[Medium]) -> Array:
    """Of smooth light, directly and by way of clear walls."""
    images = single_scattering_of(scene, media)
    if scene.tank.faces.dark:
        return images
    from tankrig.light.walls.once import by_walls_of

    return images + by_walls_of(scene, media, coarse_mm=_coarse_mm(scene)).seen_by(scene)


def _coarse_mm(scene: Scene) -> float:
    """Side of cells of the surface that show light without edges."""
    return max(scene.camera.sides_mm)

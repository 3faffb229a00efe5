"""A scene whose lenses and walls are as fits have found them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tankrig.scene import Scene
from tankrig.scene.optics import MOST_HALO, MOST_VEIL, Face, Halo

LEAST_PANE = 0.3
"""Share of what glass reflects from which on a pane is one."""


def as_found(scene: Scene, sizes: Mapping[str, float]) -> Scene:
    """A scene with halos and an entry pane as they were fitted along.

    Parameters
    ----------
    scene
        As described.
    sizes
        What was fitted beyond that, by its name in `ASTRAY`.
    """
    camera, light, faces = scene.camera, scene.projector, scene.tank.faces

    def more(halo: Halo, name: str) -> Halo:
        return replace(halo, share=float(np.clip(halo.share + sizes.get(name, 0.0), 0.0, MOST_HALO)))

    if sizes.get("pane", 0.0) > LEAST_PANE:
        faces = replace(faces, entry=replace(faces.entry, kind="glass"))
    return replace(
        scene,
        camera=replace(camera, halo=more(camera.halo, "halo")),
        projector=replace(light, halo=more(light.halo, "projector_halo")),
        tank=replace(scene.tank, faces=faces),
    )


def described_with(scene: Scene, sizes: Mapping[str, float]) -> Scene:
    """A scene with all that fits of a run have along, so that its images have what these had.

    Parameters
    ----------
    scene
        As described.
    sizes
        Of halo, its width, veil and floor, see `unmeasured`; a share below none is none.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> described_with(scene, {"floor": 0.03}).tank.faces.floor.reflectance, described_with(scene, {}) == scene
    (0.03, True)
    """
    found = of_width(as_found(scene, sizes), sizes.get("halo_width", 0.0))
    size = max(sizes.get("floor", 0.0), 0.0)
    veil_share = float(np.clip(scene.camera.veil + sizes.get("veil", 0.0), 0.0, MOST_VEIL))
    faces = found.tank.faces
    if size > 0.0 and faces.floor.dark:
        faces = replace(faces, floor=Face("diffuse", min(size, 1.0)))
    return replace(found, camera=replace(found.camera, veil=veil_share), tank=replace(found.tank, faces=faces))


def of_width(scene: Scene, wider: float) -> Scene:
    """A scene whose camera's halo has another width, by its logarithm."""
    halo = scene.camera.halo
    wide = replace(halo, sigma_mm=halo.sigma_mm * float(np.exp(wider)))
    return replace(scene, camera=replace(scene.camera, halo=wide))

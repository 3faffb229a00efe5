"""Small tanks for the stress suite: cheap to predict, with nothing in them that is round or symmetric by chance."""

from dataclasses import replace

import numpy as np

from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

SIZE_MM = (72.0, 48.0, 36.0)
PIXEL_MM = 2.0
BEAMS = (Beam((-8.3, -3.1), (15.2, 19.7)), Beam((5.0, 9.4), (18.1, 20.3), 0.6))
"""Their edges lie between the pixels'."""


def scene_of(
    medium: Medium, kind: str = "parallel", beams: tuple[Beam, ...] = BEAMS, surface: str = "matched"
) -> Scene:
    """A scene with parallel light and sight, or with pinholes."""
    light, camera = Projector("collimated", beams), Camera("orthographic", (24, 36), PIXEL_MM)
    if kind == "pinhole":
        light = Projector("pinhole", beams, (-100.0, 3.0, 17.0))
        camera = Camera("pinhole", (24, 36), PIXEL_MM, (36.0, -2.0, 200.0))
    return Scene(Tank(SIZE_MM, surface), medium, light, camera)


def medium_of(depth: float, absorbed: float, g: float) -> Medium:
    """A medium by the tank's optical depth Lz σt, the share of its extinction that is absorption, and g."""
    sigma_t = depth / SIZE_MM[2]
    return Medium(absorbed * sigma_t, (1.0 - absorbed) * sigma_t, g)


def with_beams(scene: Scene, *beams: Beam) -> Scene:
    """The same scene lit by other beams."""
    return replace(scene, projector=replace(scene.projector, beams=beams))


def with_camera(scene: Scene, shape: tuple[int, int], pixel_mm: float) -> Scene:
    """The same scene on another grid of pixels."""
    return replace(scene, camera=replace(scene.camera, shape=shape, pixel_mm=pixel_mm))


def larger(scene: Scene, k: float) -> Scene:
    """Every length times k, every coefficient divided by it."""
    medium, light, camera = scene.medium, scene.projector, scene.camera

    def scaled(lengths: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return None if lengths is None else tuple(k * length for length in lengths)

    beams = tuple(replace(beam, y_mm=scaled(beam.y_mm), z_mm=scaled(beam.z_mm)) for beam in light.beams)
    return Scene(
        replace(scene.tank, size_mm=scaled(scene.tank.size_mm)),
        Medium(medium.sigma_a / k, medium.sigma_s / k, medium.g),
        replace(light, beams=beams, position_mm=scaled(light.position_mm)),
        replace(camera, pixel_mm=k * camera.pixel_mm, position_mm=scaled(camera.position_mm)),
    )


def mirrored(scene: Scene) -> Scene:
    """The scene's mirror image in the plane y = 0."""

    def flipped(place: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return None if place is None else (place[0], -place[1], place[2])

    light, camera = scene.projector, scene.camera
    beams = tuple(replace(beam, y_mm=(-beam.y_mm[1], -beam.y_mm[0])) for beam in light.beams)
    return replace(
        scene,
        projector=replace(light, beams=beams, position_mm=flipped(light.position_mm)),
        camera=replace(camera, position_mm=flipped(camera.position_mm)),
    )


def relative(image: np.ndarray, truth: np.ndarray) -> float:
    """Relative L2 difference."""
    return float(np.linalg.norm(image - truth) / np.linalg.norm(truth))

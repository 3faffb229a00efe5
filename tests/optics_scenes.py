"""Scenes for lenses and walls that several files of tests look at, and how far two images are apart."""

import numpy as np

from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import Blur, Halo

MEDIUM = Medium(0.002, 0.018, 0.4)


def apart(image, truth):
    return float(np.linalg.norm(image - truth) / np.linalg.norm(truth))


def a_scene(camera=None, light=None, **tank):
    camera = camera or Camera("orthographic", (20, 30), 8.0)
    light = light or Projector("collimated", (Beam((-20.0, 24.0), (40.0, 80.0)),))
    return Scene(Tank(**tank), MEDIUM, light, camera)


def a_calibrated_scene(turned, aside_mm, shape):
    """Three beams of 10 mm and a camera above the tank's middle, both with lenses that blur."""
    rows, columns = shape
    fx, fy = columns / 80 * 134.0, rows / 54 * 161.0
    camera = Camera(
        "calibrated", shape, 4.0, (121.0, aside_mm, 620.0), rotation=turned,
        matrix=((fx, 0.0, columns / 2 - 1.5), (0.0, fy, rows / 2 - 0.5), (0.0, 0.0, 1.0)),
        blur=Blur(0.32, 0.38), halo=Halo(0.02, 35.0), veil=0.001,
    )  # fmt: skip
    beams = tuple(Beam((y_mm, y_mm + 9.0), (53.0, 57.0)) for y_mm in (-40.0, -2.0, 37.0))
    light = Projector("pinhole", beams, (-400.0, 5.0, 50.0), blur=Blur(0.5))
    return a_scene(camera, light, surface="fresnel", refractive_index=1.33)

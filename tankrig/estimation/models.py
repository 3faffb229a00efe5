"""Forward models for a fit: a cheap one that is smooth in the medium, and an accurate one to correct it with.

Derivatives and steps need an image that changes smoothly with the medium; accuracy needs many light paths. Both at once
would cost a fit minutes. So every step is made with few paths, always the same ones, and one accurate image near the
optimum corrects them all: what the cheap image is off by there hardly changes over the last steps of a fit.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tankrig.estimation.forward import Image, remembered
from tankrig.image.predict import predict
from tankrig.image.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene

Model = Callable[[Medium], Prediction]
"""What the camera would see with a medium in the tank."""

COARSE = 0.05
"""Tolerance of cheap images."""
FINE = 0.01
"""Tolerance of accurate images."""
COARSE_BATCHES, MOST_BATCHES = 2, 48
"""Shifted lattices of light paths of the tank model's cheap images, and of its accurate ones at most."""
FINE_NOISE = 0.002
"""Noise that the tank model's accurate images aim for, relative L2."""


@dataclass(frozen=True)
class Models:
    """Two ways to the same image.

    Parameters
    ----------
    coarse
        Cheap, smooth in the medium.
    fine
        Accurate, and states its error.
    """

    coarse: Model
    fine: Model


def models_of(scene: Scene, model: str, max_order: int | None) -> Models:
    """Cheap and accurate version of a model of a scene.

    Raises
    ------
    SceneError
        On the first image, when the model is unknown or cannot treat the scene.
    """

    def with_medium(medium: Medium) -> Scene:
        return replace(scene, medium=medium)

    if model == "tank":
        coarse = remembered(lambda medium: _tank(with_medium(medium), max_order, COARSE_BATCHES))

        def fine(medium: Medium) -> Prediction:
            need = COARSE_BATCHES * (stated_error(coarse(medium)) / FINE_NOISE) ** 2
            return _tank(with_medium(medium), max_order, int(np.clip(need, COARSE_BATCHES, MOST_BATCHES)))

        return Models(coarse, remembered(fine))

    def within(tolerance: float) -> Model:
        return remembered(lambda medium: predict(with_medium(medium), model, tolerance, max_order))

    return Models(within(COARSE), within(FINE))


def stated_error(prediction: Prediction) -> float:
    """What a prediction says about its error, relative L2 of the image: noise, and what it left out with a bound."""
    size = float(np.linalg.norm(prediction.image))
    noise = float(np.linalg.norm(prediction.stderr)) / size if prediction.stderr is not None and size > 0.0 else 0.0
    return math.hypot(noise, *(part.bound for part in prediction.skipped if math.isfinite(part.bound)))


def corrected(model: Model, at: Medium, accurate: Prediction) -> Callable[[Medium], Image]:
    """A model's images, each moved by what the model is off by at one medium."""
    off = accurate.image - model(at).image

    def image(medium: Medium) -> Image:
        return model(medium).image + off

    return image


def _tank(scene: Scene, max_order: int | None, batches: int) -> Prediction:
    from tankrig.light.tank import tank_image

    result = tank_image(scene, FINE, max_order, batches=batches)
    skipped = tuple(Skipped(*item) for item in result.skipped)
    return Prediction(np.sum(list(result.orders.values()), axis=0), "tank", stderr=result.stderr, skipped=skipped)

"""Forward models for a fit: a cheap one to search with, an accurate one to end with, and one to differentiate.

The tank model follows light paths, and its noise is a smooth function of the medium only where the same paths are
followed every time: so each version follows a fixed number of them, chosen once for a fit from the noise that the
cheap version states. Derivatives use other paths than the image that they are to improve: with the same ones, noise
would look like a way to a better fit.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.forward import remembered
from tankrig.image.predict import predict
from tankrig.image.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene

Model = Callable[[Medium], Prediction]
"""What the camera would see with a medium in the tank."""

COARSE, FINE = 0.05, 0.01
"""Tolerance of cheap and of accurate images."""
COARSE_BATCHES = 2
"""Shifted lattices of light paths of the tank model's cheap images."""
FINE_NOISE, FINE_BATCHES = 0.003, 32
SLOPE_NOISE, SLOPE_BATCHES = 0.006, 16
"""Noise (relative L2) that the images for the last steps and for derivatives aim for, and their lattices at most."""

ERROR_PIXELS = 4.0
"""Standard deviation of the Gaussian over which a stated noise is averaged."""


@dataclass(frozen=True)
class Models:
    """Versions of one forward model.

    Parameters
    ----------
    coarse
        Cheap.
    refine
        From a medium near the optimum to an accurate version and one to differentiate.
    """

    coarse: Model
    refine: Callable[[Medium], tuple[Model, Model]]


def models_of(scene: Scene, model: str, max_order: int | None) -> Models:
    """Versions of a model of a scene.

    Raises
    ------
    SceneError
        On the first image, when the model is unknown or cannot treat the scene.
    """
    if model == "tank":
        return _tank_models(scene, max_order)

    def within(tolerance: float) -> Model:
        return remembered(lambda medium: predict(replace(scene, medium=medium), model, tolerance, max_order))

    fine = within(FINE)
    return Models(within(COARSE), lambda _: (fine, fine))


def _tank_models(scene: Scene, max_order: int | None) -> Models:
    def following(batches: int, seed: int) -> Model:
        return remembered(lambda medium: _tank(replace(scene, medium=medium), max_order, batches, seed))

    coarse = following(COARSE_BATCHES, 0)

    def refine(medium: Medium) -> tuple[Model, Model]:
        need = COARSE_BATCHES * stated_error(coarse(medium)) ** 2
        fine = int(np.clip(need / FINE_NOISE**2, COARSE_BATCHES, FINE_BATCHES))
        slope = int(np.clip(need / SLOPE_NOISE**2, COARSE_BATCHES, SLOPE_BATCHES))
        return following(fine, 1), following(slope, 2)

    return Models(coarse, refine)


def _tank(scene: Scene, max_order: int | None, batches: int, seed: int) -> Prediction:
    from tankrig.light.tank import tank_image

    result = tank_image(scene, FINE, max_order, seed, batches)
    skipped = tuple(Skipped(*item) for item in result.skipped)
    return Prediction(np.sum(list(result.orders.values()), axis=0), "tank", stderr=result.stderr, skipped=skipped)


def stated_error(prediction: Prediction) -> float:
    """What a prediction says about its error, relative L2 of the image: noise, and what it left out with a bound."""
    size = float(np.linalg.norm(prediction.image))
    return float(np.linalg.norm(error_map(prediction))) / size if size > 0.0 else 0.0


def error_map(prediction: Prediction) -> NDArray[np.float64]:
    """The same by pixel, W/mm²/sr: the noise where it is, what was left out in proportion to the image.

    The stated noise is averaged over a few pixels: from few batches of paths it is itself noisy, and a pixel that
    seems free of noise would get a weight it has not earned.
    """
    from scipy.ndimage import gaussian_filter

    left_out = math.hypot(*(part.bound for part in prediction.skipped if math.isfinite(part.bound)))
    error: NDArray[np.float64] = left_out * np.abs(np.asarray(prediction.image, float))
    if prediction.stderr is None:
        return error
    variance: NDArray[np.float64] = gaussian_filter(np.square(np.asarray(prediction.stderr, float)), ERROR_PIXELS)
    whole: NDArray[np.float64] = np.hypot(error, np.sqrt(variance))
    return whole

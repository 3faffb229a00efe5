"""Forward models for a fit: a cheap one to search with, an accurate one to end with, and one to differentiate.

The tank model follows light paths, and its noise is a smooth function of the medium only where the same paths are
followed every time: so each version follows a fixed number of them, chosen once for a fit from the noise that the
cheap version states. Derivatives use other paths than the image that they are to improve: with the same ones, noise
would look like a way to a better fit.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.estimation.forward import Slopes, remembered
from tankrig.estimation.parameters import Range
from tankrig.image.predict import predict
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene

if TYPE_CHECKING:
    from tankrig.image.prepare import Prepared

Model = Callable[[Medium], Prediction]
"""What the camera would see with a medium in the tank."""
Exact = Callable[[Medium, int], Prediction]
"""The same as accurately as can be, with so many times as many light paths."""

COARSE, FINE = 0.05, 0.01
"""Tolerance of cheap and of accurate images."""
COARSE_BATCHES, SMOOTHED_BATCHES = 2, 6
"""Shifted lattices of light paths of the tank model's cheap images: where every path stands for all starts, and where
it does not and noise is told from light by their scatter (two of them err by 7 % unseen, four by 1.5 %)."""
FINE_NOISE, FINE_BATCHES = 0.003, 32
SLOPE_NOISE, SLOPE_BATCHES = 0.006, 16
"""Noise (relative L2) that the images for the last steps and for derivatives aim for, and their lattices at most."""
SLOPE_BLUR_MM = 4.0
"""Standard deviation of the Gaussian over which orders ≥ 3 are averaged where changes of the image matter and not the
image: paths take other ways in another medium, and the noise of the difference passes for knowledge."""

EXACT_NOISE, EXACT_BATCHES = 0.0005, 128
"""The same for the one image, at the optimum, that the others are corrected by."""

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
    slopes
        Derivatives by σa, σs, g, (3, rows, columns), of the model itself; None to take differences.
    range
        Media that it answers for; None: all.
    exact
        The most accurate version, for one image at the optimum, and with so many times its paths; None where the
        accurate one is that.
    """

    coarse: Model
    refine: Callable[[Medium], tuple[Model, Model]]
    slopes: Slopes | None = None
    range: Range | None = None
    exact: Exact | None = None


def models_of(scene: Scene, model: "str | Prepared", max_order: int | None) -> Models:
    """Versions of a model of a scene.

    Raises
    ------
    SceneError
        When a prepared model is of another scene; on the first image, when the model is unknown or cannot treat the
        scene.
    """
    if model == "prepared":
        from tankrig.image.prepare import prepare

        model = prepare(scene)
    if not isinstance(model, str):
        return _prepared_models(scene, model, max_order)
    if model == "tank":
        return _tank_models(scene, max_order)

    def within(tolerance: float) -> Model:
        return remembered(lambda medium: predict(replace(scene, medium=medium), model, tolerance, max_order))

    fine = within(FINE)
    return Models(within(COARSE), lambda _: (fine, fine))


def _prepared_models(scene: Scene, model: "Prepared", max_order: int | None) -> Models:
    if replace(model.scene, medium=scene.medium) != scene:
        raise SceneError(
            f"the model {model.path} was prepared for another tank, projector or camera than "
            f"{scene.source or 'the scene'} has; prepare this one"
        )
    if max_order is not None:
        raise SceneError(f'max_order = {max_order} needs model = "tank": a prepared model holds all orders in one')
    box = model.box

    def inside(medium: Medium) -> Medium:
        sigma_t = float(np.clip(medium.sigma_t, *box.sigma_t))
        albedo = float(np.clip(medium.albedo, *box.albedo))
        return Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, float(np.clip(medium.g, *box.g)))

    @remembered
    def predicted(medium: Medium) -> Prediction:
        near = inside(medium)
        error = Skipped("noise and polynomials of the prepared model", model.error_at(near))
        return Prediction(model.predict(near), "prepared", skipped=(error,))

    albedo, g = ((edges[0], min(edges[1], 1.0 - 1e-6)) for edges in (box.albedo, box.g))
    scattering = (box.sigma_t[0] * albedo[0], box.sigma_t[1])
    return Models(
        predicted, lambda _: (predicted, predicted), lambda medium: model.predict(inside(medium), derivatives=True)[1],
        Range.of_media(scattering, albedo, g, sigma_t=box.sigma_t),
    )  # fmt: skip


def _tank_models(scene: Scene, max_order: int | None) -> Models:
    def following(batches: int, seed: int, blur_mm: float = 0.0) -> Model:
        return remembered(lambda medium: _tank(replace(scene, medium=medium), max_order, batches, seed, blur_mm))

    from tankrig.light.rays import shift_invariant

    fewest = COARSE_BATCHES if shift_invariant(scene) else SMOOTHED_BATCHES
    coarse = following(fewest, 0)

    def batches(medium: Medium, noise: float, most: int) -> int:
        need = fewest * stated_error(coarse(medium)) ** 2
        return int(np.clip(need / noise**2, fewest, most))

    def refine(medium: Medium) -> tuple[Model, Model]:
        fine, slope = batches(medium, FINE_NOISE, FINE_BATCHES), batches(medium, SLOPE_NOISE, SLOPE_BATCHES)
        return following(fine, 1), following(slope, 2, SLOPE_BLUR_MM)

    def exact(medium: Medium, times: int) -> Prediction:
        return following(times * batches(medium, EXACT_NOISE, EXACT_BATCHES), 3)(medium)

    return Models(coarse, refine, exact=exact)


def _tank(scene: Scene, max_order: int | None, batches: int, seed: int, blur_mm: float) -> Prediction:
    from scipy.ndimage import gaussian_filter

    from tankrig.light.tank import tank_image

    found = tank_image(scene, FINE, max_order, seed, batches)
    if blur_mm == 0.0:
        return found
    exact = found.orders[1] + found.orders[2]
    image = exact + gaussian_filter(found.image - exact, blur_mm / scene.camera.pixel_mm, mode="nearest")
    return replace(found, image=image)


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

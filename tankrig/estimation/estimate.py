"""`estimate`: from an image of a tank to the coefficients of what is in it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import ImageError, SceneError
from tankrig.estimation.fitting import Problem, first_guess, polish, search
from tankrig.estimation.forward import slopes_of
from tankrig.estimation.models import COARSE, Model, Models, error_map, models_of, stated_error
from tankrig.estimation.observation import Observation, observe, structure
from tankrig.estimation.parameters import at_edge
from tankrig.estimation.projection import Scaling
from tankrig.estimation.uncertainty import covariance, identifiable
from tankrig.estimation.verdict import what_is_determined, what_is_left, what_was_left_out
from tankrig.image.prediction import Prediction
from tankrig.scene import Medium, Scene

Image = NDArray[np.floating]
Free = Literal["free"]


@dataclass(frozen=True)
class Estimate:
    """Coefficients fitted to an image, with what is known about them.

    Parameters
    ----------
    medium
        Fitted σa, σs, g.
    covariance
        (3, 3), of (σa, σs, g): camera noise and the model's own error, gain and offset as free as they were.
    identifiable
        Which of "sigma_a", "sigma_s", "g" the image determines.
    gain, offset
        Fitted, or as given.
    image
        Fitted image, gain · radiance + offset, in units of the observed one.
    residual
        Observed less fitted; NaN where a pixel was left out.
    rmse
        Root mean square of the residual over the pixels used, image units.
    verdict
        What is determined, which combination is where not all are, and what the residual says; plain sentences.
    model
        Name of the model fitted.
    noise
        RMS standard deviation of the image's noise, image units: as given or estimated, or as the residual shows where
        that is more.
    model_error
        The model's error that the covariance counts with: relative L2 of the image.
    """

    medium: Medium
    covariance: NDArray[np.float64]
    identifiable: dict[str, bool]
    gain: float
    offset: float
    image: Image
    residual: Image
    rmse: float
    verdict: str
    model: str
    noise: float
    model_error: float

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Where each coefficient lies with probability `level`: normal intervals cut at the range allowed.

        Parameters
        ----------
        level
            0 < level < 1.

        Returns
        -------
        {"sigma_a": (low, high), "sigma_s": …, "g": …}, σ ≥ 0 and −1 ≤ g ≤ 1
        """
        from scipy.special import ndtri

        if not 0.0 < level < 1.0:
            raise ValueError(f"level = {level} is no probability; give one between 0 and 1, such as 0.95")
        reach = float(ndtri(0.5 + 0.5 * level)) * np.sqrt(np.diag(self.covariance))
        allowed = {"sigma_a": (0.0, math.inf), "sigma_s": (0.0, math.inf), "g": (-1.0, 1.0)}
        intervals = {}
        for (name, (low, high)), half in zip(allowed.items(), reach, strict=True):
            best = getattr(self.medium, name)
            intervals[name] = (max(low, best - float(half)), min(high, best + float(half)))
        return intervals


def estimate(
    image: ArrayLike,
    scene: Scene,
    gain: float | Free = "free",
    offset: float | Free = "free",
    noise: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    model: str = "tank",
    max_order: int | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> Estimate:
    """Scattering coefficients of the liquid in an image.

    Least squares between the image and gain · radiance + offset (the paper's Eq. 15, which has neither gain nor
    offset nor errors). Gain and offset are eliminated at every step or taken as given; the coordinates are log σs,
    logit ϖ and atanh g, searched from several g over their whole range.

    Parameters
    ----------
    image
        (rows, columns) as the scene's camera delivers it, in any unit linear in radiance.
    scene
        Tank, projector and camera; its medium does not matter.
    gain, offset
        "free", or numbers: image units per W/mm²/sr, and image units.
    noise
        Standard deviation of the image's noise, scalar or per pixel; None to estimate it from pixel-to-pixel changes.
    mask
        (rows, columns), True where a pixel is to be left out.
    model
        "tank", "single", "convolution", "diffuse" or "montecarlo".
    max_order
        Fit orders of scattering 1 … max_order only; None for all.
    progress
        Told in a few words what is being done, now and then.

    Returns
    -------
    Estimate

    Raises
    ------
    ImageError
        When the image cannot be an observation of the scene, in one sentence.
    SceneError
        When the scene is dark, or the model is unknown or cannot treat it.
    """
    if not any(beam.irradiance > 0.0 for beam in scene.projector.beams):
        raise SceneError(f"{scene.source or 'the scene'}: no beam has any irradiance; give the light that was on")
    scaling = Scaling(_known("gain", gain), _known("offset", offset))
    observation = observe(image, scene.camera.shape, noise, mask)
    return fit_models(observation, scene, scaling, models_of(scene, model, max_order), progress or _silently)


def fit_models(
    observation: Observation, scene: Scene, scaling: Scaling, models: Models, progress: Callable[[str], None]
) -> Estimate:
    """Fit any forward model: search the whole range with its cheap version, end with the accurate one.

    Parameters
    ----------
    observation, scaling
        What to explain, and whether gain and offset are free.
    scene
        Gives the size of the tank and of the pixels only.
    models
        The model.
    progress
        Told in words what is being done.
    """
    length_mm = max(scene.tank.size_mm)

    def problem_of(forward: Model, slope: Model, error: Image) -> Problem:
        slopes = slopes_of(lambda medium: slope(medium).image, length_mm)
        return Problem(lambda medium: forward(medium).image, slopes, observation, scaling, error)

    progress("looking at a few media")
    ambient = float(np.percentile(observation.image[observation.used], 5)) if scaling.offset is None else scaling.offset
    brightness = np.maximum(observation.image - ambient, 0.0)
    starts = first_guess(problem_of(models.coarse, models.coarse, COARSE * brightness), length_mm)
    rough = float(np.clip(stated_error(models.coarse(starts[0])), 0.1 * COARSE, COARSE))
    found = search(problem_of(models.coarse, models.coarse, rough * brightness), starts, length_mm, progress)

    progress("refining")
    forward, slope = models.refine(found[0])
    start = forward(found[0])
    gain, offset = problem_of(forward, slope, rough * brightness).scale(start.image)
    observation = observation.with_noise_of(observation.image - gain * start.image - offset)
    error = abs(gain) * np.minimum(error_map(start), COARSE * np.abs(start.image).max())
    problem = problem_of(forward, slope, error)
    medium, _ = min((polish(problem, one, length_mm) for one in found), key=lambda end: end[1])
    progress("finding the errors")
    return _described(problem, medium, scene, forward(medium))


def _described(problem: Problem, medium: Medium, scene: Scene, prediction: Prediction) -> Estimate:
    """The estimate at an optimum: errors, verdict, residual."""
    observation, length_mm = problem.observation, max(scene.tank.size_mm)
    gain, offset = problem.scale(prediction.image)
    if gain <= 0.0:
        raise ImageError(
            "the image is dark where the scene's light is and bright where it is not; check that image and scene "
            "belong together and which way up the image is"
        )
    used = observation.used
    fitted = gain * prediction.image + offset
    residual = np.where(used, observation.image - fitted, np.nan)
    rmse, noise = _rms(residual[used]), _rms(observation.noise[used])
    brightness = _rms(gain * prediction.image[used])
    unexplained = structure(residual, used) / brightness
    white = math.sqrt(max(rmse**2 - (unexplained * brightness) ** 2, 0.0))
    noisier = white / noise if white > noise * (1.0 + 3.0 / math.sqrt(2.0 * used.sum())) else 1.0
    stated = stated_error(prediction)
    counted = max(stated, unexplained)
    # Where the model states its error, it is of the pattern stated; what goes beyond it is in proportion to the image.
    beyond = math.sqrt(counted**2 - stated**2)
    error = gain * np.hypot(error_map(prediction), beyond * np.abs(prediction.image))

    spread = covariance(
        problem.sensitivity(medium), medium, noisier * observation.noise, error,
        scene.camera.pixel_mm, length_mm,
    )  # fmt: skip
    edges = at_edge(medium, length_mm)
    known = {name: yes and name not in edges for name, yes in identifiable(medium, spread).items()}
    left_out = max((skipped.bound for skipped in prediction.skipped), default=0.0)
    sentences = [
        what_is_determined(medium, spread, known, edges),
        what_is_left(unexplained, stated, noisier if observation.noise_known else 1.0),
        what_was_left_out(observation.saturated, left_out, prediction.model),
    ]
    return Estimate(
        medium=medium, covariance=spread, identifiable=known, gain=gain, offset=offset, image=fitted, residual=residual,
        rmse=rmse, verdict=" ".join(filter(None, sentences)), model=prediction.model,
        noise=noisier * noise, model_error=counted,
    )  # fmt: skip


def _known(name: str, value: object) -> float | None:
    """A number, or None where free."""
    if value == "free":
        return None
    if not isinstance(value, float | int | np.number) or not math.isfinite(value) or (name == "gain" and value <= 0.0):
        wanted = "a positive finite number" if name == "gain" else "a finite number"
        raise ImageError(f'{name} = {value!r} cannot be; give "free" or {wanted}')
    return float(value)


def _rms(values: Image) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _silently(_: str) -> None:
    pass

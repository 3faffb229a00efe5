"""The estimate at an optimum: its errors, what the residual says, and the verdict."""

import math
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.estimation.causes import WHOLE, cause_of, misalignment_left_out, misalignments
from tankrig.estimation.fitting import MEDIUM, Problem
from tankrig.estimation.models import error_map, stated_error
from tankrig.estimation.observation import structure
from tankrig.estimation.parameters import to_medium
from tankrig.estimation.profile import stretches
from tankrig.estimation.residual_map import standing_out, structure_map
from tankrig.estimation.result import Estimate
from tankrig.estimation.uncertainty import Sensitivity, covariance, identifiable
from tankrig.estimation.verdict import what_is_determined, what_is_left, what_is_misaligned, what_was_left_out
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

HOPELESS = 0.1
"""Unexplained structure, as a share of the image, from which on nothing counts as determined."""


def described(problem: Problem, coordinates: Array, scene: Scene, prediction: Prediction) -> Estimate:
    """The estimate at an optimum.

    Parameters
    ----------
    problem
        That was solved.
    coordinates
        Where.
    scene
        As described.
    prediction
        The model's image there, without misalignments.

    Raises
    ------
    ImageError
        When the image is dark where the scene is bright.
    """
    observation, medium = problem.observation, to_medium(coordinates[:MEDIUM])
    image = problem.image(coordinates)
    gain, offset = problem.scale(image)
    if gain <= 0.0:
        raise ImageError(
            "the image is dark where the scene's light is and bright where it is not; check that image and scene "
            "belong together and which way up the image is"
        )
    used = observation.used
    fitted = gain * image + offset
    residual = np.where(used, observation.image - fitted, np.nan)
    rmse, noise = _rms(residual[used]), _rms(observation.noise[used])
    brightness = _rms(gain * image[used])
    unexplained = structure(residual, used) / brightness
    white = math.sqrt(max(rmse**2 - (unexplained * brightness) ** 2, 0.0))
    noisier = white / noise if white > noise * (1.0 + 3.0 / math.sqrt(2.0 * used.sum())) else 1.0
    stated = stated_error(prediction)
    counted = max(stated, unexplained)
    # Where the model states its error, it is of the pattern stated; what goes beyond it is in proportion to the image.
    beyond = math.sqrt(counted**2 - stated**2)
    error = gain * np.hypot(error_map(prediction), beyond * np.abs(prediction.image))

    sensitivity = problem.sensitivity(coordinates, image)
    spread = covariance(
        sensitivity, medium, noisier * observation.noise, error, scene.camera.pixel_mm, max(scene.tank.size_mm)
    )  # fmt: skip
    off, spread = _misalignments(problem, coordinates, spread), spread[:MEDIUM, :MEDIUM]
    edges = problem.range.at_edge(medium)
    hopeless = unexplained > max(HOPELESS, stated)
    known = {name: yes and name not in edges and not hopeless for name, yes in identifiable(medium, spread).items()}
    white_noise = noisier * observation.noise
    place = standing_out(np.where(used, residual, 0.0) / white_noise, used, error / white_noise)
    whole = prediction.model in WHOLE
    held = unexplained <= stated and place is None
    left_out = max((skipped.bound for skipped in prediction.skipped), default=0.0)
    misaligned = cache(partial(misalignments, scene, medium))  # eight images, and two may ask
    cause = cause_of(problem, sensitivity, coordinates, scene, misaligned) if not held and whole else None
    aside = whole and misalignment_left_out(observation, fitted, gain, misaligned)
    sentences = [
        what_is_determined(medium, spread, known, edges),
        what_is_left(unexplained, stated, noisier if observation.noise_known else 1.0, cause, place, aside),
        what_is_misaligned(off),
        what_was_left_out(observation.saturated, int(observation.specks.sum()), left_out, prediction.model, aside),
    ]
    return Estimate(
        medium=medium, covariance=spread, identifiable=known, gain=gain, offset=offset, image=fitted,
        residual=residual, rmse=rmse, verdict=" ".join(filter(None, sentences)), model=prediction.model,
        noise=noisier * noise, model_error=counted, nuisance=off,
        structure=structure_map(np.where(used, residual, 0.0) / white_noise, used),
        stretch=_stretch(problem, sensitivity, coordinates, spread),
    )  # fmt: skip


def _misalignments(problem: Problem, coordinates: Array, spread: Array) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of each term, in its unit."""
    if problem.misalignment is None:
        return {}
    off, sds = coordinates[MEDIUM:], np.sqrt(np.diag(spread))[MEDIUM:]
    terms = zip(problem.misalignment.sd.items(), off, sds, strict=True)
    return {name: (float(one) * unit, float(sd) * unit) for (name, unit), one, sd in terms}


def _stretch(
    problem: Problem, sensitivity: Sensitivity, coordinates: Array, spread: Array
) -> dict[str, tuple[float, float]]:
    used, weight = sensitivity.used, sensitivity.weight
    medium = to_medium(coordinates[:MEDIUM])
    image = problem.image(coordinates)
    gain, _ = problem.scale(image)

    def changed(other: Medium) -> Array:
        change = gain * np.asarray((problem.forward(other) - problem.forward(medium))[used], float) * weight
        return problem.scaling.unhidden(change[None], np.asarray(image[used], float), weight)[0, : weight.size]

    residual = problem.residual(coordinates)[: weight.size]
    return stretches(medium, spread, residual, sensitivity.changes, changed)


def _rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

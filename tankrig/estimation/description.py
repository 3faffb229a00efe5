"""The estimate at an optimum: its errors, what the residual says, and the verdict."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.estimation.fitting import MEDIUM, Problem
from tankrig.estimation.misalignment import USUAL, Misalignment
from tankrig.estimation.models import error_map, stated_error
from tankrig.estimation.observation import structure
from tankrig.estimation.parameters import to_medium
from tankrig.estimation.profile import stretches
from tankrig.estimation.residual_map import likely_cause, structure_map
from tankrig.estimation.result import Estimate
from tankrig.estimation.uncertainty import Sensitivity, covariance, identifiable
from tankrig.estimation.verdict import what_is_determined, what_is_left, what_is_misaligned, what_was_left_out
from tankrig.image.prediction import Prediction
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

HOPELESS = 0.1
"""Unexplained structure, as a share of the image, from which on nothing counts as determined."""
MOST_BEAMS = 16
"""That are looked at one by one."""
WHOLE = ("tank", "prepared", "montecarlo")
"""Models that describe all light, so that what they leave has another cause."""


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
    left_out = max((skipped.bound for skipped in prediction.skipped), default=0.0)
    cause = _cause(problem, sensitivity, coordinates, scene) if unexplained > stated and _whole(prediction) else None
    sentences = [
        what_is_determined(medium, spread, known, edges),
        what_is_left(unexplained, stated, noisier if observation.noise_known else 1.0, cause),
        what_is_misaligned(off),
        what_was_left_out(observation.saturated, observation.outliers, left_out, prediction.model),
    ]
    return Estimate(
        medium=medium, covariance=spread, identifiable=known, gain=gain, offset=offset, image=fitted,
        residual=residual, rmse=rmse, verdict=" ".join(filter(None, sentences)), model=prediction.model,
        noise=noisier * noise, model_error=counted, nuisance=off,
        structure=structure_map(np.where(used, residual, 0.0) / (noisier * observation.noise), used),
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


def _whole(prediction: Prediction) -> bool:
    return prediction.model in WHOLE


def _cause(problem: Problem, sensitivity: Sensitivity, coordinates: Array, scene: Scene) -> tuple[str, float] | None:
    """What the structure of the residual looks like."""
    from tankrig.light.double import double_scattering
    from tankrig.light.single import single_scattering

    used, weight = sensitivity.used, sensitivity.weight
    scene = replace(scene, medium=to_medium(coordinates[:MEDIUM]))
    image = problem.image(coordinates)
    fitted = np.linalg.qr(sensitivity.changes.T)[0]

    def unhidden(changes: Array) -> Array:
        left = problem.scaling.unhidden(changes[:, used] * weight, np.asarray(image[used], float), weight)
        left = left[:, : weight.size]
        new: Array = left - (left @ fitted) @ fitted.T
        return new

    def uneven() -> list[Array]:
        rows, columns = scene.camera.shape
        y, x = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
        return [image * way for way in (x, y, x**2, y**2, x * y)]

    def beams() -> list[Array]:
        light = scene.projector
        alone = [replace(scene, projector=replace(light, beams=(beam,))) for beam in light.beams[:MOST_BEAMS]]
        return [single_scattering(one) for one in alone]

    causes: dict[str, Callable[[], list[Array]]] = {
        "uneven ink": uneven,
        "a misaligned beam or camera": lambda: list(Misalignment(scene, USUAL).slopes(scene.medium, np.zeros(4))),
        "another phase function": lambda: [single_scattering(scene), double_scattering(scene, 0.01)],
        "beams of another brightness than described, or missing": beams,
    }
    residual = problem.residual(coordinates)[: weight.size]
    return likely_cause(residual, unhidden, causes)


def _rms(values: NDArray[np.floating]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

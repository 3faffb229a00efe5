"""From a search's optimum to the one that is reported: accurate images, alignment, and what is no light left out."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.fitting import MEDIUM, Problem, polish
from tankrig.estimation.misalignment import Misalignment
from tankrig.estimation.models import COARSE, Exact, Model, Models, error_map
from tankrig.estimation.parameters import to_medium
from tankrig.estimation.search import Optimum
from tankrig.estimation.uncertainty import Sensitivity, held_back, overconfidence
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene

Image = NDArray[np.floating]
Array = NDArray[np.float64]

CLEANINGS = 3
"""Times at most that a fit is repeated without the pixels that it shows to be outliers."""
CORRECTIONS, CORRECTED = 4, 0.3
"""Accurate images at most that an optimum is corrected by, each at the last one's, and the gain in χ²/2 below which
that is over."""
SHARPER = 4
"""Times as many light paths in the last accurate image, where the model's error hides what the photograph shows."""
ALIGNINGS, ALIGNED = 5, 2.0
"""Times at most that misalignments are searched for, and the gain in χ²/2 below which that is over."""


def limited_error(prediction: Prediction, gain: float) -> Image:
    """The model's error by pixel in units of the image, which no pixel has more of than of a coarse image."""
    error: Image = abs(gain) * np.minimum(error_map(prediction), COARSE * np.abs(prediction.image).max())
    return error


def corrected(
    problem: Problem, best: Optimum, exact: Exact, slope: Model, scene: Scene, gain: float,
    progress: Callable[[str], None],
) -> tuple[Problem, Optimum, Model]:  # fmt: skip
    """The optimum by accurate images, each at the last one's, and smooth changes about them.

    Parameters
    ----------
    problem, best
        That was solved, and where.
    exact, slope
        The most accurate version of the model, and the one that is differentiated.
    scene
        Gives the size of the tank and of the pixels.
    gain
        Of the image, for the model's error.
    progress
        Told in words what is being done.

    Returns
    -------
    The problem with a model that is accurate there, its optimum, and that model.
    """
    for _ in range(CORRECTIONS):
        progress("correcting by an accurate image")
        centre = to_medium(best.coordinates)
        seen = exact(centre, 1)
        near = _about(problem, seen, centre, gain)
        misfit = near.residual(best.coordinates)
        best = polish(near, best.coordinates)
        if 0.5 * float(misfit @ misfit) - best.cost < CORRECTED:
            break
    if held_back(*_known_by(near, best.coordinates, scene)):
        progress("correcting by an image as accurate as the photograph")
        seen = exact(centre, SHARPER)
        best = polish(_about(problem, seen, centre, gain), best.coordinates)
    forward = _corrected(slope, centre, seen)
    error = limited_error(seen, gain)
    return replace(problem, forward=lambda medium: forward(medium).image, error=error), best, forward


def corrected_at(centre: Medium, models: Models) -> Model:
    """What a fit that ended at a medium has used there: the accurate image, and changes that are smooth."""
    _, slope = models.refine(centre)
    return slope if models.exact is None else _corrected(slope, centre, models.exact(centre, 1))


def aligned(problem: Problem, best: Optimum, misalignment: Misalignment, scene: Scene) -> tuple[Problem, Optimum]:
    """The problem and its optimum with what may be off in the set-up.

    Edges that come off pixels' edges bend the way: a search that gave up goes on from where it is.
    """
    best = replace(best, coordinates=np.concatenate([best.coordinates, np.zeros(len(misalignment.names))]))
    for _ in range(ALIGNINGS):
        before = best.cost
        medium = to_medium(best.coordinates[:MEDIUM])
        problem = replace(problem, misalignment=misalignment.at(medium), firmness=np.ones(len(misalignment.names)))
        problem = replace(problem, firmness=overconfidence(*_known_by(problem, best.coordinates, scene)))
        best = polish(problem, best.coordinates)
        if before - best.cost < ALIGNED:
            break
    return problem, best


def without_outliers(problem: Problem, best: Optimum) -> tuple[Problem, Optimum]:
    """The problem and its optimum without pixels that the fit shows to be none of the liquid's light."""
    for _ in range(CLEANINGS):
        image = problem.image(best.coordinates)
        gain, offset = problem.scale(image)
        cleaned = problem.observation.cleaned(gain * image + offset)
        if cleaned.used.sum() == problem.observation.used.sum():
            break
        problem = replace(problem, observation=cleaned)
        best = polish(problem, best.coordinates)
    return problem, best


def _about(problem: Problem, exact: Prediction, centre: Medium, gain: float) -> Problem:
    """The problem with an accurate image and changes to first order: what is left of paths' noise in it is smooth."""
    slopes = problem.slopes(centre)

    def image(medium: Medium) -> Image:
        changes = [medium.sigma_a - centre.sigma_a, medium.sigma_s - centre.sigma_s, medium.g - centre.g]
        changed: Image = exact.image + np.tensordot(changes, slopes, 1)
        return changed

    return replace(problem, forward=image, error=limited_error(exact, gain))


def _corrected(forward: Model, centre: Medium, exact: Prediction) -> Model:
    """A model with the error that it shows at one medium taken off, which stays what it is nearby."""
    error = forward(centre).image - exact.image
    return lambda medium: replace(exact, image=forward(medium).image - error)


def _known_by(
    problem: Problem, coordinates: Array, scene: Scene
) -> tuple[Sensitivity, Medium, Array, Array, float, float]:
    """What errors at some coordinates follow from."""
    error = np.asarray(problem.error, float)
    return (
        problem.sensitivity(coordinates, problem.image(coordinates)), to_medium(coordinates[:MEDIUM]),
        problem.observation.noise, error, scene.camera.pixel_mm, max(scene.tank.size_mm),
    )  # fmt: skip

"""`estimate`: from an image of a tank to the coefficients of what is in it."""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import ImageError, SceneError
from tankrig.estimation.description import described
from tankrig.estimation.fitting import MEDIUM, Problem, first_guess, polish, search
from tankrig.estimation.forward import slopes_of
from tankrig.estimation.misalignment import Misalignment
from tankrig.estimation.models import COARSE, Model, Models, models_of, stated_error
from tankrig.estimation.observation import Observation, observe
from tankrig.estimation.parameters import Range, to_coordinates, to_medium
from tankrig.estimation.polishing import aligned, corrected, limited_error, without_outliers
from tankrig.estimation.projection import Scaling
from tankrig.estimation.result import Estimate as Estimate
from tankrig.scene import Scene

if TYPE_CHECKING:
    from tankrig.image.prepare import Prepared

Image = NDArray[np.floating]
Free = Literal["free"]


def estimate(
    image: ArrayLike,
    scene: Scene,
    gain: float | tuple[float, float] | Free = "free",
    offset: float | tuple[float, float] | Free = "free",
    noise: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    model: "str | Prepared" = "tank",
    max_order: int | None = None,
    *,
    nuisance: Mapping[str, float] | None = None,
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
        "free", or numbers: image units per W/mm²/sr, and image units; or (number, standard deviation).
    noise
        Standard deviation of the image's noise, scalar or per pixel; None to estimate it from pixel-to-pixel changes,
        as a function of the brightness.
    mask
        (rows, columns), True where a pixel is to be left out.
    model
        "tank", "single", "convolution", "diffuse" or "montecarlo"; what `tankrig.prepare` gave for the same scene, or
        "prepared" to have that done: a fit then takes a fraction of a second, or some seconds where the residual holds
        structure whose cause is looked for.
    max_order
        Fit orders of scattering 1 … max_order only; None for all.
    nuisance
        What may be off in the set-up, each with its standard deviation, and is fitted along: "z_mm", "y_mm" (light
        moved up, and along y), "tilt_mrad" (light turned about the vertical, towards +y), "scale" (share by which a
        pixel is larger than described).
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
    (gain_mean, gain_sd), (offset_mean, offset_sd) = _known("gain", gain), _known("offset", offset)
    scaling = Scaling(gain_mean, offset_mean, gain_sd, offset_sd)
    misalignment = Misalignment(scene, nuisance, 1 if model == "single" else max_order) if nuisance else None
    observation = observe(image, scene.camera.shape, noise, mask)
    models = models_of(scene, model, max_order)
    return fit_models(observation, scene, scaling, models, progress or _silently, misalignment)


def fit_models(
    observation: Observation,
    scene: Scene,
    scaling: Scaling,
    models: Models,
    progress: Callable[[str], None],
    misalignment: Misalignment | None = None,
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
    misalignment
        What may be off in the set-up; None where nothing is. It is fitted with the accurate model only.
    """
    length_mm = max(scene.tank.size_mm)

    def problem_of(seen: Observation, forward: Model, slope: Model, error: Image) -> Problem:
        slopes = models.slopes or slopes_of(lambda medium: slope(medium).image, length_mm)
        reach = models.range or Range.of_tank(length_mm)
        return Problem(lambda medium: forward(medium).image, slopes, seen, scaling, error, reach)

    progress("looking at a few media")
    ambient = float(np.percentile(observation.image[observation.used], 5)) if scaling.offset is None else scaling.offset
    brightness = np.maximum(observation.image - ambient, 0.0)
    first = problem_of(observation, models.coarse, models.coarse, COARSE * brightness)
    starts, reserve = first_guess(first, length_mm)
    rough = float(np.clip(stated_error(models.coarse(starts[0])), 0.1 * COARSE, COARSE))
    cheap = problem_of(observation, models.coarse, models.coarse, rough * brightness)
    found = search(cheap, starts, progress, reserve)

    progress("refining")
    forward, slope = models.refine(found[0])
    start = forward(found[0])
    gain, offset = problem_of(observation, forward, slope, rough * brightness).scale(start.image)
    fitted = gain * start.image + offset
    observation = observation.with_noise_of(observation.image - fitted, by_level=True)

    problem = problem_of(observation, forward, slope, limited_error(start, gain))
    best = min((polish(problem, to_coordinates(one)) for one in found), key=lambda end: end.cost)
    if models.exact is not None:
        problem, best, forward = corrected(problem, best, models.exact, slope, scene, gain, progress)
    if misalignment is not None:
        progress("aligning")
        problem, best = aligned(problem, best, misalignment, scene)
    problem, best = without_outliers(problem, best)
    progress("finding the errors")
    return described(problem, best.coordinates, scene, forward(to_medium(best.coordinates[:MEDIUM])))


def _known(name: str, value: object) -> tuple[float | None, float]:
    """A number and its standard deviation; None where free."""
    if value == "free":
        return None, 0.0
    pair = value if isinstance(value, tuple) and len(value) == 2 else (value, 0.0)
    numbers = [float(one) if isinstance(one, float | int | np.number) else math.nan for one in pair]
    if not np.isfinite(numbers).all() or numbers[1] < 0.0 or (name == "gain" and numbers[0] <= 0.0):
        wanted = "a positive finite number" if name == "gain" else "a finite number"
        raise ImageError(f'{name} = {value!r} cannot be; give "free", {wanted}, or it and its standard deviation')
    return numbers[0], numbers[1]


def _silently(_: str) -> None:
    pass

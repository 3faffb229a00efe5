"""What fits of several images with one gain share: checks, models, what errors are, and what images determine."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import ImageError
from tankrig.estimation.estimate import determined
from tankrig.estimation.forward import family_models
from tankrig.estimation.left_over import Left, error_of, left_over, spread_of
from tankrig.estimation.observation import Observation, observe
from tankrig.estimation.phase_answer import Asked, answer_of, is_rough, likely_spheres, mostly_spheres
from tankrig.estimation.phase_average import LikelySpheres
from tankrig.estimation.phase_families import Family
from tankrig.estimation.phase_result import Scattering
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.result import DOUBTED, UNDESCRIBED
from tankrig.estimation.series_forward import (
    ModelOf,
    low_orders_model,
    modelled_in_water,
    series_models,
    tank_model,
)
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.spheres import spheres
from tankrig.estimation.uncertainty import PATTERN, ModelError
from tankrig.estimation.versions import Models
from tankrig.light.rays import shift_invariant
from tankrig.scene import Scene

Array = NDArray[np.float64]


def observed(
    images: Sequence[ArrayLike],
    scenes: Sequence[Scene],
    noise: ArrayLike | Sequence[ArrayLike] | None,
    masks: Sequence[ArrayLike | None] | None = None,
) -> list[Observation]:
    """Check the images, each against its scene."""
    one_for_all = noise is None or isinstance(noise, float | int | np.number)
    noises: list[Any] = [noise] * len(images) if one_for_all else list(noise)  # type: ignore[arg-type]
    if len(noises) != len(images):
        raise ImageError(f"{len(images)} images but {len(noises)} noises; give one for all or one for each image")
    masks = [None] * len(images) if masks is None else masks
    if len(masks) != len(images):
        raise ImageError(f"{len(images)} images but {len(masks)} masks; give one for each image, or None")
    observations = []
    for number, (image, scene, sigma, mask) in enumerate(zip(images, scenes, noises, masks, strict=True), start=1):
        try:
            observations.append(observe(image, scene.camera.shape, sigma, mask))
        except ImageError as error:
            raise ImageError(f"image {number} of {len(images)}: {error}") from error
    return observations


def models_of_tank(scenes: Sequence[Scene], family: Family | None, water_sigma_s: float = 0.0) -> list[Models]:
    """The tank's of each image.

    A phase function's coordinates, which change images nearly alike, want images without noise, as what is prepared for
    each liquid has them; Henyey–Greenstein's three numbers do with differences of light paths.
    """
    if family is not None and all(one.tank.faces.dark or not shift_invariant(one) for one in scenes):
        by_scene = {
            one: family_models(one, family, water_sigma_s=water_sigma_s, prepared=True) for one in dict.fromkeys(scenes)
        }
        return [by_scene[scene] for scene in scenes]
    model_of, low_of = (modelled_in_water(one, water_sigma_s) for one in (tank_model, low_orders_model))
    return models_by_scene(scenes, model_of, family, low_of)


def models_by_scene(
    scenes: Sequence[Scene], model_of: ModelOf, family: Family | None, low_of: ModelOf | None = None
) -> list[Models]:
    """One for each image, whose orders 1 and 2 may be had alone; images of one scene share theirs, and what it has
    computed."""
    by_scene = {scene: series_models(scene, model_of, family, low_of) for scene in dict.fromkeys(scenes)}
    return [by_scene[scene] for scene in scenes]


def models_of_spheres(scenes: Sequence[Scene], models: Sequence[Models]) -> list[Models]:
    """Each image's versions for media of spheres; images of one scene share theirs, as they did."""
    by_scene = {scene: one.of(spheres()) for scene, one in dict(zip(scenes, models, strict=True)).items()}
    return [by_scene[scene] for scene in scenes]


def scattering_at(best: Evaluation, spread: Array, asked: Asked, left: Sequence[Left]) -> Scattering:
    """How the liquid, or the ink per ml, scatters."""
    return answer_of(best, spread, asked, all(one.beyond == 0.0 for one in left))


def spread_at(best: Evaluation, left: Sequence[Left], shots: Sequence[Shot]) -> Array:
    """Covariance of the values; models' errors as they lie, where that is known."""
    gain, _ = best.scale
    smooth = errors_of(shots, left, [PATTERN * one.counted for one in left])
    errors = [
        error if one.prediction.patterns is None else error_of(one.prediction, gain, one.beyond, shot.scene)
        for error, one, shot in zip(smooth, left, shots, strict=True)
    ]
    return spread_of(best, left, errors)


def errors_of(shots: Sequence[Shot], left: Sequence[Left], shares: Sequence[float]) -> list[ModelError]:
    """Errors of so much of each image's light."""
    return [shot.error(share * np.abs(one.light), 1.0) for shot, one, share in zip(shots, left, shares, strict=True)]


def determined_by(answer: Scattering, spread: Array, left: Sequence[Left], asked: Asked, fit: Fit) -> dict[str, bool]:
    """Which of σa, σs, g images determine; where a fit has not settled, or of a liquid that may have another phase
    function than those searched, or scatter much nearly straight on, neither σs nor g."""
    known = determined(answer.liquid, spread, left)
    doubted = fit.moved is not None or leaves_much(left, asked) or is_rough(fit.optimum, asked) or answer.may_peak
    return known | {"sigma_s": False, "g": False} if doubted else known


def leaves_much(left: Sequence[Left], asked: Asked) -> bool:
    """Whether Henyey–Greenstein, or a free phase function, leaves so much that the liquid may have another one."""
    enough = DOUBTED if asked.family is None else UNDESCRIBED
    return (asked.family is None or asked.is_free) and max(one.beyond for one in left) > enough


def likely_in_several(
    fit: Fit, left: Sequence[Left], spread: Array, asked: Asked, answer: Scattering
) -> LikelySpheres | None:
    """Spheres that are worth a fit of their own, see `likely_spheres`."""
    views = fit.optimum.problem.views
    held = [view.whitened(one.beyond * np.abs(one.light)) for view, one in zip(views, left, strict=True)]
    structure = float(sum(one @ one for one in held))
    return likely_spheres(fit.optimum, spread, asked, answer, _unsure(fit, left, asked, answer), structure=structure)


def tells_of_spheres(shots: Sequence[Shot], asked: Asked, fit: Fit) -> bool:
    """Whether a place that a fit of a free phase function is led to shows spheres that are worth a fit of their own:
    whether they are the liquid is told by that, and not by a free one's end."""
    _, _, left = left_over(fit)
    whole = fit.unsettled(spread_at(fit.optimum, left, shots))
    return likely_in_several(fit, left, whole, asked, scattering_at(fit.optimum, whole, asked, left)) is not None


def _unsure(fit: Fit, left: Sequence[Left], asked: Asked, answer: Scattering) -> bool:
    """Whether a free phase function does not describe all images, has not settled, or where several images tell so much
    that a family next to its fit is not known to first order, spheres are most of the answer."""
    undescribed = is_rough(fit.optimum, asked) or any(one.beyond > 0.0 for one in left)
    return mostly_spheres(answer) or fit.moved is not None or undescribed

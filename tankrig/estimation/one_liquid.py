"""One liquid from several images with one gain, such as a dose's patterns."""

from collections.abc import Sequence

import numpy as np

from tankrig.estimation.astray import Astray
from tankrig.estimation.coordinates import Range
from tankrig.estimation.estimate import nuisances_of
from tankrig.estimation.fitting import fitted
from tankrig.estimation.left_over import left_over, rms
from tankrig.estimation.observation import Observation
from tankrig.estimation.phase_answer import Asked, fit_phase, liquid_blocks
from tankrig.estimation.phase_average import LikelySpheres
from tankrig.estimation.result import LiquidEstimate
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.search import Told
from tankrig.estimation.several_images import (
    determined_by,
    likely_in_several,
    models_of_spheres,
    models_of_tank,
    scattering_at,
    spread_at,
)
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.spheres import spheres
from tankrig.estimation.versions import Models
from tankrig.estimation.with_astray import with_astray
from tankrig.scene import Medium, Scene


def fit_liquid(
    observations: Sequence[Observation],
    scenes: Sequence[Scene],
    scaling: Scaling,
    models: Sequence[Models] | None = None,
    start: Medium | Sequence[Medium] | None = None,
    progress: Told = lambda _: None,
    asked: Asked = Asked(),  # noqa: B008
    astray: Sequence[Astray] = (),
) -> LiquidEstimate | None:
    """One liquid from several patterns with one gain.

    Parameters
    ----------
    observations, scenes
        Of the images.
    scaling
        Gain and offset, known or free.
    models
        Of the scenes, all for one range; None for the tank model.
    start
        Where to begin, or several liquids that the search begins from in place of a look around (see
        `OrderOneFit.media`; Henyey–Greenstein's only); looked for where None.
    progress
        Told in a few words what is being done; what it raises ends the fit.
    asked
        Which phase functions are searched; not Henyey–Greenstein's only by models that know any.
    astray
        What may go astray in each image and is fitted along, as much in all; none for nothing.

    Returns
    -------
    LiquidEstimate, or None where models that answer for a range want σs or g at its edge or beyond

    Raises
    ------
    ImageError
        When the images are dark where the scenes are bright.
    """
    models = models or models_of_tank(scenes, asked.family)
    blocks_of = liquid_blocks(models[0].range or Range.of_tank(max(max(scene.tank.size_mm) for scene in scenes)))
    shots = [Shot(*one) for one in zip(observations, scenes, models, strict=True)]
    known = start if isinstance(start, Medium) else None
    if asked.family is None:
        blocks = blocks_of(None)
        begin = None if known is None else blocks[0].start(known)
        places = [blocks[0].start(one) for one in start or ()] if not isinstance(start, Medium) else []
        fit = fitted(shots, blocks, scaling, progress, begin, starts=places or None)
    else:
        fit = fit_phase(shots, asked, blocks_of, scaling, progress, densest=known)
    fit = with_astray(fit, astray) if astray else fit
    found, likely = _liquid_at(fit, shots, asked)
    if found is None or likely is None:
        return found
    versions = models_of_spheres(scenes, models)
    for liquid in likely.liquids:
        progress("fitting spheres")
        asked = Asked(spheres(), near=liquid, likely=likely)
        other = fit_liquid(observations, scenes, scaling, versions, None, progress, asked, astray)
        if other is not None and other.scattering is not None and other.scattering.explains_as_well:
            return other
    return found


def _liquid_at(
    fit: Fit, shots: Sequence[Shot], asked: Asked
) -> tuple[LiquidEstimate | None, LikelySpheres | None]:  # fmt: skip
    """The estimate at an optimum, None beyond the models' range; and spheres that are worth a fit of their own."""
    best, within = fit.optimum, shots[0].models.range
    gain, _, left = left_over(fit)
    if within is not None and {"sigma_s", "g"} & set(best.at_edge):
        return None, None
    whole = fit.unsettled(spread_at(best, left, shots))
    answer = scattering_at(best, whole, asked, left)
    medium, spread = answer.liquid, answer.covariance[:3, :3]
    if within is not None and "g" in within.at_edge(medium):
        return None, None
    found = LiquidEstimate(
        medium, spread, gain, rms(np.array([one.rmse for one in left])), rms(np.array([one.counted for one in left])),
        determined_by(answer, spread, left, asked, fit), rms(np.array([one.beyond for one in left])), answer,
        nuisances_of(best, whole),
    )  # fmt: skip
    return found, likely_in_several(fit, left, whole, asked, answer)

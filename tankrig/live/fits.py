"""The fits of a run's photographs: one dose, the series, single scattering."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.astray import Astray, unmeasured
from tankrig.estimation.followed import Model, in_water
from tankrig.estimation.forward import models_of
from tankrig.estimation.ink_blocks import in_tank
from tankrig.estimation.one_liquid import fit_liquid
from tankrig.estimation.phase_answer import asked_for
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.series import InkAndWater, SeriesEstimate, estimate_series
from tankrig.estimation.series_forward import PURE_WATER_SIGMA_S, ModelOf, prepared_model
from tankrig.estimation.several_images import observed
from tankrig.estimation.versions import Models
from tankrig.image.prepare import Prepared
from tankrig.light.prepared.box import Box
from tankrig.live.exposures import Photograph
from tankrig.live.results import DoseFit, PhaseFound, SeriesFit, SingleScattering
from tankrig.live.single import fit_single
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

Told = Callable[[str], None]

BY_EDGES = 0.02
"""Structure, as a share of an image, that a Henyey–Greenstein series beyond its models' boxes may have from being
answered at their edges: 1 to 2 % where one of three doses is a fifth thinner than they reach. More is another phase
function's."""
NEARLY = 0.3
"""Differences of log σt, albedo and g from a box's edge, added up, within which a series' search stays at the edge."""


def fit_dose(
    photographs: Sequence[Photograph],
    start: Medium | None = None,
    progress: Told = lambda _: None,
    phase: str | PhaseFunction = "hg",
    starts: Sequence[Medium] = (),
) -> DoseFit:
    """Fit all photographs of one dose by the tank model, and by single scattering beside it.

    Parameters
    ----------
    photographs
        Of one dose.
    start
        Where to begin, where that is known.
    progress
        Told in a few words what is being done, now and then; what it raises ends the fit.
    phase
        Which phase functions are searched, as in `tankrig.estimate`.
    starts
        Where that is not known: liquids that a search begins from, in place of looking around.

    Raises
    ------
    ImageError
        When they cannot be fitted.
    """
    began = time.perf_counter()
    fit = _fitted(photographs, None, start, progress, phase, starts)
    assert fit is not None  # the tank model answers for any medium
    return replace(with_single(fit, photographs), seconds=round(time.perf_counter() - began, 3))


def fit_dose_prepared(
    photographs: Sequence[Photograph],
    models: Sequence[Prepared],
    start: Medium,
    phase: str | PhaseFunction = "hg",
    quick: bool = False,
) -> DoseFit | None:
    """The same by prepared models, one for each photograph, in milliseconds; without single scattering.

    Where another phase function than Henyey–Greenstein's is asked for, the models must be prepared for any. Light by
    way of a floor that nobody has measured takes seconds besides for each photograph; a `quick` fit, for which somebody
    waits, has it from few light paths, in a ninth of that. None where the photographs want a medium that the models
    were not prepared for.

    Raises
    ------
    ImageError
        When they cannot be fitted.
    """
    family = asked_for(phase, photographs[0].scene).family
    prepared = [models_of(one.scene, one, None, family) for one in models]
    found = _fitted(photographs, prepared, start, phase=phase, quick=quick)
    return None if found is None else replace(found, first=any(one.first for one in models))


def _fitted(
    photographs: Sequence[Photograph],
    prepared: Sequence[Models] | None,
    start: Medium | None,
    progress: Told = lambda _: None,
    phase: str | PhaseFunction = "hg",
    starts: Sequence[Medium] = (),
    quick: bool = False,
) -> DoseFit | None:
    began, first = time.perf_counter(), photographs[0]
    scenes = [one.scene for one in photographs]
    noises, masks = [one.noise for one in photographs], [one.mask for one in photographs]
    observations = observed([one.image for one in photographs], scenes, noises, masks)
    scaling, asked = Scaling.given("free", first.offset), asked_for(phase, scenes[0])
    along = unmeasured(scenes[0])
    astray = [Astray(scene, along, quick=quick) for scene in scenes] if along else []
    begin = starts if start is None else start
    found = fit_liquid(observations, scenes, scaling, prepared, begin, progress, asked, astray)
    if found is None:
        return None
    return DoseFit(
        dose_ml=first.dose_ml, dose_sd_ml=first.dose_sd_ml, medium=found.medium, sd=_deviations(found.covariance),
        identifiable=found.identifiable, gain=found.gain, rmse=found.rmse, structure=found.beyond or None,
        frames=sum(one.frames for one in photographs), patterns=tuple(one.pattern for one in photographs),
        model="prepared" if prepared else "tank", model_error=found.model_error if prepared else None,
        seconds=round(time.perf_counter() - began, 4), scattering=PhaseFound.of(found.scattering),
        astray=found.nuisance,
    )  # fmt: skip


def with_single(fit: DoseFit, photographs: Sequence[Photograph]) -> DoseFit:
    """A dose's fit with single scattering beside it."""
    return replace(fit, single=SingleScattering(*fit_single(photographs, fit.medium)), passing=False)


def fit_all(
    photographs: Sequence[Photograph],
    start: InkAndWater | Medium | None = None,
    prepared: Sequence[Prepared] = (),
    progress: Told = lambda _: None,
    phase: str | PhaseFunction = "hg",
) -> SeriesFit:
    """Fit the series: all photographs of all doses, by prepared models where there are any that hold the media.

    `progress` is told in a few words what is being done; what it raises ends the fit. Of phase functions but
    Henyey–Greenstein's models must be prepared for any. A series that ends beyond their boxes, as of ink thinner than
    models are prepared for, is gone on with by the tank model there; not where it leaves so much that the ink has
    another phase function than was fitted, which leads beyond them by itself: an emulsion's on a bench of glass
    followed light paths for more than eight minutes, and determined nothing.

    Raises
    ------
    ImageError
        When they are no series.
    """
    began = time.perf_counter()

    def fitted(start: InkAndWater | Medium | None, model_of: ModelOf | None) -> SeriesEstimate:
        return estimate_series(
            [one.image for one in photographs],
            [one.scene for one in photographs],
            [one.dose_ml for one in photographs],
            [one.dose_sd_ml for one in photographs],
            offset=photographs[0].offset,
            noise=[one.noise for one in photographs],
            masks=[one.mask for one in photographs],
            start=start,
            model_of=model_of,
            water_sigma_s=PURE_WATER_SIGMA_S,
            phase=phase,
            nuisance=unmeasured(photographs[0].scene),
            progress=progress,
        )

    found = fitted(start, nearly_within(prepared) if prepared else None)
    another = found.doubted and found.beyond > BY_EDGES
    if not another and not _held(found, photographs, prepared):
        found = fitted(found, prepared_model(prepared))
    return SeriesFit(
        doses_ml=tuple(sorted({one.dose_ml for one in photographs})), ink=found.ink, water=found.water,
        sd=_deviations(found.covariance), covariance=tuple(map(tuple, found.covariance.tolist())),
        identifiable=found.identifiable, gain=found.gain, linearity=found.linearity, rmse=tuple(found.rmse.tolist()),
        patterns=tuple(one.pattern for one in photographs), verdict=found.verdict,
        seconds=round(time.perf_counter() - began, 3), scattering=PhaseFound.of(found.scattering),
        astray=found.nuisance, doubted=found.doubted,
    )  # fmt: skip


def nearly_within(models: Sequence[Prepared]) -> ModelOf:
    """Prepared models as a series' model, each for media just beyond its box too, which it shows as at its edge.

    A step too far in the search, or absorption that is tried to be nothing, would else be answered by the tank model,
    in seconds instead of milliseconds. Where a series ends is well inside as a rule, for each dose has chosen its box;
    where it is not, see `fit_all`, this model is wrong by about as much as the medium is beyond.
    """
    model_of = prepared_model(models)

    def of_scene(scene: Scene, batches: int, seed: int) -> Model:
        model, boxes = model_of(scene, batches, seed), [one.box for one in models if one.scene == scene]

        def image(medium: Medium) -> Prediction:
            within = [box.nearest(medium) for box in boxes]
            near = min(within, key=lambda one: _apart(one, medium), default=medium)
            return model(near if _apart(near, medium) < NEARLY else medium)

        return image

    return of_scene


def _held(found: SeriesEstimate, photographs: Sequence[Photograph], models: Sequence[Prepared]) -> bool:
    """Whether every photograph whose scene has models ends in the box of one of them."""
    boxes: dict[Scene, list[Box]] = {}
    for model in models:
        boxes.setdefault(model.scene, []).append(model.box)
    for one in photographs:
        liquid = in_water(in_tank(found.ink, found.water.sigma_a, one.dose_ml), PURE_WATER_SIGMA_S)
        own = boxes.get(one.scene)
        if own and not any(box.holds(liquid) for box in own):
            return False
    return True


def _apart(one: Medium, other: Medium) -> float:
    return abs(math.log(one.sigma_t / other.sigma_t)) + abs(one.g - other.g) + abs(one.albedo - other.albedo)


def _deviations(covariance: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(np.sqrt(np.diag(covariance)).tolist())

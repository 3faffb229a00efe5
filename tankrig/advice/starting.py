"""What advice starts from: a run and its fits, or a guess of the ink."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from tankrig.advice.expected import Array, Known, Shot
from tankrig.errors import ImageError
from tankrig.estimation.phase_answer import asked_for
from tankrig.estimation.phase_families import Family, as_free
from tankrig.live.exposures import Photograph, exposures_of
from tankrig.live.results import DoseFit, SeriesFit, diluted
from tankrig.report.results import recorded
from tankrig.run.reading import Run
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

MODEL_ERROR = 0.001
"""Usual error of the models that runs are fitted with, for runs whose fits don't tell it (decision 216)."""


def from_run(run: Run) -> tuple[Known, list[Shot], list[str]]:
    """What a run has found, what it has photographed, and what its doses are called.

    Parameters
    ----------
    run
        With fits, finished or not.

    Returns
    -------
    Known, the shots taken, and the names of the patterns in their order

    Raises
    ------
    ImageError
        When it has no photograph of ink, or no fit of one.
    """
    exposures = exposures_of(run)
    photographs = exposures.photographs()
    doses, series = recorded(run)
    if not photographs or not doses:
        lacks = f"fit yet; make one: tankrig refit {run.path}" if photographs else "photograph of ink; record some"
        raise ImageError(f"{run.path}: there is nothing to advise from, as it has no {lacks}")
    shots = [Shot(one.pattern, one.scene, one.dose_ml, one.dose_sd_ml, one.frames, one.used) for one in photographs]
    ink, water, gain = _ink(doses, series)
    errors = [one.model_error for one in doses if one.model_error is not None]
    error = float(np.median(errors)) if errors else MODEL_ERROR
    free = photographs[0].offset == "free"
    patterns = [exposures.plan.patterns[key].name for key in exposures.plan.scenes]
    family = _family(ink.phase, exposures.plan.phase, photographs[0].scene)
    if family is not None:
        ink = Medium(ink.sigma_a, ink.sigma_s, phase=family.phase(family.coordinates(_member(ink, family))))
    return Known(ink, water, gain, free, _noise_of(photographs), error, family), shots, patterns


def from_fit(fit: DoseFit, photographs: Sequence[Photograph]) -> tuple[Known, list[Shot]]:
    """What the fit of one dose says of ink and camera, and the photographs that it rests on.

    Parameters
    ----------
    fit
        Of a dose, of a run that may go on.
    photographs
        Of the same dose, as they were fitted.
    """
    # What the model does not explain is no noise: like its own error, more frames do not average it away.
    error = math.hypot(MODEL_ERROR if fit.model_error is None else fit.model_error, fit.structure or 0.0)
    free = photographs[0].offset == "free"
    shots = [Shot(one.pattern, one.scene, one.dose_ml, one.dose_sd_ml, one.frames, one.used) for one in photographs]
    ink = diluted(fit.medium, fit.dose_ml, 1.0)
    return Known(ink, 0.0, fit.gain, free, _noise_of(photographs), error), shots


def _family(found: PhaseFunction | None, asked: str | PhaseFunction, scene: Scene) -> Family | None:
    """What a run's fits search; None where they have found Henyey–Greenstein."""
    return None if found is None else asked_for(found if asked == "hg" else asked, scene).family


def _member(ink: Medium, family: Family) -> PhaseFunction:
    """The ink's phase function, or the free one that is most like it."""
    phase = ink.phase_function
    return family.phase(as_free(phase)) if family.is_free and phase.kind != family.name else phase


def from_guess(ink: Medium, gain: float, noise: float) -> Known:
    """A guess, where nothing has been photographed: frames of noise `noise`, a share of their peak."""

    def variance(image: Array) -> Array:
        return np.full(image.shape, (noise * float(image.max())) ** 2)

    return Known(ink, 0.0, gain, False, variance, MODEL_ERROR)


def _ink(doses: Sequence[DoseFit], series: SeriesFit | None) -> tuple[Medium, float, float]:
    """Ink per ml, σa of the water, and gain, by the best fit there is."""
    if series is not None:
        return series.ink, series.water.sigma_a, series.gain
    last = doses[-1]
    return diluted(last.medium, last.dose_ml, 1.0), 0.0, last.gain


def _noise_of(photographs: Sequence[Photograph]) -> Callable[[Array], Array]:
    """Variance of one frame as a straight line in its brightness, as the photographs show it."""
    bright = np.concatenate([one.image[one.used] for one in photographs])
    variance = np.concatenate([one.noise[one.used] ** 2 * one.frames for one in photographs])
    design = np.stack([np.ones(bright.size), bright], axis=1)
    base, slope = np.linalg.lstsq(design, variance, rcond=None)[0]
    floor = max(0.1 * float(variance.mean()), 1e-300)
    return lambda image: np.maximum(base + slope * image, floor)

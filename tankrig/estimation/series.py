"""`estimate_series`: images at several known doses, one gain, to what a ml of ink does and what water does alone.

Within one image gain, absorption and scattering imitate each other; over a series of doses they cannot, because the
gain stays and the ink grows by a known factor.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import ImageError
from tankrig.estimation.estimate import Free
from tankrig.estimation.joint import INK, Array, Doses, Image, Joint, Mixture, slopes_of
from tankrig.estimation.observation import Observation, structure
from tankrig.estimation.projection import Scaling
from tankrig.estimation.search import Optimum, minimise
from tankrig.estimation.series_input import doses_of, known, observed
from tankrig.estimation.series_model import Model, ModelOf, in_water, tank_model
from tankrig.estimation.series_verdict import Linearity, series_verdict
from tankrig.estimation.uncertainty import PATTERN, by_smooth_errors, identifiable
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene

COARSE_BATCHES, FINE_BATCHES = 2, 8
"""Lattices of light paths of the images that steps are made with, and of those that correct them near the end."""
COARSE_ERROR = 0.05
START_MEAN_FREE_PATHS = (0.6, 1.5, 4.0, 10.0)
"""Scatterings along the tank at the highest dose, of the mixtures looked at first."""
START_ASYMMETRY = (0.0, 0.5, 0.85)
COARSE_ENOUGH, FINE_ENOUGH = 20.0, 0.1
MOST_STEPS = 12
RIVAL = 2.0
"""The best start with another g is followed too where its cost is less than this times the best's."""
MOST_CORRECTIONS = 2
NEGLIGIBLE_MOVE = 0.1
"""Accurate images computed at most, and the move of a coordinate after which they need not be computed again."""


@dataclass(frozen=True)
class SeriesEstimate:
    """What a dilution series says about ink and water.

    Parameters
    ----------
    ink
        σa and σs per mm and ml, and g.
    water
        What the tank holds without ink: absorption only.
    covariance
        (4, 4), of (ink σa, ink σs, g, water σa): camera noise, the models' own error, and the doses'.
    identifiable
        Which of "sigma_a", "sigma_s", "g", "water_sigma_a" the series determines.
    gain, offsets
        Common gain; offset of each image.
    doses_ml
        (K,) the different doses, each moved within its uncertainty to where the images want it.
    images, residuals
        Fitted images and observed less fitted, NaN where a pixel was left out; in the order given.
    rmse
        (N,) root mean square residual of each image.
    linearity
        By how much the ink does more (+) or less (−) than in proportion to the dose; None below three doses.
    verdict
        What is determined, whether the ink acts in proportion to its dose, and what the residuals say.
    """

    ink: Medium
    water: Medium
    covariance: NDArray[np.float64]
    identifiable: dict[str, bool]
    gain: float
    offsets: tuple[float, ...]
    doses_ml: Array
    images: tuple[Image, ...]
    residuals: tuple[Image, ...]
    rmse: Array
    linearity: Linearity | None
    verdict: str

    def at(self, dose_ml: float) -> Medium:
        """The liquid at a dose."""
        return Mixture(self.ink, self.water.sigma_a, np.zeros(0)).at(dose_ml)


def estimate_series(
    images: Sequence[ArrayLike],
    scenes: Scene | Sequence[Scene],
    doses_ml: ArrayLike,
    doses_sd_ml: ArrayLike = 0,
    gain: float | Free = "free",
    offset: float | Free = "free",
    noise: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    start: SeriesEstimate | Medium | None = None,
    model_of: "ModelOf | None" = None,
    water_sigma_s: float = 0.0,
    progress: Callable[[str], None] | None = None,
) -> SeriesEstimate:
    """What a ml of ink does, from images at known doses with one common gain.

    Parameters
    ----------
    images
        N of them, each (rows, columns); several may share a dose, with different patterns or the same.
    scenes
        One for all, or one per image; their media do not matter.
    doses_ml
        (N,) ink in the tank in all at each image: positive, never falling, two different ones at least.
    doses_sd_ml
        Standard deviation of the doses, one for all or (N,); images at one dose share its error.
    gain
        "free" for one unknown gain common to all images, or its value: image units per W/mm²/sr.
    offset
        "free" for an unknown offset of each image, or the value of all.
    noise
        Standard deviation of a pixel, one for all images or one (scalar or per pixel) for each; None to estimate it.
    start
        An earlier estimate of the same ink, or the ink per mm and ml, to begin from, which saves the search.
    model_of
        What is fitted; None for the tank model.
    water_sigma_s
        What the water scatters without ink, 1/mm, evenly forwards and backwards; `PURE_WATER_SIGMA_S` where it is
        clean. At a tenth of a ml it makes half a per cent of the image, which would pass for absorption.
    progress
        Told in a few words what is being done, now and then.

    Returns
    -------
    SeriesEstimate

    Raises
    ------
    ImageError
        When images, doses and scenes cannot be a series, in one sentence.
    SceneError
        When the model cannot treat a scene.
    """
    images = list(images)
    scenes = [scenes] * len(images) if isinstance(scenes, Scene) else list(scenes)
    if len(scenes) != len(images):
        raise ImageError(f"{len(images)} images but {len(scenes)} scenes; give one scene for all or one for each image")
    doses = doses_of(doses_ml, doses_sd_ml, len(images))
    observations = observed(images, scenes, noise)
    scaling = Scaling(known("gain", gain), known("offset", offset))
    begin = None
    if start is not None:
        ink, water = (start, 0.0) if isinstance(start, Medium) else (start.ink, start.water.sigma_a)
        begin = Mixture(ink, water, np.zeros(doses.ml.size))
    model_of = in_water(model_of or tank_model, water_sigma_s)
    return fit_series(observations, scenes, doses, scaling, model_of, begin, progress or (lambda _: None))


def estimate_together(
    images: Sequence[ArrayLike],
    scenes: Sequence[Scene],
    offset: float | Free = "free",
    noise: Sequence[ArrayLike] | None = None,
    *,
    start: Medium | None = None,
) -> SeriesEstimate:
    """One liquid from several patterns with one unknown gain: a series of one dose, of 1 ml, in clear water.

    Parameters
    ----------
    images, scenes, offset, noise
        As for `estimate_series`.
    start
        Where to begin; searched for where None.

    Returns
    -------
    SeriesEstimate
        `ink` is the liquid, per mm.
    """
    observations = observed(images, scenes, noise)
    doses = Doses(np.ones(1), np.zeros(1), np.zeros(len(images), int))
    scaling = Scaling(None, known("offset", offset))
    begin = None if start is None else Mixture(start, 0.0, np.zeros(1))
    return fit_series(observations, scenes, doses, scaling, tank_model, begin, lambda _: None)


def fit_series(
    observations: Sequence[Observation],
    scenes: Sequence[Scene],
    doses: Doses,
    scaling: Scaling,
    model_of: ModelOf,
    start: Mixture | None,
    progress: Callable[[str], None],
) -> SeriesEstimate:
    """Fit a series with any model: three images from afar, all with the quick model, at last with the accurate one."""
    length_mm = max(max(scene.tank.size_mm) for scene in scenes)
    models = _models(scenes, model_of, COARSE_BATCHES, 0)
    quick = [_image_of(model) for model in models]
    errors = [COARSE_ERROR * _above_ambient(seen, scaling) for seen in observations]
    slopes = [slopes_of(forward, length_mm) for forward in quick]
    joint = Joint(quick, slopes, observations, errors, doses, scaling, length_mm)
    at = joint.coordinates(start) if start else _from_afar(joint, progress)
    progress("fitting all images")
    at = _minimise(joint, at, COARSE_ENOUGH).coordinates
    accurate = _models(scenes, model_of, FINE_BATCHES, 1)
    for _ in range(MOST_CORRECTIONS):
        progress("correcting with accurate images")
        before, mixture = at, joint.mixture(at)
        predictions = [model(medium) for model, medium in zip(accurate, joint.media(mixture), strict=True)]
        joint = _corrected(joint, quick, mixture, predictions)
        at = _minimise(joint, at, FINE_ENOUGH).coordinates
        if np.abs(at - before).max() < NEGLIGIBLE_MOVE:
            break
    progress("finding the errors")
    return _described(joint, joint.mixture(at), [_stated(one) for one in predictions], scenes[0].camera.pixel_mm)


def _models(scenes: Sequence[Scene], model_of: ModelOf, batches: int, seed: int) -> list[Model]:
    """One model per image; images of one scene share theirs, and what it has computed."""
    by_scene: dict[Scene, Model] = {}
    for scene in scenes:
        if scene not in by_scene:
            by_scene[scene] = lru_cache(maxsize=64)(model_of(scene, batches, seed))
    return [by_scene[scene] for scene in scenes]


def _image_of(model: Model) -> Callable[[Medium], Image]:
    return lambda medium: model(medium).image


def _above_ambient(seen: Observation, scaling: Scaling) -> Array:
    ambient = float(np.percentile(seen.image[seen.used], 5)) if scaling.offset is None else scaling.offset
    return np.maximum(seen.image - ambient, 0.0)


def _from_afar(joint: Joint, progress: Callable[[str], None]) -> Array:
    """Best mixture for one image each of the lowest, a middle and the highest dose."""
    groups = joint.doses.of_image.tolist()
    few = [groups.index(group) for group in sorted({0, (joint.doses.ml.size - 1) // 2, joint.doses.ml.size - 1})]
    part = joint.of(few)
    progress("looking at a few mixtures")
    starts = []
    for paths in START_MEAN_FREE_PATHS:
        for g in START_ASYMMETRY:
            sigma_s = paths / joint.length_mm / float(joint.doses.ml.max())
            mixture = Mixture(Medium(0.03 * sigma_s, sigma_s, g), 0.0, np.zeros(joint.doses.ml.size))
            at = joint.coordinates(mixture)
            starts.append((float(np.sum(part.residual(at) ** 2)), at))
    starts.sort(key=lambda one: one[0])
    best = starts[0]
    rivals = [one for one in starts[1:] if one[1][2] != best[1][2] and one[0] < RIVAL * best[0]]
    progress("searching with three images")
    ends = [_minimise(part, at, COARSE_ENOUGH) for _, at in (best, *rivals[:1])]
    return min(ends, key=lambda end: end.cost).coordinates


def _minimise(joint: Joint, at: Array, enough: float) -> Optimum:
    whole, longest = joint.residual_and_jacobian, joint.longest_step
    return minimise(joint.residual, whole, at, joint.box, enough, MOST_STEPS, longest)


def _corrected(
    joint: Joint, quick: Sequence[Callable[[Medium], Image]], mixture: Mixture, predictions: Sequence[Prediction]
) -> Joint:
    """The same problem, quick images moved by what they are off by at a mixture, and the weights that go with it."""
    media = joint.media(mixture)
    off = [one.image - near(medium) for one, near, medium in zip(predictions, quick, media, strict=True)]
    gain, offsets = joint.scale([one.image for one in predictions])
    observations = [
        seen.with_noise_of(seen.image - gain * one.image - offset)
        for seen, one, offset in zip(joint.observations, predictions, offsets, strict=True)
    ]
    errors = [min(COARSE_ERROR, _stated(one)) * abs(gain) * np.abs(one.image) for one in predictions]
    forwards = [_moved(near, by) for near, by in zip(quick, off, strict=True)]
    return replace(joint, forwards=forwards, observations=observations, errors=errors)


def _moved(forward: Callable[[Medium], Image], by: Image) -> Callable[[Medium], Image]:
    return lambda medium: forward(medium) + by


def _stated(prediction: Prediction) -> float:
    """A model's own error, relative L2."""
    noise = 0.0 if prediction.stderr is None else float(np.linalg.norm(prediction.stderr))
    noise /= float(np.linalg.norm(prediction.image))
    return math.hypot(noise, *(part.bound for part in prediction.skipped if math.isfinite(part.bound)))


def _described(joint: Joint, mixture: Mixture, stated: Sequence[float], pixel_mm: float) -> SeriesEstimate:
    """The estimate at an optimum: errors, linearity, residuals, verdict."""
    models = joint.images(mixture)
    gain, offsets = joint.scale(models)
    if gain <= 0.0:
        raise ImageError(
            "the images are dark where the scenes' light is and bright where it is not; check that images and scenes "
            "belong together and which way up the images are"
        )
    fitted = [gain * model + offset for model, offset in zip(models, offsets, strict=True)]
    residuals = [
        np.where(seen.used, seen.image - one, np.nan) for seen, one in zip(joint.observations, fitted, strict=True)
    ]
    rmse = np.array([_rms(one[seen.used]) for one, seen in zip(residuals, joint.observations, strict=True)])
    bright = np.array([_rms(gain * one[seen.used]) for one, seen in zip(models, joint.observations, strict=True)])
    noise = np.array([_rms(seen.noise[seen.used]) for seen in joint.observations])
    shared = np.array([structure(one, seen.used) for one, seen in zip(residuals, joint.observations, strict=True)])
    white = np.sqrt(np.maximum(rmse**2 - shared**2, 0.0))
    noisier = np.maximum(white / noise, 1.0)
    # The stated error is counted with what patterns do (see `PATTERN`); what the residuals show beyond it, as it is.
    beyond_stated = np.maximum((shared / bright) ** 2 - np.square(stated), 0.0)
    counted = np.sqrt(np.square(PATTERN * np.asarray(stated)) + beyond_stated)

    errors = [share * gain * np.abs(model) for share, model in zip(counted, models, strict=True)]
    spread, linearity = _spread(joint, mixture, noisier, errors, pixel_mm)
    ink, doses = mixture.ink, joint.doses
    determined = identifiable(ink, spread[:3, :3]) | {
        "water_sigma_a": bool(math.sqrt(spread[3, 3]) <= 0.2 * mixture.water)
    }
    noise_known = all(seen.noise_known for seen in joint.observations)
    beyond = float(np.median(noisier)) if noise_known else 1.0
    left = (float(_rms(shared / bright)), float(_rms(np.asarray(stated))), beyond)
    return SeriesEstimate(
        ink=ink, water=Medium(mixture.water, 0.0, 0.0), covariance=spread, identifiable=determined, gain=gain,
        offsets=tuple(offsets), doses_ml=doses.ml + doses.sd_ml * mixture.off, images=tuple(fitted),
        residuals=tuple(residuals), rmse=rmse, linearity=linearity,
        verdict=series_verdict(mixture.water, spread, determined, linearity, left),
    )  # fmt: skip


def _spread(
    joint: Joint, mixture: Mixture, noisier: Array, errors: Sequence[Image], pixel_mm: float
) -> tuple[Array, Linearity | None]:
    """Covariance of (ink σa, ink σs, g, water σa), and whether the ink acts in proportion to the dose."""
    doses = joint.doses
    per_ml = replace(joint, doses=replace(doses, sd_ml=np.ones_like(doses.sd_ml)))
    changes = per_ml.changes(replace(mixture, off=mixture.off * doses.sd_ml))
    bend = ((doses.ml**2 / doses.ml.max()) @ changes[INK:])[None]
    changes[INK:] *= doses.sd_ml[:, None]
    changes[3] *= joint.most_water > 0.0
    ink = mixture.ink
    widest = np.array([10.0 * (ink.sigma_a + ink.sigma_s)] * 2 + [1.0, 10.0 * joint.at_highest(mixture).sigma_t])
    prior = np.array([*widest, *np.ones(doses.ml.size)])

    def covariance(rows: Array, prior: Array) -> tuple[Array, Array]:
        """Covariance, and the inverse curvature times the rows: what the parameters do for a residual."""
        scaled = rows * prior[:, None]
        inverse = np.linalg.inv(scaled @ scaled.T + np.eye(prior.size))
        response = inverse @ scaled
        total: Array = inverse @ inverse
        parts = zip(joint.split(response), joint.observations, joint.weights, noisier, errors, strict=True)
        for part, seen, weight, factor, error in parts:
            answer = part * weight
            by_noise = answer * (factor * seen.noise[seen.used])
            total += by_noise @ by_noise.T
            smooth = by_smooth_errors(answer, seen.used, np.asarray(error, float), joint.length_mm / pixel_mm)
            total = total + smooth
        spread = total * np.outer(prior, prior)
        return 0.5 * (spread + spread.T), response * prior[:, None]

    spread, _ = covariance(changes, prior)
    if doses.ml.size < 3:
        return spread[:INK, :INK], None
    with_bend, response = covariance(np.vstack([changes, bend]), np.array([*prior, 10.0]))
    residual = joint.residual(joint.coordinates(mixture))[: changes.shape[1]]
    linearity = Linearity(float(response[-1] @ residual), math.sqrt(with_bend[-1, -1]))
    return spread[:INK, :INK], linearity


def _rms(values: Image) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

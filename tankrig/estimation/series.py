"""`estimate_series`: images at several known doses, one gain, to what a ml of ink does and what water does alone.

Within one image gain, absorption and scattering imitate each other; over a series of doses they cannot, because the
gain stays and the ink grows by a known factor.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import ImageError, SceneError
from tankrig.estimation.astray import ASTRAY, Astray
from tankrig.estimation.coordinates import to_coordinates
from tankrig.estimation.estimate import Free, nuisances_of
from tankrig.estimation.fitting import Ending, fitted
from tankrig.estimation.ink_blocks import BendBlock, Doses, in_tank
from tankrig.estimation.left_over import Left, left_over, moved_by_halos, rms
from tankrig.estimation.observation import Observation
from tankrig.estimation.phase_answer import (
    Asked,
    asked_for,
    fit_phase,
    ink_blocks,
    is_rough,
)
from tankrig.estimation.phase_average import LikelySpheres
from tankrig.estimation.phase_families import Family
from tankrig.estimation.phase_result import Scattering, coefficients_by
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.result import Linearity
from tankrig.estimation.result import SeriesEstimate as SeriesEstimate
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.search import Told
from tankrig.estimation.series_forward import ModelOf, modelled_in_water
from tankrig.estimation.several_images import (
    determined_by,
    errors_of,
    leaves_much,
    likely_in_several,
    models_by_scene,
    models_of_spheres,
    models_of_tank,
    observed,
    scattering_at,
    spread_at,
    tells_of_spheres,
)
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.spheres import spheres
from tankrig.estimation.uncertainty import PATTERN
from tankrig.estimation.verdict import (
    series_verdict,
    what_has_not_settled,
    what_is_misaligned,
    what_is_unseen,
    what_may_be_another_phase,
    what_may_peak_unseen,
    what_no_phase_describes,
    what_spheres_do,
)
from tankrig.estimation.versions import Models
from tankrig.estimation.with_astray import along_from, astray_from, with_astray
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]
Image = NDArray[np.floating]


class InkAndWater(Protocol):
    """An earlier estimate."""

    @property
    def ink(self) -> Medium:
        """Per mm and ml."""
        ...

    @property
    def water(self) -> Medium:
        """Without ink."""
        ...


def estimate_series(
    images: Sequence[ArrayLike],
    scenes: Scene | Sequence[Scene],
    doses_ml: ArrayLike,
    doses_sd_ml: ArrayLike = 0,
    gain: float | Free = "free",
    offset: float | Free = "free",
    noise: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    masks: Sequence[ArrayLike | None] | None = None,
    start: InkAndWater | Medium | None = None,
    model_of: "ModelOf | None" = None,
    water_sigma_s: float = 0.0,
    phase: str | PhaseFunction | None = None,
    nuisance: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> SeriesEstimate:
    """What a ml of ink does, from images at known doses with one common gain.

    Parameters
    ----------
    images
        N of them, each (rows, columns); several may share a dose, with different patterns or the same.
    scenes
        One for all, or one per image; of their media no more than the first one's phase function matters, see `phase`.
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
    masks
        Of each image, (rows, columns), True where a pixel is to be left out; None for none.
    start
        An earlier estimate of the same ink, or the ink per mm and ml, to begin from, which saves the search.
    model_of
        What is fitted; None for the tank model.
    water_sigma_s
        What the water scatters without ink, 1/mm, evenly forwards and backwards; `PURE_WATER_SIGMA_S` where it is
        clean. At a tenth of a ml it makes half a per cent of the image, which would pass for absorption.
    phase
        How one scattering of the ink turns light, the same at every dose; as for `estimate`.
    nuisance
        What may go astray and is fitted along, the same in all images, with its standard deviation: "halo", "veil",
        "blur_mm2", "floor", "black_level"; as for `estimate`.
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
    if unknown := (nuisance or {}).keys() - ASTRAY.keys():
        raise SceneError(f"nuisance {min(unknown)!r} is none of a series; give some of {', '.join(ASTRAY)}")
    doses = doses_of(doses_ml, doses_sd_ml, len(images))
    asked = asked_for(phase, scenes[0])
    observations = observed(images, scenes, noise, masks)
    if model_of is None:
        models = models_of_tank(scenes, asked.family, water_sigma_s)
    else:
        models = models_by_scene(scenes, modelled_in_water(model_of, water_sigma_s), asked.family)
    told = progress or (lambda _: None)
    scaling = Scaling.given(gain, offset)
    return fit_series(observations, scenes, doses, scaling, models, start, told, asked, nuisance)


def fit_series(
    observations: Sequence[Observation],
    scenes: Sequence[Scene],
    doses: Doses,
    scaling: Scaling,
    models: Sequence[Models],
    start: InkAndWater | Medium | None,
    progress: Told,
    asked: Asked = Asked(),  # noqa: B008
    nuisance: Mapping[str, float] | None = None,
) -> SeriesEstimate:
    """Fit a series with any models, one of each image; see `estimate_series`."""
    length_mm = max(max(scene.tank.size_mm) for scene in scenes)
    blocks_of = ink_blocks(doses, length_mm)
    shots = [Shot(*one) for one in zip(observations, scenes, models, doses.of_image.tolist(), strict=True)]
    astray = [Astray(scene, nuisance) for scene in scenes] if nuisance else []
    ink, water = (start, 0.0) if start is None or isinstance(start, Medium) else (start.ink, start.water.sigma_a)
    highest = doses.ml.size - 1
    may_be_spheres = asked.averaged and asked.near is None  # and they have not been refused
    few = [doses.of_image.tolist().index(dose) for dose in sorted({0, highest // 2, highest})]
    if asked.family is None:
        blocks, begin = blocks_of(None), None
        if ink is not None:
            own = np.append(to_coordinates(ink), water * length_mm)
            begin = np.append(np.clip(own, blocks[0].low, blocks[0].high), np.zeros(doses.ml.size))
            if astray:
                begin, blocks = astray_from(begin, shots, blocks, scaling, astray)
        fit = fitted(shots, blocks, scaling, progress, begin, few)
    else:
        densest = None if ink is None else in_tank(ink, water, float(doses.ml[highest]))
        if astray and (about := asked.near or densest) is not None:
            blocks_of = along_from(about, asked.family, shots, blocks_of, scaling, astray)
        ending = Ending(suffices=partial(tells_of_spheres, shots, asked) if may_be_spheres else None)
        fit = fit_phase(shots, asked, blocks_of, scaling, progress, few, densest, ending)
    if astray and not fit.early:  # or the fit of spheres, or its own end, does
        fit = with_astray(fit, astray)
    progress("finding the errors")
    found, likely = _built(fit, doses, shots, asked)
    again = partial(fit_series, observations, scenes, doses, scaling)
    densest_of = partial(in_tank, dose_ml=float(doses.ml[highest]))
    if likely is not None and may_be_spheres:
        versions = models_of_spheres(scenes, models)
        for one in likely.liquids:
            progress("fitting spheres")
            near = None if one is None else densest_of(one, found.water.sigma_a)
            other = again(versions, None, progress, Asked(spheres(), near=near, likely=likely), nuisance)
            if other.scattering is not None and other.scattering.explains_as_well:
                return replace(other, verdict=f"{what_spheres_do()} {other.verdict}")
    if not fit.early:
        return found
    progress("going on with any phase function")
    near = densest_of(found.ink, found.water.sigma_a)
    return again(models, None, progress, replace(asked, near=near), nuisance)


def _built(
    fit: Fit, doses: Doses, shots: Sequence[Shot], asked: Asked
) -> tuple[SeriesEstimate, LikelySpheres | None]:  # fmt: skip
    """The estimate at an optimum: errors, linearity, residuals, verdict; and spheres that are worth a fit of their
    own."""
    best = fit.optimum
    gain, offsets, left = left_over(fit)
    blocks, whole = best.problem.blocks, fit.unsettled(spread_at(best, left, shots))
    linearity = None
    if doses.ml.size > 2:
        bent = replace(best.problem, blocks=(*blocks, BendBlock(doses))).at(np.append(best.coordinates, 0.0))
        linearity = Linearity(float(bent.sensitivity.step(bent.left)[-1]), _sd_of_bend(bent, left, shots))
    answer = scattering_at(best, whole, asked, left)
    if asked.family is None:
        water, spread = float(best.values["ink"][3]), whole[:4, :4]
    else:
        water, spread = float(best.values["water"][0]), _with_water(best, whole, asked.family, answer)
    liquid = answer.liquid
    known = determined_by(answer, spread[:3, :3], left, asked, fit) | {
        "water_sigma_a": bool(math.sqrt(spread[3, 3]) <= 0.2 * water)
    }
    noise_known = all(view.observation.noise_known for view in best.problem.views)
    beyond = float(np.median([one.noisier for one in left])) if noise_known else 1.0
    shares = rms(np.array([one.unexplained for one in left])), rms(np.array([one.stated for one in left])), beyond
    off, rough = nuisances_of(best, whole), is_rough(best, asked)
    doubted = asked.family is None and leaves_much(left, asked)
    unseen = np.zeros(3) if "halo" in off else moved_by_halos(best, left)
    built = SeriesEstimate(
        ink=liquid, water=Medium(water, 0.0, 0.0), covariance=spread, identifiable=known, gain=gain,
        offsets=tuple(offsets), doses_ml=doses.moved(best.values["doses"]), images=tuple(one.image for one in left),
        residuals=tuple(one.residual for one in left), rmse=np.array([one.rmse for one in left]), linearity=linearity,
        verdict=" ".join(
            filter(None, [
                series_verdict(water, spread, known, linearity, shares),
                what_may_be_another_phase(doubted),
                what_no_phase_describes(asked.is_free and (leaves_much(left, asked) or rough), rough),
                what_has_not_settled(fit.moved is not None),
                what_may_peak_unseen(answer.outside_cone if answer.may_peak else None, "/mm per ml"),
                what_is_misaligned(off),
                what_is_unseen(liquid, unseen[: 3 if asked.family is None else 2], spread, known),
            ])
        ),
        scattering=answer, nuisance=off, doubted=doubted, beyond=max(one.beyond for one in left),
    )  # fmt: skip
    return built, likely_in_several(fit, left, whole, asked, answer)


def _with_water(best: Evaluation, spread: Array, family: Family, answer: Scattering) -> Array:
    """(4, 4) covariance of the ink's σa, σs and mean cosine, and the water's σa, which goes with them as it was fitted.

    Where families were averaged, their own covariance stands, and the water's correlation with it.
    """
    count = 2 + len(family.names)
    by_coordinates = np.eye(4, count + 1)
    by_coordinates[:3, :count] = coefficients_by(family, best.values["phase"])
    by_coordinates[3] = np.eye(count + 1)[count]
    fitted_spread = by_coordinates @ spread[: count + 1, : count + 1] @ by_coordinates.T
    sd = np.sqrt(np.maximum(np.diag(fitted_spread), 1e-300))
    scale = np.append(np.sqrt(np.diag(answer.covariance)) / sd[:3], 1.0)
    found = fitted_spread * np.outer(scale, scale)
    found[:3, :3] = answer.covariance
    return np.asarray(found)


def _sd_of_bend(bent: Evaluation, left: Sequence[Left], shots: Sequence[Shot]) -> float:
    """Standard deviation of the bend, if it were none: structure that residuals hold may be the bend's own.

    The stated error is counted with what patterns do (see `PATTERN`); what the residuals show beyond it, as it is.
    """
    counted = [math.hypot(PATTERN * one.stated, one.beyond) for one in left]
    spread = bent.sensitivity.covariance([one.noise for one in left], errors_of(shots, left, counted))
    return math.sqrt(spread[-1, -1])


def doses_of(doses_ml: ArrayLike, doses_sd_ml: ArrayLike, count: int) -> Doses:
    """Check the doses and group the images by them."""
    ml = _numbers("doses_ml", doses_ml)
    if ml.shape != (count,) or count == 0:
        raise ImageError(f"{count} images but doses_ml has shape {list(ml.shape)}; give one dose for each image")
    if (np.diff(ml) < 0.0).any():
        raise ImageError("doses_ml falls from one image to the next; doses are cumulative, give them as they rose")
    if ml[0] <= 0.0:
        raise ImageError(f"doses_ml begins with {ml[0]:g}, where nothing scatters; leave images without ink out")
    different, first, group = np.unique(ml, return_index=True, return_inverse=True)
    if different.size < 2:
        raise ImageError(
            f"all images are at one dose, {ml[0]:g} ml, which cannot tell ink from water and gain; "
            "give two doses or more, or use estimate"
        )
    sd = _numbers("doses_sd_ml", doses_sd_ml)
    if sd.shape not in ((), (count,)) or (sd < 0.0).any():
        raise ImageError("doses_sd_ml is not a standard deviation for all or one for each image; give zero or more")
    return Doses(different, np.broadcast_to(sd, ml.shape)[first].copy(), np.asarray(group, int))


def _numbers(name: str, values: ArrayLike) -> Array:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise ImageError(f"{name} is not made of numbers; give ml") from error
    if not np.isfinite(array).all():
        raise ImageError(f"{name} holds a number that is not finite; give ml")
    return array

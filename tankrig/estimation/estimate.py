"""`estimate`: from an image of a tank to the coefficients of what is in it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import SceneError
from tankrig.estimation.astray import ASTRAY, Astray, AstrayBlock
from tankrig.estimation.astray_patterns import floor_by_few
from tankrig.estimation.coordinates import Range
from tankrig.estimation.findings import Findings, findings_of
from tankrig.estimation.fitting import Ending, fitted_on, searched, without_outliers
from tankrig.estimation.forward import models_of
from tankrig.estimation.left_over import Left, left_over, moved_by_halos, rms, stated_errors
from tankrig.estimation.light_beside import BESIDE, BesideBlock
from tankrig.estimation.misfit import moved_unseen
from tankrig.estimation.observation import Observation, observe
from tankrig.estimation.optimiser import polish
from tankrig.estimation.phase_answer import (
    Asked,
    answer_of,
    asked_for,
    fit_phase,
    is_rough,
    likely_spheres,
    liquid_blocks,
    mostly_spheres,
)
from tankrig.estimation.phase_average import AS_WELL, FOLLOWED, LikelySpheres
from tankrig.estimation.phase_doubt import PhaseTold, told_early
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.residual import WHOLE, structure_map
from tankrig.estimation.result import Estimate as Estimate
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.search import Told
from tankrig.estimation.set_up import Misalignment, SetUpBlock
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.spheres import spheres
from tankrig.estimation.uncertainty import identifiable, overconfidence, stretches
from tankrig.estimation.verdict import (
    MUCH_LEFT_OUT,
    what_did_not_hold,
    what_has_not_settled,
    what_is_determined,
    what_is_left,
    what_is_misaligned,
    what_is_shown,
    what_is_unseen,
    what_may_be_another_phase,
    what_may_peak_unseen,
    what_no_phase_describes,
    what_phase_is_shown,
    what_spheres_do,
    what_was_hardly_told,
    what_was_left_out,
)
from tankrig.estimation.versions import Models
from tankrig.estimation.with_astray import with_astray
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

if TYPE_CHECKING:
    from tankrig.image.prepare import Prepared

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Free = Literal["free"]

ALIGNINGS, ALIGNED = 5, 2.0
"""Times at most that misalignments are searched for, and the gain in χ²/2 below which that is over."""
FAR_MORE, NEARLY_ALL = 0.5, 0.9
"""Share of what Henyey–Greenstein's leaves, squared, that a fit of other phase functions has to explain at least which
was begun from anywhere, and more than any other cause does; and share that such a cause has to explain, or that is
tried. An emulsion of σs .05 looked like uneven ink, which explained two thirds."""
HOPELESS = 0.1
"""Unexplained structure, as a share of the image, from which on nothing counts as determined."""
COMMON_FLOOR = 0.04
"""Reflectance of a floor that somebody has painted black."""


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
    phase: "str | PhaseFunction | None" = None,
    nuisance: Mapping[str, float] | None = None,
    image_error: ArrayLike | None = None,
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
        Tank, projector and camera; of its medium no more than the phase function matters, see `phase`.
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
    phase
        How one scattering turns light: "hg" (Henyey–Greenstein), "two-term", "reynolds-mccormick", "fournier-forand",
        "free" (any smooth one), or "any": all but Fournier and Forand's, weighed by their evidence. A `Mie` is what a
        label says, fitted within its accuracy; any other phase function is taken as it is. "mie" and "table" mean the
        scene's. None: the scene's, to begin from. Where it has none, "hg", and "any" where that leaves structure that
        another phase function explains better than anything else, or the image hardly tells that from others: one to
        seven CPU minutes where light or sight slants, lenses blur or walls send light back.
    nuisance
        What may be off in the set-up, each with its standard deviation, and is fitted along: "z_mm", "y_mm" (light
        moved up, and along y), "tilt_mrad" (light turned about the vertical, towards +y), "scale" (share by which a
        pixel is larger than described); and what may go astray: "halo" and "veil" (shares of the light in the camera's,
        more than described; "halo_width", the logarithm of the halo's width over the scene's, is fitted along with it,
        ± .5 unless given), "blur_mm2" (variance of the camera's blur, likewise), "floor" (its diffuse reflectance),
        "pane" (what the entry pane's outer side sends back, as a share of what glass with air behind it does),
        "black_level" (irradiance of a dark picture, W/mm²), "projector_halo" (share of the light in the projector's, of
        the width that the scene says).
    image_error
        Standard error of an image that was computed, as `Prediction.stderr` is, scalar or per pixel: it is smooth, and
        counted as the model's own is. None for a camera's.
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
    scaling, asked = Scaling.given(gain, offset), asked_for(phase, scene)
    if phase is None and asked.family is None and model == "tank" and max_order is None:
        asked = replace(asked, further=asked_for("any", scene))
    off = {name: sd for name, sd in (nuisance or {}).items() if name not in ASTRAY}
    misalignment = Misalignment(scene, off, 1 if model == "single" else max_order) if off else None
    stray = {name: sd for name, sd in (nuisance or {}).items() if name in ASTRAY}
    beside = {name: sd for name, sd in stray.items() if name in BESIDE} if asked.family is None else {}
    lenses = {name: sd for name, sd in stray.items() if name not in beside}
    astray = Astray(scene, lenses) if lenses else None
    block = BesideBlock.of(scene, beside) if beside else None
    observation = observe(image, scene.camera.shape, noise, mask, image_error)
    models = models_of(scene, model, max_order, asked.family, checked=True)
    return fit_models(observation, scene, scaling, models, progress or _silently, misalignment, asked, astray, block)


def fit_models(
    observation: Observation,
    scene: Scene,
    scaling: Scaling,
    models: Models,
    progress: Told,
    misalignment: Misalignment | None = None,
    asked: Asked = Asked(),  # noqa: B008
    astray: Astray | None = None,
    beside: BesideBlock | None = None,
) -> Estimate:
    """Fit one image by any forward model: a series of one.

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
    asked
        Which phase functions are.
    astray
        What light may go astray; None where nothing is fitted of that.
    beside
        Light beside the beams' own that is fitted from the first look on, with Henyey–Greenstein's phase function;
        None where there is none.
    """
    blocks_of = liquid_blocks(models.range or Range.of_tank(max(scene.tank.size_mm)))
    shot = Shot(observation, scene, models)
    if asked.family is None:
        blocks = (*blocks_of(None), beside) if beside is not None else blocks_of(None)
        looked = searched([shot], blocks, scaling, progress)
        if asked.further is not None and misalignment is None and astray is None and beside is None:
            early = told_early(shot, looked, progress)
            if early is not None:
                liquid = early.liquid
                other = _further(observation, scene, scaling, models, progress, None, asked.further, None, liquid)
                return _in_place(other, early.share)
        fit = fitted_on([shot], looked, progress, Ending(sharper=True))
        fit = fit if beside is None else weighed(fit, beside)
    else:
        fit = fit_phase([shot], asked, blocks_of, scaling, progress, ending=Ending(sharper=not asked.averaged))
    if misalignment is not None:
        progress("aligning")
        fit = _aligned(fit, misalignment)
    if astray is not None:
        progress("following light astray")
        fit = with_astray(fit, [astray])
    fit = without_outliers(fit)
    progress("finding the errors")
    found, phase, likely = _built(fit, scene, models, asked)
    for spherical in likely.liquids if likely is not None else ():
        of_spheres = Asked(spheres(), near=spherical, likely=likely)
        other = _as_spheres(observation, scene, scaling, models, progress, misalignment, of_spheres, astray)
        if _explains_as_well(other, found):
            found = other
            break
    if asked.further is None or not (phase.misled or phase.undecided or phase.explained < NEARLY_ALL):
        return found
    if beside is not None:
        astray = Astray(scene, {**beside.sd, **(astray.sd if astray else {})})
    instead = phase.instead if phase.misled else None
    near = found.medium if phase.undecided else None
    if instead is not None:
        near = instead.liquid
    other = _further(observation, scene, scaling, models, progress, misalignment, asked.further, astray, near)
    if instead is not None:
        return _in_place(other, instead.share)
    if phase.undecided:
        explains = other.rmse < AS_WELL * found.rmse
        return replace(other, verdict=f"{what_was_hardly_told()} {other.verdict}") if explains else found
    # From where Henyey–Greenstein's has gone astray no look leads back: what explains far more is begun from anywhere.
    share = 1.0 - (other.rmse / found.rmse) ** 2
    return _in_place(other, share) if share > max(FAR_MORE, phase.explained) else found


def _further(
    observation: Observation, scene: Scene, scaling: Scaling, models: Models, progress: Told,
    misalignment: Misalignment | None, asked: Asked, astray: Astray | None, near: Medium | None,
) -> Estimate:  # fmt: skip
    """The estimate by further phase functions, begun near a liquid, or from anywhere."""
    progress("weighing other phase functions")
    other, asked = models.of(asked.family), replace(asked, near=near)
    return fit_models(observation, scene, scaling, other, progress, misalignment, asked, astray)


def _as_spheres(
    observation: Observation, scene: Scene, scaling: Scaling, models: Models, progress: Told,
    misalignment: Misalignment | None, asked: Asked, astray: Astray | None,
) -> Estimate:  # fmt: skip
    """The estimate by spheres, begun near likely ones."""
    progress("fitting spheres")
    other = fit_models(observation, scene, scaling, models.of(spheres()), progress, misalignment, asked, astray)
    return replace(other, verdict=f"{what_spheres_do()} {other.verdict}")


def _explains_as_well(other: Estimate, freely: Estimate) -> bool:
    """Whether an estimate leaves as much of an image as one of a free phase function does, within what that follows of
    noise and of the model's own error."""
    error = freely.model_error * rms(freely.image)
    return other.rmse**2 < (AS_WELL * freely.rmse) ** 2 + FOLLOWED * error**2


def _in_place(other: Estimate, share: float) -> Estimate:
    """An estimate that takes the place of Henyey–Greenstein's, and explains a share of what that leaves."""
    return replace(other, verdict=f"{what_did_not_hold(share)} {other.verdict}")


def _aligned(fit: Fit, misalignment: Misalignment) -> Fit:
    """The fit with what may be off in the set-up; edges that come off pixels' edges bend the way, so it is repeated."""
    best, none = fit.optimum, np.zeros(len(misalignment.names))
    at, (view,), liquid = np.concatenate([best.coordinates, none]), best.problem.views, best.problem.blocks
    for _ in range(ALIGNINGS):
        before, block = best.cost, SetUpBlock(misalignment.at(best.media[0]), np.ones(none.size))
        problem = replace(best.problem, blocks=(*liquid, block))
        sensitivity, believed = problem.at(at).sensitivity, problem.believed(block)
        weight = overconfidence(sensitivity, believed, [view.observation.noise], [view.error])
        best = polish(replace(problem, blocks=(*liquid, replace(block, weight=weight))), at)
        at = best.coordinates
        if before - best.cost < ALIGNED:
            break
    return replace(fit, optimum=best)


def weighed(fit: Fit, block: BesideBlock) -> Fit:
    """The fit with beliefs in light beside weighed as the model's error wants it, and with that light's own error."""
    best = fit.optimum
    errors = [view.error for view in best.problem.views]
    noise = [view.observation.noise for view in best.problem.views]
    weight = overconfidence(best.sensitivity, best.problem.believed(block), noise, errors)
    blocks = tuple(replace(block, weight=weight) if one is block else one for one in best.problem.blocks)
    found = polish(replace(best.problem, blocks=blocks), best.coordinates)
    error = block.stderr(found.values, found.media[0])
    models = tuple(partial(_less_sure, model, error) for model in fit.models)
    return replace(fit, optimum=found, models=models)


def _less_sure(model: Callable[[Medium], Prediction], error: Array, liquid: Medium) -> Prediction:
    found = model(liquid)
    known = 0.0 if found.stderr is None else np.asarray(found.stderr, float)
    return replace(found, stderr=np.hypot(known, error))


def _built(fit: Fit, scene: Scene, models: Models, asked: Asked) -> tuple[Estimate, PhaseTold, LikelySpheres | None]:
    """The estimate at an optimum: its errors, what the residual says, and the verdict; what it tells of other phase
    functions; and spheres that are likelier, if there are any, where families are weighed."""
    best = fit.optimum
    gain, (offset,), (left,) = left_over(fit)
    found = findings_of(fit, left, scene, models, asked)
    phase, spread = found.phase, fit.unsettled(found.spread(left))
    off, exact = nuisances_of(best, spread), fit.exact or models.exact
    answer = answer_of(best, spread, asked, left.beyond == 0.0, exact)
    undescribed, rough = _undescribed(best, left, asked)
    unsure = undescribed or fit.moved is not None or (answer.beads is None and mostly_spheres(answer))
    likely = likely_spheres(best, spread, asked, answer, unsure, models.prepares)
    medium, spread = answer.liquid, phase.counted(answer.covariance)
    bent = phase.misled or phase.doubted or undescribed or fit.moved is not None or answer.may_peak
    known = {
        name: yes and name not in best.at_edge and not (bent and name != "sigma_a")
        for name, yes in determined(medium, spread, [left]).items()
    }
    sentences = [
        what_is_determined(medium, spread, known, best.at_edge, combined=not bent),
        *_on_residual(best, left, found),
        what_no_phase_describes(undescribed, rough),
        what_has_not_settled(fit.moved is not None),
        what_may_peak_unseen(answer.outside_cone if answer.may_peak else None),
        what_may_be_another_phase(phase.doubted and _left_out(left) <= MUCH_LEFT_OUT),
        what_is_misaligned(off),
        *_on_light_astray(left, found, scene, medium, off, spread, known),
        _on_what_was_left_out(best, left, found),
    ]
    used = best.problem.views[0].observation.used
    built = Estimate(
        medium=medium, covariance=spread, identifiable=known, gain=gain, offset=offset, image=left.image,
        residual=left.residual, rmse=left.rmse, verdict=" ".join(filter(None, sentences)), model=left.prediction.model,
        noise=rms(left.noise[used]), model_error=left.counted, nuisance=off,
        structure=structure_map(found.whitened, used),
        stretch=_stretch(best, spread) if asked.family is None else {}, scattering=replace(answer, covariance=spread),
    )  # fmt: skip
    return built, phase, likely


def _undescribed(best: Evaluation, left: Left, asked: Asked) -> tuple[bool, bool]:
    """Whether a free phase function was fitted that does not describe the image, and whether it is rougher than free
    ones are expected to be, which is one reason for that."""
    rough = is_rough(best, asked)
    return rough or (asked.is_free and left.beyond > 0.0), rough


def _on_residual(best: Evaluation, left: Left, found: Findings) -> list[str]:
    """What the residual says, and what it shows of phase functions though it is noise by its size: two sentences."""
    (view,), cause, phase = best.problem.views, found.cause, found.phase
    return [
        what_is_left(
            left.unexplained,
            left.stated,
            left.noisier if view.observation.noise_known else 1.0,
            (cause.name, cause.share) if cause else None,
            found.place,
            found.aside,
            found.sign is not None or phase.shown,
            [one.name for one in found.likely[1:]],
        ),
        what_phase_is_shown(phase.freed.evidence if phase.freed else -math.inf, phase.shown),
    ]


def _on_light_astray(
    left: Left, found: Findings, scene: Scene, medium: Medium, off: Mapping[str, object], spread: Array,
    known: Mapping[str, bool],
) -> list[str]:  # fmt: skip
    """What the residual shows of light astray, and what light astray it would not show: sentences, or nothing."""
    sign, own, calm = found.sign, found.own, found.calm
    whole = left.prediction.model in WHOLE
    return [
        what_is_shown(medium, sign.name, sign.deviations, sign.moved[:own], found.bare, sign.others) if sign else "",
        what_is_unseen(medium, moved_by_halos(calm, [left])[:own], spread, known) if "halo" not in off else "",
        _unseen_floor(calm, own, left, scene, medium, off, spread, known) if whole else "",
    ]


def _on_what_was_left_out(best: Evaluation, left: Left, found: Findings) -> str:
    """Which pixels and which light do not count: sentences, or nothing."""
    seen, model = best.problem.views[0].observation, left.prediction.model
    return what_was_left_out(seen.saturated, int(seen.specks.sum()), _left_out(left), model, found.aside)


def _left_out(left: Left) -> float:
    """Share of the light that the model leaves out."""
    return max((skipped.bound for skipped in left.prediction.skipped), default=0.0)


def _unseen_floor(
    best: Evaluation, own: int, left: Left, scene: Scene, medium: Medium, off: Mapping[str, object], spread: Array,
    known: Mapping[str, bool],
) -> str:  # fmt: skip
    """What a floor that nobody has described would do to so many of the coefficients: a sentence, or nothing."""
    if not scene.tank.faces.floor.dark or "floor" in off:
        return ""
    (view,) = best.problem.views
    gain, _ = best.scale
    pattern = gain * floor_by_few(replace(scene, medium=medium), left.prediction.image)
    changes = best.project_out(view.whitened(pattern[None]))[:, : best.left.size]
    moved = moved_unseen(best.sensitivity, changes, COMMON_FLOOR, [left.noise], stated_errors(best, [left]))
    what = f"the floor sent back {100.0 * COMMON_FLOOR:.0f} % of the light"
    return what_is_unseen(medium, moved[:own], spread, known, what)


def determined(medium: Medium, spread: Array, left: Sequence[Left]) -> dict[str, bool]:
    """Which of σa, σs, g images determine: none where what is left of one is more structure than any model leaves."""
    hopeless = any(one.unexplained > max(HOPELESS, one.stated) for one in left)
    return {name: yes and not hopeless for name, yes in identifiable(medium, spread).items()}


def nuisances_of(best: Evaluation, spread: Array) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of each term that was fitted along, in its unit."""
    found = {}
    for block in best.problem.blocks:
        if not isinstance(block, SetUpBlock | AstrayBlock | BesideBlock):
            continue
        units = block.misalignment.sd if isinstance(block, SetUpBlock) else block.sd
        off, sds = best.values[block.name], np.sqrt(np.diag(spread))[best.problem.believed(block)]
        for (name, unit), one, sd in zip(units.items(), off, sds, strict=True):
            found[name] = float(one) * unit, float(sd) * unit
    return found


def _stretch(best: Evaluation, spread: Array) -> dict[str, tuple[float, float]]:
    (view,), (medium,), (gain, _) = best.problem.views, best.media, best.scale

    def changed(other: Medium) -> Array:
        change = gain * view.whitened(view.forward(other) - view.forward(medium))
        return best.project_out(change[None])[0, : best.left.size]

    return stretches(medium, spread, best.left, best.sensitivity.changes, changed)


def _silently(_: str) -> None:
    pass

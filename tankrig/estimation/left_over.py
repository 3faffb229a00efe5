"""What a fit leaves of each image, what that says of the errors of its values, and which light astray it shows."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.estimation.astray_causes import SIGNS, causes
from tankrig.estimation.found_optics import as_found
from tankrig.estimation.light_beside import sizes_along
from tankrig.estimation.misfit import STRAY, faults_of, halos_of, moved_by_faults, moved_unseen, shown
from tankrig.estimation.observation import Observation, structure
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.residual import ALIKE, COUNTED
from tankrig.estimation.shots import Fit
from tankrig.estimation.stated_errors import smooth_error_map, stated_error
from tankrig.estimation.uncertainty import ModelError, PatternedError, SmoothError
from tankrig.estimation.verdict import TELLING_MOVE
from tankrig.prediction import Prediction
from tankrig.scene import Scene

Array = NDArray[np.float64]
Image = NDArray[np.floating]

TOLD = 2.5
"""Standard deviations of its size from which on a cause is named where the residual is no more than noise. By chance
3 % of images show one of eight causes so; at 2 it would be 9 %, at 3 .7 %."""
WORTH_A_LOOK = 1.25
"""Standard deviations by a rough pattern from which on a cause is looked at by its own. Patterns alike by a cosine of
.88 differ by half a standard deviation of chance, so that 2 % of the causes that are just told stay unseen."""


@dataclass(frozen=True)
class Left:
    """What a fit leaves of one image.

    Parameters
    ----------
    prediction
        The model's, without gain, offset and what may be misaligned.
    light, image, residual
        Fitted without and with the offset, and observed less fitted; NaN where a pixel is not used.
    smooth
        Fitted light without what is known of paths' noise, see `Fit.calm`: what looks like a fault is made of it.
    rmse
        RMS of the residual over the used pixels.
    noise, noisier
        (rows, columns) standard deviation as assumed, or more by a factor where the residual shows that.
    unexplained, stated
        Structure of the residual, and the model's own error, as shares of the image.
    own
        (n, rows, columns) patterns, in units of the fitted light, of noise that `smooth` still has, and the residual as
        well; none where none is known.
    """

    prediction: Prediction
    light: Image
    image: Image
    residual: Array
    smooth: Image
    rmse: float
    noise: Array
    noisier: float
    unexplained: float
    stated: float
    own: Array

    @property
    def counted(self) -> float:
        """The model's error that counts: as stated, or as seen where that is more."""
        return max(self.stated, self.unexplained)

    @property
    def beyond(self) -> float:
        """What is seen of it beyond what is stated."""
        return math.sqrt(self.counted**2 - self.stated**2)


def left_over(fit: Fit) -> tuple[float, list[float], list[Left]]:
    """Gain and offsets at an optimum, and what is left of each image.

    Raises
    ------
    ImageError
        When the images are dark where the scenes are bright.
    """
    best = fit.optimum
    gain, offsets = best.scale
    if gain <= 0.0:
        raise ImageError(
            "the image is dark where the scene's light is and bright where it is not; check that image and scene "
            "belong together and which way up the image is"
        )
    found = []
    apart = fit.apart or (None,) * len(offsets)
    seen_so = zip(best.problem.views, best.images, fit.calm.images, offsets, fit.predictions, apart, strict=True)
    for view, image, calm, offset, prediction, taken_out in seen_so:
        seen, used = view.observation, view.observation.used
        own = np.zeros((0, *image.shape)) if taken_out is not None else _unbiased(prediction.patterns, image)
        light = gain * image
        residual = np.where(used, seen.image - light - offset, np.nan)
        rmse, noise, bright = rms(residual[used]), rms(seen.noise[used]), rms(light[used])
        unexplained = structure(residual, used) / bright
        white = math.sqrt(max(rmse**2 - (unexplained * bright) ** 2, 0.0))
        noisier = white / noise if white > noise * (1.0 + 3.0 / math.sqrt(2.0 * used.sum())) else 1.0
        prediction = _with_error_of(seen, prediction, gain)
        stated = stated_error(prediction)
        found.append(
            Left(
                prediction=prediction, light=light, image=light + offset, residual=residual, smooth=gain * calm,
                rmse=rmse, noise=noisier * seen.noise, noisier=noisier, unexplained=unexplained, stated=stated,
                own=gain * own,
            )
        )  # fmt: skip
    return gain, offsets, found


def _with_error_of(seen: Observation, prediction: Prediction, gain: float) -> Prediction:
    """A model's image with the error that a computed image has itself: either may be what they differ by."""
    if seen.error is None:
        return prediction
    known = 0.0 if prediction.stderr is None else np.asarray(prediction.stderr, float)
    return replace(prediction, stderr=np.hypot(known, seen.error / gain))


def _unbiased(patterns: Image | None, image: Image) -> Array:
    """Patterns whose products are the noise's covariance, without Student's factor; none where it is not known."""
    count = 0 if patterns is None else len(patterns)
    if patterns is None or count <= 3:
        return np.zeros((0, *image.shape))
    return np.asarray(patterns * math.sqrt((count - 3.0) / (count - 1.0)))


def error_of(prediction: Prediction, gain: float, beyond: float, scene: Scene) -> ModelError:
    """A prediction's error in units of the image: noise by its patterns where they are known, the rest as smooth."""
    rest = gain * np.hypot(smooth_error_map(prediction), beyond * np.abs(prediction.image))
    smooth = SmoothError.of(scene, rest)
    return smooth if prediction.patterns is None else PatternedError(gain * prediction.patterns, smooth)


def spread_of(
    best: Evaluation, left: Sequence[Left], errors: Sequence[ModelError], explained: Array | None = None
) -> Array:
    """Covariance of the values at an optimum: of one image's fit, a dose's, a live one and a series' alike.

    Camera noise and errors of the model as they are counted; where residuals hold structure, also what usual faults
    that look like it move the values by; and where that is beyond what the model states, what parts of the images
    disagree by. What a cause that was found explains of the residuals, (n,) whitened, is no such fault's.
    """
    noise, sensitivity = [one.noise for one in left], best.sensitivity
    if not any(one.unexplained > 0.0 for one in left):
        return sensitivity.covariance(noise, errors)
    residual, views = best.left, best.problem.views
    changes = [view.whitened(faults_of(one.smooth)) for view, one in zip(views, left, strict=True)]
    faults = best.project_out(np.hstack(changes))[:, : residual.size]
    rest = residual if explained is None else residual - explained
    moved = moved_by_faults(sensitivity, rest, faults, noise, stated_errors(best, left))
    disagreeing = residual if any(one.beyond > 0.0 for one in left) else None
    return sensitivity.covariance(noise, errors, disagreeing) + moved


def moved_by_halos(best: Evaluation, left: Sequence[Left]) -> Array:
    """(values,) how far a halo of `STRAY` of the light that no residual shows would move each value at most."""
    views = best.problem.views
    changes = [view.whitened(halos_of(one.smooth)) for view, one in zip(views, left, strict=True)]
    halos = best.project_out(np.hstack(changes))[:, : best.left.size]
    return moved_unseen(best.sensitivity, halos, STRAY, [one.noise for one in left], stated_errors(best, left))


def met_by_noise(best: Evaluation, left: Left, changes: Array, gained: Callable[[Image, Image], Array]) -> Array:
    """Products of faults with a residual that noise of the model's image makes by being in both.

    Faults c are made of the fitted image m + e, which the residual y − m − e has as well: ⟨c · residual⟩ has −⟨Δc · e⟩
    where no fault is, Δc being what e changes of c. And e draws a free gain, see `Scaling.drawn`. In images that light
    paths' noise dominates, blur was named by three standard deviations that way.

    Parameters
    ----------
    best, left
        Of the fit of one image.
    changes
        (faults, n) whitened, with all that a gain could make of them.
    gained
        From the image and noise, in units of the fitted light, to what faults gain by that noise.

    Returns
    -------
    (faults,) array.
    """
    (view,), gain, scaling = best.problem.views, best.scale[0], best.problem.scaling
    found, squared, pixels = np.zeros(len(changes)), 0.0, best.left.size
    for noise in left.own:
        whole = view.whitened(noise)
        kept = best.project_out(whole[None])[0, :pixels]
        found -= view.whitened(gained(left.smooth, noise)) @ kept
        squared += float(whole @ whole)
    if squared > 0.0 and scaling.free_gain:
        models, ones = [gain * model for model in best.models], [view.one]
        values = np.array([best.sensitivity.step(one) for one in best.project_out(changes)[:, :pixels]])
        # What values have followed, the residual shows no more.
        found += scaling.drawn(changes, models, ones, squared)
        found -= values @ scaling.drawn(best.changes_at(gain), models, ones, squared)
    return found


def stated_errors(best: Evaluation, left: Sequence[Left]) -> list[ModelError]:
    """What models state of their errors, as covariances count them: noise of light paths by its patterns.

    Counted as if it were smooth all over the image it would hide what goes astray: a floor of 4 % that moves σs by nine
    standard deviations was seen by 1.9 of them instead of 7.
    """
    gain, _ = best.scale
    found: list[ModelError] = []
    for view, one in zip(best.problem.views, left, strict=True):
        patterns, smooth = one.prediction.patterns, view.error
        if patterns is not None and isinstance(smooth, SmoothError):
            rest = replace(smooth, sd=gain * smooth_error_map(one.prediction))
            found.append(PatternedError(gain * patterns, rest))
        elif view.observation.error is not None and isinstance(smooth, SmoothError):
            found.append(replace(smooth, sd=np.hypot(smooth.sd, view.observation.error)))
        else:
            found.append(smooth)
    return found


@dataclass(frozen=True)
class Shown:
    """A cause that a residual shows, see `astray_shown`.

    Parameters
    ----------
    name
        Of the cause.
    deviations
        By how many standard deviations its size is seen.
    moved
        (values,) what it moves values by, or a cause that is nearly as likely and moves them more.
    explained
        (n,) what it explains of the residual, whitened.
    others
        Causes that are nearly as likely.
    """

    name: str
    deviations: float
    moved: Array
    explained: Array
    others: tuple[str, ...] = ()


def astray_shown(
    best: Evaluation, left: Left, scene: Scene, spread: Array, own: int = 3, name: str | None = None
) -> Shown | None:
    """The cause that a residual shows most, if it moves a coefficient by `TELLING_MOVE`; None where none does.

    Light astray may be no more than noise by its size, and yet move the coefficients by ten standard deviations. It is
    looked for by its own pattern.

    Parameters
    ----------
    best, left
        Of the fit.
    scene
        With the fitted liquid.
    spread
        Covariance of the values without it.
    own
        How many of the values are the liquid's.
    name
        Of the only cause that is asked for; None: all.
    """
    along = sizes_along(best.problem.blocks, best.values)
    (gain, _), (view,) = best.scale, best.problem.views
    quick = name is None and left.prediction.model == "prepared"
    found_along = as_found(scene, along)
    errors = stated_errors(best, [left])

    def own_pattern(cause: str, image: Image) -> Array:
        return causes(scene, image, quick, found_along)[cause]()[0]

    def rough_pattern(cause: str, image: Image) -> Array:
        rough = SIGNS[cause].rough
        assert rough is not None
        return rough(scene, image)

    def told(names: Sequence[str], pattern: Callable[[str, Image], Array]) -> tuple[Array, Array, Array, Array]:
        """Of each cause its size, the deviation of that by chance, what it moves, and what one unit of it changes."""
        patterns = np.array([pattern(one, left.smooth / gain) for one in names])
        whole = view.whitened(gain * patterns)
        faults = best.project_out(whole)[:, : best.left.size]

        def gained(light: Image, noise: Image) -> Array:
            found = np.zeros_like(patterns)
            for number, one in enumerate(names):
                if SIGNS[one].of_image:
                    found[number] = gain * (pattern(one, (light + noise) / gain) - patterns[number])
            return found

        met = met_by_noise(best, left, whole, gained)
        return (*shown(best.sensitivity, best.left, faults, [left.noise], errors, met), faults)

    asked = causes(scene, left.smooth / gain, quick, found_along)
    names = [one for one in asked if SIGNS[one].along not in along and name in (None, one)]
    roughly = [one for one in names if SIGNS[one].rough is not None] if name is None and not quick else []
    if roughly:
        sizes, chances, _, _ = told(roughly, rough_pattern)
        hardly = {
            one for one, of_chance in zip(roughly, np.abs(sizes / chances), strict=True) if of_chance < WORTH_A_LOOK
        }
        names = [one for one in names if one not in hardly]
    if not names:
        return None
    sizes, chances, moved, faults = told(names, own_pattern)
    moves = np.abs(moved / np.sqrt(np.maximum(np.diag(spread), 1e-300)))[:, :own].max(axis=1)
    low, high = np.array([SIGNS[one].sizes(scene) for one in names]).T
    believed = (sizes > low) & (sizes - TOLD * chances < high)
    deviations = sizes / chances
    seen = np.where((moves > TELLING_MOVE) & believed, np.abs(deviations), 0.0)
    most = int(np.argmax(seen))
    if seen[most] <= TOLD:
        return None
    explained = sizes[most] * faults[most] - moved[most] @ best.sensitivity.changes
    # A veil and a floor are told apart by chance: whichever is named, what the other may have done is counted.
    alike = np.flatnonzero((seen > TOLD) & (seen**2 > seen[most] ** 2 - ALIKE))
    others = tuple(names[one] for one in alike if one != most)
    counted = np.flatnonzero((seen > TOLD) & (seen**2 > seen[most] ** 2 - COUNTED))
    worst = counted[int(np.argmax(moves[counted]))]
    return Shown(names[most], float(deviations[most]), moved[worst], explained, others)


def rms(values: Image) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))

"""What a fit leaves of each image, and what that says of the errors of its values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.estimation.misfit import STRAY, faults_of, halos_of, moved_by_faults, moved_unseen
from tankrig.estimation.observation import Observation, structure
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.shots import Fit
from tankrig.estimation.stated_errors import smooth_error_map, stated_error
from tankrig.estimation.uncertainty import ModelError, PatternedError, SmoothError
from tankrig.prediction import Prediction
from tankrig.scene import Scene

Array = NDArray[np.float64]
Image = NDArray[np.floating]


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


def rms(values: Image) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))

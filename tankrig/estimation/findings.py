"""What the residual of one image's fit says: structure, its likely causes, light astray, other phase functions."""

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.astray_causes import SIGNS
from tankrig.estimation.astray_shown import Shown, astray_shown
from tankrig.estimation.left_over import Left, error_of, spread_of
from tankrig.estimation.phase_answer import Asked
from tankrig.estimation.phase_doubt import Doubt, PhaseTold
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.residual import WHOLE, Cause, misalignment_left_out, misalignments, standing_out
from tankrig.estimation.shots import Fit
from tankrig.estimation.stated_errors import error_map
from tankrig.estimation.uncertainty import ModelError
from tankrig.estimation.versions import Models
from tankrig.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Findings:
    """What the residual of one image's fit says.

    Parameters
    ----------
    calm
        The optimum, see `Fit.calm`.
    whitened
        (rows, columns) residual in standard deviations of the noise; 0 where a pixel is not used.
    place
        Where it stands out most, see `standing_out`; None where chance may do that.
    likely
        What may explain its structure, the likeliest first.
    sign
        Light astray that it shows; None where it shows none.
    phase
        What it tells of other phase functions.
    aside
        Whether the pixels that were left out as specks look like what a misalignment shows.
    own
        How many of the first values are σa, σs and g: a family's coordinates are not the mean cosine.
    error
        Of the model, as covariances count it.
    bare
        Covariance of the values by noise and that error alone.
    """

    calm: Evaluation
    whitened: Array
    place: tuple[float, int, int] | None
    likely: list[Cause]
    sign: Shown | None
    phase: PhaseTold
    aside: bool
    own: int
    error: ModelError
    bare: Array

    @property
    def cause(self) -> Cause | None:
        """The likeliest cause of its structure; None where there is none."""
        return self.likely[0] if self.likely else None

    def spread(self, left: Left) -> Array:
        """Covariance of the values, with what the light astray that it shows would move them by."""
        if self.sign is None:
            return spread_of(self.calm, [left], [self.error])
        moved, deviations = self.sign.moved, self.sign.deviations
        spread = spread_of(self.calm, [left], [self.error], self.sign.explained)
        return np.asarray(spread + np.outer(moved, moved) * (1.0 + 1.0 / deviations**2))


def findings_of(fit: Fit, left: Left, scene: Scene, models: Models, asked: Asked) -> Findings:
    """What the residual of one image's fit says.

    Parameters
    ----------
    fit
        Of the image.
    left
        What it leaves.
    scene, models
        The image's.
    asked
        Which phase functions were.
    """
    best, calm = fit.optimum, fit.calm
    (gain, _), (medium,) = best.scale, best.media
    observation, prediction = best.problem.views[0].observation, left.prediction
    # Where the model states its error, it is of the pattern stated; what goes beyond it is in proportion to the image.
    error = gain * np.hypot(error_map(prediction), left.beyond * np.abs(prediction.image))
    whitened = np.where(observation.used, left.residual, 0.0) / left.noise
    place = standing_out(whitened, observation.used, error / left.noise)
    held = left.unexplained <= left.stated and place is None
    misaligned = cache(partial(misalignments, scene, medium))  # eight images, and two may ask
    doubt = Doubt(best, left, scene, models, asked)
    likely, phase = ([], PhaseTold()) if held else doubt.causes(misaligned)
    own = 3 if asked.family is None else 2
    counted = error_of(prediction, gain, left.beyond, scene)
    bare = calm.sensitivity.covariance([left.noise], [counted])
    whole, named = prediction.model in WHOLE, likely[0].name if likely else None
    sign = None
    if whole and (named is None or named in SIGNS):
        sign = astray_shown(calm, left, replace(scene, medium=medium), bare, own, named)
    if held:
        phase = doubt.hidden(sign)
        sign = None if phase.shown else sign
    aside = whole and misalignment_left_out(observation, left.image, gain, misaligned)
    return Findings(calm, whitened, place, likely, sign, phase, aside, own, counted, bare)

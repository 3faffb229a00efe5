"""How firmly priors hold where images tell less than they seem to, as their residuals show.

Least squares weighs pixels as if what a model is off by were another in each. Where residuals hold structure, of the
bench or of the model, seventeen coordinates of a free phase function follow it as far as that seems to tell: on a bench
whose images had structure of .6 % of the light and camera noise of .05 %, ink's p(θ) went up and down by a factor of
fifteen between 100° and 140°, with amplitudes' squares that add up to 72 where 16 are expected. So priors weigh more by
as much as images weigh too much, for all shapes alike: a likelihood to the power of 1/t (Grünwald and van Ommen 2017).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tankrig.estimation.left_over import error_of, rms
from tankrig.estimation.observation import structure
from tankrig.estimation.phase_block import PhaseBlock
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.stated_errors import stated_error
from tankrig.estimation.uncertainty import total
from tankrig.prediction import Prediction
from tankrig.scene import Scene

TOLD = 1.0
"""How much images seem to tell of a direction, in what was known of it before, from which on it is asked how much they
do."""


def believing(problem: Problem, weight: float) -> Problem:
    """A problem where phase functions are expected to be smooth so many times as firmly."""
    blocks = (replace(one, weight=weight) if isinstance(one, PhaseBlock) else one for one in problem.blocks)
    return replace(problem, blocks=tuple(blocks))


def weight_in(problem: Problem) -> float:
    """How firmly a problem expects phase functions to be smooth; 1 where it searches none."""
    return max((one.weight for one in problem.blocks if isinstance(one, PhaseBlock)), default=1.0)


def weight_of_priors(end: Evaluation, seen: Sequence[Prediction], scenes: Sequence[Scene]) -> float:
    """How many times more a fit's images seem to tell than they do; 1 where noise and the model's error explain them.

    Parameters
    ----------
    end
        Where a fit has ended.
    seen
        Images of the model there, or nearby, which state its errors.
    scenes
        Of the images.

    Notes
    -----
    Values respond to errors ε as F⁻¹ J W ε. Where errors were as the weights say, J W ε had the covariance F; what the
    model's error gives it, as smooth as that is, and what the parts of the images disagree by, is S. Of the directions
    that images seem to tell, the median of vᵀ S v over vᵀ F v.
    """
    gain, offsets = end.scale
    beyond = []
    for view, image, offset, prediction in zip(end.problem.views, end.images, offsets, seen, strict=True):
        used, light = view.observation.used, gain * image
        residual = np.where(used, view.observation.image - light - offset, np.nan)
        unexplained = structure(residual, used) / rms(light[used])
        beyond.append(math.sqrt(max(unexplained**2 - stated_error(prediction) ** 2, 0.0)))
    if not any(beyond):
        return 1.0
    sensitivity, parts = end.sensitivity, []
    for response, view, prediction, share, scene in zip(
        sensitivity.responses, end.problem.views, seen, beyond, scenes, strict=True
    ):
        parts.append(response.information(view.observation.noise, error_of(prediction, gain, share, scene)))
    told = total(parts)
    units = np.outer(sensitivity.widest, sensitivity.widest)
    scatter = (told.scatter + sensitivity.disagreement(end.left)) * units
    sizes, ways = np.linalg.eigh(told.fisher * units)
    ways = ways[:, sizes > TOLD]
    if ways.size == 0:
        return 1.0
    shares = np.einsum("ik,ij,jk->k", ways, scatter, ways) / sizes[sizes > TOLD]
    return max(float(np.median(shares)), 1.0)

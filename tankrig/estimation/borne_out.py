"""Whether exact images bear out where a fit went, and whether it has settled there."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.about_exact import always
from tankrig.estimation.phase_block import PhaseBlock
from tankrig.estimation.phase_result import coefficients_by
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.shots import Fit
from tankrig.estimation.uncertainty import identifiable
from tankrig.prediction import Prediction

Vector = NDArray[np.float64]

SETTLED = 0.1
"""The move of every coordinate below which an optimum has settled, see `Block.looseness`."""
SETTLED_SHARE = 0.5
"""Share of its standard deviation by which each value may have moved besides."""
NOISY = 0.1
"""Share of noise in the derivatives' products from which on only that counts: they say no more how far it is."""
WORSE, HALVINGS, SHORTEST = 3.0, 3, 0.1
"""By how much more the next exact image may cost, in χ²/2, times at most that the way to it is shortened otherwise, by
half or more, and share of it at least that is left each time; where a phase function's coordinates are fitted: of three
numbers steps bend little."""
SHARPER = 4
"""Times as many light paths in the last exact image, where the model's error hides what the photograph shows."""


def borne_out(
    fit: Fit, centre: Evaluation, exact: Callable[[Evaluation], list[Prediction]], halvings: int
) -> tuple[Evaluation, list[Prediction]]:
    """Where exact images explain no less than where a fit went from, on the way to where it went; and these images.

    Models that say how images change about a place do not know how far they hold.
    """
    ahead = fit.optimum
    weighed, here = ahead.problem, ahead.problem.at(centre.coordinates).cost
    promised = max(here - ahead.cost, 0.0)
    for _ in range(halvings):
        seen = exact(ahead)
        worse = _cost_by(weighed, ahead, seen) - here
        if worse <= WORSE:
            return ahead, seen
        # Where a parabola has its lowest point that begins as was promised and ends where the exact image is.
        share = min(max(promised / (2.0 * promised + worse), SHORTEST), 0.5)
        promised *= share * (2.0 - share)
        ahead = weighed.at(centre.coordinates + share * (ahead.coordinates - centre.coordinates))
    return ahead, exact(ahead)


def cost_saved(fit: Fit, centre: Evaluation, ahead: Evaluation, seen: Sequence[Prediction]) -> float:
    """By how much less a place costs, by exact images of it, than the one that a fit went from."""
    weighed = fit.optimum.problem
    return weighed.at(centre.coordinates).cost - _cost_by(weighed, ahead, seen)


def _cost_by(weighed: Problem, at: Evaluation, seen: Sequence[Prediction]) -> float:
    """What a place costs by exact images of it."""
    return weighed.by([always(one.image) for one in seen]).at(at.coordinates).cost


def settled(best: Evaluation, centre: Evaluation, near: Vector) -> bool:
    """Whether an optimum stayed where the image that it was corrected by was made, or within a share of its errors."""
    close = (np.abs(best.coordinates - centre.coordinates) < near).all()
    if close and best.sensitivity.noise_share < NOISY:
        return True
    return bool((np.abs(best.row - centre.row) < SETTLED_SHARE * best.deviations).all())


def held_back(best: Evaluation) -> bool:
    """Whether the model's error leaves a coefficient undetermined that noise alone would not."""
    views, medium = best.problem.views, best.media[0]
    noise = [view.observation.noise for view in views]
    others = best.problem.blocks[1:]
    count, by = 3, np.eye(3)  # σa, σs and g, whatever comes after them
    if others and isinstance(others[0], PhaseBlock):  # a family's coordinates are not the mean cosine
        by = coefficients_by(others[0].family, best.values[others[0].name])
        count = by.shape[1]
    with_error, without = (
        identifiable(medium, by @ best.sensitivity.covariance(noise, errors)[:count, :count] @ by.T)
        for errors in ([view.error for view in views], [None] * len(noise))
    )
    return with_error != without

"""Problems of accurate models, which are good for media near some place."""

from collections.abc import Sequence
from dataclasses import replace

from tankrig.estimation.astray import AstrayBlock
from tankrig.estimation.followed import Model
from tankrig.estimation.light_beside import is_solved
from tankrig.estimation.prior_weight import weight_of_priors
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.shots import Shot, weighed_problem
from tankrig.estimation.versions import image_of, is_noisy
from tankrig.estimation.with_prepared import fine_slopes_together, told_together
from tankrig.prediction import Prediction

Versions = list[tuple[Model, Model]]
"""A model for each image, and the one whose derivatives are taken."""


def refined(problem: Problem, shots: Sequence[Shot], near: Evaluation, rough: bool = False) -> tuple[Problem, Versions]:
    """The problem of the accurate models for media near some place, see `accurate_problem`, and these models."""
    versions = versions_near(shots, near)
    return accurate_problem(problem, shots, near, versions, rough), versions


def versions_near(shots: Sequence[Shot], near: Evaluation, roughly: bool = False) -> Versions:
    """Accurate models for media near some place, each with the one whose derivatives are taken; `roughly` by fewer
    light paths, see `Models`."""
    versions = [shot.models.refined(liquid, roughly) for shot, liquid in zip(shots, near.media, strict=True)]
    told_together([fine for fine, _ in versions])
    return versions


def accurate_problem(
    problem: Problem, shots: Sequence[Shot], near: Evaluation, versions: Sequence[tuple[Model, Model]],
    rough: bool = False,
) -> Problem:  # fmt: skip
    """The problem of accurate models, whose errors count as they are at some place.

    If `rough`, derivatives are as accurate as the image that they are of, where that costs less: of orders that are
    solved for, or by a family's coordinates. What may go astray and is fitted along has its patterns there.
    """
    seen = [fine(liquid) for (fine, _), liquid in zip(versions, near.media, strict=True)]
    problem = _with_astray_at(problem, near, seen)
    if not rough:
        fine_slopes_together([slope for _, slope in versions], near.media)
    forwards = [image_of(fine) for fine, _ in versions]
    differentiated = [
        fine if rough and (is_solved(fine) or shot.models.family) else slope
        for shot, (fine, slope) in zip(shots, versions, strict=True)
    ]
    slopes = [shot.slopes_of(model) for shot, model in zip(shots, differentiated, strict=True)]
    quick = all(shot.models.quick(model) for shot, model in zip(shots, differentiated, strict=True))
    slow = any(shot.models.prepares for shot in shots)
    weighed = weighed_problem(problem, shots, forwards, slopes, seen, problem.at(near.coordinates).added)
    noisy = any(is_noisy(shot.models, model) for shot, model in zip(shots, differentiated, strict=True))
    return replace(weighed, quick=quick, slow=slow, noisy=noisy)


def _with_astray_at(problem: Problem, near: Evaluation, seen: Sequence[Prediction]) -> Problem:
    """The problem with patterns of what may go astray as they are at a place, of which images are given.

    A floor's light, a tenth of what is seen of a thin dose, was kept as at a bench's first guess: where the fit had
    come to, χ² fell by a third when the floor was that of the liquid there, and seventeen shapes had followed the rest.
    """
    images = [one.image for one in seen]
    blocks = tuple(
        one.at(near.media, images, near.values[one.name]) if isinstance(one, AstrayBlock) else one
        for one in problem.blocks
    )
    return replace(problem, blocks=blocks)


def smoothness_at(shots: Sequence[Shot], best: Evaluation, versions: Versions) -> float:
    """How firmly a phase function is expected to be smooth, see `weight_of_priors`."""
    seen = [fine(liquid) for (fine, _), liquid in zip(versions, best.media, strict=True)]
    return weight_of_priors(best, seen, [shot.scene for shot in shots])

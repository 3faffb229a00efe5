"""An optimum corrected by exact images, about which other models say only how images change."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from tankrig.estimation.about_exact import (
    BENT_STEPS,
    FEW_STEPS,
    MANY_ENOUGH,
    NEAR_ENOUGH,
    at_media,
    exact_images,
    problem_about,
)
from tankrig.estimation.borne_out import HALVINGS, SETTLED, SHARPER, borne_out, held_back, settled
from tankrig.estimation.by_shares import MOST_CORRECTIONS, ByShares
from tankrig.estimation.followed import Model
from tankrig.estimation.light_beside import is_solved
from tankrig.estimation.optimiser import LAST_STEPS, solve, without_noise
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.search import Told, by_cost
from tankrig.estimation.shots import Fit, Shot
from tankrig.prediction import Prediction

BENT_ENOUGH, SOLVED_ENOUGH = 0.05, 1.0
"""Where searches about exact images stop as the models bend: with three numbers, of more see `MANY_ENOUGH`; and where
high orders are solved for, whose source is as rough as that."""
CORRECTIONS = 4
"""Exact images at most that an optimum is corrected by, each at the last one's."""


def corrected_fit(
    best: Evaluation, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool
) -> Fit:
    """The optimum by exact images, and by how other models change about them.

    Parameters
    ----------
    best
        Of the problem that was solved.
    shots
        Whose exact images are asked for.
    models
        That are differentiated; in the end, with the error that they show at the optimum taken off.
    progress
        Told in words what is being done.
    sharper
        Whether images follow more paths where the model's error hides what the images show.
    """
    by_shares = ByShares.of(best.problem, shots, models, progress)
    if by_shares is not None:
        centre, made = by_shares.by_few_paths(best)
        return by_shares.by_all_paths(centre, MOST_CORRECTIONS - made, sharper)
    return _corrected_by_models(best, shots, models, progress, sharper)


def _corrected_by_models(
    best: Evaluation, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool
) -> Fit:
    """The optimum by exact images, about which models change as they do by themselves.

    To first order at first: what is left of paths' noise in that is smooth. Then as the models bend on the way, which
    says as much as other exact images there would (of what these gained in a dose's fit from afar, 105 %). Then on by
    what noise of the derivatives has held back.
    """
    problem = best.problem
    many = any(shot.models.family for shot in shots)
    bent_enough, steps = (MANY_ENOUGH, FEW_STEPS) if many else (BENT_ENOUGH, BENT_STEPS)
    solved = any(is_solved(model) for model in models)
    slopes_noise = [shot.slopes_noise_of(model) for shot, model in zip(shots, models, strict=True)]

    def about(centre: Evaluation, seen: Sequence[Prediction], start: Evaluation) -> Fit:
        slopes = problem.of_views(lambda view: view.slopes(centre.liquids[view.dose]))
        here = problem_about(problem, shots, models, slopes, at_media(slopes_noise, centre.media), centre, seen)
        end = solve(here.line, start.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        if not solved:  # or steps as the models bend would cost more than another exact image, and say no more
            if many:  # along which moments bend
                end = by_cost(here.bent.at(one.coordinates) for one in (end, start))[0]
            end = solve(here.bent, end.coordinates, bent_enough, steps, damping=0.0)
        return here.fit(end.coordinates + without_noise(here.line.at(centre.coordinates)))

    progress("correcting by accurate images")
    centre = best
    fit = about(centre, exact_images(shots, centre), centre)
    for _ in range(CORRECTIONS - 1):
        if settled(fit.optimum, centre, SETTLED * problem.looseness):
            break
        progress("correcting by accurate images")
        centre, seen = borne_out(fit, centre, partial(exact_images, shots), HALVINGS if many else 0)
        fit = about(centre, seen, centre)
    if sharper and held_back(fit.optimum):
        progress("correcting by images as accurate as the photographs")
        fit = about(centre, exact_images(shots, centre, SHARPER), fit.optimum)
    end = fit.optimum
    views = (replace(view, slopes=own.slopes) for view, own in zip(end.problem.views, problem.views, strict=True))
    whole = replace(end.problem, views=tuple(views)).with_slopes_noise(slopes_noise)
    return replace(fit, optimum=whole.at(end.coordinates))

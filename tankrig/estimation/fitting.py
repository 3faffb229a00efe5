"""From images to the optimum: search with the cheap models, go on with accurate ones, correct by exact images."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.about_exact import MANY_ENOUGH, few_steps
from tankrig.estimation.accurate import Versions, refined, smoothness_at
from tankrig.estimation.by_prepared import by_prepared, made_right_at
from tankrig.estimation.corrections import SOLVED_ENOUGH, corrected_fit
from tankrig.estimation.light_beside import is_solved
from tankrig.estimation.modes import in_likeliest_mode
from tankrig.estimation.optimiser import COARSE_ENOUGH, polish, solve
from tankrig.estimation.parameters import Block
from tankrig.estimation.prior_weight import believing
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.search import RIVAL, Told, by_cost, densities, first_guess, profiled, search
from tankrig.estimation.shots import Fit, Shot, Suffices, rough_problem
from tankrig.estimation.stated_errors import COARSE, stated_error
from tankrig.scene import Medium

Vector = NDArray[np.float64]

PROFILE_FROM = 0.55
"""g of the liquids that are looked at first."""
VALLEYS = 3
"""Valleys of the profile in g that are searched, at most."""
SEVERAL_ENOUGH, SEVERAL_SHARE = 20.0, 0.02
"""Where the cheap models' fit of several images stops, and a search of phase functions by them, see `solve`: what these
promise below that they do not keep. Of a bench's series 30 further steps lowered the cost by .35 %."""
CLEANINGS = 3
"""Times at most that a fit is repeated without the pixels that it shows to be outliers."""


@dataclass(frozen=True)
class Ending:
    """Where a fit may end.

    Parameters
    ----------
    sharper
        Whether exact images follow more paths where the model's error hides what the images show.
    suffices
        Where it ends early, see `by_prepared`; None to go on until it has settled.
    """

    sharper: bool = False
    suffices: Suffices | None = None


def fitted(
    shots: Sequence[Shot],
    blocks: tuple[Block, ...],
    scaling: Scaling,
    progress: Told,
    start: Vector | None = None,
    few: Sequence[int] = (0,),
    ending: Ending = Ending(),
    starts: Sequence[Vector] | None = None,
) -> Fit:
    """From images to the optimum: search with the cheap models, go on with accurate ones, correct by exact images.

    Parameters
    ----------
    shots
        The images, and their models.
    blocks
        What is searched for.
    scaling
        Whether gain and offset are free.
    progress
        Told in words what is being done.
    start
        Coordinates to begin from; None to search everywhere.
    few
        Numbers of the images that the search looks at.
    ending
        Where it may end.
    starts
        Coordinates that the cheap models' search begins from, in place of a look around.
    """
    if starts is not None:
        problem = rough_problem(shots, blocks, scaling)
        where = (COARSE_ENOUGH, 0.0) if len(few) == 1 else (SEVERAL_ENOUGH, SEVERAL_SHARE)
        found = search(problem.of(few), starts, progress, *where)
    elif start is None:
        problem, found = searched(shots, blocks, scaling, progress, few)
    else:
        problem, found = rough_problem(shots, blocks, scaling), [start]
    return fitted_on(shots, (problem, found), progress, ending)


Searched = tuple[Problem, list[Vector]]
"""The problem of the cheap models, and the ends of a search of it, best first."""


def fitted_on(
    shots: Sequence[Shot],
    looked: Searched,
    progress: Told,
    ending: Ending = Ending(),
) -> Fit:
    """The same from where a search has ended."""
    problem, found = looked
    moved: Vector | None = None
    early = False
    if not all(shot.models.refine for shot in shots):
        progress("fitting all images")
        versions = [(shot.models.coarse, shot.models.coarse) for shot in shots]
        best = by_cost(solve(problem, one, SEVERAL_ENOUGH) for one in found)[0]
    elif any(shot.models.prepares for shot in shots):
        progress("preparing models of what was found")
        ended = by_prepared(problem, shots, found, ending.suffices)
        best, versions, moved, early = ended.best, ended.versions, ended.moved, ended.early
    elif len(shots) > 1 and all(shot.models.family and shot.models.exact for shot in shots):
        # The first exact images lead on from there for less, for they need no paths at each step.
        best = by_cost(problem.at(one) for one in found)[0]
        versions = [shot.models.refined(liquid) for shot, liquid in zip(shots, best.media, strict=True)]
    else:
        progress("refining")
        best, versions = _nearer(problem, shots, found)
    if all(shot.models.exact for shot in shots):
        slopes = [slope for _, slope in versions]
        fit = corrected_fit(best, shots, slopes, progress, ending.sharper)
        return in_likeliest_mode(fit, best.problem, shots, slopes, progress, ending.sharper)
    noise = [shot.slopes_noise_of(slope) for shot, (_, slope) in zip(shots, versions, strict=True)]
    settled = best.problem.with_slopes_noise(noise).at(best.coordinates)
    exact = partial(made_right_at, shots[0]) if len(shots) == 1 and shots[0].models.prepares else None
    return Fit(settled, tuple(fine for fine, _ in versions), exact=exact, moved=moved, early=early)


def _nearer(problem: Problem, shots: Sequence[Shot], found: Sequence[Vector]) -> tuple[Evaluation, Versions]:
    """The optimum by accurate models from where a search has ended, and these models, see `refined`."""
    problem, versions = refined(problem, shots, problem.at(found[0]), rough=True)
    of_family = any(shot.models.family for shot in shots)
    enough = SOLVED_ENOUGH if any(is_solved(fine) for fine, _ in versions) else None
    steps = few_steps(shots)
    if of_family:
        enough = MANY_ENOUGH
    best = by_cost(
        polish(problem, one) if enough is None else solve(problem, one, enough, steps, damping=0.0) for one in found
    )[0]
    if of_family:
        weight = smoothness_at(shots, best, versions)
        if weight > 1.0:  # what followed structure goes back
            best = solve(believing(problem, weight), best.coordinates, MANY_ENOUGH, steps, damping=0.0)
    if any(is_solved(fine) for fine, _ in versions):  # for what was found, and not for where it began
        problem, versions = refined(problem, shots, best)
        best = problem.at(best.coordinates)
    return best, versions


def searched(
    shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, progress: Told, few: Sequence[int] = (0,)
) -> Searched:
    """The problem of the cheap models, and the ends of a search of it that looks at few images, best first."""
    problem = rough_problem(shots, blocks, scaling)
    if len(few) > 1:  # they have no twins
        progress("looking at a few media")
        first, _ = first_guess(problem.of(few), shots[0].length_mm)
        starts = [look.coordinates for look in first[: 2 if first[1].cost < RIVAL * first[0].cost else 1]]
        return problem, search(problem.of(few), starts, progress, enough=SEVERAL_ENOUGH)
    progress("looking at a few media")
    look = [shots[number].looked_at() for number in few]
    blocks = tuple(block.binned(look[0].binned_by) for block in blocks)
    seen = rough_problem(look, blocks, scaling)
    places = [seen.at(one) for one in densities(seen, look[0].length_mm, PROFILE_FROM)]
    best = min(places, key=lambda one: one.cost)
    share = stated_error(look[0].models.coarse(best.media[0]))
    seen = rough_problem(look, blocks, scaling, float(np.clip(share, 0.1 * COARSE, COARSE)))
    valleys = profiled(seen, best.coordinates, progress)[:VALLEYS]
    return problem, search(seen, [one.coordinates for one in valleys], progress)


def guessed(
    shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, progress: Told, few: Sequence[int] = (0,)
) -> Medium:
    """About what the liquid of the last of a few images is, by the cheap models alone."""
    if len(few) > 1:
        problem, found = searched(shots, blocks, scaling, progress, few)
        return problem.of(few).at(found[0]).media[-1]
    progress("looking at a few media")
    look = [shots[number].looked_at() for number in few]
    problem = rough_problem(look, tuple(block.binned(look[0].binned_by) for block in blocks), scaling)
    first, _ = first_guess(problem, shots[0].length_mm)
    return problem.at(search(problem, [one.coordinates for one in first], progress)[0]).media[0]


def promising(
    shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, ladder: Sequence[Vector],
    few: Sequence[int] = (0,),
) -> list[Vector]:  # fmt: skip
    """Places on a ladder that explain a few images better than their neighbours on it, best first."""
    problem = rough_problem(shots, blocks, scaling).of(few)
    costs = [problem.at(np.clip(one, *problem.box)).cost for one in ladder]
    around = [math.inf, *costs, math.inf]
    found = [k for k, cost in enumerate(costs) if cost <= min(around[k], around[k + 2])]
    return [ladder[k] for k in sorted(found, key=lambda k: costs[k])]


def without_outliers(fit: Fit) -> Fit:
    """The fit without pixels that it shows to be none of the liquid's light."""
    for _ in range(CLEANINGS):
        best = fit.optimum
        gain, offsets = best.scale
        views = tuple(
            replace(view, observation=view.observation.cleaned(gain * image + offset))
            for view, image, offset in zip(best.problem.views, best.images, offsets, strict=True)
        )
        cleaned = replace(best.problem, views=views)
        if cleaned.pixels == best.problem.pixels:
            break
        # By images without the paths' noise, or that would draw a free gain towards 0.
        fit = replace(fit, optimum=cleaned.at(best.coordinates))
        fit = replace(fit, optimum=cleaned.at(polish(fit.calm.problem, best.coordinates).coordinates))
    return fit

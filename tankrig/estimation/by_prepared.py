"""The optimum by models that are prepared about where a search has ended, and made right where they lead.

What is prepared of orders ≥ 3 holds for media nearby, and its image and derivatives are right at one of them
(`WithPrepared`). A fit goes from there to where that leads, and it is made right there anew, until a place is what the
one before foretold, or hardly apart from it. Where an image hardly tells a phase function's shapes a fit would go far
beyond what is known of derivatives, so shapes are held to where they are right, and a place that explains less than the
one before, by models made right at both, is not gone on from.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.about_exact import MANY_ENOUGH, always
from tankrig.estimation.accurate import Versions, accurate_problem, refined, smoothness_at, versions_near
from tankrig.estimation.borne_out import WORSE
from tankrig.estimation.by_shares import CLOSE
from tankrig.estimation.modes import by_ladder
from tankrig.estimation.optimiser import solve, whole_step
from tankrig.estimation.prior_weight import believing
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.search import by_cost
from tankrig.estimation.shots import Fit, Shot, Suffices
from tankrig.estimation.uncertainty import PatternedError, SmoothError
from tankrig.estimation.with_prepared import WithPrepared, told_together
from tankrig.light.prepared.phases.checked import MOST
from tankrig.prediction import Prediction
from tankrig.scene import Medium

Vector = NDArray[np.float64]
Image = NDArray[np.floating]

MOST_PREPARED, MOST_CENTRES = 3, 12
"""Times that models are prepared at most, each about where the last ones led, and that they are then made right at
another medium: a two-term liquid of σs .020 behind glass and surface took four."""
STEPS_BEFORE_WEIGHT, PREPARED_STEPS, FINE_STEPS = 4, 20, 4
"""Steps by them at most: until it is told how firmly a phase function is expected to be smooth, then, and with fine
derivatives."""
LIGHTER = 0.5
"""Share of how firmly that was expected, below which an end that says so has the fit go on."""
FIRMER, MOST_REFUSED = 4.0, 3
"""Times as closely that shapes are held where a place was not gone on from, and how often in a row that is done."""
TELLING, MORE = 0.5, 1024
"""Share of σs's variance, as noise, priors and structure of the images leave it, that noise of paths may add before
many lattices are followed in the end, of one image so many: of beads of .5 µm 256 more than doubled it, and σs came out
3.1 standard deviations too large."""
STRUCTURED = 100.0
"""Times more that images seem to tell than they do, from which on noise of fewer light paths does at every place: of a
bench's emulsion 3,500, where 256 lattices of each of six images took 323 CPU s a place behind glass."""
STEPS_ENOUGH = 0.25
"""Standard deviations that no value has moved by, nor would without shapes held, at a place that is gone to from one
where models were made right: it is the end, and bearing it out would cost as much as each place before. Of a bench's
emulsion images of places that were .1 % of σs apart still differed by more than noise of light paths, and σs is known
to .4 % by noise and models' errors alone."""
NOWHERE = 0.05
"""Change of χ²/2 below which shapes held so lead nowhere: let go again at the same place they would go to where they
were refused, until no centres are left (beads of .5 µm did so five times)."""


@dataclass(frozen=True)
class Ended:
    """Where a fit by prepared models ended.

    Parameters
    ----------
    best
        The optimum.
    versions
        The models there.
    moved
        By how much values were still corrected where it has not settled, or differ in another mode of the family that
        is as likely; else None.
    early
        Whether it ended where it sufficed, see `Suffices`.
    """

    best: Evaluation
    versions: Versions
    moved: Vector | None = None
    early: bool = False


def by_prepared(
    problem: Problem, shots: Sequence[Shot], found: Sequence[Vector], suffices: Suffices | None = None
) -> Ended:
    """The optimum from where a search has ended.

    Parameters
    ----------
    problem, found
        Of the cheap models, and coordinates where a search of it has ended.
    shots
        The images.
    suffices
        Where a fit of images that hold structure ends early, for each of its places takes minutes; None to end where it
        settles.
    """
    best, versions, weight = _about_search(problem, shots, found)
    family, moved = shots[0].models.family, None
    if family is not None and family.ladder.size:
        best, moved = by_ladder(best, family, weight * MANY_ENOUGH, PREPARED_STEPS)
    structured = weight > STRUCTURED
    ended = by_centres(best, shots, versions, weight, suffices if structured else None)
    if ended.early:
        return ended
    best, versions = ended.best, ended.versions
    if len(shots) == 1 or structured:  # several images without structure are made right by as many paths everywhere
        versions = _by_enough_paths(best, versions, structured)
    last = accurate_problem(best.problem, shots, best, versions)
    best = solve(last, best.coordinates, weight * MANY_ENOUGH, FINE_STEPS, damping=0.0)
    return Ended(best, versions, ended.moved if moved is None else moved)


def made_right_at(shot: Shot, medium: Medium, _times: float) -> Prediction:
    """The image of a medium by what was prepared, made right there, by as many light paths as ever."""
    fine, _ = shot.models.refined(medium)
    return fine(medium)


def share_by_paths(best: Evaluation, patterns: Sequence[Image], structured: bool = False) -> float:
    """What noise of light paths adds to the variance of σs, of what noise of the camera, priors and structure leave.

    Parameters
    ----------
    best
        Where it is told.
    patterns
        Of each image (n, rows, columns) of that noise, see `Prediction`.
    structured
        Whether images hold structure, by which parts of them disagree besides.
    """
    gain, _ = best.scale
    by_paths = [PatternedError(gain * one, SmoothError(np.zeros(one.shape[1:]), 1.0)) for one in patterns]
    noise, left = [view.observation.noise for view in best.problem.views], best.left if structured else None
    both, alone = (
        float(best.sensitivity.covariance(noise, errors, left)[1, 1]) for errors in (by_paths, [None] * len(noise))
    )
    return both / alone - 1.0


def _by_enough_paths(best: Evaluation, versions: Versions, structured: bool) -> Versions:
    """Models made right where they are by more lattices of light paths, one image's by `MORE`, where noise of fewer
    tells."""
    prepared = [fine for fine, _ in versions if isinstance(fine, WithPrepared)]
    if len(prepared) < len(versions):
        return versions
    patterns = [one(medium).patterns for one, medium in zip(prepared, best.media, strict=True)]
    told = [one for one in patterns if one is not None]
    if len(told) < len(versions) or share_by_paths(best, told, structured) < TELLING:
        return versions
    finer = [one.by_lattices(MORE if len(prepared) == 1 else MOST) for one in prepared]
    told_together(finer)
    return [(one, replace(one, fine=True)) for one in finer]


def _about_search(
    problem: Problem, shots: Sequence[Shot], found: Sequence[Vector]
) -> tuple[Evaluation, Versions, float]:
    """Where models lead that are prepared about where a search has ended, and again where that leads out of them; these
    models, and how firmly a phase function is expected to be smooth."""
    best = by_cost(problem.at(one) for one in found)[0]
    for _ in range(MOST_PREPARED):
        near, versions = refined(problem, shots, best, rough=True)
        near = replace(near, close=(best.coordinates, CLOSE))
        best = solve(near, best.coordinates, MANY_ENOUGH, STEPS_BEFORE_WEIGHT, damping=0.0)
        weight = smoothness_at(shots, best, versions)
        best = solve(believing(near, weight), best.coordinates, weight * MANY_ENOUGH, PREPARED_STEPS, damping=0.0)
        lighter = smoothness_at(shots, best, versions)
        if lighter < LIGHTER * weight:  # there was structure since these few steps had not led to the end
            weight = lighter
            best = solve(believing(near, weight), best.coordinates, weight * MANY_ENOUGH, PREPARED_STEPS, damping=0.0)
        if all(
            fine.holds(medium)
            for (fine, _), medium in zip(versions, best.media, strict=True)
            if isinstance(fine, WithPrepared)
        ):
            break
    return replace(best.problem, close=None).at(best.coordinates), versions, weight


def by_centres(
    best: Evaluation, shots: Sequence[Shot], versions: Versions, weight: float, suffices: Suffices | None = None
) -> Ended:
    """The last place where models were made right."""
    centre: Evaluation | None = None
    close, refused, wanted = CLOSE, 0, np.zeros(0)
    for _ in range(MOST_CENTRES):
        there = versions_near(shots, best, weight > STRUCTURED)
        if centre is not None and costs_more(best, centre, there, weight):
            close, refused, wanted = FIRMER * max(close, CLOSE), refused + 1, best.row - centre.row
            if refused == MOST_REFUSED:
                break
        else:
            foretold = are_foretold(there, versions)
            settled = foretold and close == 0.0
            centre, versions, close, refused = best, there, 0.0 if foretold else CLOSE, 0
            if settled:
                return Ended(centre, versions)
        near = accurate_problem(best.problem, shots, centre, versions, rough=True)
        centre = replace(near, close=None).at(centre.coordinates)
        held = replace(near, close=(centre.coordinates, close) if close else None)
        best = solve(held, centre.coordinates, weight * MANY_ENOUGH, PREPARED_STEPS, damping=0.0)
        best = centre.problem.at(best.coordinates)
        if not refused and has_settled(centre, best, weight > 1.0):
            return Ended(best, versions)
        if refused and abs(centre.cost - best.cost) < NOWHERE * weight:
            return Ended(centre, versions, wanted)
        moved = best.row - centre.row
        if suffices is not None and suffices(Fit(best, tuple(fine for fine, _ in versions), moved=moved)):
            return Ended(best, versions, moved, early=True)
    assert centre is not None
    return Ended(centre, versions, best.row - centre.row)


def has_settled(centre: Evaluation, ahead: Evaluation, structured: bool) -> bool:
    """Whether a place is hardly apart from the one that a fit went from, by what is known of each value, nor would be
    if shapes were not held to where derivatives are right.

    Where images are `structured` by what no phase function explains, values are known as well as parts of them agree.
    """
    enough = STEPS_ENOUGH * (ahead.deviations_by_parts if structured else ahead.deviations)
    wanted = ahead.chain @ whole_step(ahead)
    return bool((np.abs(ahead.row - centre.row) < enough).all() and (np.abs(wanted) < enough).all())


def costs_more(ahead: Evaluation, centre: Evaluation, there: Versions, weight: float) -> bool:
    """Whether a place explains less than the one that a fit went from, by models made right at both.

    Where much is left that no phase function explains, costs are as many times larger as smoothness has weight, and so
    is what noise of light paths makes of them; what a place costs more than another by less than steps call enough is
    no reason to turn back.
    """
    seen = [always(fine(medium).image) for (fine, _), medium in zip(there, ahead.media, strict=True)]
    return centre.problem.by(seen).at(ahead.coordinates).cost > centre.cost + max(WORSE, weight * MANY_ENOUGH)


def are_foretold(there: Versions, before: Versions) -> bool:
    """Whether models' images at their media are what earlier ones said, as far as they are of what was prepared."""
    return all(
        one.agrees(earlier)
        for (one, _), (earlier, _) in zip(there, before, strict=True)
        if isinstance(one, WithPrepared) and isinstance(earlier, WithPrepared)
    )

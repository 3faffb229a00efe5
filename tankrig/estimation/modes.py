"""Other modes of a family of phase functions: members that are apart, and explain an image as well.

Spheres whose diameters are some per cent apart scatter alike near a right angle. A model with 1 % of noise does not
tell which of them an image shows: for beads of 2 µm such models led to 1.91 µm from anywhere, the truth included, as if
these were of many sizes. About an exact image few paths tell what another mode's would be, and exact images tell modes
apart.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.about_exact import exact_images
from tankrig.estimation.by_shares import MOST_CORRECTIONS, MOST_ROUGH, ByShares
from tankrig.estimation.followed import Model
from tankrig.estimation.optimiser import solve
from tankrig.estimation.phase_families import Family
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.search import Told, by_cost
from tankrig.estimation.shots import Fit, Shot

Vector = NDArray[np.float64]

REACH = 1.0
"""How far from a fit's end other modes are looked for, in the family's first coordinate."""
APART, APART_SD = 0.1, 3.0
"""By how much that differs in another mode: at least so much, and so many standard deviations."""
SPARSELY = 2
"""Every which of the ladder's places prepared models look at."""
FEW = 0.25
"""Share of the lattices in derivatives that a look begins with."""
PROMISING, AS_LIKELY = 30.0, 5.0
"""How much more, in χ²/2, another mode may cost by few paths to be fitted by all of them, and by these to be as likely
as the best: exact images of two modes have most of their noise in common. An end that the best one's errors reach is
fitted only where it is as likely by few paths."""


def in_likeliest_mode(
    fit: Fit, problem: Problem, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool
) -> Fit:
    """A fit; that of another mode of its family where it explains the images better. Where both are as likely, it has
    moved as far as from one to the other.

    Parameters
    ----------
    fit
        By exact images.
    problem, shots, models, progress, sharper
        That it was made of, see `corrected_fit`.
    """
    by, family = ByShares.of(problem, shots, models, progress), shots[0].models.family
    if by is None or family is None or not family.ladder.size:
        return fit
    progress("looking at other modes")
    others = _others(fit, by, family)
    if not others:
        return fit
    progress("fitting another mode")
    other = by.by_all_paths(others[0], MOST_CORRECTIONS - MOST_ROUGH, sharper)
    lower, higher = sorted([fit, other], key=lambda one: one.optimum.cost)
    if higher.optimum.cost > lower.optimum.cost + AS_LIKELY or not _is_apart(lower.optimum, higher.optimum):
        return lower
    return replace(lower, moved=higher.optimum.row - lower.optimum.row)


def by_ladder(best: Evaluation, family: Family, enough: float, steps: int) -> tuple[Evaluation, Vector | None]:
    """The likeliest of where fits by prepared models end that begin on a family's ladder about an end, by models that
    answer in no time; and by how much the values of another that is as likely differ, if there is one.

    Parameters
    ----------
    best
        The end.
    family
        That is searched.
    enough, steps
        Where fits stop, see `solve`.
    """
    first = _first(best)
    rungs = family.ladder[np.abs(family.ladder - best.coordinates[first]) <= REACH][::SPARSELY]
    starts = [_on_ladder(best, family, rung) for rung in rungs]
    ends = by_cost([best, *(solve(best.problem, one, enough, steps, damping=0.0) for one in starts)])
    others = [one for one in ends[1:] if one.cost < ends[0].cost + AS_LIKELY and _is_apart(ends[0], one)]
    return ends[0], others[0].row - ends[0].row if others else None


def _others(fit: Fit, by: ByShares, family: Family) -> list[Evaluation]:
    """Where fits end that begin on the family's ladder, of those that end elsewhere and may explain the images as well,
    best first."""
    best, media, ladder = fit.optimum, fit.optimum.media, family.ladder
    first = _first(best)
    one = None if fit.exact is None else fit.exact(media[0], 1.0)
    seen = exact_images(by.shots, best, by.each) if one is None else [one]
    told, few = by.shares_at(best, FEW), [model.with_share(0.0, False) for model in by.models]
    found = []
    for rung in ladder[np.abs(ladder - best.coordinates[first]) <= REACH]:
        here = best.problem.at(_on_ladder(best, family, rung))
        places = zip(few, media, seen, here.media, strict=True)
        guessed = [model.beside(known, image, medium) for model, known, image, medium in places]
        found.append(by.about(here, guessed, told, here).optimum)
    return by_cost(one for one in found if _is_promising(best, one))


def _on_ladder(best: Evaluation, family: Family, rung: float) -> Vector:
    """Coordinates of an end with a member of the family on its ladder, as expected otherwise."""
    first, rest = _first(best), family.like(best.media[0].g)[1:]
    start = best.coordinates.copy()
    start[first : first + 1 + rest.size] = [rung, *rest]
    return np.asarray(np.clip(start, *best.problem.box))


def _is_promising(best: Evaluation, other: Evaluation) -> bool:
    """Whether another end by few paths is worth a fit by all of them."""
    most = PROMISING if _is_apart(best, other) else AS_LIKELY
    return _off(best, other) > APART and other.cost < best.cost + most


def _is_apart(best: Evaluation, other: Evaluation) -> bool:
    """Whether another end is in another mode than the best."""
    return _off(best, other) > max(APART, APART_SD * float(best.deviations[_first(best)]))


def _off(best: Evaluation, other: Evaluation) -> float:
    """By how much the family's first coordinate differs."""
    first = _first(best)
    return abs(float(other.coordinates[first] - best.coordinates[first]))


def _first(at: Evaluation) -> int:
    """The number of the family's first coordinate, which is its value too: behind those of σa and σs."""
    return len(at.problem.blocks[0].names)

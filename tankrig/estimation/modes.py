"""Other modes of a family of phase functions: members that are apart, and explain an image as well.

Spheres whose diameters are some per cent apart scatter alike near a right angle. A model with 1 % of noise does not
tell which of them an image shows: for beads of 2 µm such models led to 1.91 µm from anywhere, the truth included, as if
these were of many sizes. About an exact image few paths tell what another mode's would be, and exact images tell modes
apart.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tankrig.estimation.corrections import MOST_CORRECTIONS, MOST_ROUGH, ByShares
from tankrig.estimation.followed import Model
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.search import Told, by_cost
from tankrig.estimation.shots import Fit, Shot

REACH = 1.0
"""How far from a fit's end other modes are looked for, in the family's first coordinate."""
APART, APART_SD = 0.1, 3.0
"""By how much that differs in another mode: at least so much, and so many standard deviations."""
FEW = 0.25
"""Share of the lattices in derivatives that a look begins with."""
PROMISING, AS_LIKELY = 30.0, 5.0
"""How much more, in χ²/2, another mode may cost by few paths to be fitted by all of them, and by these to be as likely
as the best: exact images of two modes have most of their noise in common."""


def in_likeliest_mode(
    fit: Fit, problem: Problem, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool
) -> Fit:
    """A fit of one image; that of another mode of its family where it explains the image better.

    Parameters
    ----------
    fit
        By exact images.
    problem, shots, models, progress, sharper
        That it was made of, see `corrected_fit`.
    """
    by, family = ByShares.of(problem, shots, models, progress), shots[0].models.family
    if by is None or fit.exact is None or family is None or not family.ladder.size:
        return fit
    others = _others(fit, by)
    if not others:
        return fit
    progress("fitting another mode")
    return _likelier(fit, by.by_all_paths(others[0], MOST_CORRECTIONS - MOST_ROUGH, sharper))


def _others(fit: Fit, by: ByShares) -> list[Evaluation]:
    """Where fits end that begin on the family's ladder, of those that end elsewhere and may explain the image as well,
    best first."""
    best, model = fit.optimum, by.models[0]
    assert fit.exact is not None
    assert model.family is not None
    by.progress("looking at other modes")
    (known,), ladder = best.media, model.family.ladder
    first, rest = len(best.problem.blocks[0].names), model.family.like(known.g)[1:]
    seen, told = fit.exact(known, 1.0), by.shares_at(best, FEW)
    few, found = model.with_share(0.0, False), []
    for rung in ladder[np.abs(ladder - best.coordinates[first]) <= REACH]:
        start = best.coordinates.copy()
        start[first : first + 1 + rest.size] = [rung, *rest]
        here = best.problem.at(np.clip(start, *best.problem.box))
        found.append(by.about(here, [few.beside(known, seen, here.media[0])], told, here).optimum)
    apart, most = max(APART, APART_SD * float(best.deviations[first])), best.cost + PROMISING
    return by_cost(
        one for one in found if abs(one.coordinates[first] - best.coordinates[first]) > apart and one.cost < most
    )


def _likelier(one: Fit, other: Fit) -> Fit:
    """That of two modes which explains the image better; moved as far as the other is, where that is as likely."""
    lower, higher = sorted([one, other], key=lambda fit: fit.optimum.cost)
    moved = higher.optimum.row - lower.optimum.row
    same = (np.abs(moved) < APART_SD * lower.optimum.deviations).all()
    return lower if same or higher.optimum.cost > lower.optimum.cost + AS_LIKELY else replace(lower, moved=moved)

"""Fits with what light may go astray: along from a start that is known, or from the optimum without it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.astray import Astray, AstrayBlock
from tankrig.estimation.optimiser import polish
from tankrig.estimation.parameters import Block
from tankrig.estimation.phase_answer import BlocksOf
from tankrig.estimation.phase_families import Family
from tankrig.estimation.prior_weight import weight_in
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.shots import Fit, Shot, rough_problem
from tankrig.estimation.uncertainty import overconfidence
from tankrig.estimation.with_prepared import looked_at_together
from tankrig.scene import Medium

Array = NDArray[np.float64]

REPEATS, SETTLED = 5, 2.0
"""Times at most that patterns are made anew for the liquid found, and the change of χ²/2 below which that is over, or
so many times more as images seem to tell more than they do."""


def astray_from(
    start: Array, shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, astray: Sequence[Astray]
) -> tuple[Array, tuple[Block, ...]]:
    """Coordinates and blocks to begin from where it is known about what images are of: with what may go astray, none of
    it at first, by its patterns there.

    A series of a thin dose has its optimum elsewhere without a floor's light, which is half of what is seen there: a
    bench's fit went to twice the density, beyond all that had been prepared, and stayed there.
    """
    at, none = rough_problem(shots, blocks, scaling).at(start), np.zeros(len(astray[0].sd))
    looked_at_together([shot.models.coarse for shot in shots], at.media)
    patterns = tuple(
        replace(one, quick=True).at(medium, shot.models.coarse(medium).image, none)
        for one, shot, medium in zip(astray, shots, at.media, strict=True)
    )
    return np.concatenate([start, none]), (*blocks, AstrayBlock(patterns, np.ones(none.size)))


def along_from(
    densest: Medium, family: Family, shots: Sequence[Shot], blocks_of: BlocksOf, scaling: Scaling,
    astray: Sequence[Astray],
) -> BlocksOf:  # fmt: skip
    """The same blocks for any phase functions, and what may go astray along with them, by its patterns at a liquid.

    Where a floor's light came in at the end only, an emulsion's series on a bench crept to σs 10 % too large, 160 CPU s
    a place.
    """
    blocks = blocks_of(family)
    start = np.concatenate([one.start(densest) for one in blocks])
    *_, block = astray_from(start, shots, blocks, scaling, astray)[1]
    return lambda family: (*blocks_of(family), block)


def with_astray(fit: Fit, astray: Sequence[Astray]) -> Fit:
    """The fit with what may go astray in each image; patterns follow the liquid, so it is repeated."""
    best, none = fit.optimum, np.zeros(len(astray[0].sd))
    firmly = weight_in(best.problem)
    views = best.problem.views
    before = tuple(block for block in best.problem.blocks if not isinstance(block, AstrayBlock))
    begun = len(before) < len(best.problem.blocks)  # by `astray_from`, with sizes as the last coordinates
    at = best.coordinates if begun else np.concatenate([best.coordinates, none])
    for _ in range(REPEATS):
        cost, media = best.cost, best.media
        images = [view.forward(medium) for view, medium in zip(views, media, strict=True)]
        block = AstrayBlock(tuple(astray), np.ones(none.size)).at(media, images, at[at.size - none.size :])
        problem = replace(best.problem, blocks=(*before, block))
        sensitivity, believed = problem.at(at).sensitivity, problem.believed(block)
        noise, errors = [view.observation.noise for view in views], [view.error for view in views]
        weight = overconfidence(sensitivity, believed, noise, errors)
        best = polish(replace(problem, blocks=(*before, replace(block, weight=weight))), at, firmly)
        at = best.coordinates
        if abs(cost - best.cost) < firmly * SETTLED:
            break
    return replace(fit, optimum=best)

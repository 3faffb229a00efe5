"""From starts all over the allowed range, by a cheap model, to the few places that an accurate one goes on from."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.optimiser import COARSE_ENOUGH, solve
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.scene import Medium

Vector = NDArray[np.float64]
Told = Callable[[str], object]

START_MEAN_FREE_PATHS = (0.6, 2.4, 9.6)
START_ALBEDO = 0.97
START_ASYMMETRY = (0.0, 0.5, 0.85)
"""Media looked at first: every pair of scatterings along the tank and g; the best for each g is a start."""
PROFILE_ASYMMETRY = (-0.7, -0.35, 0.0, 0.3, 0.6, 0.82, 0.94)
"""At which the whole profile of one image is looked at."""
PROFILE_ENOUGH, PROFILE_SHARE, PROFILE_STEPS = 10.0, 0.3, 8
"""Where a look stops, in χ²/2 or as a share of what it began with, and its steps at most."""
ALBEDO_COORDINATE, ASYMMETRY_COORDINATE = 1, 2
"""Numbers of logit ϖ and atanh g among the coordinates of a medium, and of ink."""
FAR_FROM_START = 2.0
"""In log σs: a neighbour's best that is as far from the start is not the only place that a look begins from."""
LEAST_ABSORBING = math.log(0.99 / 0.01)
"""logit ϖ at most, where a look begins: a step may lead to no absorption at all, from where no logarithm leads back."""
FIRST_STEPS = 5
"""Steps that every start gets before only the best go on."""
RIVAL, DISTINCT, EQUAL = 2.0, 0.2, 30.0
"""Starts go on whose cost is less than RIVAL times the best; ends that differ by DISTINCT in a coordinate, and in cost
by less than EQUAL, are left for the accurate model to tell apart."""


def first_guess(problem: Problem, length_mm: float) -> tuple[list[Evaluation], list[Evaluation]]:
    """Where to start from: the best of a few densities for each of a few g, best first; and the others."""
    first, rest = [], []
    for g in START_ASYMMETRY:
        looks = [problem.at(one) for one in densities(problem, length_mm, g)]
        best, *others = by_cost(looks)
        first.append(best)
        rest += others
    return by_cost(first), by_cost(rest)


def densities(problem: Problem, length_mm: float, g: float) -> list[Vector]:
    """Coordinates of liquids of a few densities."""
    scattering = [paths / length_mm for paths in START_MEAN_FREE_PATHS]
    media = [Medium(sigma_s * (1.0 / START_ALBEDO - 1.0), sigma_s, g) for sigma_s in scattering]
    return [np.clip(problem.start(one), *problem.box) for one in media]


def profiled(problem: Problem, start: Vector, seen: Told) -> list[Evaluation]:
    """Places along the whole profile in g that explain an image better than their neighbours, best first.

    One image may have several optima, most of them at a g of their own: light that turns back looks like light that
    goes on and is absorbed. At a given g extinction and albedo have few, mostly one, so each g is begun from the best
    of its neighbour, away from the start and then back.

    Parameters
    ----------
    problem
        Of one image; a cheap forward model will do.
    start
        Coordinates to begin from.
    seen
        Told in words what is being done.
    """
    along = np.arctanh(PROFILE_ASYMMETRY)
    found: list[Evaluation | None] = [None] * along.size

    def look(number: int, begin: Vector) -> None:
        held, best = replace(problem, held=((ASYMMETRY_COORDINATE, float(along[number])),)), found[number]
        here = np.where(np.arange(begin.size) == ALBEDO_COORDINATE, np.minimum(begin, LEAST_ABSORBING), begin)
        ahead = held.at(np.clip(here, *held.box))
        if best is None or begin is start or ahead.cost < (1.0 - PROFILE_SHARE) * best.cost:
            end = solve(held, ahead.coordinates, PROFILE_ENOUGH, PROFILE_STEPS, share=PROFILE_SHARE)
            found[number] = end if best is None or end.cost < best.cost else best

    first = int(np.argmin(np.abs(along - start[ASYMMETRY_COORDINATE])))
    for number in (*range(first, along.size), *range(first - 1, -1, -1)):
        seen(f"looking at g = {PROFILE_ASYMMETRY[number]:g}")
        near = None if number == first else found[number - 1 if number > first else number + 1]
        look(number, start if near is None else near.coordinates)
        if near is not None and abs(near.coordinates[0] - start[0]) > FAR_FROM_START:
            look(number, start)  # where g is wrong, clear water with a gain may be the best, from where none is found
    for number in (*range(along.size - 2, first, -1), *range(1, first + 1)):  # and back
        near = found[number + 1 if number > first else number - 1]
        if near is not None:
            look(number, near.coordinates)
    profile = [one for one in found if one is not None]
    costs = [math.inf, *(one.cost for one in profile), math.inf]
    valleys = [one for k, one in enumerate(profile) if one.cost <= min(costs[k], costs[k + 2])]
    return [problem.at(one.coordinates) for one in by_cost(valleys)]


def by_cost(places: Iterable[Evaluation]) -> list[Evaluation]:
    """Places, the one that explains best first."""
    return sorted(places, key=lambda one: one.cost)


def search(
    problem: Problem, starts: Sequence[Vector], seen: Told, enough: float = COARSE_ENOUGH, share: float = 0.0
) -> list[Vector]:
    """Best coordinates over the whole allowed range, and others that are as good as far as this problem can tell.

    Parameters
    ----------
    problem
        To minimise; a cheap forward model will do.
    starts
        Where to begin; the least promising are given up early.
    seen
        Told in words what is being done.
    enough, share
        Where to stop, see `solve`.
    """
    begun = []
    for number, start in enumerate(starts, 1):
        seen(f"searching from start {number} of {len(starts)}")
        one = problem.at(np.clip(start, *problem.box))
        begun.append(one if len(starts) == 1 else solve(problem, start, enough, FIRST_STEPS, share=share))
    seen("searching from the best")
    ends: list[Evaluation] = []
    for one in by_cost(begun):
        if ends and one.cost > RIVAL * ends[0].cost:
            break
        end = solve(problem, one.coordinates, enough, share=share)
        if all(_distinct(end, other) for other in ends):
            ends.append(end)
    ends = by_cost(ends)
    return [end.coordinates for end in ends if end.cost < ends[0].cost + EQUAL]


def _distinct(one: Evaluation, other: Evaluation) -> bool:
    return bool(np.abs(one.coordinates - other.coordinates).max() > DISTINCT)

"""Phase functions that a prepared model is trained with: of particles, of families, and of no family."""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from tankrig.scene.free_phase import SHAPES, FreePhase
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import FournierForand, HenyeyGreenstein, ReynoldsMcCormick, TwoTerm
from tankrig.scene.phase_table import PhaseFunction

SPHERES, WATERS = 160, 60
"""Particles that are drawn once, of which those are taken whose mean cosine is wanted."""
BESIDE = 0.1
"""Share of a range of mean cosines by which those taken may lie beside it."""
OF_PARTICLES = 0.4
"""Share of particles among those taken, where there are enough."""
MOST_ASYMMETRY = 0.985
STEPS = 8
"""Of the bisection for a mean cosine, which need not be met closely."""

Draw = np.random.Generator


def training_phases(range_of_g: tuple[float, float], count: int) -> list[PhaseFunction]:
    """Phase functions whose mean cosines lie evenly in a range, and a little beside it; always the same ones.

    Parameters
    ----------
    range_of_g
        Lowest and highest mean cosine.
    count
        How many.

    Examples
    --------
    >>> found = training_phases((0.7, 0.8), 12)
    >>> len(found), all(0.68 < one.mean_cosine < 0.82 for one in found)
    (12, True)
    """
    low, high = range_of_g
    room = BESIDE * (high - low)
    low, high = max(low - room, -MOST_ASYMMETRY), min(high + room, MOST_ASYMMETRY)
    rng = np.random.default_rng(23)
    particles = [one for one in particles_drawn() if low <= one.mean_cosine <= high]
    found: list[PhaseFunction] = []
    while len(found) < count:
        if particles and rng.random() < OF_PARTICLES:
            found.append(particles[int(rng.integers(len(particles)))])
            continue
        one = _of_a_family(rng, float(rng.uniform(low, high)))
        if one is not None and low - 1e-6 <= one.mean_cosine <= high + 1e-6:
            found.append(one)
    return found


@lru_cache(maxsize=1)
def particles_drawn() -> list[PhaseFunction]:
    """Spheres of .15 to 3 µm in water at 633 nm, alike and of many sizes, and particles of natural waters."""
    rng = np.random.default_rng(17)
    spheres: list[PhaseFunction] = [
        Mie(
            math.exp(rng.uniform(math.log(0.15), math.log(3.0))), float(rng.uniform(1.4, 1.62)), 1.3317, 633.0,
            spread=math.exp(rng.uniform(math.log(0.02), math.log(0.5))),
        )
        for _ in range(SPHERES)
    ]  # fmt: skip
    return spheres + [
        FournierForand(float(rng.uniform(1.03, 1.2)), float(rng.uniform(3.2, 4.4))) for _ in range(WATERS)
    ]


def _of_a_family(rng: Draw, g: float) -> PhaseFunction | None:
    """One with about that mean cosine; None where the family has none."""
    kind = rng.random()
    if kind < 0.1:
        return HenyeyGreenstein(g)
    if kind < 0.25:
        backward, share = -rng.uniform(0.05, 0.6), rng.uniform(0.75, 0.999)
        forward = (g - (1.0 - share) * backward) / share
        return TwoTerm(float(forward), float(backward), float(share)) if 0.02 < forward < MOST_ASYMMETRY else None
    if kind < 0.45:
        alpha = math.exp(rng.uniform(math.log(0.05), math.log(3.0)))
        return _with_mean_cosine(lambda base: ReynoldsMcCormick(base, alpha), 0.02, g) if g > 0.05 else None
    amplitudes = tuple((rng.normal(size=SHAPES) * rng.uniform(0.2, 1.0)).tolist())
    return _with_mean_cosine(lambda base: FreePhase(base, amplitudes), -MOST_ASYMMETRY, g)


def _with_mean_cosine(member: Callable[[float], PhaseFunction], low: float, g: float) -> PhaseFunction:
    """The member of a family that rises with its number, by bisection."""
    high = MOST_ASYMMETRY
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if member(middle).mean_cosine < g else (low, middle)
    return member(0.5 * (low + high))

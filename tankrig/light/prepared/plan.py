"""Which images a prepared model is made from."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.box import Box, Coordinates
from tankrig.light.prepared.polynomials import Plane, nodes

Array = NDArray[np.float64]

EXACT_RATE = (3.8, 3.4)
"""Degree of the polynomials of orders 1 and 2 per unit of the stretched σt and g: 9 and 8 over the whole box."""
PATHS_RATE = (2.584, 3.05)
"""The same of orders ≥ 3, whose noise weighs more than their polynomials' error: 6 and 8 over the whole box, 3 and 5
over σt .008 … .032 and g .3 … .9, where 2 and 5 err by .57 instead of .50 %, 3 and 4 by .58."""
ALBEDO_RATE = 1.9
EXACT_SHARE, PATHS_SHARE = 0.06, 0.17
"""Of the usual tolerance, or a rough one, what the logarithm of 1 − g or of 1 + g, which all light goes with where g is
near an end, may be off by as a polynomial: near ±1 that takes more degrees than the width of the box says. Beams in
water of σt .0093 and g .954 were 1 % too dim, in all orders alike."""
MOST_MORE = 3
"""Degrees that this adds."""
ROUGH, ROUGHLY = 0.1, 0.6
"""Tolerance from which on degrees are this share of those: 1 to 3 % off over the box of a first look, decision 216."""
FULLNESS = 1.2
MEDIA_PER_PRODUCT = 8
"""Media at which paths are followed, per coefficient to be found from them."""
FEWEST = 0.5
"""Share of those media that is enough where the tolerance is large."""
EFFORT = 0.6
"""Lattices of paths per medium, of those by `PreparationPlan.paths`: eight media for each coefficient need no more."""
SLANTED_EFFORT = 8.0
"""Times as many lattices where light or sight slant: there a path stands for one start, not for all along a beam."""
AT_EDGES, WIDE = 0.12, 1.5
"""Share of the media of orders ≥ 3, about, that lie on the edges of either coordinate: what lies beyond all of them is
extrapolated to, with twice the noise in a corner. In boxes that are wider in σt only: narrow ones are made for liquids
in their middle, which has a tenth less noise without."""
CHECKS, CHECKS_SHARE = 6, 1 / 3
"""Media beside the grid at most, and in media of the grid."""
TOGETHER = 16
"""Media at most whose orders 1 and 2 are computed at once: more save little, and are lost where it is interrupted."""
FIRST = 0.25
"""Share of a medium's lattices that a first model follows where light or sight slant (decision 211)."""
USUAL_TOLERANCE = 0.01
SPREAD = (0.7548776662466927, 0.5698402909980532)
"""Steps of the additive sequence that fills a square most evenly (powers of the plastic number's inverse)."""


@dataclass(frozen=True)
class Sample:
    """A medium at ϖ = 1 to compute images of.

    Parameters
    ----------
    index
        In its list.
    sigma_t, g
        The medium.
    place
        Its coordinates u and v.
    batches
        Shifted lattices of paths to follow; 0 for the exact orders.
    """

    index: int
    sigma_t: float
    g: float
    place: tuple[float, float]
    batches: int = 0


@dataclass(frozen=True)
class PreparationPlan:
    """What to compute for a box and a tolerance.

    Parameters
    ----------
    box
        Media to answer for.
    length_mm
        Of the tank.
    tolerance
        Relative L2 error to aim for; the number of paths goes with its inverse square.
    slanted
        Whether light or sight slant.
    first
        Whether it is of a first model, which follows a share of the paths: the polynomials are the same.
    """

    box: Box
    length_mm: float
    tolerance: float
    slanted: bool = False
    first: bool = False

    @cached_property
    def coordinates(self) -> Coordinates:
        """Coordinates of the media in the box."""
        return Coordinates(self.box, self.length_mm)

    def _degrees(self, rates: tuple[float, float], share: float) -> tuple[int, int]:
        spans = self.coordinates.spans * (ROUGHLY if self.tolerance >= ROUGH else 1.0)
        by_sigma_t, by_g = (max(2, math.ceil(rate * span)) for rate, span in zip(rates, spans[[0, 2]], strict=True))
        enough = share * (self.tolerance if self.tolerance >= ROUGH else min(self.tolerance, USUAL_TOLERANCE))
        near_an_end = self._degree_of_logarithm(enough, by_g + MOST_MORE)
        return by_sigma_t, max(by_g, near_an_end)

    def _degree_of_logarithm(self, enough: float, most: int) -> int:
        """Degree from which on Chebyshev's series of log(1 ± g) is as near as that, or the most.

        A pole at v off [−1, 1] leaves coefficients of 2 ρ⁻ⁿ/n, ρ = |v| + √(v² − 1).
        """
        v = min(abs(self.coordinates.of(self.box.sigma_t[0], self.box.albedo[0], end)[0][2]) for end in (-1.0, 1.0))
        ratio = v + math.sqrt(v * v - 1.0)
        return next((n for n in range(1, most) if 2.0 * ratio ** -(n + 1) / (n + 1) < enough), most)

    @cached_property
    def exact_plane(self) -> Plane:
        """Polynomials for orders 1 and 2."""
        return Plane(self._degrees(EXACT_RATE, EXACT_SHARE))

    @cached_property
    def paths_plane(self) -> Plane:
        """Polynomials for orders ≥ 3."""
        return Plane(self._degrees(PATHS_RATE, PATHS_SHARE), FULLNESS)

    @cached_property
    def brightness_plane(self) -> Plane:
        """Polynomials for the logarithm of brightness, and of noise."""
        first, second = self.paths_plane.degrees
        return Plane((min(first, 4), min(second, 4)), 1.0)

    @cached_property
    def albedo_places(self) -> Array:
        """Coordinates w of the albedos that paths are summed for."""
        return nodes(max(3, math.ceil(ALBEDO_RATE * self.coordinates.spans[1]) + 1))

    @cached_property
    def albedos(self) -> tuple[float, ...]:
        """The same as albedos."""
        return tuple(float(self.coordinates.back([0.0, w, 0.0])[1]) for w in self.albedo_places)

    @cached_property
    def exact(self) -> list[Sample]:
        """Media for orders 1 and 2, on the polynomials' grid."""
        first, second = self.exact_plane.degrees
        places = [(u, v) for u in nodes(first + 1) for v in nodes(second + 1)]
        return [self._sample(index, place) for index, place in enumerate(places)]

    @cached_property
    def checks(self) -> list[Sample]:
        """Media beside that grid, where its polynomials' error is seen; numbered on from those."""
        first = len(self.exact)
        count = min(CHECKS, round(CHECKS_SHARE * first))
        even = (np.arange(1, count + 1)[:, None] * SPREAD) % 1.0
        return [self._sample(first + index, (u, v)) for index, (u, v) in enumerate((2.0 * even - 1.0).tolist())]

    @cached_property
    def together(self) -> list[tuple[Sample, ...]]:
        """Media of both whose orders 1 and 2 are computed at once: the steepest says how fine tables are.

        Those of one extinction follow each other.
        """
        ordered = sorted(self.exact + self.checks, key=lambda one: (one.g, one.index))
        parts = [ordered[first : first + TOGETHER] for first in range(0, len(ordered), TOGETHER)]
        return [tuple(sorted(part, key=lambda one: (one.sigma_t, one.g))) for part in parts]

    @cached_property
    def paths(self) -> list[Sample]:
        """Media for orders ≥ 3: spread evenly, denser towards the edges as polynomials need it."""
        effort = (USUAL_TOLERANCE / self.tolerance) ** 2
        share = min(1.0, max(FEWEST, effort))
        count = math.ceil(self.paths_plane.size * MEDIA_PER_PRODUCT * share)
        effort *= EFFORT / share * (SLANTED_EFFORT if self.slanted else 1.0)
        even = (0.5 + np.arange(count)[:, None] * SPREAD) % 1.0
        if self.coordinates.spans[0] > WIDE:
            even = np.clip((1.0 + AT_EDGES) * even - 0.5 * AT_EDGES, 0.0, 1.0)
        samples = []
        for index, (u, v) in enumerate(np.cos(np.pi * even)):
            sample = self._sample(index, (float(u), float(v)))
            depth = sample.sigma_t * self.length_mm
            forward = max(sample.g, 0.0)
            # As a lattice's noise goes: with the depth, and most where dense water scatters nearly straight on.
            noisy = 1.0 + depth * (0.12 + 0.3 * forward**2)
            if not self.slanted:  # there marks cost as much as ever, and whole boxes took minutes
                noisy += depth**2 * (0.006 + 0.08 * forward**16)
            batches = max(1, round(effort * noisy))
            samples.append(replace(sample, batches=self._first_of(batches) if self.first else batches))
        return samples

    def lattices(self, sample: Sample) -> list[range]:
        """Numbers of a medium's lattices: those of a first model, and those that the whole one follows besides."""
        first = sample.batches if self.first else self._first_of(sample.batches)
        return [part for part in (range(first), range(first, sample.batches)) if part]

    def _first_of(self, batches: int) -> int:
        """As many of a medium's lattices as a first model follows; all where light and sight run straight, since there
        models take seconds."""
        return math.ceil(FIRST * batches) if self.slanted else batches

    def _sample(self, index: int, place: tuple[float, float]) -> Sample:
        sigma_t, _, g = self.coordinates.back([place[0], 0.0, place[1]])
        return Sample(index, float(sigma_t), float(g), (float(place[0]), float(place[1])))

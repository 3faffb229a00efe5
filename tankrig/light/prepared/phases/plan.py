"""Which images a prepared model of any phase function is made from."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.box import Box
from tankrig.light.prepared.phases.products import DIRECTIONS, Excess, Products
from tankrig.light.prepared.phases.training import training_phases
from tankrig.light.prepared.phases.traits import PhaseTraits
from tankrig.light.prepared.plan import EFFORT, FEWEST, SPREAD, USUAL_TOLERANCE, PreparationPlan
from tankrig.light.prepared.polynomials import nodes
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

MEDIA_PER_PRODUCT = 12
"""Media at which paths are followed, per coefficient to be found from them, each by two lattices of its own."""
SLANTED_EFFORT = 1.0
"""Lattices of paths for each of them in thin water, where light or sight slant."""
CHECKS = 6
"""Media beside those of orders 1 and 2, where these are computed as a prediction does."""


@dataclass(frozen=True)
class PhaseSample:
    """A medium at ϖ = 1 to follow paths in.

    Parameters
    ----------
    index
        In its list.
    sigma_t
        1/mm.
    phase
        Its phase function.
    u
        Coordinate of σt.
    batches
        Shifted lattices in either of two images.
    """

    index: int
    sigma_t: float
    phase: PhaseFunction
    u: float
    batches: int


@dataclass(frozen=True)
class PhasePlan:
    """What to compute for a box and a tolerance.

    Parameters
    ----------
    box
        Media to answer for; g is the mean cosine.
    length_mm
        Of the tank.
    tolerance
        Relative L2 error to aim for.
    slanted
        Whether light or sight slant: one image of each medium then, since what they differ by from the fit of all tells
        their noise.
    """

    box: Box
    length_mm: float
    tolerance: float
    slanted: bool = False

    @cached_property
    def base(self) -> PreparationPlan:
        """That of Henyey–Greenstein, whose degrees and albedos hold for any phase function."""
        return PreparationPlan(self.box, self.length_mm, self.tolerance)

    @cached_property
    def traits(self) -> PhaseTraits:
        """What is known of a phase function."""
        return PhaseTraits()

    @cached_property
    def low_sigma_t(self) -> list[tuple[float, float]]:
        """Coordinates u, and σt, at which orders 1 and 2 are computed."""
        return [(float(u), self._sigma_t(float(u))) for u in nodes(self.base.exact_plane.degrees[0] + 1)]

    @cached_property
    def products(self) -> Products:
        """Polynomials of orders ≥ 3."""
        return Products(self.base.paths_plane, DIRECTIONS)

    @cached_property
    def scale_products(self) -> Products:
        """Polynomials of the logarithm of their brightness, and of noise."""
        return Products(self.base.brightness_plane, DIRECTIONS, tilted=False)

    @property
    def _share(self) -> float:
        return min(1.0, max(FEWEST, (USUAL_TOLERANCE / self.tolerance) ** 2))

    @property
    def _count(self) -> int:
        return math.ceil(self.products.size * MEDIA_PER_PRODUCT * self._share)

    @cached_property
    def _phases(self) -> list[PhaseFunction]:
        return training_phases(self.box.g, self._count + CHECKS)

    @cached_property
    def paths(self) -> list[PhaseSample]:
        """Media for orders ≥ 3."""
        each = SLANTED_EFFORT if self.slanted else 0.5 * EFFORT
        count, effort = self._count, each * (USUAL_TOLERANCE / self.tolerance) ** 2 / self._share
        even = np.cos(np.pi * ((0.5 + np.arange(count) * SPREAD[0]) % 1.0))
        samples = []
        for index, (u, phase) in enumerate(zip(even.tolist(), self._phases[:count], strict=True)):
            sigma_t = self._sigma_t(u)
            depth = sigma_t * self.length_mm
            batches = max(1, round(effort * (1.0 + depth * (0.12 + 0.3 * max(phase.mean_cosine, 0.0) ** 2))))
            samples.append(PhaseSample(index, sigma_t, phase, u, batches))
        return samples

    @cached_property
    def moments(self) -> Array:
        """(media, 1 + highest) of the phase functions of `paths`."""
        return np.array([sample.phase.moments(self.traits.highest) for sample in self.paths])

    @cached_property
    def excess(self) -> Excess:
        """How phase functions differ from Henyey–Greenstein."""
        return Excess.of(self.moments)

    @cached_property
    def places(self) -> tuple[Array, Array, Array]:
        """u, v (media,) and z (media, directions) of `paths`."""
        u = np.array([sample.u for sample in self.paths])
        v = np.array([self.base.coordinates.of(1.0, 0.9, float(one[1]))[0][2] for one in self.moments])
        return u, v, self.excess.at(self.moments)

    @cached_property
    def checks(self) -> list[PhaseSample]:
        """Media whose orders 1 and 2 are compared with a prediction's."""
        phases = self._phases[self._count :]
        even = np.linspace(-0.8, 0.8, CHECKS).tolist()
        return [
            PhaseSample(k, self._sigma_t(u), phase, u, 0) for k, (u, phase) in enumerate(zip(even, phases, strict=True))
        ]

    def _sigma_t(self, u: float) -> float:
        return float(self.base.coordinates.back([u, 0.0, 0.0])[0])

"""The blocks of a liquid whose phase function is fitted: coefficients, and coordinates of a family of phase functions.

With Henyey–Greenstein `MediumBlock` holds all three, and none of these is used.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import LONGEST_STEP, NAMES, Range, slopes, to_coordinates, to_medium
from tankrig.estimation.ink_blocks import MOST_WATER, Doses, InkBlock
from tankrig.estimation.parameters import WIDEST, Block, Values
from tankrig.estimation.phase_families import Family, as_free
from tankrig.scene import Medium

Array = NDArray[np.float64]
Image = NDArray[np.floating]

DAMPED = 1e-4
"""Least damping of a phase function's coordinates."""
LOOSE = 5.0
"""See `PhaseBlock.looseness`."""
CLEAREST = math.log(200.0)
"""σs over σa at most where a search begins: a liquid that another phase function left without absorption may have some,
and where there is none no step along its logarithm does anything."""
UNTURNED = 0.0
"""Asymmetry of a liquid until a phase block has said what it is."""


@dataclass(frozen=True)
class CoefficientsBlock(Block):
    """σa and σs of one liquid in all views.

    Parameters
    ----------
    range
        Where to search.
    """

    range: Range
    name: ClassVar[str] = "medium"
    of_liquid = True
    names = NAMES[:2]
    longest_step = LONGEST_STEP[:2]

    @property
    def low(self) -> Array:
        """Lowest values that the range allows."""
        return self.range.low[:2]

    @property
    def high(self) -> Array:
        """Highest values that the range allows."""
        return self.range.high[:2]

    def start(self, densest: Medium) -> Array:
        """The liquid itself, in the range, and not where absorption is too little for its logarithm to matter."""
        scattering, logit, _ = to_coordinates(Medium(densest.sigma_a, densest.sigma_s, UNTURNED))
        return np.asarray(np.clip([scattering, min(logit, CLEAREST)], self.low, self.high))

    def values(self, coordinates: Array) -> Array:
        """σa and σs."""
        medium = to_medium(np.append(coordinates, UNTURNED))
        return np.array([medium.sigma_a, medium.sigma_s])

    def slopes(self, coordinates: Array) -> Array:
        """(2, 2)."""
        return slopes(to_medium(np.append(coordinates, UNTURNED)))[:2, :2]

    def widest(self, values: Values) -> Array:
        """In units of σt."""
        return np.full(2, WIDEST * float(values[self.name].sum()))

    def at_edge(self, values: Values) -> tuple[str, ...]:
        """See `Range.at_edge`; the mean cosine is the phase function's."""
        return tuple(name for name in self.range.at_edge(self._liquid(values)) if name in self.names)

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """The same everywhere."""
        return self._liquid(values)

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """The liquid's own."""
        return by_liquid[:2]

    def _liquid(self, values: Values) -> Medium:
        sigma_a, sigma_s = values[self.name].tolist()
        return Medium(sigma_a, sigma_s, UNTURNED)


@dataclass(frozen=True)
class InkCoefficientsBlock(Block):
    """σa and σs of ink per mm and ml: at d ml there is d times as much of both.

    Parameters
    ----------
    doses
        As measured.
    length_mm
        Longest side of the tank.
    """

    doses: Doses
    length_mm: float
    name: ClassVar[str] = InkBlock.name
    of_liquid = True
    names = NAMES[:2]
    longest_step = LONGEST_STEP[:2]

    @property
    def _whole(self) -> InkBlock:
        """With an asymmetry and water, of which nothing here is used."""
        return InkBlock(self.doses, self.length_mm)

    @property
    def low(self) -> Array:
        """What a tank can tell from clear water, at the highest dose."""
        return self._whole.low[:2]

    @property
    def high(self) -> Array:
        """What it can tell from chalk."""
        return self._whole.high[:2]

    def start(self, densest: Medium) -> Array:
        """Ink of which the highest dose is that, and not where absorption is too little for its logarithm to matter."""
        scattering, logit, *_ = self._whole.start(Medium(densest.sigma_a, densest.sigma_s, UNTURNED))
        return np.asarray(np.clip([scattering, min(logit, CLEAREST)], self.low, self.high))

    def values(self, coordinates: Array) -> Array:
        """The ink's σa and σs."""
        return self._whole.values(np.array([*coordinates, UNTURNED, 0.0]))[:2]

    def slopes(self, coordinates: Array) -> Array:
        """(2, 2)."""
        return self._whole.slopes(np.array([*coordinates, UNTURNED, 0.0]))[:2, :2]

    def widest(self, values: Values) -> Array:
        """In units of the ink's σt."""
        return np.full(2, WIDEST * float(values[self.name].sum()))

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """So much ink."""
        dose_ml = float(self.doses.moved(values["doses"])[dose])
        sigma_a, sigma_s = (dose_ml * float(one) for one in values[self.name])
        return Medium(sigma_a, sigma_s, UNTURNED)

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """In proportion to the dose."""
        return np.asarray(self.doses.moved(values["doses"])[dose] * by_liquid[:2])


@dataclass(frozen=True)
class WaterBlock(Block):
    """σa of the water alone, in all views.

    Parameters
    ----------
    length_mm
        Longest side of the tank.
    """

    length_mm: float
    name: ClassVar[str] = "water"
    of_liquid = True
    names = ("water_sigma_a",)
    longest_step = np.array([0.3])

    @property
    def low(self) -> Array:
        """None."""
        return np.zeros(1)

    @property
    def high(self) -> Array:
        """In absorption lengths along the tank."""
        return np.array([MOST_WATER])

    def values(self, coordinates: Array) -> Array:
        """1/mm."""
        return coordinates / self.length_mm

    def slopes(self, coordinates: Array) -> Array:
        """(1, 1)."""
        return np.array([[1.0 / self.length_mm]])

    def widest(self, values: Values) -> Array:
        """As much as is searched."""
        return np.array([MOST_WATER / self.length_mm])

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """The same in this water."""
        return replace(before, sigma_a=before.sigma_a + float(values[self.name][0]))

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """That by σa."""
        return by_liquid[:1]


@dataclass(frozen=True)
class PhaseBlock(Block):
    """How one scattering turns light, in all views alike.

    Parameters
    ----------
    family
        That is searched.
    weight
        How many times as firmly coordinates are expected to be 0 ± 1, see `weight_of_priors`.
    """

    family: Family
    weight: float = 1.0
    name: ClassVar[str] = "phase"
    of_liquid = True

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its coordinates."""
        return self.family.names

    @property
    def low(self) -> Array:
        """Lowest values that the family allows."""
        return self.family.low

    @property
    def high(self) -> Array:
        """Highest values that the family allows."""
        return self.family.high

    @property
    def longest_step(self) -> Array:
        """How far the family's coordinates may go in one step."""
        return self.family.longest_step

    @property
    def looseness(self) -> Array:
        """What is expected to be 0 ± 1 changes an image little in a tenth of that."""
        return np.where(self.prior_weight > 0.0, LOOSE, 1.0)

    @property
    def least_damping(self) -> float:
        """An image may hold next to nothing about a combination of coordinates, along which no step should go far."""
        return DAMPED

    def start(self, densest: Medium) -> Array:
        """As much like the liquid's as the family can be; of a family that is not free, like its mean cosine."""
        phase = densest.phase
        if phase is not None and self.family.has(phase):
            return np.clip(self.family.coordinates(phase), self.low, self.high)
        if phase is not None and self.family.is_free:
            return np.clip(as_free(phase), self.low, self.high)
        return np.clip(self.family.like(densest.g), self.low, self.high)

    @property
    def prior_weight(self) -> Array:
        """For coordinates that are expected to be 0 ± 1; 0 for others."""
        return (
            np.where(self.family.expected, self.weight, 0.0) if self.family.expected.size else np.zeros(len(self.names))
        )

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """The same with this phase function."""
        return Medium(before.sigma_a, before.sigma_s, phase=self.family.phase(values[self.name]))

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """The liquid's own, which follow those by σa and σs."""
        return by_liquid[2:]

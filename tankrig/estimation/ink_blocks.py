"""Blocks of a dilution series: ink in water that absorbs, errors of its doses, and a bend of its response."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import LONGEST_STEP, NAMES, Range, coefficients, slopes, to_coordinates, to_medium
from tankrig.estimation.parameters import WIDEST, Block, Image, Values
from tankrig.scene import Medium

Array = NDArray[np.float64]

MOST_WATER = 5.0
"""Absorption lengths of water along the tank at most."""


@dataclass(frozen=True)
class Doses:
    """Ink in the tank.

    Parameters
    ----------
    ml, sd_ml
        (K,) different doses and their standard deviations.
    of_image
        (N,) which of them each image was taken at.
    """

    ml: Array
    sd_ml: Array
    of_image: NDArray[np.int_]

    def moved(self, off: Array) -> Array:
        """(K,) ml when each is off by so many standard deviations."""
        return np.maximum(self.ml + self.sd_ml * off, 0.01 * self.ml)


@dataclass(frozen=True)
class InkBlock(Block):
    """Ink per mm and ml in water that absorbs: at d ml σa = water + ink·d, σs = ink·d, and the ink's g.

    Parameters
    ----------
    doses
        As measured.
    length_mm
        Longest side of the tank.
    """

    doses: Doses
    length_mm: float
    name: ClassVar[str] = "ink"
    of_liquid = True
    names = (*NAMES, "water_sigma_a")
    longest_step = np.array([*LONGEST_STEP, 0.3])

    @property
    def _per_ml(self) -> Array:
        """What takes coordinates of the densest liquid to those of the ink."""
        return np.array([math.log(float(self.doses.ml.max())), 0.0, 0.0])

    @property
    def low(self) -> Array:
        """What a tank can tell from clear water, at the highest dose."""
        return np.array([*(Range.of_tank(self.length_mm).low - self._per_ml), 0.0])

    @property
    def high(self) -> Array:
        """What it can tell from chalk."""
        return np.array([*(Range.of_tank(self.length_mm).high - self._per_ml), MOST_WATER])

    def start(self, densest: Medium) -> Array:
        """Ink of which the highest dose is that, in clear water."""
        return np.asarray(np.clip([*(to_coordinates(densest) - self._per_ml), 0.0], self.low, self.high))

    def values(self, coordinates: Array) -> Array:
        """The ink's σa, σs, g, and the water's σa."""
        return np.array([*coefficients(coordinates[:3]), coordinates[3] / self.length_mm])

    def slopes(self, coordinates: Array) -> Array:
        """(4, 4): of the ink's values, and of the water's."""
        found = np.diag([0.0, 0.0, 0.0, 1.0 / self.length_mm])
        found[:3, :3] = slopes(to_medium(coordinates[:3]))
        return found

    def widest(self, values: Values) -> Array:
        """In units of σt, of the ink and of the densest liquid."""
        sigma_t, water = float(values[self.name][:2].sum()), float(values[self.name][3])
        densest = water + sigma_t * float(self.doses.ml.max())
        return np.array([WIDEST * sigma_t, WIDEST * sigma_t, 1.0, WIDEST * densest])

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """So much ink in the water."""
        *ink, water = values[self.name].tolist()
        return in_tank(Medium(*ink), water, float(self.doses.moved(values["doses"])[dose]))

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """In proportion to the dose."""
        dose_ml = self.doses.moved(values["doses"])[dose]
        return np.stack([dose_ml * by_liquid[0], dose_ml * by_liquid[1], by_liquid[2], by_liquid[0]])


def in_tank(ink: Medium, water_sigma_a: float, dose_ml: float) -> Medium:
    """The liquid of so much ink, given per mm and ml, in water that absorbs."""
    return replace(ink, sigma_a=water_sigma_a + ink.sigma_a * dose_ml, sigma_s=ink.sigma_s * dose_ml)


@dataclass(frozen=True)
class DosesBlock(Block):
    """Errors of the doses, in their standard deviations."""

    doses: Doses
    name: ClassVar[str] = "doses"
    of_liquid = True

    @property
    def names(self) -> tuple[str, ...]:
        """One for each dose."""
        return tuple(f"dose {dose_ml:g} ml" for dose_ml in self.doses.ml)

    @property
    def prior_weight(self) -> Array:
        """Each is known as it was measured."""
        return np.ones(self.doses.ml.size)

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """What the view's own dose changes."""
        found = np.zeros((self.doses.ml.size, *by_liquid.shape[1:]))
        found[dose] = self.doses.sd_ml[dose] * np.tensordot(values["ink"][:2], by_liquid[:2], 1)
        return found


@dataclass(frozen=True)
class BendBlock(Block):
    """By how much ink does more than in proportion to its dose, as a share at the highest dose."""

    doses: Doses
    name: ClassVar[str] = "bend"
    of_liquid = True
    names = ("bend",)

    def widest(self, values: Values) -> Array:
        """Nothing is known."""
        return np.array([WIDEST])

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """The dose's share of the highest, once more."""
        by = self.doses.ml[dose] ** 2 / self.doses.ml.max()
        found: Image = by * np.tensordot(values["ink"][:2], by_liquid[:2], 1)[None]
        return found

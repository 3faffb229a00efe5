"""What a fit searches: parameters in blocks, each with its names, coordinates, range, prior and derivatives.

The optimiser moves in coordinates, values are what is reported (`tankrig.estimation.coordinates`). A block says what
its values do to the liquid of a view, or to its image besides; problem, optimiser, uncertainty and verdict know no more
of it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import LONGEST_STEP, NAMES, Range, coefficients, slopes, to_coordinates, to_medium
from tankrig.scene import Medium

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Values = Mapping[str, Array]
"""Values of each block, by its name."""

LEAST_LEFT = 0.3
"""Share of its σs that a liquid keeps at least in one step."""
WIDEST = 10.0
"""Standard deviation that σa and σs are known to before, in units of σt; g is known to 1."""
FURTHEST_OFF = 5.0
"""Standard deviations by which what is known may be off, at most."""


class Block(Protocol):
    """Parameters that belong together; what a block does not define does nothing."""

    name: ClassVar[str]
    of_liquid: ClassVar[bool] = False
    """Whether its changes of an image are made of the liquid's, in proportion."""
    """Under which its values are found."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its values, in their order."""
        raise NotImplementedError

    @property
    def low(self) -> Array:
        """(k,) lowest coordinates; where none are given, as many standard deviations as anything may be off."""
        return np.full(len(self.names), -FURTHEST_OFF)

    @property
    def high(self) -> Array:
        """(k,) highest coordinates."""
        return np.full(len(self.names), FURTHEST_OFF)

    @property
    def longest_step(self) -> Array:
        """(k,) how far coordinates may go in one step."""
        return np.ones(len(self.names))

    @property
    def looseness(self) -> Array:
        """(k,) times that a coordinate may have moved further than others where a fit has settled."""
        return np.ones(len(self.names))

    @property
    def least_damping(self) -> float:
        """Share of the curvature that steps are damped by at least: more than 0 where coordinates may be alike."""
        return 0.0

    def start(self, densest: Medium) -> Array:
        """(k,) coordinates to begin from when the densest liquid is about this; in the middle."""
        return np.zeros(len(self.names))

    def evenly(self, coordinates: Array, step: Array) -> Array:
        """(k,) coordinates at which values have changed as a step changes them at first; those that it leads to."""
        return np.asarray(coordinates + step)

    def values(self, coordinates: Array) -> Array:
        """(k,) values at coordinates; the same numbers."""
        return coordinates

    def slopes(self, coordinates: Array) -> Array:
        """(k, k) derivatives of the values by the coordinates."""
        return np.eye(coordinates.size)

    @property
    def prior_weight(self) -> Array:
        """(k,) of coordinates that are expected to be 0 ± 1: times that this counts as an observation; 0: unknown."""
        return np.zeros(len(self.names))

    def widest(self, values: Values) -> Array:
        """(k,) standard deviations of the values before anything was observed; they keep uncertainties finite."""
        return np.ones(len(self.names))

    def at_edge(self, values: Values) -> tuple[str, ...]:
        """Names of values that are at the edge of their range."""
        return ()

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """The liquid of views at a dose, where the blocks before this one say `before`."""
        return before

    def added(self, values: Values, liquid: Medium) -> Image | float:
        """What the image of a liquid gains, W/mm²/sr."""
        return 0.0

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """(k, rows, columns) derivatives of a view's image by the values.

        Parameters
        ----------
        values
            Of all blocks.
        dose, liquid
            Of the view.
        by_liquid
            (3, rows, columns) derivatives of the image by the liquid's σa, σs and g.
        """
        raise NotImplementedError

    def turned(self, values: Values, liquid: Medium) -> Image | float:
        """(3, rows, columns) derivatives of `added` by the liquid's σa, σs and g; none where it stays what it is."""
        return 0.0

    def binned(self, by: int) -> "Block":
        """The same of images whose pixels are blocks of this one's, `by` along a side, as a search looks at them."""
        return self

    def added_in(self, view: int, values: Values, liquid: Medium) -> Image | float:
        """`added` in a view of that number; the same in all."""
        return self.added(values, liquid)

    def changes_in(self, view: int, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """`changes` in a view of that number; the same in all."""
        return self.changes(values, dose, liquid, by_liquid)


@dataclass(frozen=True)
class MediumBlock(Block):
    """One liquid in all views: σa, σs and g.

    Parameters
    ----------
    range
        Where to search.
    """

    range: Range
    name: ClassVar[str] = "medium"
    of_liquid = True
    names = NAMES
    longest_step = LONGEST_STEP

    @property
    def low(self) -> Array:
        """Lowest values that the range allows."""
        return self.range.low

    @property
    def high(self) -> Array:
        """Highest values that the range allows."""
        return self.range.high

    def start(self, densest: Medium) -> Array:
        """The liquid itself, in the range."""
        return np.clip(to_coordinates(densest), self.low, self.high)

    def values(self, coordinates: Array) -> Array:
        """σa, σs, g."""
        return np.array(coefficients(coordinates))

    def evenly(self, coordinates: Array, step: Array) -> Array:
        """In proportion to σa, σs and g: where light is hardly absorbed its logarithm may go anywhere."""
        sigma_a, sigma_s, g = self.values(coordinates)
        scattered = sigma_s * max(1.0 + step[0], LEAST_LEFT)
        absorbed = max(sigma_a * (1.0 + step[0] - step[1]), scattered * math.exp(-float(self.high[1])))
        turned = g + (1.0 - g) * (1.0 + g) * step[2]
        low, high = math.tanh(float(self.low[2])), math.tanh(float(self.high[2]))
        return np.array([math.log(scattered), math.log(scattered / absorbed), math.atanh(min(max(turned, low), high))])

    def slopes(self, coordinates: Array) -> Array:
        """See `slopes`."""
        return slopes(to_medium(coordinates))

    def widest(self, values: Values) -> Array:
        """In units of σt."""
        sigma_t = float(values[self.name][:2].sum())
        return np.array([WIDEST * sigma_t, WIDEST * sigma_t, 1.0])

    def at_edge(self, values: Values) -> tuple[str, ...]:
        """See `Range.at_edge`."""
        return self.range.at_edge(Medium(*values[self.name]))

    def liquid(self, values: Values, dose: int, before: Medium) -> Medium:
        """The same everywhere."""
        return Medium(*values[self.name])

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """The liquid's own."""
        return by_liquid

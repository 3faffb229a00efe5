"""What a fit searches: parameters in blocks, each with its names, coordinates, range, prior and derivatives.

The optimiser moves in coordinates, in which every allowed value is an ordinary point: log σs, logit ϖ and atanh g of a
medium. Values are what is reported, and what derivatives and covariances are of. A block says what its values do to the
liquid of a view, or to its image besides; problem, optimiser, uncertainty and verdict know no more of it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from tankrig.checked_toml import MOST
from tankrig.errors import ImageError
from tankrig.scene import Medium

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Values = Mapping[str, Array]
"""Values of each block, by its name."""

NAMES = ("sigma_a", "sigma_s", "g")
"""Coefficients in the order of every covariance and derivative."""

MEAN_FREE_PATHS = (1e-3, 100.0)
"""Range of σs, in scatterings along the tank's longest side, that a fit searches."""
ALBEDO = (0.01, 1.0 - 1e-6)
ASYMMETRY = (-0.95, 0.98)
NEAR_EDGE = np.array([0.01, 0.1, 0.001])
"""Distance from the edge of the range, in log σs, logit ϖ and atanh g, that counts as at it."""
LONGEST_STEP = np.array([1.0, 2.0, 0.5])
"""In log σs, logit ϖ and atanh g; further than this no linearisation is trusted."""
LEAST_LEFT = 0.3
"""Share of its σs that a liquid keeps at least in one step."""
WIDEST = 10.0
"""Standard deviation that σa and σs are known to before, in units of σt; g is known to 1."""
MOST_WATER = 5.0
"""Absorption lengths of water along the tank at most."""
FURTHEST_OFF = 5.0
"""Standard deviations by which what is known may be off, at most."""


def to_coordinates(medium: Medium) -> Array:
    """(log σs, logit ϖ, atanh g) of a medium that scatters; logit ϖ of one that does not absorb is infinite.

    Examples
    --------
    >>> to_coordinates(Medium(0.0, 1.0, 0.0))
    array([ 0., inf,  0.])
    >>> medium = to_medium(to_coordinates(Medium(0.001, 0.02, -0.3)))
    >>> round(medium.sigma_a, 12), round(medium.sigma_s, 12), round(medium.g, 12)
    (0.001, 0.02, -0.3)
    """
    logit = math.log(medium.sigma_s / medium.sigma_a) if medium.sigma_a > 0.0 else math.inf
    return np.array([math.log(medium.sigma_s), logit, math.atanh(medium.g)])


def to_medium(coordinates: Array) -> Medium:
    """Medium at (log σs, logit ϖ, atanh g); logit ϖ = log(σs/σa)."""
    return Medium(*_coefficients(coordinates))


def _coefficients(coordinates: Array) -> tuple[float, float, float]:
    """Its σa, σs and g, without the checks that a medium makes."""
    scattering, logit, asymmetry = (float(value) for value in coordinates)
    sigma_s = math.exp(scattering)
    return sigma_s * math.exp(-logit), sigma_s, math.tanh(asymmetry)


def slopes(medium: Medium) -> Array:
    """∂(σa, σs, g)/∂(log σs, logit ϖ, atanh g), shape (3, 3)."""
    return np.array(
        [
            [medium.sigma_a, -medium.sigma_a, 0.0],
            [medium.sigma_s, 0.0, 0.0],
            [0.0, 0.0, (1.0 - medium.g) * (1.0 + medium.g)],
        ]
    )


@dataclass(frozen=True)
class Range:
    """Where a fit searches.

    Parameters
    ----------
    low, high
        Coordinates.
    sigma_t
        (low, high) extinction that the forward model answers for, 1/mm.
    """

    low: Array
    high: Array
    sigma_t: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def of_media(
        cls,
        sigma_s: tuple[float, float],
        albedo: tuple[float, float],
        g: tuple[float, float],
        sigma_t: tuple[float, float] = (0.0, math.inf),
    ) -> "Range":
        """From coefficients, 1/mm, each (low, high)."""
        edges = [
            np.array([math.log(sigma_s[k]), math.log(albedo[k] / (1.0 - albedo[k])), math.atanh(g[k])]) for k in (0, 1)
        ]
        return cls(edges[0], edges[1], sigma_t)

    @classmethod
    def of_tank(cls, length_mm: float) -> "Range":
        """Everything that a tank of this length can tell from clear water and from chalk."""
        low, high = (paths / length_mm for paths in MEAN_FREE_PATHS)
        return cls.of_media((low, high), ALBEDO, ASYMMETRY)

    def at_edge(self, medium: Medium) -> tuple[str, ...]:
        """Coefficients that a fit left at the edge, where no optimum is: "sigma_a", "sigma_s", "g".

        Examples
        --------
        >>> tank = Range.of_tank(240.0)
        >>> tank.at_edge(Medium(0.001, 0.02, 0.98)), tank.at_edge(Medium(0.0, 0.02, 0.5))
        (('g',), ('sigma_a',))
        """
        if medium.sigma_a == 0.0:
            return ("sigma_a",)
        at = to_coordinates(medium)
        near = (at <= self.low + NEAR_EDGE) | (at >= self.high - NEAR_EDGE)
        near[0] |= not self.sigma_t[0] < medium.sigma_t < self.sigma_t[1]
        return tuple(name for name, edge in (("sigma_a", near[1]), ("sigma_s", near[0]), ("g", near[2])) if edge)


class Block(Protocol):
    """Parameters that belong together; what a block does not define does nothing."""

    name: ClassVar[str]
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
        return np.array(_coefficients(coordinates))

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
        return np.array([*_coefficients(coordinates[:3]), coordinates[3] / self.length_mm])

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
    names = ("bend",)

    def widest(self, values: Values) -> Array:
        """Nothing is known."""
        return np.array([WIDEST])

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """The dose's share of the highest, once more."""
        by = self.doses.ml[dose] ** 2 / self.doses.ml.max()
        found: Image = by * np.tensordot(values["ink"][:2], by_liquid[:2], 1)[None]
        return found


@dataclass(frozen=True)
class Scaling:
    """Gain and offset, which are linear and therefore solved for at every step instead of being searched for.

    image = gain · radiance + offset, with one gain for all images and an offset of each (Golub and Pereyra 1973, with
    Kaufman's Jacobian; the paper's Eq. 15 has neither). A prior on either is one more observation, of the number
    itself. All images are given in standard deviations of their errors, as (n,) arrays of their used pixels.

    Parameters
    ----------
    gain, offset
        The number; None where nothing is known.
    gain_sd, offset_sd
        How well it is known, as a standard deviation; 0: exactly.
    """

    gain: float | None
    offset: float | None
    gain_sd: float = 0.0
    offset_sd: float = 0.0

    @classmethod
    def given(cls, gain: object, offset: object) -> "Scaling":
        """From "free", numbers, or pairs of a number and its standard deviation.

        Raises
        ------
        ImageError
            When either is none of these.
        """
        (gain_mean, gain_sd), (offset_mean, offset_sd) = _known("gain", gain), _known("offset", offset)
        return cls(gain_mean, offset_mean, gain_sd, offset_sd)

    def solve(
        self, models: Sequence[Array], ones: Sequence[Array], observed: Sequence[Array]
    ) -> tuple[float, list[float]]:
        """Gain and offsets that minimise Σ (observed − gain·model − offset)² and what their priors add.

        Parameters
        ----------
        models, observed
            Images.
        ones
            What an offset of one adds to each.
        """
        gain, offset = self.gain or 0.0, self.offset or 0.0
        model = np.concatenate(models)
        # What is left to explain once gain and offset have their expected values, which priors want to keep.
        left = np.concatenate(observed) - gain * model - offset * np.concatenate(ones)
        columns = self._columns(models, ones)
        if self._free_gain:
            column = columns.pop()
            change = float(left @ column[: left.size]) / max(float(column @ column), 1e-300)
            gain, left = gain + change, left - change * model
        changes = [float(left @ one[: left.size]) / float(one @ one) for one in columns] or [0.0] * len(models)
        return gain, [offset + change for change in changes]

    def prior_residuals(self, gain: float, offsets: Sequence[float]) -> Array:
        """Standard deviations by which gain and offsets are short of what they were expected to be, (priors,)."""
        known = [(self.gain, gain, self.gain_sd), *((self.offset, one, self.offset_sd) for one in offsets)]
        return np.array([(expected - found) / sd for expected, found, sd in known if expected is not None and sd])

    def project_out(self, changes: Array, models: Sequence[Array], ones: Sequence[Array]) -> Array:
        """Part of changes of all images, one after the other, (k, n), that no gain and no offset could make.

        Returns
        -------
        (k, n + priors): after the images' pixels what is left of the priors.
        """
        columns = self._columns(models, ones)
        if not columns:
            return changes
        basis = np.stack([one / max(float(np.linalg.norm(one)), 1e-300) for one in columns])
        left: Array = -(changes @ basis[:, : changes.shape[1]].T) @ basis
        left[:, : changes.shape[1]] += changes
        return left

    @property
    def _free_gain(self) -> bool:
        return self.gain is None or self.gain_sd > 0.0

    def _columns(self, models: Sequence[Array], ones: Sequence[Array]) -> list[Array]:
        """What one unit of each free offset, and last of a free gain, does to images and priors; made orthogonal."""
        ends = np.cumsum([0, *(one.size for one in ones)])
        own = int(self.gain_sd > 0.0)
        priors = own + (len(ones) if self.offset_sd > 0.0 else 0)
        columns = []
        for k, one in enumerate(ones if self.offset is None or self.offset_sd > 0.0 else ()):
            column = np.zeros(ends[-1] + priors)
            column[ends[k] : ends[k + 1]] = one
            if self.offset_sd > 0.0:
                column[ends[-1] + own + k] = 1.0 / self.offset_sd
            columns.append(column)
        if self._free_gain:
            column = np.concatenate([*models, np.zeros(priors)])
            if own:
                column[ends[-1]] = 1.0 / self.gain_sd
            for other in columns:
                column = column - other * float(column @ other) / float(other @ other)
            columns.append(column)
        return columns


def _known(name: str, value: object) -> tuple[float | None, float]:
    """A number and its standard deviation; None where free."""
    if value == "free":
        return None, 0.0
    pair = value if isinstance(value, tuple) and len(value) == 2 else (value, 0.0)
    numbers = [float(one) if isinstance(one, float | int | np.number) else math.nan for one in pair]
    possible = np.isfinite(numbers).all() and max(map(abs, numbers)) <= MOST and numbers[1] >= 0.0
    if not possible or (name == "gain" and numbers[0] < 1.0 / MOST):
        wanted = "a positive finite number" if name == "gain" else "a finite number"
        raise ImageError(f'{name} = {value!r} cannot be; give "free", {wanted}, or it and its standard deviation')
    return numbers[0], numbers[1]

"""A model of one liquid's neighbourhood: orders 1 and 2 as they are, and the others from what was prepared for it.

Where light or sight slants, an image by 3·10⁵ light paths has 1 to 5 % of noise, and what is prepared about a medium in
20 to 50 CPU s, and made right at it, has .2 to .3 %, for every medium nearby.

Light of a halo, light that walls send back and what a wide lens makes of edges take three to ten times as long as the
rest together, and change with the liquid nearly as that does: they are computed at one medium, as a factor of each
pixel's other light (`Lift`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.differences import turning_of
from tankrig.estimation.followed import ALIKE, FAINT_LOW, Followed, Model, in_water, remembered
from tankrig.estimation.light_beside import described_beside
from tankrig.estimation.phase_families import Family
from tankrig.light.double import table_error
from tankrig.light.prepared.about import box_for, holds
from tankrig.light.prepared.phases.checked import CheckedOrders, checked_at
from tankrig.light.prepared.phases.high import HighAnswer, high_orders_prepared
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium
from tankrig.scene.optics import PINHOLE

Image = NDArray[np.floating]

TOLERANCE = 0.01
"""Relative L2 error of the image that is asked of what is prepared."""
ALIKE_DENSITY = 0.4
"""Change of σt's logarithm up to which a search takes over one medium's factors of each pixel's light for another."""


@dataclass(frozen=True, eq=False)
class Lift:
    """A scene with light beside its beams' own, and without it.

    Parameters
    ----------
    bare
        Without.
    whole
        With all that the scene describes.
    """

    bare: Followed
    whole: Followed

    @classmethod
    def of(cls, whole: Followed) -> "Lift":
        """A scene's model with and without; the same twice where walls are dark and there is no halo or wide lens."""
        bare, _ = described_beside(whole.scene)
        bare = replace(bare, projector=replace(bare.projector, wide_lens=PINHOLE))
        return cls(whole if bare == whole.scene else replace(whole, scene=bare), whole)

    @property
    def nothing(self) -> bool:
        """Whether there is no other light."""
        return self.bare is self.whole

    def of_low(self, centre: Medium) -> Image:
        """(rows, columns) factors of orders 1 and 2 at a medium."""
        return self._factors(lambda model: model.low_image(centre))

    def of_all(self, centre: Medium) -> Image:
        """(rows, columns) factors of the whole image."""
        return self._factors(lambda model: model(centre).image)

    def _factors(self, image_of: Callable[[Followed], Image]) -> Image:
        if self.nothing:
            return np.ones(self.whole.scene.camera.shape)
        bare = image_of(self.bare)
        return np.asarray(image_of(self.whole) / np.maximum(bare, FAINT_LOW * float(bare.max(initial=0.0)) + 1e-300))


@dataclass(frozen=True, eq=False)
class Lifted:
    """A cheap model of light paths, brightened as light beside does at the first medium that is asked of its density.

    Doses of a series share their scene's model.

    Parameters
    ----------
    lift
        The scene with and without that light.
    """

    lift: Lift

    def __call__(self, medium: Medium) -> Prediction:
        """The image."""
        found = self.lift.bare(medium)
        return replace(found, image=found.image * self._factors(medium))

    def slopes(self, medium: Medium) -> Image:
        """As `Followed` has them."""
        return np.asarray(self.lift.bare.slopes(medium) * self._factors(medium))

    def _factors(self, medium: Medium) -> Image:
        density = math.log(medium.sigma_t)
        near = [factors for known, factors in self._told if abs(known - density) < ALIKE_DENSITY]
        if not near:
            near = [self.lift.of_all(medium)]
            self._told.append((density, near[0]))
        return near[0]

    @cached_property
    def _told(self) -> list[tuple[float, Image]]:
        return []


@dataclass(frozen=True, eq=False)
class Secant:
    """How what was prepared of orders ≥ 3 errs on the way from one medium to another (Broyden 1965).

    Parameters
    ----------
    along
        (2 + k,) the way over its square, in the coordinates of `WithPrepared.place_of`.
    change
        (rows, columns) by how much more at its end, over the L2 norm of those orders.
    """

    along: NDArray[np.float64]
    change: Image


@dataclass(frozen=True, eq=False)
class WithPrepared:
    """The tank's image of media near one, and its derivatives by a family's coordinates.

    Parameters
    ----------
    lift
        Tells orders 1 and 2.
    high
        Tells the others, made right at the centre.
    centre
        The medium, where the errors are told.
    fine
        Whether derivatives are as fine as a phase function's finer shapes want them.
    secants
        How they err on the ways between centres that a fit has been at. Where it follows shapes that what was prepared
        hardly knows, as of beads of .5 µm, that errs by 4 % more there, and centres alone led to and fro.
    """

    lift: Lift
    high: CheckedOrders
    centre: Medium
    fine: bool = False
    secants: tuple[Secant, ...] = ()

    @classmethod
    def about(cls, lift: Lift, centre: Medium, made: list[HighAnswer]) -> "WithPrepared":
        """By the first of what was made that holds a medium; else what is prepared for a box about it, or read from
        the cache, is added there."""
        low = lift.whole
        liquid = in_water(centre, low.water_sigma_s)
        high = next((one for one in made if holds(one.box, liquid)), None)
        if high is None:
            box = box_for(Medium(liquid.sigma_a, liquid.sigma_s, liquid.g))
            high = high_orders_prepared(low.scene, box, TOLERANCE)
            made.append(high)
        return cls(lift, checked_at(high, liquid), centre)

    def __call__(self, medium: Medium) -> Prediction:
        """The image, with its errors as they lie."""
        return self._image(medium)

    def slopes(self, medium: Medium) -> Image:
        """(2 + k, rows, columns) derivatives by σa, σs and the family's coordinates."""
        return self._slopes(medium)

    def holds(self, medium: Medium) -> bool:
        """Whether a medium is well inside what was prepared."""
        return holds(self.high.high.box, self._in_water(medium))

    def after(self, before: "WithPrepared") -> "WithPrepared":
        """With what is learned on the way from another centre."""
        way = self.place_of(self.centre) - before.place_of(before.centre)
        square = float(way @ way)
        if self.high.high is not before.high.high or square == 0.0:
            return self
        return replace(self, secants=(*before.secants, Secant(way / square, self._unforeseen_by(before))))

    def agrees(self, before: "WithPrepared") -> bool:
        """Whether its image is what a model about another centre said, within its error."""
        if self.high.high is not before.high.high:
            return False
        return float(np.linalg.norm(self._unforeseen_by(before))) < float(np.linalg.norm(self.high.errors))

    def _unforeseen_by(self, before: "WithPrepared") -> Image:
        """What orders ≥ 3 at the centre are off by that a model about another one has not said, over their norm. Both
        have followed the same lattices, whose noise is nearly the same."""
        return self.high.off - before.high.off - before.lacking(self.centre)

    @cached_property
    def _image(self) -> Model:
        errors = self.high.errors_at(self._in_water(self.centre))
        size = float(np.linalg.norm(self._whole(self.centre)))
        tables = table_error(self.lift.whole.scene, self.lift.whole.tables or TOLERANCE)
        skipped = (Skipped("tables that order 2 is looked up in", tables),)

        def image(medium: Medium) -> Prediction:
            # Errors go with the image: from one medium to the next they change as slowly as that.
            found = self._whole(medium)
            patterns = errors * (float(np.linalg.norm(found)) / size if size > 0.0 else 1.0)
            stderr = np.sqrt(np.sum(np.square(patterns), axis=0))
            return Prediction(found, "tank", stderr=stderr, skipped=skipped, patterns=patterns)

        return remembered(image)

    def _whole(self, medium: Medium) -> Image:
        return self._low(medium) + self.high.image(self._in_water(medium), self.lacking(medium))

    def lacking(self, medium: Medium) -> NDArray[np.float64] | float:
        """(rows, columns) of orders ≥ 3, what they lack more than at the centre, over their norm; 0 where no way is
        known, for media of any family."""
        if not self.secants:
            return 0.0
        way = self.place_of(medium) - self.place_of(self.centre)
        told = [float(one.along @ way) * one.change for one in self.secants]
        return np.asarray(np.sum(told, axis=0), float)

    def place_of(self, medium: Medium) -> NDArray[np.float64]:
        """Logarithms of σt and σs, and the family's coordinates, over changes that are `ALIKE`."""
        sigma_t, sigma_s, phase = math.log(medium.sigma_t), math.log(medium.sigma_s), medium.phase_function
        return np.array([sigma_t / ALIKE[0], sigma_s / ALIKE[0], *(self._family.coordinates(phase) / ALIKE[1])])

    @property
    def _family(self) -> Family:
        family = self.lift.whole.family
        assert family is not None
        return family

    def _low(self, medium: Medium) -> Image:
        return self.lift.bare.low_image(medium) * self._factors

    @cached_property
    def _factors(self) -> Image:
        return self.lift.of_low(self.centre)

    def _in_water(self, medium: Medium) -> Medium:
        return in_water(medium, self.lift.whole.water_sigma_s)

    @cached_property
    def _slopes(self) -> Callable[[Medium], Image]:
        family = self._family
        telling = replace(self.lift.whole if self.fine else self.lift.bare, fine=self.fine)
        told: list[tuple[NDArray[np.float64], Image]] = []

        def shares(medium: Medium) -> Image:
            """Derivatives of the logarithm of orders 1 and 2, which cost as much as four images, and are used again
            until a medium is further than `ALIKE`; fine ones, which are told once, cost as much as ten."""
            at = self.place_of(medium)
            if not told or not (self.fine or (np.abs(at - told[0][0]) < 1.0).all()):
                told[:] = [(at, telling.low_shares(medium))]
            return told[0][1]

        def slopes(medium: Medium) -> Image:
            turning, sizes = turning_of(medium, family)
            _, high = self.high.image_and_slopes(medium, turning.others, self.lacking(medium))
            per_step = np.concatenate([np.ones(2), 1.0 / sizes])[:, None, None]
            by_high = high * per_step + self._slopes_of_lacking(medium)
            return np.asarray(self._low(medium) * shares(medium) + by_high)

        return remembered(slopes)

    def _slopes_of_lacking(self, medium: Medium) -> Image:
        """(2 + k, rows, columns) what the way to a medium adds to derivatives of orders ≥ 3, by what these lack."""
        found = np.zeros((2 + self._family.low.size, *self.lift.whole.scene.camera.shape))
        for one in self.secants:
            by_sigma_t, by_sigma_s = one.along[:2] / ALIKE[0] / (medium.sigma_t, medium.sigma_s)
            by_values = np.array([by_sigma_t, by_sigma_t + by_sigma_s, *(one.along[2:] / ALIKE[1])])
            found += by_values[:, None, None] * one.change
        return self.high.size_at(self._in_water(medium)) * found

"""A model of one liquid's neighbourhood: orders 1 and 2 as they are, and the others from what was prepared for it.

Where light or sight slants, an image by 3·10⁵ light paths has 1 to 5 % of noise, and what is prepared about a medium in
20 to 50 CPU s, and made right at it, has .2 to .3 %, for every medium nearby.

Light of a halo, light that walls send back and what a wide lens makes of edges take three to ten times as long as the
rest together, and change with the liquid nearly as that does: they are computed at one medium, as a factor of each
pixel's other light, with what derivatives of both differ by there (`Lift`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.differences import turning_of, values_of
from tankrig.estimation.followed import ALIKE, FAINT_LOW, FURTHEST, LOW_ORDERS, Followed, Model, in_water, remembered
from tankrig.estimation.light_beside import described_beside
from tankrig.estimation.phase_families import Family
from tankrig.light.double import table_error
from tankrig.light.prepared.about import box_for, holds
from tankrig.light.prepared.phases.checked import FEWEST, CheckedOrders, Known, checked_at, checked_by_lattices
from tankrig.light.prepared.phases.high import HighAnswer, high_orders_prepared
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium
from tankrig.scene.optics import PINHOLE

Image = NDArray[np.floating]

Made = dict[HighAnswer, Known]
"""What was prepared, and what is known of each where it was made right."""

LATTICES, FIRST_LATTICE = 16, 7
"""Lattices of light paths by which derivatives are made right, and the seed of the first."""
TOLERANCE, TOLERANCE_BY_FACES = 0.01, 0.02
"""Relative L2 error of the image that is asked of what is prepared, and where faces send light back, whose paths take
three times as long. It is made right where a fit asks, and so need only tell what changes from there."""
MOST_TOLD = 6
"""Media by which a pattern's light beside is told, twice as many as an ink's doses usually are."""
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

    def tell_low(self, centres: Sequence[Medium]) -> None:
        """Compute what `of_low` of some media rests on, for all of them together."""
        if not self.nothing:
            for model in (self.bare, self.whole):
                model.low_images(centres)

    def of_low(self, centre: Medium) -> Image:
        """(rows, columns) factors of orders 1 and 2 at a medium."""
        return self._factors(lambda model: model.low_image(centre))

    def of_all(self, centres: Sequence[Medium]) -> list[Image]:
        """(rows, columns) factors of the whole image of each of some media, as a search wants them.

        What a halo and a wide lens add to orders from 2 on is left out: 2 to 4 % of an image of a bench, most of it
        noise of the few paths that tell it, for half of the time.
        """
        if self.whole.scene.projector.black_level > 0.0:  # which may be as bright as the beams
            return [self._factors(partial(_image_of, medium=one)) for one in centres]
        more = zip(self.whole.first_images(centres), self.bare.first_images(centres), centres, strict=True)
        added = [whole - bare + self.whole.by_faces(medium) for whole, bare, medium in more]
        return [
            np.asarray(1.0 + more / _not_dark(self.bare(medium).image))
            for more, medium in zip(added, centres, strict=True)
        ]

    def tell_beside(self, centres: Sequence[Medium]) -> None:
        """Compute what `beside` rests on of those media that are of the family, for all of them together."""
        family = self.whole.family
        ours = [] if self.nothing or family is None else [one for one in centres if family.has(one.phase)]
        new = [one for one in ours if self._told_near(one) is None]
        if new:
            self.whole.first_slopes(new)
        for one in new:
            self.beside(one)

    def beside(self, centre: Medium) -> Image:
        """(2 + k, rows, columns) by how much more than the beams' own light the logarithm of orders 1 and 2 changes
        with σa, σs and the family's coordinates; what was told of a medium that is `ALIKE` serves again."""
        known = self._told_near(centre)
        if known is not None:
            return known
        whole, beams = self.low_shares(centre)
        self._told[:] = [*self._told[1 - MOST_TOLD :], (self.place_of(centre), whole - beams)]
        return whole - beams

    def low_shares(self, medium: Medium, fine: bool = False) -> tuple[Image, Image]:
        """(2 + k, rows, columns) derivatives of the logarithm of orders 1 and 2: of all light, and of the beams' own.

        Those of order 1 are of all its light, which by way of walls is scattered by other angles than the beams' own.
        Order 2 changes as that of the beams does: what a halo adds to it is a hundredth, and as smooth.
        """
        beams = replace(self.bare, fine=True) if fine else self.bare
        both, of_both = beams.low_slopes(medium)
        own = of_both / _not_dark(both)
        if self.nothing:
            return own, own
        ((first, of_first),) = self.whole.first_slopes([medium])
        ((alone, of_alone),) = beams.first_slopes([medium])
        by_second = (of_both - of_alone) / _not_dark(both - alone)
        low = self.whole.low_image(medium)
        return np.asarray((of_first + np.maximum(low - first, 0.0) * by_second) / _not_dark(low)), own

    def place_of(self, medium: Medium) -> NDArray[np.float64]:
        """Logarithms of σt and σs, and the family's coordinates, over changes that are `ALIKE`."""
        assert self.whole.family is not None
        at = _logarithms(medium, self.whole.family)
        return np.concatenate([at[:2] / ALIKE[0], at[2:] / ALIKE[1]])

    def _told_near(self, centre: Medium) -> Image | None:
        """What was told of a medium that is `ALIKE`; None where there is none."""
        at = self.place_of(centre)
        return next((shares for place, shares in self._told if (np.abs(at - place) < 1.0).all()), None)

    @cached_property
    def _told(self) -> list[tuple[NDArray[np.float64], Image]]:
        return []

    def _factors(self, image_of: Callable[[Followed], Image]) -> Image:
        if self.nothing:
            return np.ones(self.whole.scene.camera.shape)
        return np.asarray(image_of(self.whole) / _not_dark(image_of(self.bare)))


@dataclass(frozen=True, eq=False)
class Lifted:
    """A cheap model of light paths, brightened as light beside does at the first medium that is asked of its density.

    Doses of a series share their scene's model, which may be told of all of them together.

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

    def tell(self, media: Sequence[Medium]) -> None:
        """Compute what images of some media rest on, for all of them together."""
        new: list[Medium] = []
        for medium in media:
            if self._told_near(medium) is None and not any(_dense_alike(medium, other) for other in new):
                new.append(medium)
        self._told.extend(zip(new, self.lift.of_all(new) if new else [], strict=True))

    def _factors(self, medium: Medium) -> Image:
        self.tell([medium])
        found = self._told_near(medium)
        assert found is not None
        return found

    def _told_near(self, medium: Medium) -> Image | None:
        return next((factors for known, factors in self._told if _dense_alike(known, medium)), None)

    @cached_property
    def _told(self) -> list[tuple[Medium, Image]]:
        return []


def _dense_alike(one: Medium, other: Medium) -> bool:
    """Whether a search takes over one medium's factors for another."""
    return abs(math.log(one.sigma_t / other.sigma_t)) < ALIKE_DENSITY


def _image_of(model: Followed, medium: Medium) -> Image:
    return model(medium).image


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
    missed
        Tells what derivatives of orders ≥ 3 lack at the centre as prepared, see `missed_slopes`.
    fine
        Whether derivatives are as fine as a phase function's finer shapes want them.
    """

    lift: Lift
    high: CheckedOrders
    centre: Medium
    missed: Callable[[], Image]
    fine: bool = False

    @classmethod
    def about(cls, lift: Lift, centre: Medium, made: Made, most: int | None = None) -> "WithPrepared":
        """By the first of what was made that holds a medium; else what is prepared for a box about it, or read from
        the cache, is added there.

        That is where a search has ended, from where a fit goes on: few lattices make it right there, elsewhere so many
        at most, see `checked_at`.
        """
        low = lift.whole
        liquid = in_water(centre, low.water_sigma_s)
        high = next((one for one in made if holds(one.box, liquid)), None)
        if high is None:
            box = box_for(Medium(liquid.sigma_a, liquid.sigma_s, liquid.g))
            tolerance = TOLERANCE if low.scene.tank.faces.dark else TOLERANCE_BY_FACES
            high = high_orders_prepared(low.scene, box, tolerance)
            made[high] = []
            right = checked_by_lattices(high, liquid, FEWEST)
        else:
            right = checked_at(high, liquid, made[high], most)
        return cls(lift, right, centre, cache(partial(missed_slopes, lift.bare, right, centre)))

    def by_lattices(self, count: int) -> "WithPrepared":
        """The same, made right at its centre by so many lattices of light paths."""
        return replace(self, high=checked_by_lattices(self.high.high, self._in_water(self.centre), count))

    def __call__(self, medium: Medium) -> Prediction:
        """The image, with its errors as they lie."""
        return self._image(medium)

    def slopes(self, medium: Medium) -> Image:
        """(2 + k, rows, columns) derivatives by σa, σs and the family's coordinates."""
        return self._slopes(medium)

    def holds(self, medium: Medium) -> bool:
        """Whether a medium is well inside what was prepared."""
        return holds(self.high.high.box, self._in_water(medium))

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
        """(rows, columns) of orders ≥ 3, what they lack more than at the centre, over their norm; 0 at the centre,
        which may be of any family."""
        if medium == self.centre:
            return 0.0
        way = _logarithms(medium, self._family) - _logarithms(self.centre, self._family)
        return np.asarray(np.tensordot(way, self.missed(), 1), float)

    @property
    def _family(self) -> Family:
        family = self.lift.whole.family
        assert family is not None
        return family

    def _low(self, medium: Medium) -> Image:
        found = self.lift.bare.low_image(medium) * self._factors
        if medium == self.centre or self.lift.nothing:
            return np.asarray(found)
        way = values_of(medium, self._family) - values_of(self.centre, self._family)
        return np.asarray(found * np.exp(np.clip(np.tensordot(way, self._beside, 1), -FURTHEST, FURTHEST)))

    @cached_property
    def _beside(self) -> Image:
        """What the logarithm of orders 1 and 2 changes by more than the beams' own."""
        return self.lift.beside(self.centre)

    @cached_property
    def _factors(self) -> Image:
        return self.lift.of_low(self.centre)

    def _in_water(self, medium: Medium) -> Medium:
        return in_water(medium, self.lift.whole.water_sigma_s)

    @cached_property
    def _slopes(self) -> Callable[[Medium], Image]:
        family, lift = self._family, self.lift
        told: list[tuple[NDArray[np.float64], Image]] = []

        def shares(medium: Medium) -> Image:
            """Derivatives of the logarithm of orders 1 and 2, which cost as much as four images, and are used again
            until a medium is further than `ALIKE`; fine ones, which are told once, cost as much as ten."""
            at = lift.place_of(medium)
            if not told or not (self.fine or (np.abs(at - told[0][0]) < 1.0).all()):
                if self.fine:
                    found, _ = lift.low_shares(medium, fine=True)
                else:
                    found = lift.bare.low_shares(medium) + (0.0 if lift.nothing else self._beside)
                told[:] = [(at, found)]
            return told[0][1]

        def slopes(medium: Medium) -> Image:
            turning, sizes = turning_of(medium, family)
            _, high = self.high.image_and_slopes(medium, turning.others, self.lacking(medium))
            per_step = np.concatenate([np.ones(2), 1.0 / sizes])[:, None, None]
            by_high = high * per_step + self._slopes_of_lacking(medium)
            return np.asarray(self._low(medium) * shares(medium) + by_high)

        return remembered(slopes)

    def _slopes_of_lacking(self, medium: Medium) -> Image:
        """(2 + k, rows, columns) derivatives of what orders ≥ 3 lack, by σa, σs and the family's coordinates."""
        missed = self.missed()
        by_sigma_t, by_sigma_s = missed[0] / medium.sigma_t, missed[1] / medium.sigma_s
        found = np.concatenate([[by_sigma_t, by_sigma_t + by_sigma_s], missed[2:]])
        return self.high.size_at(self._in_water(medium)) * found


def looked_at_together(models: Sequence[Model], media: Sequence[Medium]) -> None:
    """Compute what a search's images of media rest on, one of each model, for all those of the same pattern at once."""
    asked: dict[Lifted, list[Medium]] = {}
    for model, medium in zip(models, media, strict=True):
        if isinstance(model, Lifted):
            asked.setdefault(model, []).append(medium)
    for model, its in asked.items():
        model.tell(its)


def told_together(models: Sequence[Model]) -> None:
    """Compute light beside for all media of the same pattern at once that models were made right at: behind glass order
    1 of three doses takes 13 CPU s, and so does that of one."""
    for lift, media in _by_lift([(one, one.centre) for one in models if isinstance(one, WithPrepared)]):
        lift.tell_low(media)
        lift.tell_beside(media)


def fine_slopes_together(models: Sequence[Model], media: Sequence[Medium]) -> None:
    """Compute what fine derivatives at a medium of each model rest on for all those of the same pattern at once."""
    ours = [(one, medium) for one, medium in zip(models, media, strict=True) if isinstance(one, WithPrepared)]
    for lift, asked in _by_lift(ours):
        if not lift.nothing:
            lift.whole.first_slopes(asked)


def _by_lift(asked: Sequence[tuple[WithPrepared, Medium]]) -> list[tuple[Lift, list[Medium]]]:
    """Media of models that share a scene's light beside, as doses of a pattern do."""
    found: dict[Lift, list[Medium]] = {}
    for model, medium in asked:
        found.setdefault(model.lift, []).append(medium)
    return list(found.items())


def missed_slopes(paths: Followed, high: CheckedOrders, centre: Medium) -> Image:
    """What derivatives of orders ≥ 3 lack at a medium where they were made right, by light paths.

    What is prepared knows ten moments of p, and what these do only as far as they do it in the media that it was
    fitted to: derivatives by a free phase function's third to tenth shape are 30 to 140 % off, and 16 lattices tell
    them to 2 to 10 % in the patterns that its images are made of (two terms of σs .020, two pinholes).

    Parameters
    ----------
    paths
        Tells derivatives along light paths, of beams between dark walls.
    high
        The orders.
    centre
        The medium.

    Returns
    -------
    numpy.ndarray
        (2 + k, rows, columns) by the logarithms of σt and σs and the family's coordinates, over the norm of these
        orders.
    """
    from tankrig.light.paths.block import LARGE
    from tankrig.light.tangent import Turning, by_paths

    family = paths.family
    assert family is not None
    turning, sizes = turning_of(centre, family)
    every = Turning(turning.others, turning.others, np.eye(len(turning.others)))
    scene = replace(paths.scene, medium=centre)
    found = by_paths(scene, LATTICES, FIRST_LATTICE, paths.max_order, LARGE, 0.0, every, LOW_ORDERS + 1)
    image, prepared = high.image_and_slopes(in_water(centre, paths.water_sigma_s), turning.others)
    ratio = float(np.linalg.norm(image)) / (float(np.linalg.norm(found.prediction.image)) or 1.0)
    missed = (ratio * found.slopes - prepared) / (high.size_at(centre) or 1.0)
    patterns = high.high.patterns
    shown = np.asarray((missed.reshape(len(missed), -1) @ patterns.T) @ patterns, float).reshape(missed.shape)
    by_sigma_a, by_sigma_s = shown[:2]
    by_phase = shown[2:] / sizes[:, None, None]
    return np.concatenate([[centre.sigma_t * by_sigma_a, centre.sigma_s * (by_sigma_s - by_sigma_a)], by_phase])


def _not_dark(image: Image) -> Image:
    """An image that may be divided by."""
    return np.maximum(image, FAINT_LOW * float(image.max(initial=0.0)) + 1e-300)


def _logarithms(medium: Medium, family: Family) -> NDArray[np.float64]:
    """(2 + k,) logarithms of σt and σs, and the family's coordinates."""
    coordinates = family.coordinates(medium.phase_function)
    return np.array([math.log(medium.sigma_t), math.log(medium.sigma_s), *coordinates])

"""The tank's image by fixed light paths, a smooth function of the medium, and its derivatives.

In dense water all orders above a few are one linear solve for moments of the light instead.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.phase_families import Family
from tankrig.light.moments.plan import MomentPlan
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_functions import HenyeyGreenstein, Mixture

if TYPE_CHECKING:
    from tankrig.light.tangent import Tangent

Image = NDArray[np.floating]
Model = Callable[[Medium], Prediction]
"""What the camera would see with a medium in the tank."""
Answer = TypeVar("Answer")

TOLERANCE = 0.01
"""Tolerance of what is computed without paths."""
SLOPE_BLUR_MM = 4.0
"""Standard deviation of the Gaussian over which orders ≥ 3 are averaged where changes of the image matter and not the
image: paths take other ways in another medium, and the noise of the difference passes for knowledge."""
ABSORPTION_STEP, STEP = 0.01, 0.005
"""By which the solution for moments is differenced: σa times the tank's length; of σs, and of 1 − g²."""
FEWEST = 8
"""Lattices whose scatter tells the noise of derivatives."""
LOW_ORDERS = 2
"""That are computed without paths."""
FAINT, FAINT_LOW, FURTHEST = 1e-3, 1e-7, 1.0
"""Share of the brightest light of high orders below which there is no logarithm of it; the same of orders 1 and 2,
which have no noise; and how far the first may change."""
ALIKE = 0.1, 0.7
"""Changes that count alike: of the logarithm of σt and σs, and of a coordinate that is expected to be 0 ± 1."""
LATTICES_BY_FACES = 4
"""Of such paths, which are noisier than others, in a search's image."""
MOST_LOW, MOST_FIRST = 8, 3
"""Media whose orders 1 and 2 are kept, and those whose order 1 is with its derivatives; or as many as were asked for
together."""
SOLVED_BATCHES = 16
"""Lattices of paths for the orders that are left to them where the others are solved for."""


def in_water(ink: Medium, sigma_s: float) -> Medium:
    """Ink in water that scatters by itself: coefficients add up, and p is the mean over what scatters.

    Parameters
    ----------
    ink
        In the tank.
    sigma_s
        The water's, 1/mm, isotropic.

    Examples
    --------
    >>> found = in_water(Medium(0.001, 0.009, 0.8), 0.001)
    >>> round(found.sigma_s, 6), round(found.g, 6)
    (0.01, 0.72)
    """
    whole = ink.sigma_s + sigma_s
    if sigma_s == 0.0 or whole == 0.0:
        return ink
    if ink.phase is None:
        return Medium(ink.sigma_a, whole, ink.g * ink.sigma_s / whole)
    shares = ink.sigma_s / whole, sigma_s / whole
    return Medium(ink.sigma_a, whole, phase=Mixture((ink.phase, HenyeyGreenstein(0.0)), shares))


@dataclass(frozen=True, eq=False)
class Followed:
    """The tank's image by a fixed number of lattices of paths, and its derivatives along them.

    Parameters
    ----------
    scene
        Of any medium.
    batches, seed, max_order
        See `tank_tangent`.
    small
        Whether lattices are of a quarter as many paths.
    rough
        Whether order 2 is left to the paths as well.
    family
        Of the media's phase functions; None: Henyey–Greenstein.
    sharp
        Whether derivatives by a family's coordinates are left as they are, and not averaged as others are.
    fine
        Whether their order 2 is as fine as those by the finer shapes of a phase function want it, and not as images'.
    tables
        Tolerance that order 2 is computed to; None: as accurate images want it.
    water_sigma_s
        What water scatters besides, of media of a family, see `in_water`; their derivatives are those without it.
    alone
        Whether images are made without derivatives, which another model gives.
    """

    scene: Scene
    batches: int
    seed: int
    max_order: int | None
    small: bool = False
    rough: bool = False
    family: Family | None = None
    sharp: bool = False
    fine: bool = False
    tables: float | None = None
    water_sigma_s: float = 0.0
    alone: bool = False

    def __call__(self, medium: Medium) -> Prediction:
        """The image; of another phase function than Henyey–Greenstein's by itself."""
        found = self._direct(medium)
        return found if self.scene.tank.faces.dark else replace(found, image=found.image + self.by_faces(medium))

    def slopes(self, medium: Medium) -> Image:
        """(3, rows, columns) derivatives by σa, σs and g, or (2 + k, rows, columns) by a family's coordinates."""
        return self._whole(medium).slopes if self.family is None else self._by_family(medium)

    def slopes_noise(self, medium: Medium) -> Image:
        """(n, 3, rows, columns) patterns of their noise, see `Tangent`."""
        return self._whole(medium).noise if self.family is None else self._paths_by_family(medium).noise

    def with_share(self, share: float, fine: bool) -> "Followed":
        """The same by a share of the lattices, but by `FEWEST` if there are as many, and as `fine` as it is or not."""
        fewer = min(max(FEWEST, round(share * self.batches)), self.batches)
        return replace(self, batches=fewer, fine=self.fine and fine)

    def shares(self, medium: Medium) -> Image:
        """(2 + k, rows, columns) derivatives by a family's coordinates of the logarithm of what paths bring."""
        found = self._paths_by_family(medium)
        bright = found.prediction.image
        return found.slopes / np.maximum(bright, FAINT * float(bright.max(initial=0.0)) + 1e-300)

    def about(self, centre: Medium, exact: Prediction, shares: Image) -> Model:
        """The image near a medium where it is known: orders 1 and 2 as they are, and changes of the others' logarithm
        to first order, see `shares`.

        How that bends is less than what the others' noise differs by between two media.
        """
        from tankrig.estimation.differences import values_of

        family = self.family
        at, others = values_of(centre, family), np.maximum(exact.image - self.low_image(centre), 0.0)

        def near(medium: Medium) -> Prediction:
            by = np.tensordot(values_of(medium, family) - at, shares, 1)
            return replace(exact, image=self.low_image(medium) + others * np.exp(np.clip(by, -FURTHEST, FURTHEST)))

        return remembered(near)

    def beside(self, centre: Medium, exact: Prediction, medium: Medium) -> Prediction:
        """The image of a medium that may be unlike one where it is known: orders 1 and 2 as they are, and the others'
        changed as these few paths change, averaged over `SLOPE_BLUR_MM`.

        The same lattices have much of their noise in common. Shares hold no further than p is alike.
        """
        from scipy.ndimage import gaussian_filter

        widths = [SLOPE_BLUR_MM / side for side in self.scene.camera.sides_mm]
        here, there = (
            gaussian_filter(np.maximum(self._direct(one).image - self.low_image(one), 0.0), widths, mode="nearest")
            for one in (centre, medium)
        )
        others = np.maximum(exact.image - self.low_image(centre), 0.0)
        return replace(
            exact, image=self.low_image(medium) + others * there / np.maximum(here, FAINT * here.max() + 1e-300)
        )

    def taught(self, shares: Image, centre: Medium, exact: Prediction, ahead: Medium, shown: Prediction) -> Image:
        """`shares` at a medium where an exact image is known, so changed that they foretell another one ahead.

        By as little as that takes, and changes that are `ALIKE` by as much (Broyden 1965).
        """
        from tankrig.estimation.differences import values_of

        step = values_of(ahead, self.family) - values_of(centre, self.family)
        scale = np.array([ALIKE[0] * centre.sigma_t, ALIKE[0] * centre.sigma_s, *np.full(step.size - 2, ALIKE[1])])
        far = float(np.sum((step / scale) ** 2))
        if far == 0.0:
            return shares
        foretold = self.about(centre, exact, shares)(ahead).image
        others = foretold - self.low_image(ahead)
        missed = (shown.image - foretold) / np.maximum(others, FAINT * float(others.max(initial=0.0)) + 1e-300)
        missed = np.log(np.clip(1.0 + missed, math.exp(-FURTHEST), math.exp(FURTHEST)))
        return np.asarray(shares + (step / scale**2 / far)[:, None, None] * missed)

    def low_shares(self, medium: Medium) -> Image:
        """(2 + k, rows, columns) derivatives by a family's coordinates of the logarithm of orders 1 and 2."""
        low, slopes = self.low_slopes(medium)
        return np.asarray(slopes / np.maximum(low, FAINT_LOW * float(low.max(initial=0.0)) + 1e-300))

    def slopes_about(self, centre: Medium, exact: Image, shares: Image, low_shares: Image | None = None) -> Image:
        """(2 + k, rows, columns) its derivatives there; of orders 1 and 2 by `low_shares` from next to it, or anew."""
        if low_shares is None:
            low, slopes = self.low_slopes(centre)
        else:
            low = self.low_image(centre)
            slopes = low * low_shares
        return np.asarray(slopes + (exact - low) * shares)

    def low_image(self, medium: Medium) -> Image:
        """Orders 1 and 2."""
        return self.low_images([medium])[0]

    def low_images(self, media: Sequence[Medium]) -> list[Image]:
        """Orders 1 and 2 of several media, such as an ink's doses: order 1 of three takes as long as that of one."""
        from tankrig.light.tangent import low_images

        def compute(asked: Sequence[Medium]) -> Sequence[Image]:
            liquids = [in_water(medium, self.water_sigma_s) for medium in asked]
            return list(low_images(self.scene, liquids, self.tables))

        return _of_each(media, self._known_low, MOST_LOW, compute)

    @cached_property
    def _known_low(self) -> dict[Medium, Image]:
        return {}

    def first_images(self, media: Sequence[Medium]) -> list[Image]:
        """Order 1 of several media, which takes as long as of one; nothing of it is kept."""
        from tankrig.light.behind_lenses import BehindLenses

        return list(BehindLenses(self.scene).once([in_water(medium, self.water_sigma_s) for medium in media]))

    def first_slopes(self, media: Sequence[Medium]) -> list[tuple[Image, Image]]:
        """Order 1 of several media, and (2 + k, rows, columns) its derivatives by σa, σs and a family's coordinates."""
        from tankrig.estimation.differences import turning_of
        from tankrig.light.tangent import first_orders

        family = self.family
        assert family is not None

        def compute(asked: Sequence[Medium]) -> list[tuple[Image, Image]]:
            turnings, sizes = zip(*(turning_of(medium, family) for medium in asked), strict=True)
            firsts = first_orders(self.scene, asked, [one.others for one in turnings])
            return [
                (image, slopes / np.append(np.ones(2), size)[:, None, None])
                for size, (image, slopes) in zip(sizes, firsts, strict=True)
            ]

        return _of_each(media, self._known_first, MOST_FIRST, compute)

    @cached_property
    def _known_first(self) -> dict[Medium, tuple[Image, Image]]:
        return {}

    def _direct(self, medium: Medium) -> Prediction:
        """The image without what paths by way of faces bring."""
        whole = medium.phase is None and not self.alone
        return self._whole(medium).prediction if whole else self._alone(medium)

    @cached_property
    def by_faces(self) -> Callable[[Medium], Image]:
        """What paths by way of faces bring."""
        from tankrig.light.behind_lenses import BehindLenses

        def by_faces(medium: Medium) -> Image:
            scene = replace(self.scene, medium=in_water(medium, self.water_sigma_s))
            return BehindLenses(scene).by_faces(self.seed, LATTICES_BY_FACES)

        return remembered(by_faces)

    @property
    def _tables(self) -> float | None:
        """As for `tank_tangent`."""
        from tankrig.light.tangent import BY_PATHS

        return BY_PATHS if self.rough else self.tables

    @cached_property
    def _alone(self) -> Model:
        from tankrig.light.paths.block import LARGE, SMALL
        from tankrig.light.tangent import tank_steady

        lattice = SMALL if self.small and self.family is not None else LARGE

        def alone(medium: Medium) -> Prediction:
            scene = replace(self.scene, medium=in_water(medium, self.water_sigma_s))
            return tank_steady(scene, self.batches, self.seed, self.max_order, lattice, self.tables)

        return remembered(alone)

    @cached_property
    def _by_family(self) -> Callable[[Medium], Image]:
        lowest = LOW_ORDERS if self.rough else LOW_ORDERS + 1

        def slopes(medium: Medium) -> Image:
            low, paths = self.low_slopes(medium, lowest - 1)[1], self._paths_by_family(medium).slopes
            return np.asarray(low + paths)

        return remembered(slopes)

    def low_slopes(self, medium: Medium, highest: int = LOW_ORDERS) -> tuple[Image, Image]:
        """The image of orders up to one that follows no paths, and its derivatives by a family's coordinates."""
        return self._known_low_slopes((medium, min(highest, self.max_order or highest)))

    @cached_property
    def _known_low_slopes(self) -> Callable[[tuple[Medium, int]], tuple[Image, Image]]:
        from tankrig.estimation.differences import turning_of
        from tankrig.light.tangent import low_orders

        family = self.family
        assert family is not None

        def slopes(asked: tuple[Medium, int]) -> tuple[Image, Image]:
            medium, highest = asked
            turning, sizes = turning_of(medium, family)
            tables = None if self.fine else self._tables
            low, found = low_orders(replace(self.scene, medium=medium), highest, turning.others, tables)
            return low, found / np.append(np.ones(2), sizes)[:, None, None]

        return lru_cache(maxsize=MOST_FIRST)(slopes)

    @cached_property
    def _paths_by_family(self) -> "Callable[[Medium], Tangent]":
        """What paths bring of the image, and of its derivatives by a family's coordinates."""
        from tankrig.estimation.differences import turning_of
        from tankrig.light.paths.block import LARGE, SMALL
        from tankrig.light.tangent import by_paths

        family, lattice = self.family, SMALL if self.small else LARGE
        assert family is not None

        def paths(medium: Medium) -> "Tangent":
            turning, sizes = turning_of(medium, family)
            found = by_paths(
                replace(self.scene, medium=medium), self.batches, self.seed, self.max_order, lattice,
                0.0 if self.sharp else SLOPE_BLUR_MM, turning, LOW_ORDERS if self.rough else LOW_ORDERS + 1,
            )  # fmt: skip
            per_step = np.concatenate([np.ones(2), 1.0 / sizes])[:, None, None]
            return replace(found, slopes=found.slopes * per_step, noise=found.noise * per_step)

        return remembered(paths)

    @cached_property
    def _whole(self) -> "Callable[[Medium], Tangent]":
        from tankrig.light.paths.block import LARGE, SMALL
        from tankrig.light.tangent import tank_tangent

        lattice = SMALL if self.small else LARGE

        def whole(medium: Medium) -> "Tangent":
            scene = replace(self.scene, medium=medium)
            return tank_tangent(
                scene, self.batches, self.seed, self.max_order, lattice, SLOPE_BLUR_MM, tables=self._tables
            )

        return remembered(whole)


@dataclass(frozen=True, eq=False)
class Solved:
    """The tank's image in dense water: few orders by a fixed number of lattices of paths, all others by one solve.

    The solve has no noise of its own: what its source has is small. Along paths noise of the derivatives grows with the
    number of scatterings: at σt/ϖ/g .093/.997/−.32 what sixteen lattices of 16,381 paths added to what tells g and σs
    apart was three times what there is.

    Parameters
    ----------
    low
        The orders up to `plan.above`.
    plan
        For the others.
    parts
        Of the source, each solved for by itself: where there are several their scatter tells its noise.
    """

    low: Followed
    plan: MomentPlan
    parts: int = 1

    def __call__(self, medium: Medium) -> Prediction:
        """The image."""
        low, high = self.low(medium), self._high(medium)
        image = low.image + high
        share = float(np.linalg.norm(high)) / (float(np.linalg.norm(image)) or 1.0)
        left_out = Skipped(f"degrees beyond {self.plan.degree} and coarse cells", self.plan.bound * share)
        return replace(low, image=image, skipped=(*low.skipped, left_out))

    def slopes(self, medium: Medium) -> Image:
        """(3, rows, columns) derivatives by σa, σs and g."""
        result: Image = self.low.slopes(medium) + self._changes(medium)
        return result

    def slopes_noise(self, medium: Medium) -> Image:
        """(n, 3, rows, columns) patterns of their noise, see `Tangent`: of the paths, and of the source in parts."""
        parts, mean = [changes(medium) for changes in self._changes_of_parts], self._changes(medium)
        scale = 1.0 / math.sqrt(self.parts * max(self.parts - 1.0, 1.0))
        return np.concatenate([self.low.slopes_noise(medium), *(scale * (one - mean)[None] for one in parts)])

    def _high(self, medium: Medium) -> Image:
        """The image of orders above `plan.above`, mean of the parts."""
        return np.asarray(np.mean([part(medium) for part in self._parts], axis=0))

    def _changes(self, medium: Medium) -> Image:
        return np.asarray(np.mean([changes(medium) for changes in self._changes_of_parts], axis=0))

    @cached_property
    def _parts(self) -> list[Callable[[Medium], Image]]:
        from tankrig.light.behind_lenses import BehindLenses
        from tankrig.light.moments.dense import dense_image

        def image(seed: int, medium: Medium) -> Image:
            behind = BehindLenses(replace(self.low.scene, medium=medium))
            return behind.seen(dense_image(behind.of_paths, self.plan, seed))

        def part(seed: int) -> Callable[[Medium], Image]:
            return remembered(partial(image, seed))

        return [part(self.low.seed + number) for number in range(self.parts)]

    @cached_property
    def _changes_of_parts(self) -> list[Callable[[Medium], Image]]:
        return [remembered(partial(self._differences, part)) for part in self._parts]

    def _differences(self, high: Callable[[Medium], Image], medium: Medium) -> Image:
        """(3, rows, columns) one-sided differences of an image without noise, by σa, σs and g."""
        here, steps = high(medium), {
            "sigma_a": ABSORPTION_STEP / max(self.low.scene.tank.size_mm),
            "sigma_s": STEP * medium.sigma_s,
            "g": STEP * (1.0 - medium.g**2) * (-1.0 if medium.g > 0.0 else 1.0),
        }  # fmt: skip
        return np.array(
            [
                (high(replace(medium, **{name: getattr(medium, name) + step})) - here) / step
                for name, step in steps.items()
            ]
        )


def tank_along(scene: Scene, max_order: int | None, batches: int, seed: int, blur_mm: float) -> Prediction:
    """Image by a fixed number of lattices, with orders ≥ 3 averaged over a Gaussian."""
    from scipy.ndimage import gaussian_filter

    from tankrig.light.tank import tank_image

    found = tank_image(scene, TOLERANCE, max_order, seed, batches)
    if blur_mm == 0.0:
        return found
    exact = found.orders[1] + found.orders[2]
    image = exact + gaussian_filter(
        found.image - exact, [blur_mm / side for side in scene.camera.sides_mm], mode="nearest"
    )
    return replace(found, image=image)


def _of_each(
    media: Sequence[Medium],
    kept: dict[Medium, Answer],
    most: int,
    compute: Callable[[Sequence[Medium]], Sequence[Answer]],
) -> list[Answer]:
    """Answers for media: those that are kept, and the others computed together, of which the newest are kept."""
    found = dict(kept)  # a copy, since views that are computed side by side share a model
    asked = [medium for medium in dict.fromkeys(media) if medium not in found]
    if asked:
        told = dict(zip(asked, compute(asked), strict=True))
        found |= told
        kept.update(told)
        for old in list(kept)[: -max(most, len(media))]:
            kept.pop(old, None)
    return [found[medium] for medium in media]


def remembered(forward: Callable[[Medium], Answer]) -> Callable[[Medium], Answer]:
    """The same function, answering at once for the few media asked for last."""
    return lru_cache(maxsize=8)(forward)

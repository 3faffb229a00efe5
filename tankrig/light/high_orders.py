"""Orders ≥ 3 in the finite tank: as many lattices of light paths as the tolerance asks for, and time allows.

Where light and sight run straight, a path stands for every start and its image is taken as it is; elsewhere images are
smoothed. In dense water the paths correct a solution for moments of the light field: what both differ in is smoothed
likewise, so that with more paths their image takes over from the solution.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tankrig.light.paths.block import LARGE, SMALL, TURNS, Lattice, PathLimits
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.lattices import THINNING, Groups, traced
from tankrig.light.paths.record import CLASSES, GROUPS, Bins
from tankrig.light.paths.smoothing import FEWEST, Smoothed, averaged, smoothed, smoothed_classes
from tankrig.light.rays import shift_invariant
from tankrig.scene import Scene

Array = NDArray[np.float64]

NOISE_SHARE, BIAS_SHARE = 0.7, 0.8
"""Shares of the tolerance that either may use up: errors are above what is stated in every other case."""
FINE, FINE_SHARES = 0.005, (0.55, 0.62)
"""Tolerance below which shares are smaller: at .3 % nine of a hundred scenes had been 1.0 to 1.3 times as far off as
was asked for, with shares of .62 and .7 four, at 1 % none. Of a hundred errors 97 are within 1.45 of the stated one."""
FIRST_LATTICES, FIRST_SMOOTHED = 6, 8
MOST_ORDERS = 30_000
"""To which paths are followed; in water so deep that light stays for longer, one path would take seconds."""
FAINTEST = 2e-4
"""Share of its weight below which only some paths go on."""
LOST_USUALLY = 5.0
"""Square of what smoothing loses over the variance that it keeps: 3 with 8 lattices, 4 to 7 with 48 (four scenes)."""
MANY = 120.0
"""Lattices from which a solution is worth its time in shallow water, as the first eight tell it: they take it for half
of what it turns out to be."""
LOW_ONLY = 2**20
"""Number from which lattices are counted that are followed through a tail's low orders only."""
FURTHER_ORDERS = 30.0
FEWEST_FULL = 8
"""At least one in so many lattices is followed through all orders."""
NEAR_MM = 6.0
"""Over which what smoothing has lost is averaged, to tell where it was lost."""


@dataclass(frozen=True)
class Allowance:
    """How long a caller lets work go on, and who is told how far it is.

    Parameters
    ----------
    until_s
        `time.perf_counter()` at which it ends; infinity for as long as it takes.
    progress
        Called with the share of the work that is done, 0 … 1; an exception that it raises ends the work.
    """

    until_s: float = math.inf
    progress: Callable[[float], object] = lambda _: None

    @classmethod
    def of(cls, budget_s: float | None, progress: Callable[[float], object] | None) -> "Allowance":
        """From now on, for so many seconds."""
        until_s = math.inf if budget_s is None else time.perf_counter() + budget_s
        return cls(until_s, progress or (lambda _: None))

    def goes_on(self) -> bool:
        """Whether there is time left."""
        return time.perf_counter() < self.until_s


@dataclass(frozen=True)
class Tail:
    """A solution for the orders above some, that paths correct.

    Parameters
    ----------
    above
        Highest order that it has nothing of; 3 or more, up to 19.
    to_20, beyond_20
        (rows, columns) on the cells of `CellGrid`, W/mm²/sr.
    bound
        On its error, relative L2 of the whole image, as far as that is known before.
    coarse
        What it holds no detail of.
    """

    above: int
    to_20: Array
    beyond_20: Array
    bound: float
    coarse: str


@dataclass(frozen=True)
class HighOrders:
    """Orders ≥ 3 on the camera's pixels.

    Parameters
    ----------
    images
        (3, rows, columns) for the classes of `GROUPS`, W/mm²/sr.
    stderr
        (rows, columns) one-sigma error of their sum: noise, and what smoothing or the tail's solution is off by.
    paths
        How many were followed.
    by_walls
        (2, rows, columns) of orders up to 1 and of order 2, as far as faces have sent it back; order 1 by way of clear
        faces left out.
    tail
        The solution that they correct, if there is one.
    """

    images: Array
    stderr: Array
    paths: int
    by_walls: Array
    tail: Tail | None = None

    @property
    def by_class(self) -> dict[int | str, Array]:
        """Images by order class."""
        return dict(zip(GROUPS, self.images, strict=True))


def high_orders(
    scene: Scene,
    known: Array,
    tolerance: float,
    max_order: int | None = None,
    seed: int = 0,
    batches: int | None = None,
    tail: Tail | Callable[[], Tail] | None = None,
    allowance: Allowance | None = None,
) -> HighOrders:
    """Image of the light scattered three times and more.

    Parameters
    ----------
    scene
        Any scene with σs > 0.
    known
        (rows, columns) image of the orders below.
    tolerance
        Relative L2 error, of the image of all orders, to stay below.
    max_order
        Highest order that counts.
    seed
        Of the lattice's random shifts.
    batches
        Follow this many shifted lattices instead of what `tolerance` asks for: then the image is a smooth function of
        the medium.
    tail
        Solution for the orders above some; or what solves for them, which is asked where the first lattices tell that
        so many would be wanted (`MANY`) that it is worth its time.
    allowance
        How long to go on.

    Notes
    -----
    Work goes on until noise and bias are within the tolerance or the allowance is used up; the lattices of a larger
    tolerance are the first ones of a smaller one.
    """
    allowance = allowance or Allowance()
    solve, tail = (None, tail) if tail is None or isinstance(tail, Tail) else (tail, None)
    above = 0 if tail is None else tail.above
    grid = CellGrid.of(scene)
    highest = min(max_order or MOST_ORDERS, MOST_ORDERS)
    lattice, thinning = (SMALL, _thinning(scene)) if batches is None else (LARGE, THINNING)
    turns = TURNS if batches is not None else _turns(scene)
    bins, first = (CLASSES, 0) if tail is None else (_bins_above(above), 2)
    reflecting = not scene.tank.faces.dark
    lattices_of = _Lattices(scene, grid, seed, bins, lattice, PathLimits(highest, FAINTEST, thinning, turns), above)
    groups, low_groups, every = Groups(lattices_of.image), Groups(lattices_of.low_image), 1
    plain = tail is None and grid.shiftable and not reflecting
    apart = tail is not None and not grid.shiftable
    prior = _prior(tail, grid, reflecting)
    wanted = batches or (FIRST_LATTICES if plain else FIRST_SMOOTHED)
    scale = math.sqrt(grid.seen_mm2) / scene.camera.pixel_mm
    done, steady = 0.0, batches is not None
    parts = _Parts(grid, first, plain, apart, steady)
    noise_share, bias_share = FINE_SHARES if tolerance < FINE else (NOISE_SHARE, BIAS_SHARE)
    while True:
        through = max(groups.lattices, math.ceil(wanted / every))
        low_wanted = wanted if apart else wanted - through
        share, before, aim = done, groups.lattices + low_groups.lattices, through + low_wanted

        def told(here: int, elsewhere: int, share: float = share, before: int = before, aim: int = aim) -> bool:
            allowance.progress(share + (1.0 - share) * min(1.0, (here + elsewhere - before) / max(aim - before, 1)))
            return here < FEWEST or allowance.goes_on()  # fewer don't tell how far off they are

        in_time = groups.follow(through, partial(told, elsewhere=low_groups.lattices))
        if low_wanted > 0 and (in_time or apart):
            in_time = low_groups.follow(low_wanted, partial(told, elsewhere=groups.lattices)) and in_time
        in_time = in_time and allowance.goes_on()
        means, low_means = groups.means, low_groups.means
        peak = float(np.abs(means).max(initial=0.0)) or 1.0  # squares of faint light would be 0, with its noise
        means -= prior
        own = groups.counted / (groups.counted + low_groups.counted)
        found, low, lower = parts.together(means, low_means, own, peak)
        whole = found.image if lower is None else found.image + lower.image
        image = known + grid.to_pixels(grid.unfolded(peak * whole + prior.sum(axis=0)))
        size = float(np.linalg.norm(image / peak)) or 1.0
        bias = _bias(found, tail, grid, size / scale)
        if lower is not None:
            bias += _bias(lower, None, grid, size / scale)
            found = _with(found, lower)
        noise = math.sqrt(float(found.variance.sum())) * scale / size
        off = math.sqrt(float(bias.sum())) * scale / size
        if batches is not None or not in_time:
            break
        missed = math.hypot(noise * math.sqrt(1.0 + found.spread) / noise_share, off / bias_share) / tolerance
        if missed <= 1.0:
            break
        if solve is not None and before == 0 and groups.lattices * missed**2 > MANY:
            return high_orders(scene, known, tolerance, max_order, seed, batches, solve(), allowance)
        if tail is not None and before == 0:
            every = low_per_full(low_means if apart else means[:, :first], means[:, first:], above, apart)
        followed = low_groups.lattices if apart else groups.lattices + low_groups.lattices
        wanted = math.ceil(followed * min(max(1.1 * missed**2, 1.3), 6.0))
        done = max(done, min(followed / wanted, 0.99))
    stated = found.variance * (_student(len(means)) if batches is None else 1.0) + bias
    stderr = peak * np.sqrt(grid.variance_to_pixels(stated))
    above_low = peak * (found.image - low.sum(axis=0))
    rest = means[:, first:].mean(axis=0) if plain else smoothed_classes(means[:, first:], above_low, steady)
    classes = grid.unfolded(np.concatenate([peak * low, rest]) + prior)
    if tail is not None:
        classes = np.array([classes[0], classes[1] + classes[2], classes[3]])
    images = np.array([np.maximum(grid.to_pixels(one), 0.0) for one in classes])
    by_walls = images[len(GROUPS) :] if reflecting else np.zeros_like(images[:2])
    allowance.progress(1.0)
    paths = (groups.lattices + low_groups.lattices) * lattice.points
    return HighOrders(images[: len(GROUPS)], stderr, paths, by_walls, tail)


@dataclass(frozen=True)
class _Lattices:
    """Lattices of paths, each by its number: through all orders, or through those only that a tail has nothing of."""

    scene: Scene
    grid: CellGrid
    seed: int
    bins: Bins
    lattice: Lattice
    limits: PathLimits
    above: int

    def image(self, number: int) -> Array:
        """By class, with what walls send back."""
        own = self.seed, number
        images = traced(self.scene, self.grid, own, self.bins, self.limits, self.lattice)
        if not self.scene.tank.faces.dark:
            images = _with_walls(images, self.scene, self.grid, own, self.limits.max_order)
        return self.grid.folded(images)

    def low_image(self, number: int) -> Array:
        """The two low classes."""
        own, limits = (self.seed, LOW_ONLY + number), PathLimits(self.above, FAINTEST, self.limits.first_thinning)
        return self.grid.folded(traced(self.scene, self.grid, own, self.bins, limits, self.lattice))[:2]


@dataclass(frozen=True)
class _Parts:
    """How images by class of many lattices are put together to one.

    Parameters
    ----------
    grid
        That they are on.
    first
        Classes before it are not smoothed.
    plain
        Whether none is.
    apart
        Whether the low ones are smoothed by themselves, on lattices of their own.
    steady
        See `smoothed`.
    """

    grid: CellGrid
    first: int
    plain: bool
    apart: bool
    steady: bool

    def together(
        self, means: Array, low_means: Array, own: float, peak: float
    ) -> tuple[Smoothed, Array, Smoothed | None]:
        """Their sum over `peak`, low classes by themselves, and the sum's part from lattices of low orders, if any.

        `own` is the share of the lattices that are followed through all orders.
        """
        first = self.first
        if self.apart:
            low, lower = _low_orders(low_means / peak, self.grid, self.steady)
            return _found(means[:, first:] / peak, 0, 1.0, False, self.grid, self.steady), low, lower
        low = own * means[:, :first].mean(axis=0) / peak
        found = _found(means / peak, first, own, self.plain, self.grid, self.steady)
        if own == 1.0:
            return found, low, None
        low += (1.0 - own) * low_means.mean(axis=0) / peak
        return found, low, averaged((1.0 - own) * low_means.sum(axis=1) / peak, self.grid.seen)


def _with_walls(images: Array, scene: Scene, grid: CellGrid, seed: tuple[int, int], highest: int) -> Array:
    """Images by class with what walls and floor send back, and two more of that in orders up to 1 and in order 2."""
    from tankrig.light.walls.paths import wall_images

    order = np.arange(CLASSES.size)
    bins = np.where(order <= 2, len(GROUPS) + (order == 2), CLASSES)
    more = wall_images(scene, grid, seed, bins, highest, FAINTEST)
    return np.concatenate([images + more[: len(GROUPS)], more[len(GROUPS) :]])


def _found(batches: Array, first: int, own: float, plain: bool, grid: CellGrid, steady: bool) -> Smoothed:
    """Sum over classes of (n, classes, rows, columns) batches; those before `first` as they are, times `own`."""
    if plain:
        return averaged(batches.sum(axis=1), grid.seen)
    return smoothed(batches[:, first:].sum(axis=1), own * batches[:, :first].sum(axis=1), grid.seen, steady)


def _low_orders(batches: Array, grid: CellGrid, steady: bool) -> tuple[Array, Smoothed]:
    """Smooth images by class of (n, classes, rows, columns) batches, and their sum."""
    found = smoothed(batches.sum(axis=1), seen=grid.seen, steady=steady)
    return smoothed_classes(batches, found.image, steady), found


def _with(found: Smoothed, further: Smoothed) -> Smoothed:
    """An image with an independent one added to it."""
    of, to = float(found.variance.sum()), float(further.variance.sum())
    spread = math.hypot(found.spread * of, further.spread * to) / (of + to) if of + to > 0.0 else 0.0
    return Smoothed(
        found.image + further.image, found.variance + further.variance, spread, found.lost + further.lost,
        math.hypot(found.lost_stderr, further.lost_stderr),
    )  # fmt: skip


def low_per_full(low_batches: Array, high_batches: Array, above: int, apart: bool) -> int:
    """Of how many lattices one is worth being followed beyond the orders that the tail has nothing of.

    Work with the least noise for its cost: as the noise of either part goes, over the root of its cost. Low orders cost
    in proportion to their number; all further ones about as much as `FURTHER_ORDERS`.

    Parameters
    ----------
    low_batches, high_batches
        (n, classes, rows, columns) of both parts, the latter less the tail.
    above
        The highest of the low orders.
    apart
        Whether low orders are smoothed, on lattices of their own.
    """
    low = (smoothed if apart else averaged)(low_batches.sum(axis=1))
    high = smoothed(high_batches.sum(axis=1))
    noise = math.sqrt(float(high.variance.sum()) / (float(low.variance.sum()) or 1.0))
    return int(min(max(1.0 / max(noise * math.sqrt(above / FURTHER_ORDERS), 1e-9), 1.0), FEWEST_FULL))


def _student(batches: int) -> float:
    """What the variance seen in so many batches is multiplied by: error over stated error is then 1 in its square mean.

    That ratio is Student's t with one degree of freedom less than there are batches; its variance is (n − 1)/(n − 3).
    """
    return (batches - 1.0) / (batches - 3.0) if batches > 3 else 1.0


def _bins_above(above: int) -> Bins:
    """Order 3, up to `above`, up to 20, beyond."""
    orders = np.arange(22)
    return np.select([orders <= 3, orders <= above, orders <= 20], [0, 1, 2], 3)


def _prior(tail: Tail | None, grid: CellGrid, reflecting: bool) -> Array:
    """What paths are compared with, by class."""
    if tail is None:
        return grid.folded(np.zeros((len(GROUPS) + 2 * reflecting, grid.rows, grid.columns)))
    zero = np.zeros_like(tail.to_20)
    return grid.folded(np.array([zero, zero, tail.to_20, tail.beyond_20]))


def _bias(found: Smoothed, tail: Tail | None, grid: CellGrid, size: float) -> Array:
    """(rows, columns) square of what smoothing has lost, as it is seen; `size` is the image's norm there.

    What is seen is noisy while there are few paths. What is usual, or of a solution its bound, counts for more then.
    """
    near = np.maximum(gaussian_filter(found.lost, NEAR_MM / math.sqrt(grid.seen_mm2), mode="nearest"), 0.0)
    seen = max(float(found.lost.sum()), 0.0)
    if tail is not None:
        image = np.square(grid.seen(grid.folded((tail.to_20 + tail.beyond_20)[None]))[0])
        usual, where = (tail.bound * size) ** 2, image / (float(image.sum()) or 1.0)
    else:
        noise = float(found.variance.sum())
        usual, where = LOST_USUALLY * noise * float(found.lost_stderr > 0.0), found.variance / (noise or 1.0)
    sure = 0.5 * usual  # what is usual is known within a factor of 1.5
    weight = sure**2 / (sure**2 + found.lost_stderr**2) if usual > 0.0 else 0.0
    here = near / (float(near.sum()) or 1.0)
    squared: Array = weight * seen * here + (1.0 - weight) * usual * where
    return squared


def beyond_orders(scene: Scene) -> float:
    """Bound on the light of orders above `MOST_ORDERS`: light stays for about the square of the depth in free paths."""
    medium = scene.medium
    deep = (medium.sigma_t * min(scene.tank.size_mm)) ** 2 > MOST_ORDERS
    return float(medium.albedo**MOST_ORDERS) if deep else 0.0


def _turns(scene: Scene) -> int:
    """How many of the first scatterings paths may turn at: more where light goes on for many of them before it turns.

    At σt/ϖ/g = .056/.999/.95 a third of the variance, at g ≤ .93 and in shallower water none.
    """
    deep = scene.medium.sigma_t * scene.tank.size_mm[2] > 4.0
    return 3 * TURNS if deep and scene.medium.g > 0.9 and shift_invariant(scene) else TURNS


def _thinning(scene: Scene) -> int:
    """Order from which later ones need fewer paths: the deeper the water in free paths, the later (measured)."""
    depth = scene.medium.sigma_t * scene.tank.size_mm[2]
    return 4 if depth < 4.0 else 16 if depth < 8.0 else 32

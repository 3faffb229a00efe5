"""The tank's image as fits want it: with its derivatives by the medium, or accurate and with its noise as it lies."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tankrig.light.behind_lenses import BehindLenses
from tankrig.light.double import table_error
from tankrig.light.high_orders import FAINTEST, LOST_USUALLY, MOST_ORDERS
from tankrig.light.paths.block import LARGE, SMALL, Lattice, PathLimits
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.lattices import THINNING, Groups, traced
from tankrig.light.paths.record import Bins
from tankrig.light.paths.smoothing import FEWEST, averaged, smoothed_batches
from tankrig.light.paths.tangents import traced_tangents
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction
from tankrig.threads import THREADS

Array = NDArray[np.float64]

BY_PATHS = math.inf
"""Tolerance of order 2 that leaves it to the paths, see `tank_tangent`."""
TABLES, FINE_TABLES = 0.01, 0.001
"""Tolerance that order 2 is computed to beside derivatives by g, where coarse tables do, and in accurate images. Of
derivatives by the finer shapes of a free phase function coarse ones get a quarter to three quarters wrong."""
FEWEST_APART = 12
"""Lattices whose scatter tells what the noise of their mean does."""
MANY_PIXELS = 40_000
"""Of a camera, from which the noise of no more lattices is kept apart."""
GROUPS, FEW_GROUPS = 8, 2
"""Of lattices, whose scatter tells the noise of derivatives, and where there are `MANY_PIXELS`."""
LEARNT = 2.0
"""Times the scatter of lattices that are smoothed by what stands out of them is the variance of their mean: 1.7 to 2.5
for derivatives in three scenes with pinholes, by six and by sixteen lattices."""
ONE_BIN: Bins = np.zeros(4, np.int64)
"""All orders in one image."""
LOOKED_UP = 0.004
"""Error of what a calibrated camera looks up of order 2, of its own norm."""
STEP_LENGTH, STEP_ASYMMETRY = 0.02, 0.015
"""By which orders 1 and 2, which have no noise, are differentiated: σa times the tank's length, and g over 1 − g²."""


@dataclass(frozen=True, eq=False)
class Turning:
    """Ways that a phase function p may change, where it is not Henyey–Greenstein's.

    Parameters
    ----------
    others
        Phase functions q near p: derivatives are by the share t of the way to each, (1 − t) p + t q.
    ways
        Phase functions that paths have their scores of: fewer, where their orders know no more of p than these tell.
    by_ways
        (others, ways) what the others are of these, for that.
    """

    others: Sequence[PhaseFunction]
    ways: Sequence[PhaseFunction]
    by_ways: Array


@dataclass(frozen=True, eq=False)
class Tangent:
    """An image with its derivatives.

    Parameters
    ----------
    prediction
        The image.
    slopes
        (3, rows, columns) derivatives by σa, σs and g; of other phase functions (2 + k, rows, columns) by σa, σs and
        `Turning.others`.
    noise
        (n, 3, rows, columns) patterns of what the paths' noise puts on the derivatives: its covariance is the sum of
        their products. None of them where there is one lattice only.
    """

    prediction: Prediction
    slopes: Array
    noise: Array


def tank_tangent(
    scene: Scene, batches: int, seed: int = 0, max_order: int | None = None, lattice: Lattice = LARGE,
    blur_mm: float = 0.0, turning: Turning | None = None, tables: float | None = None,
) -> Tangent:  # fmt: skip
    """Image of the finite tank by a fixed number of lattices of paths, and its derivatives along the same paths.

    Parameters
    ----------
    scene
        Any scene with σs > 0; light that its faces send back is none of it.
    batches
        Number of shifted lattices.
    seed
        Of their shifts.
    max_order
        Sum orders 1 … max_order only.
    lattice
        Of the paths.
    blur_mm
        Standard deviation of a Gaussian that the derivatives of orders ≥ 3 are averaged over.
    turning
        Where the phase function may go; None where it is Henyey–Greenstein's, which is differentiated by g.
    tables
        Tolerance that order 2 is computed to; None: as derivatives by the finer shapes of a phase function want it;
        `BY_PATHS`: it is left to the paths as well, which is noisier, and where light or sight slant three times as
        quick.

    Returns
    -------
    Tangent
        The image is as `tank_image` has it with as many lattices, but for its orders.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.001, 0.02, 0.5), light, Camera("orthographic", (40, 60), 4.0))
    >>> slopes = tank_tangent(scene, 2).slopes
    >>> slopes.shape, bool((slopes[0].sum() < 0.0) & (slopes[1].sum() > 0.0))
    ((3, 40, 60), True)
    """
    lowest = 2 if tables == BY_PATHS else 3
    others = () if turning is None else turning.others
    tables = _tables(scene.medium) if tables is None else tables
    sharp, slopes = low_orders(scene, min(max_order or MOST_ORDERS, lowest - 1), others, tables)
    high = by_paths(scene, batches, seed, max_order, lattice, blur_mm, turning, lowest)
    image = sharp + high.prediction.image
    skipped = (_looked_up(scene, sharp, image, tables),)
    return Tangent(replace(high.prediction, image=image, skipped=skipped), slopes + high.slopes, high.noise)


def by_paths(
    scene: Scene, batches: int, seed: int, max_order: int | None, lattice: Lattice, blur_mm: float,
    turning: Turning | None, lowest: int = 3,
) -> Tangent:  # fmt: skip
    """What of `tank_tangent` paths bring: orders from the lowest on."""
    ways = () if turning is None else turning.ways
    rest, stderr, noise = _from_paths(scene, batches, seed, max_order or MOST_ORDERS, lattice, lowest, ways)
    if turning is not None:
        rest = np.concatenate([rest[:3], np.tensordot(turning.by_ways, rest[3:], 1)])
        noise = np.concatenate([noise[:, :2], np.einsum("kw,nwij->nkij", turning.by_ways, noise[:, 2:])], axis=1)
    if blur_mm > 0.0:
        widths = [0.0, *(blur_mm / side for side in scene.camera.sides_mm)]
        rest[1:] = gaussian_filter(rest[1:], widths, mode="nearest")
        noise = gaussian_filter(noise, [0.0, *widths], mode="nearest")
    return Tangent(Prediction(np.maximum(rest[0], 0.0), "tank", stderr=stderr), rest[1:], noise)


def tank_steady(
    scene: Scene, batches: int, seed: int = 0, max_order: int | None = None, lattice: Lattice = LARGE,
    tables: float | None = None,
) -> Prediction:  # fmt: skip
    """The image of `tank_tangent` without its derivatives."""
    lowest = 2 if tables == BY_PATHS else 3
    tables = _tables(scene.medium) if tables is None else tables
    behind, highest = BehindLenses(scene), max_order or MOST_ORDERS
    sharp = behind.once([scene.medium])[0]
    if highest >= 2 and lowest == 3:
        sharp = sharp + behind.twice([scene.medium], tables)[0]
    if highest < lowest:
        return Prediction(sharp, "tank")
    lit = behind.of_paths
    grid = CellGrid.of(lit)

    def followed(number: int) -> Array:
        limits = PathLimits(highest, FAINTEST, THINNING, lowest=lowest)
        return np.asarray(grid.folded(traced(lit, grid, (seed, number), ONE_BIN, limits, lattice))[0])

    with ThreadPoolExecutor(min(THREADS, batches)) as pool:
        light = np.array(list(pool.map(followed, range(batches))))
    smooth, stderr = _steadied(light, grid)
    image = sharp + np.maximum(behind.seen(grid.to_pixels(grid.unfolded(smooth.mean(axis=0)))), 0.0)
    stderr = behind.error_seen(stderr)
    return Prediction(image, "tank", stderr=stderr, skipped=(_looked_up(scene, sharp, image, tables),))


def _steadied(light: Array, grid: CellGrid) -> tuple[Array, Array]:
    """Images of lattices, smoothed where that is needed, and the standard error of their mean in pixels."""
    plain = grid.shiftable or len(light) < FEWEST
    peak = float(np.abs(light).max()) + 1e-300
    smooth = light if plain else peak * smoothed_batches(light / peak, steady=True)
    more = 1.0 if plain else 1.0 + LOST_USUALLY
    return smooth, peak * np.sqrt(grid.variance_to_pixels(more * averaged(smooth / peak, grid.seen).variance))


def _tables(medium: Medium) -> float:
    """Tolerance that order 2 is computed to beside derivatives."""
    return TABLES if medium.phase is None else FINE_TABLES


def _looked_up(scene: Scene, sharp: Array, image: Array, tables: float) -> Skipped:
    """What tables of order 2 err by."""
    off = table_error(scene, tables) * float(np.linalg.norm(sharp)) / (float(np.linalg.norm(image)) or 1.0)
    return Skipped("tables that order 2 is looked up in", off)


def low_images(scene: Scene, media: Sequence[Medium], tables: float | None = None) -> Array:
    """(media, rows, columns) of orders 1 and 2; where lines of sight meet beams is found once for all of them."""
    behind = BehindLenses(scene)
    # Order 2 of each by itself, as its tables have the nodes that it wants.
    seconds = [behind.twice([one], _tables(one) if tables is None else tables)[0] for one in media]
    return np.asarray(behind.once(media) + np.array(seconds))


def first_orders(
    scene: Scene, media: Sequence[Medium], others: Sequence[Sequence[PhaseFunction]]
) -> list[tuple[Array, Array]]:
    """Order 1 of several media, and its derivatives by σa, σs and the share of the way to each of a medium's others.

    Where lines of sight meet beams, which takes nearly all of the time behind glass, is found once for all of them.
    """
    absorption = STEP_LENGTH / max(scene.tank.size_mm)
    stepped = [
        [
            one,
            replace(one, sigma_a=one.sigma_a + absorption),
            *(Medium(one.sigma_a, one.sigma_s, phase=other) for other in its),
        ]
        for one, its in zip(media, others, strict=True)
    ]
    images = iter(BehindLenses(scene).once([one for each in stepped for one in each]))
    found = []
    for medium, each in zip(media, stepped, strict=True):
        image, absorbed, *turned = (next(images) for _ in each)
        by_absorption = (absorbed - image) / absorption
        slopes = [by_absorption, by_absorption + image / medium.sigma_s, *(one - image for one in turned)]
        found.append((image, np.stack(slopes)))
    return found


def low_orders(
    scene: Scene, highest: int, others: Sequence[PhaseFunction], tables: float | None = None
) -> tuple[Array, Array]:
    """Orders 1 and 2, and their derivatives: they go with σs and σs² at one extinction."""
    medium, behind, tables = scene.medium, BehindLenses(scene), _tables(scene.medium) if tables is None else tables
    absorption = STEP_LENGTH / max(scene.tank.size_mm)
    stepped = [medium, replace(medium, sigma_a=medium.sigma_a + absorption)]
    turning = STEP_ASYMMETRY * (1.0 - medium.g) * (1.0 + medium.g) * (-1.0 if medium.g > 0.0 else 1.0)
    if medium.phase is None:
        stepped.append(replace(medium, g=medium.g + turning))
    count = len(stepped)
    ones = behind.once([*stepped, *(Medium(medium.sigma_a, medium.sigma_s, phase=other) for other in others)])
    twos, turned = np.zeros((count, *scene.camera.shape)), np.zeros((len(others), *scene.camera.shape))
    if highest >= 2 and medium.phase is None:  # together, for liquids so near have tables of the same nodes
        twos = behind.twice(stepped, tables)
    elif highest >= 2:
        here = behind.twice([medium], tables, others)
        twos, turned = np.array([here[0], behind.twice(stepped[1:], tables)[0]]), here[1:]
    first, second = ones[0], twos[0]
    image = first + second
    by_absorption = (ones[1] + twos[1] - image) / absorption
    by_scattering = by_absorption + (first + 2.0 * second) / medium.sigma_s
    if medium.phase is None:
        return image, np.stack([by_absorption, by_scattering, (ones[2] + twos[2] - image) / turning])
    return image, np.stack([by_absorption, by_scattering, *(ones[count:] - first + turned)])


def tank_accurate(scene: Scene, paths: int, seed: int = 0, max_order: int | None = None) -> Prediction:
    """Image of the finite tank by so many paths, with the patterns that its noise has.

    Noise of paths is alike along beams and lines of sight, and what it does to fitted coefficients is what its patterns
    do: the scatter of lattices from their mean. It is not smoothed: a fit averages over all pixels by itself, and what
    smoothing takes from the light it could not give back.

    Parameters
    ----------
    scene
        Any scene with σs > 0.
    paths
        At least so many are followed, on `FEWEST_APART` lattices or more.
    seed, max_order
        As for `tank_tangent`.
    """
    behind, highest = BehindLenses(scene), max_order or MOST_ORDERS
    first = behind.once([scene.medium])[0]
    second = behind.twice([scene.medium], FINE_TABLES)[0] if highest >= 2 else np.zeros_like(first)
    sharp, lit = first + second, behind.of_paths
    if highest < 3:
        return Prediction(sharp, "tank")
    grid = CellGrid.of(lit)
    count = max(FEWEST_APART, math.ceil(paths / SMALL.points))

    def followed(number: int) -> Array:
        found = traced(lit, grid, (seed, number), ONE_BIN, PathLimits(highest, FAINTEST, THINNING), SMALL)
        return np.asarray(grid.folded(found)[0])

    groups = Groups(lambda number: followed(number)[None])
    groups.follow(count, lambda _: True)
    batches = groups.means[:, 0]
    mean, count = batches.mean(axis=0), len(batches)
    image = sharp + np.maximum(behind.seen(grid.to_pixels(grid.unfolded(mean))), 0.0)
    if math.prod(scene.camera.shape) > MANY_PIXELS and count > FEWEST_APART:  # or patterns would take a GiB
        whole = batches[: count // FEWEST_APART * FEWEST_APART]
        batches = np.array([part.mean(axis=0) for part in np.split(whole, FEWEST_APART)])
    count = len(batches)
    apart = (batches - mean) / math.sqrt(count * (count - 3.0))  # as Student's t is wider
    patterns = behind.seen(np.array([grid.to_pixels(grid.unfolded(one)) for one in apart]))
    size = float(np.linalg.norm(image)) or 1.0
    tables = table_error(scene, FINE_TABLES) * float(np.linalg.norm(sharp)) / size
    skipped = [Skipped("tables that order 2 is looked up in", tables)]
    if scene.camera.kind == "calibrated":
        looked_up = LOOKED_UP * float(np.linalg.norm(second)) / size
        skipped.append(Skipped("what a calibrated camera looks up of order 2", looked_up))
    stderr = np.sqrt(np.sum(np.square(patterns), axis=0))
    return Prediction(image, "tank", stderr=stderr, skipped=tuple(skipped), patterns=patterns)


def _from_paths(
    scene: Scene, batches: int, seed: int, max_order: int, lattice: Lattice, lowest: int, ways: Sequence[PhaseFunction]
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Orders from the lowest on and their derivatives, (4, rows, columns), the light's standard error, and patterns of
    the derivatives' noise, (n, 3, rows, columns); of ways that the phase function may go, one for each instead of g."""
    behind = BehindLenses(scene)
    lit = behind.of_paths
    grid = CellGrid.of(lit)
    if max_order < lowest:
        zero = np.zeros((4 if scene.medium.phase is None else 3 + len(ways), *scene.camera.shape))
        return zero, zero[0], np.zeros((0, *zero[1:].shape))

    def followed(number: int) -> Array:
        found = traced_tangents(lit, grid, (seed, number), max_order, FAINTEST, lattice, lowest=lowest, others=ways)
        return grid.folded(found)

    with ThreadPoolExecutor(min(THREADS, batches)) as pool:
        layers = np.moveaxis(np.array(list(pool.map(followed, range(batches)))), 1, 0)
    plain = grid.shiftable or batches < FEWEST
    peaks = np.abs(layers).max(axis=(1, 2, 3), keepdims=True) + 1e-300
    smooth = layers if plain else peaks * np.array([smoothed_batches(one, steady=True) for one in layers / peaks])

    def to_pixels(images: Array) -> Array:
        return behind.seen(np.array([grid.to_pixels(grid.unfolded(one)) for one in images]))

    more = 1.0 if plain else 1.0 + LOST_USUALLY
    stderr = np.sqrt(grid.variance_to_pixels(more * averaged(smooth[0] / peaks[0], grid.seen).variance))
    most = FEW_GROUPS if math.prod(scene.camera.shape) > MANY_PIXELS else GROUPS
    scale = 1.0 if plain else math.sqrt(LEARNT)
    noise = [scale * to_pixels(apart) for apart in _apart(np.moveaxis(smooth[1:], 1, 0), most)]
    shape = (len(noise), len(layers) - 1, *scene.camera.shape)
    error = float(peaks[0, 0, 0, 0]) * behind.error_seen(stderr)
    return to_pixels(smooth.mean(axis=1)), error, np.array(noise).reshape(shape)


def _apart(batches: Array, most: int) -> list[Array]:
    """How groups of batches, at most so many, differ from the mean of all, as patterns of its noise."""
    groups = min(most, len(batches))
    if groups < 2:
        return []
    mean, scale = batches.mean(axis=0), math.sqrt(groups / (groups - 1.0)) / len(batches)
    return [scale * (part - mean).sum(axis=0) for part in np.array_split(batches, groups)]

"""`simulate` a scene with a number of photons, or with as many as a tolerance asks for."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.montecarlo.among_faces import IMAGES, KernelFaces, kernel_faces, trace_among_faces
from tankrig.montecarlo.first_order import first_order
from tankrig.montecarlo.kernel_scene import KernelScene, beam_table, kernel_scene, pixel_weights
from tankrig.montecarlo.tally import CLASSES
from tankrig.montecarlo.transport import trace
from tankrig.prediction import ORDER_CLASSES
from tankrig.scene import Scene
from tankrig.threads import THREADS

Image = NDArray[np.float64]
Batch = tuple[NDArray[np.float64], tuple[float, float]]

BATCHES = 64
"""Independent parts of a run, always as many, so that its result doesn't depend on the number of threads; their scatter
gives the standard error to 1/√(2 · 63) = 9 % per pixel."""
DIRECTLY = 4
"""Photons by way of faces for each that shows what is seen without: the latter are led to scatter, for less noise."""
PILOT_PHOTONS = 32_000
LOWEST_ORDERS = (1, 2, 3, 4, 21)
"""Of the classes of orders."""


@dataclass(frozen=True)
class Tally:
    """What a Monte Carlo run has counted.

    Parameters
    ----------
    orders
        Images by order of scattering (keys of `tankrig.prediction.ORDER_CLASSES`), (rows, columns), W/mm²/sr.
    stderr
        One-sigma standard error of `image`; order 1 is a quadrature and adds none.
    photons
        How many were followed.
    absorbed, escaped
        Fractions of the projector's light that the medium absorbed and that left the tank. They add up to 1, but for
        noise, unless orders were cut off.
    """

    orders: Mapping[int | str, Image]
    stderr: Image
    photons: int
    absorbed: float
    escaped: float

    @property
    def image(self) -> Image:
        """Radiance that leaves z = Lz towards the camera: the sum of all orders, W/mm²/sr."""
        return np.asarray(sum(self.orders.values()), np.float64)

    @property
    def noise(self) -> float:
        """Relative L2 of the noise: √Σ stderr² / √Σ image²; 0 where the image is dark."""
        scale = float(np.linalg.norm(self.image))
        return float(np.linalg.norm(self.stderr)) / scale if scale > 0.0 else 0.0


def simulate(
    scene: Scene,
    photons: int,
    seed: int = 0,
    max_order: int | None = None,
    threads: int = THREADS,
    coarsen: int = 1,
    min_order: int = 1,
) -> Tally:
    """Image of a scene by Monte Carlo, without bias, order 1 without noise.

    Parameters
    ----------
    scene
        Any scene.
    photons
        How many to follow; rounded up to a multiple of 64.
    seed
        The same seed gives the same image, whatever `threads` is.
    max_order
        Sum orders 1 … max_order only; None for all.
    threads
        Threads at work at the same time.
    coarsen
        Side, in pixels, of the blocks in which orders 2 and up are counted and between which they are interpolated:
        far fewer photons where the camera is finer than multiply scattered light is.
    min_order
        2: leave out what is sharp, for who has it from elsewhere: order 1, by way of clear faces too, and what a
        diffuse face shows of light that was not scattered before. Order 1 by way of such a face counts with order 2.

    Raises
    ------
    ValueError
        When a number is below 1, or `min_order` above 2.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> scene = Scene(
    ...     tank=Tank(),
    ...     medium=Medium(sigma_a=0.002, sigma_s=0.018, g=0.5),
    ...     projector=Projector("collimated", beams=(Beam((-2.0, 2.0), (58.0, 62.0)),)),
    ...     camera=Camera("orthographic", shape=(80, 120), pixel_mm=2.0),
    ... )
    >>> tally = simulate(scene, photons=10_000)
    >>> list(tally.orders), tally.noise < 0.05
    ([1, 2, 3, '4-20', '>20'], True)
    """
    if min_order not in (1, 2):
        raise ValueError(f"min_order = {min_order} is neither 1 nor 2; orders from 2 on are counted together")
    first = first_order(scene) if min_order == 1 else None
    return _simulated(scene, photons, seed, max_order, threads, coarsen, first)


def _simulated(
    scene: Scene, photons: int, seed: int, max_order: int | None, threads: int, coarsen: int, first: Image | None
) -> Tally:
    """The same with order 1 as it is given, which depends on no photon; None where it is left out."""
    highest = 2**62 if max_order is None else max_order
    if min(photons, highest, threads, coarsen) < 1:
        raise ValueError("photons, max_order, threads and coarsen are counts; give 1 or more of each")
    per_batch = math.ceil(photons / BATCHES)
    coarse = _coarser(scene, coarsen)
    images = CLASSES if scene.tank.faces.dark else IMAGES
    sums, squares, energy = np.zeros((images, *coarse.camera.shape)), np.zeros(coarse.camera.shape), np.zeros(2)
    if (highest > 1 or images == IMAGES) and sum(beam.power for beam in scene.projector.beams) > 0.0:
        symmetric = _mirror_symmetric(coarse)
        lit = _lit(coarse)
        with ThreadPoolExecutor(threads) as pool:
            for counts, fates in _in_order(pool, lambda batch: _batch(lit, per_batch, (seed, batch), highest), threads):
                if symmetric:
                    counts = 0.5 * (counts + counts[:, ::-1])
                if images == IMAGES and first is None:
                    counts[0] = 0.0
                sums += counts
                squares += counts.sum(axis=0) ** 2
                energy += fates
    means = sums / BATCHES
    variance = np.maximum(squares / BATCHES - means.sum(axis=0) ** 2, 0.0) / (BATCHES - 1)
    orders: dict[int | str, Image] = {} if first is None else {1: first}
    if images == IMAGES:  # the first two are counted with order 1
        if first is not None:
            orders[1] = first + _enlarged(means[0] + means[1], coarsen, scene)
        else:
            means[2] += means[1]
        means = means[2:]
    for name, lowest, mean in zip(ORDER_CLASSES[1:], LOWEST_ORDERS[1:], means, strict=True):
        if lowest <= highest:
            orders[name] = _enlarged(mean, coarsen, scene)
    stderr = _enlarged(np.sqrt(variance), coarsen, scene)
    absorbed, escaped = energy / BATCHES
    return Tally(orders, stderr, per_batch * BATCHES, float(absorbed), float(escaped))


def simulate_to(
    scene: Scene,
    tolerance: float,
    seed: int = 0,
    max_order: int | None = None,
    threads: int = THREADS,
    coarsen: int = 1,
    most_photons: int = 2_000_000_000,
) -> Tally:
    """`simulate` with as many photons as it takes for the relative L2 of the noise to be at most `tolerance`.

    Parameters
    ----------
    tolerance
        Of `Tally.noise`, > 0.
    most_photons
        Where to give up; the `noise` of what is returned says how far it got.
    scene, seed, max_order, threads, coarsen
        As for `simulate`.
    """
    if not tolerance > 0.0:
        raise ValueError(f"tolerance = {tolerance} is not positive; noise never vanishes")
    photons, first = PILOT_PHOTONS, first_order(scene)
    while True:
        tally = _simulated(scene, min(photons, most_photons), seed, max_order, threads, coarsen, first)
        if tally.noise <= tolerance or photons >= most_photons:
            return tally
        photons = math.ceil(photons * max(1.1 * (tally.noise / tolerance) ** 2, 1.5))


class _Lit(NamedTuple):
    """What all batches of a scene share: its flat numbers, its beams that carry light, and how large pixels are."""

    shape: tuple[int, int]
    scene: KernelScene
    beams: Image
    powers: Image
    weights: Image | float
    faces: KernelFaces | None
    """None where all are black."""


def _lit(scene: Scene) -> _Lit:
    beams = tuple(beam for beam in scene.projector.beams if beam.power > 0.0)
    lit = replace(scene, projector=replace(scene.projector, beams=beams))
    powers = np.cumsum([beam.power for beam in beams])
    faces = None if scene.tank.faces.dark else kernel_faces(scene.tank)
    return _Lit(scene.camera.shape, kernel_scene(lit), beam_table(lit), powers, pixel_weights(lit), faces)


def _batch(lit: _Lit, photons: int, seed: tuple[int, int], highest: int) -> Batch:
    """One independent part of a run: images by class of orders, and what became of the light."""
    numbers = np.random.default_rng(seed)
    key = np.uint64(numbers.integers(2**63))
    images = np.zeros((CLASSES, *lit.shape))
    share = photons if lit.faces is None else math.ceil(photons / DIRECTLY)
    fates = trace(lit.scene, lit.beams, lit.powers, share, highest, key, numbers.random(3), images)
    if lit.faces is not None:  # other photons, which chance leads more, show what comes by way of faces
        directly, images = images, np.zeros((IMAGES, *lit.shape))
        key = np.uint64(numbers.integers(2**63))
        fates = trace_among_faces(lit.scene, lit.faces, lit.beams, lit.powers, photons, highest, key, images)
        images[-CLASSES:] += directly
    images *= lit.weights
    return images, fates


def _in_order(pool: Executor, run: Callable[[int], Batch], threads: int) -> Iterator[Batch]:
    """All batches, by and by, so that few of them are in memory at a time however large the camera is."""
    for first in range(0, BATCHES, 2 * threads):
        yield from pool.map(run, range(first, min(first + 2 * threads, BATCHES)))


def _mirror_symmetric(scene: Scene) -> bool:
    """Whether y → −y changes nothing, so that each photon may be counted on both sides."""
    faces = scene.tank.faces
    if scene.camera.kind == "calibrated" or faces.left != faces.right:
        return False
    centred = all(
        device.kind in ("collimated", "orthographic")
        or (device.position_mm is not None and device.position_mm[1] == 0.0)
        for device in (scene.projector, scene.camera)
    )
    whole = scene.camera.shape[0] * scene.camera.pixel_mm == scene.tank.size_mm[1]
    beams = scene.projector.beams
    mirrored = (replace(beam, y_mm=(-beam.y_mm[1], -beam.y_mm[0])) for beam in beams)
    return centred and whole and Counter(mirrored) == Counter(beams)


def _coarser(scene: Scene, factor: int) -> Scene:
    rows, columns = scene.camera.shape
    shape = (math.ceil(rows / factor), math.ceil(columns / factor))
    return replace(scene, camera=replace(scene.camera.binned(factor), shape=shape))


def _enlarged(image: Image, factor: int, scene: Scene) -> Image:
    """Back to the camera's pixels, which share the light of each coarse one as its neighbours suggest.

    Running sums are interpolated rather than values, so that no light is lost or made, not even at the tank's walls.
    """
    if factor == 1:
        return image
    from scipy.interpolate import PchipInterpolator

    for axis in (0, 1):
        count = image.shape[axis]
        zero = np.zeros_like(image.take([0], axis))
        sums = np.concatenate([zero, np.cumsum(image, axis)], axis)
        edges = np.linspace(0.0, count, count * factor + 1)
        image = factor * np.diff(PchipInterpolator(np.arange(count + 1.0), sums, axis)(edges), axis=axis)
    rows, columns = scene.camera.shape
    return image[:rows, :columns]

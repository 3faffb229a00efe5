"""Orders 1 and 2 of a pattern for all liquids that a tank of glass may hold, before there is any ink.

Behind clear walls what these orders cost is mostly what no liquid changes: of twelve media, which a dose's model wants,
they take 16 (three beams) and 35 CPU seconds (stripes), of which finding where lines of sight meet beams takes 10 and
22. Polynomials over a wide box, of 56 media, are off by .03 to .1 % of the image at any other medium, so that the
models of all doses read these orders there, and nobody waits for them once there is ink (decision 211). Between dark
walls a dose's own take a few seconds.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.box import Box, Coordinates
from tankrig.light.prepared.cache import Place, regardless
from tankrig.light.prepared.plan import SPREAD, TOGETHER, Sample
from tankrig.light.prepared.polynomials import Plane, nodes
from tankrig.light.prepared.sampling import first_images, second_images
from tankrig.light.prepared.term import Term
from tankrig.light.rays import shift_invariant
from tankrig.scene import Scene
from tankrig.threads import THREADS, one_blas_thread

Array = NDArray[np.float64]

LIQUIDS = Box((5e-5, 0.06), (0.5, 0.9999), (0.0, 0.95))
"""Media that these orders are prepared for."""
TOLERANCE = 0.01
"""The finest tolerance of models that read these orders; order 2 is computed to half of it."""
RATE = (3.4, 3.4)
"""Degree of the polynomials per unit of the stretched σt and g: 6 and 7 in a tank of 240 mm. Of 56 media they are off
by .03 to .1 % at seven others in a tank of glass, 8 and 8 of 81 media by .002 to .02 %."""
CHECKS = 4
"""Media beside the grid, where that error is seen."""
FIRST_COST = 24.0
"""Time that order 1 of all takes, in orders 2 of one medium."""
DARK = 1e-300


@dataclass(frozen=True, eq=False)
class LowOrders:
    """These orders of a scene's pattern at ϖ = 1, as polynomials of the medium.

    Parameters
    ----------
    coordinates
        Of `LIQUIDS`.
    terms
        Orders 1 and 2, whose patterns are pixels.
    off
        (n, pixels) what both together were off by at media beside the grid, over their norm there.
    """

    coordinates: Coordinates
    terms: tuple[Term, Term]
    off: NDArray[np.float32]

    @classmethod
    def kept_for(cls, scene: Scene, box: Box, tolerance: float) -> "LowOrders | None":
        """What the cache keeps for a scene, where it serves a model of a box and a tolerance; else None."""
        return _Work(scene).kept() if tolerance >= TOLERANCE and _serve(scene, box) else None

    def images(self, liquids: Sequence[tuple[float, float]]) -> Array:
        """(liquids, 2, pixels) of liquids of some σt and g, W/mm²/sr, as `exact_images` has them."""
        found = []
        for sigma_t, g in liquids:
            at = (*self.coordinates.of(sigma_t, LIQUIDS.albedo[0], g), sigma_t, 1.0)
            found.append([term.at(*at)[0] for term in self.terms])
        return np.array(found)


def are_dear(scene: Scene) -> bool:
    """Whether a scene's orders 1 and 2 are worth preparing for all liquids: light comes back from clear walls."""
    return not shift_invariant(scene) and any(scene.tank.faces.clear)


def prepare_low_orders(
    scene: Scene, box: Box, progress: Callable[[float], object] = lambda _: None, threads: int = THREADS
) -> bool:
    """Have the cache keep a scene's orders 1 and 2, where models of a box read them there; elsewhere do nothing.

    What an interrupted call has done is not done again.

    Returns
    -------
    bool
        Whether there was anything to do.

    Raises
    ------
    CacheError
        When there is no room for them.
    """
    if not _serve(scene, box):
        return False
    work = _Work(scene)
    if work.place.model.exists() and work.kept() is not None:
        return False
    work.do(progress, threads)
    return True


def interpolated(samples: Sequence[Sample], plane: Plane, images: Array, order: int) -> Term:
    """One order at ϖ = 1 of the media of a grid, (media, pixels), by polynomials; its patterns are still pixels."""
    products = plane.values(*np.array([sample.place for sample in samples]).T)
    norm = np.linalg.norm(images, axis=1)
    scale = np.linalg.solve(
        products, np.log(np.maximum(norm / np.array([sample.sigma_t**order for sample in samples]), DARK))
    )
    fields = np.linalg.solve(products, images / np.maximum(norm, DARK)[:, None])
    return Term(order, plane, plane, fields[None], scale[None])


def _serve(scene: Scene, box: Box) -> bool:
    """Whether models of a box read a scene's orders here; any albedo will do, for light goes with its powers."""
    inside = ((box.sigma_t, LIQUIDS.sigma_t), (box.g, LIQUIDS.g))
    return are_dear(scene) and all(lowest <= low and high <= highest for (low, high), (lowest, highest) in inside)


class _Work:
    """The images that polynomials are made from, a file for each while they are being made."""

    def __init__(self, scene: Scene) -> None:
        self._scene = regardless(scene)
        self._coordinates = Coordinates(LIQUIDS, scene.tank.size_mm[0])
        spans = self._coordinates.spans
        self._plane = Plane((math.ceil(RATE[0] * spans[0]), math.ceil(RATE[1] * spans[2])))
        self._pixels = math.prod(scene.camera.shape)
        self.place = Place.of("orders 1 and 2", self._scene, LIQUIDS, TOLERANCE)

    @cached_property
    def _grid(self) -> list[Sample]:
        first, second = self._plane.degrees
        return [
            self._sample(n, place)
            for n, place in enumerate((u, v) for u in nodes(first + 1) for v in nodes(second + 1))
        ]

    @cached_property
    def _samples(self) -> list[Sample]:
        """The grid, and the media beside it."""
        even = 2.0 * ((np.arange(1, CHECKS + 1)[:, None] * SPREAD) % 1.0) - 1.0
        count = len(self._grid)
        return self._grid + [self._sample(count + n, (float(u), float(v))) for n, (u, v) in enumerate(even)]

    def _sample(self, index: int, place: tuple[float, float]) -> Sample:
        sigma_t, _, g = self._coordinates.back([place[0], 0.0, place[1]])
        return Sample(index, float(sigma_t), float(g), place)

    def kept(self) -> LowOrders | None:
        """What the cache keeps; None where there is nothing, or it is something else."""
        arrays = self.place.kept(self.place.model) or {}
        shapes = {
            "fields": (2, self._plane.size, self._pixels),
            "scale": (2, self._plane.size),
            "off": (CHECKS, self._pixels),
        }
        if any(name not in arrays or arrays[name].shape != shape for name, shape in shapes.items()):
            return None
        if not all(arrays[name].dtype.kind == "f" and np.isfinite(arrays[name]).all() for name in shapes):
            return None
        fields, scale = (np.asarray(arrays[name], float) for name in ("fields", "scale"))
        first, second = (
            Term(order, self._plane, self._plane, fields[None, order - 1], scale[None, order - 1]) for order in (1, 2)
        )
        return LowOrders(self._coordinates, (first, second), np.asarray(arrays["off"], np.float32))

    def do(self, progress: Callable[[float], object], threads: int) -> None:
        """Compute them, or read what is there of them, and keep the polynomials."""
        self.place.require_room(16 * self._pixels * len(self._samples))
        by_g = sorted(self._samples, key=lambda one: (one.g, one.index))  # the steepest says how fine tables are
        parts = [by_g[first : first + TOGETHER] for first in range(0, len(by_g), TOGETHER)]
        jobs = [(partial(self._first, self._samples), 1, self._samples, FIRST_COST)]
        jobs += [(partial(self._second, number, part), 2, part, float(len(part))) for number, part in enumerate(parts)]
        images, total, done = np.zeros((len(self._samples), 2, self._pixels)), sum(job[3] for job in jobs), 0.0
        pool = ThreadPoolExecutor(threads)
        try:
            running = {pool.submit(job[0]): job[1:] for job in jobs}
            for future in as_completed(running):
                order, samples, cost = running[future]
                images[[one.index for one in samples], order - 1] = future.result()
                done += cost
                progress(0.99 * done / total)
        finally:
            pool.shutdown(cancel_futures=True)
        with one_blas_thread():
            found = self._assembled(images)
        fields, scale = (
            np.concatenate([getattr(term, name) for term in found.terms]) for name in ("amplitudes", "scale")
        )
        self.place.keep(self.place.model, {"fields": fields.astype(np.float32), "scale": scale, "off": found.off})
        self.place.clear_parts()
        progress(1.0)

    def _assembled(self, images: Array) -> LowOrders:
        grid, beside = np.split(images, [len(self._grid)])
        first, second = (interpolated(self._grid, self._plane, grid[:, order - 1], order) for order in (1, 2))
        found = LowOrders(self._coordinates, (first, second), np.zeros((0, self._pixels), np.float32))
        truth = beside.sum(axis=1)
        off = found.images([(one.sigma_t, one.g) for one in self._samples[len(self._grid) :]]).sum(axis=1) - truth
        return replace(found, off=(off / np.maximum(np.linalg.norm(truth, axis=1), DARK)[:, None]).astype(np.float32))

    def _first(self, samples: Sequence[Sample]) -> Array:
        shape = (len(samples), self._pixels)
        return self.place.part("first", shape, lambda: first_images(self._scene, _liquids(samples)))

    def _second(self, number: int, samples: Sequence[Sample]) -> Array:
        shape = (len(samples), self._pixels)
        return self.place.part(
            f"second{number}", shape, lambda: second_images(self._scene, _liquids(samples), TOLERANCE)
        )


def _liquids(samples: Sequence[Sample]) -> list[tuple[float, float]]:
    return [(one.sigma_t, one.g) for one in samples]

"""Preparing a model: compute what its plan asks for, keep every image as it comes, and put them together."""

import math
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.light.prepared.answer import Answer
from tankrig.light.prepared.assembly import Images, assemble
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.cache import Place, regardless
from tankrig.light.prepared.entrance import MOVED, Entrance
from tankrig.light.prepared.low_orders import LowOrders
from tankrig.light.prepared.packing import packed, unpacked
from tankrig.light.prepared.plan import PreparationPlan, Sample
from tankrig.light.prepared.sampling import PathImages, exact_images
from tankrig.light.rays import shift_invariant
from tankrig.scene import Medium, Scene
from tankrig.threads import THREADS, one_blas_thread

Array = NDArray[np.float64]
Progress = Callable[[float], object]
"""Told the share of the work that is done, 0 … 1."""

MOST_PIXELS = 40_000
"""Beyond, the images of all media would take more than a GiB."""
EXACT_COST = 0.7
"""Time that orders 1 and 2 take at one medium, in batches of paths."""


def place_of(scene: Scene, box: Box, tolerance: float) -> Place:
    """Where the cache keeps a model, whether it is there or not."""
    return Place.of(regardless(scene), box, float(tolerance))


def prepared(
    scene: Scene, box: Box, tolerance: float, progress: Progress, threads: int = THREADS, first: bool = False
) -> tuple[Answer, Path | None]:
    """The model of a scene's geometry and pattern, from the cache or made now, and the file that keeps it.

    A first model, by a share of its light paths, has no such file: the whole one goes on with these paths. Where that
    saves little it is the whole one.

    Raises
    ------
    SceneError
        When the camera has more pixels than can be prepared.
    CacheError
        When there is no room for it.

    Warns
    -----
    UserWarning
        When paths are followed although a bench was learned: what that has otherwise.
    """
    scene = regardless(scene)
    rows, columns = scene.camera.shape
    if rows * columns > MOST_PIXELS:
        raise SceneError(
            f"a camera of {rows} × {columns} pixels has more than the {MOST_PIXELS} that can be prepared; "
            "bin them: give camera.bin, the pixels along the side of a bin"
        )
    place = place_of(scene, box, tolerance)
    plan = PreparationPlan(box, scene.tank.size_mm[0], tolerance, not shift_invariant(scene))
    sampling = PathImages(scene, plan.albedos)
    known = _kept_answer(place, plan, scene.camera.shape, math.prod(sampling.shape[1:]))
    if known is not None:
        progress(1.0)
        return known, place.model
    entrance = Entrance.known_to(scene, box, tolerance)
    first = first and plan.slanted and entrance is None
    plan = replace(plan, first=first)
    work = _Work(sampling, plan, place, entrance, LowOrders.kept_for(scene, box, tolerance))
    place.require_room(work.size)
    unlike = Entrance.unlike(scene, box, tolerance)
    if unlike:
        warnings.warn(unlike, stacklevel=3)
    with one_blas_thread():
        answer = assemble(plan, sampling, work.images(progress, threads), scene.camera.shape)
    if not first:
        place.keep(place.model, packed(answer))
        place.clear_parts()
    progress(1.0)
    return answer, None if first else place.model


def _kept_answer(place: Place, plan: PreparationPlan, shape: tuple[int, int], cells: int) -> Answer | None:
    """The model that the cache keeps; None where there is none, or what is there is none."""
    arrays = place.kept(place.model)
    if arrays is None:
        return None
    try:
        return unpacked(arrays, plan.coordinates, shape, cells)
    except (KeyError, TypeError, ValueError):
        return None


@dataclass(frozen=True)
class _Job:
    """One file of the preparation: orders 1 and 2 of some media, or light paths of one, of lattices of some numbers."""

    samples: tuple[Sample, ...]
    cost: float
    lattices: range = range(0)

    @property
    def name(self) -> str:
        """Of the file."""
        first = self.samples[0].index
        return f"paths{first}from{self.lattices.start}" if self.lattices else f"exact{first}"


class _Work:
    """The images that a plan asks for: those that an interrupted preparation has left are not made again."""

    def __init__(
        self,
        sampling: PathImages,
        plan: PreparationPlan,
        place: Place,
        entrance: Entrance | None,
        low: LowOrders | None,
    ) -> None:
        self._sampling, self._plan, self._place, self._entrance, self._low = sampling, plan, place, entrance, low
        self._pixels = math.prod(sampling.scene.camera.shape)
        # What takes longest comes first, so that no core is left with it at the end.
        self._jobs = sorted(
            [_Job(part, (EXACT_COST if low is None else 0.0) * len(part)) for part in plan.together]
            + [
                _Job((sample,), len(lattices), lattices)
                for sample in (() if entrance else plan.paths)
                for lattices in plan.lattices(sample)
            ],
            key=lambda job: -job.cost,
        )

    @property
    def size(self) -> int:
        """Bytes that the images take."""
        return 8 * (
            2 * self._pixels * (len(self._plan.exact) + len(self._plan.checks))
            + int(np.prod(self._sampling.shape)) * len(self._plan.paths) // 2
        )

    def images(self, progress: Progress, threads: int) -> Images:
        """Compute, or read, all."""
        total, done = sum(job.cost for job in self._jobs), 0.0
        exact: dict[int, Array] = {}
        paths = np.zeros((len(self._plan.paths), *self._sampling.shape))
        pool = ThreadPoolExecutor(threads)
        try:
            running = {pool.submit(self._images, job): job for job in self._jobs}
            for future in as_completed(running):
                job, images = running[future], future.result()
                if job.lattices:
                    (one,) = job.samples
                    paths[one.index] += len(job.lattices) / one.batches * images[0]
                else:
                    exact |= {one.index: image for one, image in zip(job.samples, images, strict=True)}
                done += job.cost
                progress(0.97 * done / total)
        finally:
            pool.shutdown(cancel_futures=True)
        if self._entrance is not None:
            for index, image in self._entrance.images(self._sampling, self._plan.paths):
                paths[index] = image
        share = MOVED if self._entrance is not None else 0.0
        grid, checks = np.split(np.array([exact[index] for index in sorted(exact)]), [len(self._plan.exact)])
        return Images(grid, checks, paths, share, None if self._low is None else self._low.off)

    def _images(self, job: _Job) -> Array:
        """Of each of a job's media."""
        if job.lattices:
            (one,) = job.samples
            of_one = (1, *self._sampling.shape)
            return self._place.part(job.name, of_one, lambda: self._followed(one, job.lattices)[None])
        liquids = [(one.sigma_t, one.g) for one in job.samples]
        if self._low is not None:
            return self._low.images(liquids)
        shape = (len(job.samples), 2, self._pixels)
        return self._place.part(job.name, shape, lambda: self._exact(job.samples, liquids))

    def _followed(self, one: Sample, lattices: range) -> NDArray[np.float32]:
        return self._sampling.sample(Medium(0.0, one.sigma_t, one.g), one.index, lattices).astype(np.float32)

    def _exact(self, samples: tuple[Sample, ...], liquids: list[tuple[float, float]]) -> Array:
        tables = self._entrance.tables(samples) if self._entrance is not None else []
        return exact_images(self._sampling.scene, liquids, self._plan.tolerance, tables)

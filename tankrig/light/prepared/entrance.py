"""What light that enters a bench at one height becomes, learned once: any pattern there, without paths or tables.

Light paths are followed from strips of the wall in each medium of a plan, and kept; the image of a pattern is put
together from theirs (`tankrig.light.prepared.strips`).

What a pattern has beside the band, as halo and black level, is followed by paths of its own: it is little.

Order 2 is put together from tables that reach from side wall to side wall, for all beams of the band (`light.double`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.light.double import Tabulated, numbers_of_wall, tables_of_wall
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.cache import Place
from tankrig.light.prepared.plan import PreparationPlan, Sample
from tankrig.light.prepared.sampling import PathImages, order_2_tolerance
from tankrig.light.prepared.strips import APART_MM, LAYERS, STRIP_MM, Strips, put_together
from tankrig.light.prepared.unlike import Conditions, why_not_learned
from tankrig.light.prepared.wall_tables import packed_tables, unpacked_tables
from tankrig.light.rays import geometry_of, shift_invariant
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.description import Interval
from tankrig.threads import THREADS

Array = NDArray[np.float64]
Single = NDArray[np.float32]

MOVED = 0.004
"""Share of the light of orders ≥ 3 that images put together may be off by; counted as an error of every image."""
PATHS = 3.0
"""Times as many paths, in all strips together, as one pattern's model takes."""
MOST_BANDS, HIGHEST_BAND_MM = 3, 16.0
"""Heights that are learned at once, and how high a band may be."""
AT_ONCE = 8
"""Media that are put together at once."""
TABLES_COST = 9.0
"""Time that tables of order 2 take at one medium, in lattices that one pattern's model takes of paths."""
ROOM_MM = 1.5
"""That a band has beyond the beams that it is learned for: others of the same height lie a little beside them."""


@dataclass(frozen=True)
class Entrance:
    """Strips of the wall that light enters by, and what they are learned for.

    Parameters
    ----------
    scene
        Gives tank, projector and camera; its beams do not matter.
    band
        z of the wall, low and high, mm.
    box, tolerance
        Of the models that shall be made from it.
    """

    scene: Scene
    band: Interval
    box: Box
    tolerance: float

    @classmethod
    def known_to(cls, scene: Scene, box: Box, tolerance: float) -> "Entrance | None":
        """The one that was learned for the bench of a scene and holds most of its light; None where there is none."""
        if not can_be_learned(scene):
            return None
        lit = PathImages(scene, ()).lit
        of_all = _place(lit, box, tolerance)
        found: list[tuple[float, Entrance]] = []
        for file in sorted(of_all.folder.glob(f"{of_all.name}_*_*.npz")):
            try:
                low, high = (float(one) for one in file.stem.split("_")[1:])
            except ValueError:
                continue
            one = cls(lit, (low, high), box, tolerance)
            if one.is_there:
                found.append((sum(beam.power for beam in lit.projector.beams if one.holds(beam)), one))
        share, best = max(found, key=lambda each: each[0], default=(0.0, None))
        return best if share > 0.0 else None

    @staticmethod
    def unlike(scene: Scene, box: Box, tolerance: float) -> str:
        """One sentence on what the nearest learned bench has otherwise; empty where none was, or a scene needs none."""
        if not can_be_learned(scene) or Entrance.known_to(scene, box, tolerance) is not None:
            return ""
        return why_not_learned(PathImages(scene, ()).lit, box, tolerance)

    @property
    def place(self) -> Place:
        """Where the cache keeps it."""
        of_all = _place(self.scene, self.box, self.tolerance)
        return replace(of_all, name=f"{of_all.name}_{self.band[0]:g}_{self.band[1]:g}")

    @property
    def is_there(self) -> bool:
        """Whether all of it has been learned."""
        return self.place.kept(self.place.model) is not None

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        numbers = math.prod(PathImages(self.scene, self.plan.albedos).shape)
        tables = sum(numbers_of_wall(*self._wanted(samples)) for samples in self.plan.together)
        return 2 * len(self.strips.scenes) * len(self.plan.paths) * numbers + 4 * tables

    @cached_property
    def plan(self) -> PreparationPlan:
        """Plan of the models that shall be made from it."""
        return PreparationPlan(self.box, self.scene.tank.size_mm[0], self.tolerance, True)

    @cached_property
    def strips(self) -> Strips:
        """The strips of the wall."""
        return Strips(self.scene, self.band)

    def batches(self, sample: Sample) -> int:
        """Lattices of paths for each strip."""
        return max(1, round(PATHS * sample.batches / len(self.strips.scenes)))

    def holds(self, beam: Beam) -> bool:
        """Whether a beam enters by the band."""
        return self.band[0] - 1e-6 <= beam.z_mm[0] and beam.z_mm[1] <= self.band[1] + 1e-6

    def images(self, sampling: PathImages, samples: Sequence[Sample]) -> Iterator[tuple[int, Array]]:
        """What `PathImages.sample` gives of a pattern at media that were learned, each with its number.

        Parameters
        ----------
        sampling
            Of the pattern's scene.
        samples
            The plan's media, with the lattices that the pattern alone would take.
        """
        beams = sampling.lit.projector.beams
        used, weights = self.strips.weights([beam for beam in beams if self.holds(beam)])
        beside = tuple(beam for beam in beams if not self.holds(beam) and beam.power > 0.0)
        share = sum(beam.power for beam in beside) / sum(beam.power for beam in beams)
        lit = sampling.lit
        rest = replace(sampling, scene=replace(lit, projector=replace(lit.projector, beams=beside))) if beside else None
        for first in range(0, len(samples), AT_ONCE):
            some = samples[first : first + AT_ONCE]
            found = put_together(weights, [self._learned(one, used) for one in some], sampling.along)
            for sample, image in zip(some, found, strict=True):
                medium = Medium(0.0, sample.sigma_t, sample.g)
                image = image + sampling.twice_smooth(medium, sample.index, range(sample.batches))
                if rest is not None:
                    image = image + rest.sample(medium, sample.index, range(max(1, round(share * sample.batches))))
                yield sample.index, np.asarray(image, float)

    def learn_one(self, sample: Sample) -> None:
        """Follow the paths of all strips in one medium, where that has not been done."""
        if self._kept(sample) is not None:
            return
        medium, batches = Medium(0.0, sample.sigma_t, sample.g), self.batches(sample)
        images = [
            PathImages(one, self.plan.albedos).sample(medium, sample.index, range(batches))
            for one in self.strips.scenes
        ]
        # Half precision does for a few per cent of noise, once the largest number is 1.
        size = np.max(np.abs(images), axis=(2, 3)) + 1e-300
        small = (np.array(images) / size[:, :, None, None]).astype(np.float16)
        self.place.keep(self._file(sample), {"images": small, "size": size})

    def learn_tables(self, samples: tuple[Sample, ...]) -> None:
        """Tabulate order 2 of all light in the band for media that are together, where that has not been done."""
        if not self.tables(samples):
            self.place.keep(self._tables(samples), packed_tables(tables_of_wall(*self._wanted(samples))))

    def tables(self, samples: tuple[Sample, ...]) -> list[Tabulated]:
        """What was tabulated for media that the plan has together; nothing where that is not there."""
        kept = self.place.kept(self._tables(samples))
        try:
            return [] if kept is None else unpacked_tables(kept, len(samples))
        except (KeyError, TypeError, ValueError):
            return []

    def _tables(self, samples: tuple[Sample, ...]) -> Path:
        return self.place.parts / f"tables{self.plan.together.index(samples)}.npz"

    def _wanted(self, samples: tuple[Sample, ...]) -> tuple[Scene, Interval, list[Medium], float]:
        """What `tables_of_wall` is asked for."""
        media = [Medium(0.0, one.sigma_t, one.g) for one in samples]
        return self.scene, self.band, media, order_2_tolerance(self.scene, self.tolerance)

    def _learned(self, sample: Sample, used: NDArray[np.int64]) -> Single:
        """(used strips, albedos, rows, degrees)."""
        kept = self._kept(sample)
        if kept is None:
            self.learn_one(sample)
            kept = self._kept(sample)
        assert kept is not None
        images, size = kept
        return np.asarray(images[used].astype(np.float32) * size[used].astype(np.float32)[:, :, None, None])

    def _kept(self, sample: Sample) -> tuple[NDArray[np.generic], NDArray[np.generic]] | None:
        kept = self.place.kept(self._file(sample)) or {}
        images, size = kept.get("images"), kept.get("size")
        shape = (len(self.strips.scenes), *PathImages(self.scene, self.plan.albedos).shape)
        if images is None or size is None or images.shape != shape or size.shape != shape[:2]:
            return None
        return images, size

    def _file(self, sample: Sample) -> Path:
        return self.place.parts / f"paths{sample.index}.npz"


def learn(
    scene: Scene, box: Box, tolerance: float, progress: Callable[[float], object], threads: int = THREADS
) -> list[Entrance]:
    """Learn what light becomes that enters a bench at the heights of a scene's beams, where that is not known yet.

    Every medium is kept as it comes, so that what was interrupted goes on where it was.

    Raises
    ------
    SceneError
        When light and sight run straight or walls send light back, or the beams have no few heights.
    CacheError
        When there is no room for it.
    """
    if not can_be_learned(scene):
        raise SceneError(
            "light that runs straight under a camera above, or that walls send back, is not learned; "
            "prepare the pattern by itself"
        )
    lit = PathImages(scene, ()).lit
    entrances = [Entrance(lit, band, box, tolerance) for band in bands(scene)]
    for one in entrances:
        one.place.require_room(one.size)
    jobs: list[tuple[Callable[[], None], float]] = []
    for one in (each for each in entrances if not each.is_there):
        jobs += [(partial(one.learn_tables, part), TABLES_COST * len(part)) for part in one.plan.together]
        jobs += [(partial(one.learn_one, sample), sample.batches) for sample in one.plan.paths]
    total, done = sum(cost for _, cost in jobs), 0.0
    pool = ThreadPoolExecutor(threads)
    try:
        running = {pool.submit(job): cost for job, cost in jobs}
        for future in as_completed(running):
            future.result()
            done += running[future]
            progress(done / total)
    finally:
        pool.shutdown(cancel_futures=True)
    for one in entrances:
        one.place.keep(one.place.model, Conditions.of(lit, box, tolerance, one.band).arrays)
    progress(1.0)
    return entrances


def bands(scene: Scene) -> list[Interval]:
    """The heights of a scene's beams, each with a little room.

    Raises
    ------
    SceneError
        When there are more than can be learned, or one is too high for its image to be linear in the height.
    """
    found: list[Interval] = []
    for low, high in sorted(beam.z_mm for beam in scene.projector.beams if beam.power > 0.0):
        low, high = math.floor(low - ROOM_MM), math.ceil(high + ROOM_MM)
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], high)
        else:
            found.append((low, high))
    highest = scene.tank.size_mm[2]
    found = [(max(low, 0.0), min(high, highest)) for low, high in found]
    if not found or len(found) > MOST_BANDS or max(high - low for low, high in found) > HIGHEST_BAND_MM:
        raise SceneError(
            f"light is learned that enters at one to {MOST_BANDS} heights, each within {HIGHEST_BAND_MM:g} mm; "
            "give the scene's beams, or the sequence's patterns, such z_mm"
        )
    return found


def can_be_learned(scene: Scene) -> bool:
    """Whether light or sight slant and walls are dark: elsewhere a path stands for all starts, or comes back."""
    return not shift_invariant(scene) and scene.tank.faces.dark


def _place(lit: Scene, box: Box, tolerance: float) -> Place:
    """Place of all bands of a bench: the same for all its patterns, and however its camera's pixels lie."""
    grid = PathImages(lit, ()).grid
    numbers = tuple(geometry_of(lit)), (grid.rows, grid.columns, grid.cell_mm)
    return Place.of("entrance", numbers, (STRIP_MM, APART_MM, LAYERS), box, float(tolerance))

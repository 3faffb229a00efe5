"""Preparing a model of any phase function: what its plan asks for, computed or read, and put together."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.light.double import double_scattering
from tankrig.light.entering import is_plain
from tankrig.light.leaving import CameraLens
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.cache import Place, regardless
from tankrig.light.prepared.phases.answer import PhaseAnswer
from tankrig.light.prepared.phases.assembly import PhaseImages, assemble
from tankrig.light.prepared.phases.low import low_orders_at
from tankrig.light.prepared.phases.packing import packed, unpacked
from tankrig.light.prepared.phases.plan import PhasePlan, PhaseSample
from tankrig.light.prepared.sampling import PathImages, order_2_tolerance
from tankrig.light.rays import shift_invariant
from tankrig.light.single import single_scattering
from tankrig.scene import Medium, Scene
from tankrig.threads import THREADS

Array = NDArray[np.float64]
Progress = Callable[[float], object]


def place_of(scene: Scene, box: Box, tolerance: float) -> Place:
    """Where the cache keeps a model, whether it is there or not."""
    return Place.of("any phase function", regardless(scene), box, float(tolerance))


def can_be_prepared(scene: Scene) -> bool:
    """Whether there are models of any phase function: light and sight run straight, sharp, between dark walls."""
    return (
        shift_invariant(scene) and is_plain(scene) and CameraLens.of(scene) is None and scene.tank.faces.dark
    )  # fmt: skip


def prepared_for_phases(
    scene: Scene, box: Box, tolerance: float, progress: Progress, threads: int = THREADS
) -> tuple[PhaseAnswer, Path]:
    """The model of a scene's geometry and pattern, from the cache or made now, and the file that keeps it.

    Raises
    ------
    SceneError
        When light or sight slant, or lenses and walls are not ideal.
    CacheError
        When there is no room for it.
    """
    if not can_be_prepared(scene):
        raise SceneError(
            "models of any phase function are prepared for collimated, sharp light, an orthographic camera and dark "
            'walls only; fit this scene by light paths (model = "tank"), or with phase = "hg"'
        )
    scene = regardless(scene)
    place, plan = place_of(scene, box, tolerance), PhasePlan(box, scene.tank.size_mm[0], tolerance)
    known = place.kept(place.model)
    if known is not None:
        try:
            answer = unpacked(known, plan, scene.camera.shape)
        except (KeyError, TypeError, ValueError):
            known = None
        else:
            progress(1.0)
            return answer, place.model
    sampling = PathImages(scene, plan.base.albedos)
    pixels = scene.camera.shape[0] * scene.camera.shape[1]
    place.require_room(16 * int(np.prod(sampling.shape)) * len(plan.paths) // 2 + 64 * 4 * pixels)
    images = training_images(scene, plan, place, sampling, progress, threads)
    answer = assemble(plan, sampling, images, scene.camera.shape)
    place.keep(place.model, packed(answer))
    place.clear_parts()
    progress(1.0)
    return answer, place.model


def training_images(
    scene: Scene, plan: PhasePlan, place: Place, sampling: PathImages, progress: Progress, threads: int
) -> PhaseImages:
    """Compute all, or read what an interrupted preparation has left of the paths' images."""
    tolerance = order_2_tolerance(scene, plan.tolerance)
    progress(0.0)
    low = [low_orders_at(scene, plan, sigma_t) for _, sigma_t in plan.low_sigma_t]
    checks = []
    for check in plan.checks:
        seen = replace(scene, medium=Medium(0.0, check.sigma_t, phase=check.phase))
        first, second = single_scattering(seen), double_scattering(seen, tolerance)
        checks.append(np.stack([first.ravel() / check.sigma_t, second.ravel() / check.sigma_t**2]))
    total, done = sum(sample.batches for sample in plan.paths), 0
    found: dict[int, NDArray[np.floating]] = {}
    pool = ThreadPoolExecutor(threads)
    try:
        running = {pool.submit(_paths_of, sample, place, sampling): sample for sample in plan.paths}
        for future in as_completed(running):
            sample = running[future]
            found[sample.index] = future.result()
            done += sample.batches
            progress(0.95 * done / total)
    finally:
        pool.shutdown(cancel_futures=True)
    paths = np.array([found[sample.index] for sample in plan.paths], float)
    return PhaseImages(low, np.array(checks), np.ascontiguousarray(paths.swapaxes(0, 1)))


def _paths_of(sample: PhaseSample, place: Place, sampling: PathImages) -> NDArray[np.floating]:
    """(2, albedos, rows, degrees) of a medium, by different paths."""
    medium = Medium(0.0, sample.sigma_t, phase=sample.phase)

    def followed() -> NDArray[np.float32]:
        halves = [sampling.sample(medium, 2 * sample.index + half, range(sample.batches)) for half in range(2)]
        return np.array(halves, np.float32)

    return place.part(f"paths{sample.index}", (2, *sampling.shape), followed)

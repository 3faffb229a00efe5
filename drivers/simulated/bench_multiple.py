"""Light scattered more than once on a simulated bench: by Monte Carlo in blocks of camera pixels, brought back to them."""

import math

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import distance_transform_edt

from tankrig.montecarlo import simulate
from tankrig.pattern import Pattern
from tankrig.scene.description import Medium

from .bench_ink import true_scene
from .bench_single import looks_in
from .bench_truth import Array, TrueBench

_BLOCK_MM = 1.25
_JUDGED_MM = 4.0
_PILOTS, _PILOT_PHOTONS = 4, 16_000
_MOST_PHOTONS = 3_000_000


def scattered_more(
    bench: TrueBench, pattern: Pattern, medium: Medium, once: Array, tolerance: float, seed: int
) -> tuple[Array, Array]:
    """Radiance of orders 2 and up at the camera's pixels, and its standard error; before the lens's blur."""
    pixel_mm = true_scene(bench, pattern, medium).camera.pixel_mm
    side = max(1, round(_BLOCK_MM / pixel_mm))
    judged = max(1, round(_JUDGED_MM / pixel_mm / side))
    scene = true_scene(bench, pattern, medium, side)
    pilots = [simulate(scene, _PILOT_PHOTONS, (seed + k) % 2**48, min_order=2) for k in range(_PILOTS)]
    images = np.array([pilot.image for pilot in pilots])
    binned = np.array([_binned(image, judged) for image in images])
    noise = float(np.linalg.norm(binned.std(axis=0, ddof=1))) / math.sqrt(_PILOTS)
    light = float(np.linalg.norm(binned.mean(axis=0) + _binned(_binned(once, side), judged)))
    image, stderr, done = images.mean(axis=0), images.std(axis=0, ddof=1) / 2.0, _PILOTS * _PILOT_PHOTONS
    wanted = min(math.ceil(done * (noise / (tolerance * light)) ** 2), _MOST_PHOTONS)
    if wanted > done:
        more = simulate(scene, wanted - done, (seed + _PILOTS) % 2**48, min_order=2)
        image = (done * image + more.photons * more.image) / (done + more.photons)
        stderr = more.stderr * math.sqrt(more.photons / (done + more.photons))
    return _at_pixels(image, side, bench), _at_pixels(stderr, side, bench)


def _at_pixels(blocks: Array, side: int, bench: TrueBench) -> Array:
    """At the camera's pixels, of blocks that may look beside the tank in part; running sums are interpolated."""
    inside = looks_in(bench)
    rows, columns = inside.shape
    share = _binned(inside, side)
    blocks = np.where(share > 0.25, blocks / np.maximum(share, 0.25), 0.0)
    nearest = distance_transform_edt(share <= 0.25, return_distances=False, return_indices=True)
    fine: Array = blocks[tuple(nearest)]
    for axis in (0, 1):
        count = fine.shape[axis]
        sums = np.concatenate([np.zeros_like(fine.take([0], axis)), np.cumsum(fine, axis)], axis)
        edges = np.linspace(0.0, count, count * side + 1)
        fine = side * np.diff(PchipInterpolator(np.arange(count + 1.0), sums, axis)(edges), axis=axis)
    missing = (max(rows - fine.shape[0], 0), max(columns - fine.shape[1], 0))
    return np.asarray(np.pad(fine, ((0, missing[0]), (0, missing[1])), mode="edge")[:rows, :columns])


def _binned(image: Array, side: int) -> Array:
    """Means over blocks; what is left over at the ends is dropped, as `Camera.binned` does."""
    rows, columns = (n // side for n in image.shape)
    return np.asarray(image[: rows * side, : columns * side].reshape(rows, side, columns, side).mean(axis=(1, 3)))

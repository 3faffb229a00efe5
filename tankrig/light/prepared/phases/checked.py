"""Orders ≥ 3 as prepared, made right about one medium by light paths that are followed there.

What a prepared model knows of a phase function is not all of it, and nothing in its training images tells what it
misses: of the image of 1 µm beads alike 2 to 3 %, where its noise is .2 to .4 (decision 211). What lattices of light
paths at one medium differ from it by does. Nearly all of that lies in the few patterns that the model's images are made
of, in which lattices have little noise; the rest is smooth, and counts as far as it is more than noise:

    off = PᵀP d + max(0, 1 − n²/s²) r,    r = d − PᵀP d, averaged over a Gaussian,

with the lattices' mean difference d, the patterns P, and r's squared norms as it is, s², and of noise alone, n² (James
and Stein 1961). Its errors are the lattices' scatter, what smoothing takes off r, of which smoothing twice takes as
much again, and how little of r is known to be no noise.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.noise import signs_of_chance
from tankrig.light.prepared.phases.high import HighAnswer
from tankrig.scene import Medium
from tankrig.scene.phase_table import PhaseFunction
from tankrig.threads import THREADS

Array = NDArray[np.float64]

FEWEST, MOST = 64, 256
"""Lattices that are followed, four times as many as long as there is more noise than wanted."""
ENOUGH = 0.003
"""Error over the whole of orders ≥ 3 that does."""
SMOOTH_MM = 4.0
"""Standard deviation of the Gaussian. On a bench, 64 and 256 lattices, 2 to 8 mm: an emulsion is .19 to .12 % off, as
prepared .26; beads of 1 µm .67 to .31, as prepared 2.8; 4 mm are best, or nearly."""
PATTERNS = 32
"""How many the errors are told by: sums over all lattices with signs of chance."""


@dataclass(frozen=True, eq=False)
class CheckedOrders:
    """Images of orders ≥ 3 about a medium, and their errors.

    Parameters
    ----------
    high
        As prepared.
    off
        (rows, columns) what that lacks at the medium, over the image's L2 norm.
    errors
        (n, rows, columns) how that errs, over the same: their covariance is the sum of the products.
    """

    high: HighAnswer
    off: Array
    errors: Array

    def image(self, medium: Medium) -> Array:
        """(rows, columns) of orders ≥ 3, W/mm²/sr; never negative."""
        found = self.high.image(medium)
        return np.maximum(found + float(np.linalg.norm(found)) * self.off, 0.0)

    def image_and_slopes(self, medium: Medium, others: Sequence[PhaseFunction]) -> tuple[Array, Array]:
        """The image, and (2 + others, rows, columns) its derivatives by σa, σs and the share of the way to each of the
        other phase functions."""
        found, slopes = self.high.image_and_slopes(medium, others)
        size = float(np.linalg.norm(found))
        growth = np.tensordot(slopes, found, 2) / size if size > 0.0 else np.zeros(len(slopes))
        return np.maximum(found + size * self.off, 0.0), slopes + growth[:, None, None] * self.off

    def errors_at(self, medium: Medium) -> Array:
        """(n, rows, columns) the errors of the image of a medium nearby, as they lie."""
        return float(np.linalg.norm(self.high.image(medium))) * self.errors


def checked_at(high: HighAnswer, medium: Medium, threads: int = THREADS) -> CheckedOrders:
    """A prepared model made right about a medium; 2 to 20 CPU s, a quarter of what preparing it takes."""
    expected = high.image(medium)
    size = float(np.linalg.norm(expected)) or 1.0
    apart: Array = np.zeros((0, expected.size))
    wanted = FEWEST
    while True:
        with ThreadPoolExecutor(threads) as pool:
            more = list(pool.map(lambda seed: high.by_paths(medium, seed), range(len(apart), wanted)))
        apart = np.concatenate([apart, (np.array(more) - expected.ravel()) / size])
        off, errors = _difference(apart, high, expected.shape)
        if wanted >= MOST or float(np.linalg.norm(errors)) < ENOUGH:
            return CheckedOrders(high, off, errors)
        wanted *= 4


def _difference(apart: Array, high: HighAnswer, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """What lattices differ by from an image, (lattices, pixels), on average, and its errors."""
    count = len(apart)
    mean = apart.mean(axis=0)
    chance = signs_of_chance(PATTERNS, count) @ (apart - mean) / math.sqrt(count * (count - 1.0))
    sums = np.concatenate([mean[None], chance])
    held = (sums @ high.patterns.T) @ high.patterns
    sides_mm = high.sampling.scene.camera.sides_mm
    rest = _smooth((sums - held).reshape(-1, *shape), sides_mm)
    more = max(0.0, 1.0 - float(np.sum(rest[1:] ** 2)) / max(float(np.sum(rest[0] ** 2)), 1e-300))
    held = held.reshape(-1, *shape)
    taken_off = rest[:1] - _smooth(rest[:1], sides_mm)
    errors = [held[1:] + math.sqrt(more) * rest[1:], more * taken_off, math.sqrt(more * (1.0 - more)) * rest[:1]]
    return held[0] + more * rest[0], np.concatenate(errors)


def _smooth(images: Array, sides_mm: tuple[float, float]) -> Array:
    """Averages over a Gaussian in the tank, which reach no further than an image does."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(images, [0.0, *(SMOOTH_MM / side for side in sides_mm)], mode="nearest"))

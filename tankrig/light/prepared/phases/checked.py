"""Orders ≥ 3 as prepared, made right about one medium by light paths that are followed there.

What a prepared model knows of a phase function is not all of it, and nothing in its training images tells what it
misses: of the image of 1 µm beads alike 2 to 3 %, where its noise is .2 to .4 (decision 211). What lattices of light
paths at one medium differ from it by does. Nearly all of that lies in the few patterns that the model's images are made
of, in which lattices have little noise. The rest counts as far as it is more than noise, smooth light and fine light
each for itself:

    off = PᵀP d + Σ max(0, 1 − nₖ²/sₖ²) rₖ,    r₁ = G (d − PᵀP d),    r₂ = d − PᵀP d − r₁,

with the lattices' mean difference d, the patterns P, a Gaussian average G, rₖ's squared norms as they are, sₖ², and of
noise alone, nₖ² (James and Stein 1961). Its errors are the lattices' scatter, and of rₖ the root of its share of that,
whose square is what such an estimate errs by.
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
"""Standard deviation of the Gaussian. Of beads of .5 µm 64 and 256 lattices leave .68 and .44 % of the image, with
smooth light alone .71 and .60, and state .62 and .41, where that stated .55 and .35; of an emulsion .25 and .18, .26
and .22. Four bands do no better."""
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

    def image(self, medium: Medium, besides: Array | float = 0.0) -> Array:
        """(rows, columns) of orders ≥ 3, W/mm²/sr, which lack so much besides, over their norm; never negative."""
        found = self.high.image(medium)
        return np.maximum(found + float(np.linalg.norm(found)) * (self.off + besides), 0.0)

    def image_and_slopes(
        self, medium: Medium, others: Sequence[PhaseFunction], besides: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """The image, and (2 + others, rows, columns) its derivatives by σa, σs and the share of the way to each of the
        other phase functions; of what it lacks besides as the norm changes only."""
        found, slopes = self.high.image_and_slopes(medium, others)
        size, off = float(np.linalg.norm(found)), self.off + besides
        growth = np.tensordot(slopes, found, 2) / size if size > 0.0 else np.zeros(len(slopes))
        return np.maximum(found + size * off, 0.0), slopes + growth[:, None, None] * off

    def size_at(self, medium: Medium) -> float:
        """L2 norm of orders ≥ 3 as prepared."""
        return float(np.linalg.norm(self.high.image(medium)))

    def errors_at(self, medium: Medium) -> Array:
        """(n, rows, columns) the errors of the image of a medium nearby, as they lie."""
        return self.size_at(medium) * self.errors


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
    held = np.asarray((sums @ high.patterns.T) @ high.patterns, float)
    rest = (sums - held).reshape(-1, *shape)
    smooth = _smooth(rest, high.sampling.scene.camera.sides_mm)
    images = held.reshape(-1, *shape)
    off, errors = images[0], images[1:]
    for band in (smooth, rest - smooth):
        more = max(0.0, 1.0 - float(np.sum(band[1:] ** 2)) / max(float(np.sum(band[0] ** 2)), 1e-300))
        off, errors = off + more * band[0], errors + math.sqrt(more) * band[1:]
    return off, errors


def _smooth(images: Array, sides_mm: tuple[float, float]) -> Array:
    """Averages over a Gaussian in the tank, which reach no further than an image does."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(images, [0.0, *(SMOOTH_MM / side for side in sides_mm)], mode="nearest"))

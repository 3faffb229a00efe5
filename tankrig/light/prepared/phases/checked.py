"""Orders ≥ 3 as prepared, made right about one medium by light paths that are followed there.

What a prepared model knows of a phase function is not all of it, and nothing in its training images tells what it
misses: of the image of 1 µm beads alike 2 to 3 %, where its noise is .2 to .4 (decision 211). What lattices of light
paths at one medium differ from it by on average does, and is taken over as it is, with the lattices' scatter as its
error. What is drawn towards the model, because it might be noise, is light that goes missing where the model is wrong.

A fit asks at one medium after another, ever nearer to each other, where the same lattices err nearly alike. So what
was learned at one by all lattices is taken over, and a few tell what is otherwise at the next,

    d = ⟨dₐ⟩ over all + ⟨d − dₐ⟩ over the few,

where the scatter of the difference says that this has hardly more noise (a control variate).
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
Known = list[NDArray[np.floating]]
"""What lattices of light paths differed by from a model at media where it was made right, (lattices, pixels) each."""

FEWEST, MOST = 64, 256
"""Lattices that are followed, four times as many as long as there is more noise than wanted."""
NEAR, LITTLE_MORE = 16, 0.25
"""Lattices that may tell what is otherwise than at a medium nearby, four times as many where that adds more than so
much of its variance there."""
MOST_KNOWN = 3
"""Media whose lattices are kept, 15 MB each of a bench."""
ENOUGH = 0.003
"""Error over the whole of orders ≥ 3 that does."""
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


def checked_at(high: HighAnswer, medium: Medium, known: Known | None = None, threads: int = THREADS) -> CheckedOrders:
    """A prepared model made right about a medium; .5 to 20 CPU s, a quarter of what preparing it takes at most.

    Parameters
    ----------
    high
        The model.
    medium
        Where it is made right.
    known
        Of other media; where this one is near none of them, it is added.
    threads
        To follow them by.
    """
    known = [] if known is None else known
    apart: Array = np.zeros((0, math.prod(high.sampling.scene.camera.shape)))
    for wanted in (NEAR, FEWEST, MOST):
        apart = np.concatenate([apart, _apart(high, medium, range(len(apart), wanted), threads)])
        near = _nearest(apart, known)
        if near is not None:
            return _made_right(high, *_beside(apart, near))
        if wanted < FEWEST:
            continue
        found = _made_right(high, *_by_all(apart))
        if wanted == MOST or float(np.linalg.norm(found.errors)) < ENOUGH:
            break
    known[:] = [*known[1 - MOST_KNOWN :], apart.astype(np.float32)]
    return found


def checked_finely_at(high: HighAnswer, medium: Medium, lattices: int, threads: int = THREADS) -> CheckedOrders:
    """The same by so many lattices, whatever noise they leave; 25 to 110 ms of CPU each."""
    return _made_right(high, *_by_all(_apart(high, medium, range(lattices), threads)))


def _apart(high: HighAnswer, medium: Medium, seeds: range, threads: int) -> Array:
    """(lattices, pixels) what lattices at a medium differ by from a model, over the norm of its image."""
    expected = high.image(medium)
    with ThreadPoolExecutor(threads) as pool:
        images = list(pool.map(lambda seed: high.by_paths(medium, seed), seeds))
    return np.asarray((np.array(images) - expected.ravel()) / (float(np.linalg.norm(expected)) or 1.0))


def _nearest(apart: Array, known: Known) -> Array | None:
    """What is known of the medium that tells most of one where so many lattices have been followed; None where all tell
    too little, or as many lattices had to be followed there."""
    count = len(apart)
    told = [
        (_scatter(apart - one[:count]) / count, _scatter(one) / len(one), number)
        for number, one in enumerate(known)
        if len(one) > count
    ]
    told = [(more, noise, number) for more, noise, number in told if more <= LITTLE_MORE * noise]
    return np.asarray(known[min(told)[2]], float) if told else None


def _scatter(lattices: NDArray[np.floating]) -> float:
    """Variance of lattices, over all pixels."""
    return float(np.sum(np.var(lattices, axis=0, ddof=1)))


def _by_all(apart: Array) -> tuple[Array, Array]:
    """Mean of lattices, (pixels,), and its errors (n, pixels), by sums of their scatter with signs of chance."""
    count, mean = len(apart), apart.mean(axis=0)
    return mean, signs_of_chance(PATTERNS, count) @ (apart - mean) / math.sqrt(count * (count - 1.0))


def _beside(apart: Array, near: Array) -> tuple[Array, Array]:
    """The same of a medium where few lattices have been followed, by the many of another one and what differs there."""
    count = len(apart)
    (mean, errors), change = _by_all(near), apart - near[:count]
    signs = signs_of_chance(PATTERNS, len(near))[:, :count]
    more = change.mean(axis=0)
    return mean + more, errors + signs @ (change - more) / math.sqrt(count * (count - 1.0))


def _made_right(high: HighAnswer, off: Array, errors: Array) -> CheckedOrders:
    """A model with what it is off by, (pixels,), and its errors, (n, pixels)."""
    shape = high.sampling.scene.camera.shape
    return CheckedOrders(high, off.reshape(shape), errors.reshape(-1, *shape))

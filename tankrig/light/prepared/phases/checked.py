"""Orders ≥ 3 as prepared, made right about one medium by light paths that are followed there.

What a prepared model knows of a phase function is not all of it, and nothing in its training images tells what it
misses: of the image of 1 µm beads alike 2 to 3 %, where its noise is .2 to .4 (decision 211). What lattices of light
paths at one medium differ from it by on average does, and is taken over as it is, with the lattices' scatter as its
error. What is drawn towards the model, because it might be noise, is light that goes missing where the model is wrong.

A fit asks at one medium after another, ever nearer to each other, where the same lattices err nearly alike. So what
was learned at one by all lattices is taken over, and a few tell what is otherwise at the next,

    d = ⟨dₐ⟩ over all + ⟨G(d − dₐ)⟩ over the few,

where the scatter of the difference says that this has hardly more noise (a control variate). G is an average over
`BLUR_MM` in proportion to the light: paths part at media that hardly differ, and light behind glass is seen where few
of them end, so that the bare difference at 1 % of σs had .92 of a lattice's own noise there, and its average .10. A
change that is larger than the error of what is known is not taken so, since what is finer than the average would be
left out.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

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
BLUR_MM, FAINT = 8.0, 1e-3
"""Standard deviation of the Gaussian over which such a change is averaged, and the share of the brightest light that it
is in proportion to at least. Of the change of the whole light of orders ≥ 3, not of what a model misses of it, that
leaves out 10 to 37 % (a glass tank, σs .002 and .02/mm; 4 mm: 3 to 17 %)."""
MOST_CHANGE = 1.0
"""Times the error of what is known at one medium, which a change may be where its average is taken for it. Of 5 % of σs
and .05 of the mean cosine in that tank what was missed is off by 1.0 and 1.2 times what is stated then, by 16 lattices;
of 15 % and another family it would be by 1.7 and 1.2."""
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


def checked_at(
    high: HighAnswer, medium: Medium, known: Known | None = None, most: int | None = None, threads: int = THREADS
) -> CheckedOrders:
    """A prepared model made right about a medium; .5 to 60 CPU s, the most of them in a tank of glass.

    Parameters
    ----------
    high
        The model.
    medium
        Where it is made right.
    known
        Of other media; where this one is near none of them, it is added.
    most
        Lattices that are followed at most, from `FEWEST` on; None: `MOST`.
    threads
        To follow them by.
    """
    known, most = [] if known is None else known, MOST if most is None else most
    apart: Array = np.zeros((0, math.prod(high.sampling.scene.camera.shape)))
    for wanted in (NEAR, FEWEST, most):
        apart = np.concatenate([apart, _apart(high, medium, range(len(apart), wanted), threads)])
        near = _nearest(apart, known, high, medium)
        if near is not None:
            return _made_right(high, *_beside(*near))
        if wanted < FEWEST:
            continue
        found = _made_right(high, *_by_all(apart))
        if wanted == most or float(np.linalg.norm(found.errors)) < ENOUGH:
            break
    known[:] = [*known[1 - MOST_KNOWN :], apart.astype(np.float32)]
    return found


def checked_by_lattices(high: HighAnswer, medium: Medium, lattices: int, threads: int = THREADS) -> CheckedOrders:
    """The same by so many lattices, whatever noise they leave; 25 to 110 ms of CPU each."""
    return _made_right(high, *_by_all(_apart(high, medium, range(lattices), threads)))


def _apart(high: HighAnswer, medium: Medium, seeds: range, threads: int) -> Array:
    """(lattices, pixels) what lattices at a medium differ by from a model, over the norm of its image."""
    expected = high.image(medium)
    with ThreadPoolExecutor(threads) as pool:
        images = list(pool.map(lambda seed: high.by_paths(medium, seed), seeds))
    return np.asarray((np.array(images) - expected.ravel()) / (float(np.linalg.norm(expected)) or 1.0))


def _nearest(apart: Array, known: Known, high: HighAnswer, medium: Medium) -> tuple[Array, Array] | None:
    """What is known of the medium that tells most of one where so many lattices have been followed, and how these
    differ from it there; None where all tell too little, or as many lattices had to be followed there."""
    count, told = len(apart), []
    for number, one in enumerate(known):
        if len(one) <= count:
            continue
        change = _averaged(apart - one[:count], high, medium)
        more, noise = _scatter(change) / count, _scatter(one) / len(one)
        size = float(np.sum(np.square(change.mean(axis=0))))
        if more <= LITTLE_MORE * noise and size <= MOST_CHANGE**2 * noise:
            told.append((more, number, change))
    if not told:
        return None
    _, number, change = min(told, key=lambda one: one[0])
    return np.asarray(known[number], float), change


def _averaged(changes: Array, high: HighAnswer, medium: Medium) -> Array:
    """(n, pixels) the same, as shares of the light of a medium that are averaged over `BLUR_MM`."""
    camera, light = high.sampling.scene.camera, high.image(medium)
    widths = [BLUR_MM / side for side in camera.sides_mm]
    spread = gaussian_filter(light, widths, mode="nearest")
    per_light = light / np.maximum(spread, FAINT * float(light.max(initial=0.0)) + 1e-300)
    averaged = gaussian_filter(changes.reshape(-1, *camera.shape), [0.0, *widths], mode="nearest")
    return np.asarray((per_light * averaged).reshape(changes.shape))


def _scatter(lattices: NDArray[np.floating]) -> float:
    """Variance of lattices, over all pixels."""
    return float(np.sum(np.var(lattices, axis=0, ddof=1)))


def _by_all(apart: Array) -> tuple[Array, Array]:
    """Mean of lattices, (pixels,), and its errors (n, pixels), by sums of their scatter with signs of chance."""
    count, mean = len(apart), apart.mean(axis=0)
    return mean, signs_of_chance(PATTERNS, count) @ (apart - mean) / math.sqrt(count * (count - 1.0))


def _beside(near: Array, change: Array) -> tuple[Array, Array]:
    """The same of a medium where few lattices have been followed, by the many of another one and what differs there."""
    count = len(change)
    mean, errors = _by_all(near)
    signs = signs_of_chance(PATTERNS, len(near))[:, :count]
    more = change.mean(axis=0)
    return mean + more, errors + signs @ (change - more) / math.sqrt(count * (count - 1.0))


def _made_right(high: HighAnswer, off: Array, errors: Array) -> CheckedOrders:
    """A model with what it is off by, (pixels,), and its errors, (n, pixels)."""
    shape = high.sampling.scene.camera.shape
    return CheckedOrders(high, off.reshape(shape), errors.reshape(-1, *shape))

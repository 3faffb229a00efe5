"""What a fit minimises: weighted least squares of any number of images, gain and offsets eliminated."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from tankrig.estimation.differences import Forward, Slopes
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import Block
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.uncertainty import ModelError, Response, Sensitivity, Whitening
from tankrig.scene import Medium
from tankrig.threads import THREADS

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Answer = TypeVar("Answer")

UNKNOWN = Medium(0.0, 0.0, 0.0)
"""The liquid before any block has said what it is."""


@dataclass(frozen=True)
class View:
    """An image and what the model says about it.

    Parameters
    ----------
    observation
        What to explain.
    forward, slopes
        The model and its derivatives by σa, σs and g (of a cheaper version, perhaps).
    error
        Of the model's image.
    dose
        Number of the dose that it was taken at.
    number
        Of the image.
    slopes_noise
        Patterns of the derivatives' noise, (n, 3, rows, columns): its covariance is the sum of their products; None
        where it is not known, and taken for none.
    """

    observation: Observation
    forward: Forward
    slopes: Slopes
    error: ModelError
    dose: int = 0
    number: int = 0
    slopes_noise: Slopes | None = None

    @cached_property
    def whitening(self) -> Whitening:
        """How errors as large as assumed are made 1, on the pixels that are used."""
        return self.error.whitening(self.observation.noise, self.observation.used)

    @cached_property
    def pixels(self) -> NDArray[np.intp]:
        """(n,) numbers of those that are used: far quicker to pick by than a mask."""
        return np.flatnonzero(self.observation.used)

    def whitened(self, images: Image) -> Array:
        """The used pixels of images, (…, rows, columns), in standard deviations."""
        flat = np.reshape(images, (*images.shape[:-2], -1))
        return self.whitening.whiten(np.asarray(flat[..., self.pixels], float))

    @cached_property
    def one(self) -> Array:
        """What an offset of one adds, whitened."""
        return self.whitened(np.ones(self.observation.image.shape))

    @cached_property
    def observed(self) -> Array:
        """The image, whitened."""
        return self.whitened(self.observation.image)


@dataclass(frozen=True)
class Problem:
    """Weighted least squares of images and forward models.

    Parameters
    ----------
    views
        The images.
    blocks
        Of parameters; those before say what those after act on.
    scaling
        Gain and offset, known or free.
    quick
        Whether derivatives come along with the models' images.
    held
        Coordinates that are not searched: number and value of each.
    close
        Coordinates that those expected to be 0 ± 1 stay close to, and how many times as much as to 0; None: to none.
    slow
        Whether images take so long though derivatives come along that several at a time are worth it, and derivatives
        three times as long: those of six photographs behind glass by a free phase function's shapes take 57 CPU s.
    noisy
        Whether images and derivatives have the noise of light paths, by which they need not agree.
    """

    views: tuple[View, ...]
    blocks: tuple[Block, ...]
    scaling: Scaling
    quick: bool = True
    held: tuple[tuple[int, float], ...] = ()
    close: tuple[Array, float] | None = None
    slow: bool = False
    noisy: bool = False

    @property
    def box(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates."""
        low, high = (np.concatenate([getattr(one, end) for one in self.blocks]) for end in ("low", "high"))
        for number, value in self.held:
            low[number] = high[number] = value
        return low, high

    @property
    def longest_step(self) -> Array:
        """How far each coordinate may go in one step."""
        return np.concatenate([one.longest_step for one in self.blocks])

    @property
    def looseness(self) -> Array:
        """Times that each coordinate may have moved further than others where a fit has settled."""
        return np.concatenate([one.looseness for one in self.blocks])

    @property
    def least_damping(self) -> float:
        """Share of the curvature that steps are damped by at least, see `Block.least_damping`."""
        return max(one.least_damping for one in self.blocks)

    @property
    def pixels(self) -> int:
        """Used, in all images."""
        return sum(int(view.observation.used.sum()) for view in self.views)

    @cached_property
    def prior_weight(self) -> Array:
        """(k,) of coordinates that are expected to be 0 ± 1; 0 where nothing is known."""
        return np.concatenate([block.prior_weight for block in self.blocks])

    def start(self, densest: Medium) -> Array:
        """Coordinates to begin from when the densest liquid is about this."""
        return np.concatenate([one.start(densest) for one in self.blocks])

    def evenly(self, coordinates: Array, step: Array) -> Array:
        """Coordinates in the box where values have changed as a step changes them at first, see `Block.evenly`."""
        parts = zip(self.blocks, self.split(coordinates), self.split(step), strict=True)
        found = np.concatenate([block.evenly(at, by) for block, at, by in parts])
        return np.asarray(np.clip(np.where(step == 0.0, coordinates, found), *self.box))

    def at(self, coordinates: Array) -> "Evaluation":
        """The problem at some coordinates."""
        return Evaluation(self, coordinates)

    def scale(self, models: Sequence[Array]) -> tuple[float, list[float]]:
        """The best gain for all whitened models, and the best offset of each image."""
        return self.scaling.solve(models, [view.one for view in self.views], [view.observed for view in self.views])

    def left_by(self, models: Sequence[Array], gain: float, offsets: Sequence[float]) -> Array:
        """(n,) observed less whitened models, one image after the other."""
        parts = zip(self.views, models, offsets, strict=True)
        return np.concatenate([view.observed - gain * model - offset * view.one for view, model, offset in parts])

    def whitened(self, images: Sequence[Image]) -> list[Array]:
        """Used pixels of an image of each view, in standard deviations."""
        return [view.whitened(image) for view, image in zip(self.views, images, strict=True)]

    def split(self, coordinates: Array) -> list[Array]:
        """The coordinates of each block."""
        return np.split(coordinates, np.cumsum([len(block.names) for block in self.blocks])[:-1])

    def believed(self, block: Block) -> NDArray[np.bool_]:
        """(k,) which values are a block's."""
        return np.concatenate([np.full(len(one.names), one is block) for one in self.blocks])

    def of(self, few: Sequence[int]) -> "Problem":
        """The problem of some of the images."""
        return replace(self, views=tuple(self.views[k] for k in few))

    def by(self, forwards: Sequence[Forward]) -> "Problem":
        """The problem with other models of the images."""
        views = zip(self.views, forwards, strict=True)
        return replace(self, views=tuple(replace(view, forward=forward) for view, forward in views))

    def with_slopes_noise(self, noise: Sequence[Slopes | None]) -> "Problem":
        """The problem where so much is known of the derivatives' noise in each view."""
        views = zip(self.views, noise, strict=True)
        return replace(self, views=tuple(replace(view, slopes_noise=one) for view, one in views))

    def of_views(self, answer: Callable[[View], Answer]) -> list[Answer]:
        """What a function says of each view; of several at a time."""
        if (self.quick and not self.slow) or len(self.views) == 1:
            return [answer(view) for view in self.views]
        with ThreadPoolExecutor(THREADS) as pool:
            return list(pool.map(answer, self.views))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A problem at some coordinates. What is asked of it is computed then, and once.

    Parameters
    ----------
    problem
        Whose.
    coordinates
        (k,) of all blocks, one after the other.
    """

    problem: Problem
    coordinates: Array

    @cached_property
    def values(self) -> dict[str, Array]:
        """Values of each block, by its name."""
        parts = zip(self.problem.blocks, self.problem.split(self.coordinates), strict=True)
        return {block.name: block.values(part) for block, part in parts}

    @property
    def row(self) -> Array:
        """(m,) values of all blocks, one after the other."""
        return np.concatenate([self.values[block.name] for block in self.problem.blocks])

    @cached_property
    def deviations(self) -> Array:
        """(m,) standard deviations of `row`, by noise and by the models' own error."""
        return self._deviations(None)

    @property
    def deviations_by_parts(self) -> Array:
        """(m,) the same where images hold structure that these do not explain: as parts of them disagree, besides."""
        return self._deviations(self.left)

    def _deviations(self, residual: Array | None) -> Array:
        noise = [view.observation.noise for view in self.problem.views]
        spread = self.sensitivity.covariance(noise, [view.error for view in self.problem.views], residual)
        return np.asarray(np.sqrt(np.diag(spread)))

    @cached_property
    def liquids(self) -> dict[int, Medium]:
        """Liquids of the views, by the number of their dose."""
        found = {}
        for dose in {view.dose for view in self.problem.views}:
            found[dose] = UNKNOWN
            for block in self.problem.blocks:
                found[dose] = block.liquid(self.values, dose, found[dose])
        return found

    @property
    def media(self) -> list[Medium]:
        """The liquid of each view."""
        return [self.liquids[view.dose] for view in self.problem.views]

    @property
    def at_edge(self) -> tuple[str, ...]:
        """Names of values at an edge of the range, where no optimum is."""
        return tuple(name for block in self.problem.blocks for name in block.at_edge(self.values))

    @cached_property
    def images(self) -> list[Image]:
        """Radiance, (rows, columns), of each view."""

        def image(view: View) -> Image:
            return view.forward(self.liquids[view.dose]) + self._added_to(view)

        return self.problem.of_views(image)

    @cached_property
    def added(self) -> list[Image | float]:
        """What blocks add to the models' images of each view."""
        return [self._added_to(view) for view in self.problem.views]

    def _added_to(self, view: View) -> Image | float:
        liquid = self.liquids[view.dose]
        found: Image | float = 0.0
        for block in self.problem.blocks:
            found = found + block.added_in(view.number, self.values, liquid)
        return found

    @cached_property
    def models(self) -> list[Array]:
        """The images, whitened."""
        return self.problem.whitened(self.images)

    @cached_property
    def scale(self) -> tuple[float, list[float]]:
        """The best gain for all images, and the best offset of each."""
        return self.problem.scale(self.models)

    @cached_property
    def left(self) -> Array:
        """(n,) observed less fitted, whitened, one image after the other."""
        return self.problem.left_by(self.models, *self.scale)

    @cached_property
    def residual(self) -> Array:
        """(n + priors,) the same; then expected less found of what is known."""
        weight = self.problem.prior_weight
        known = [(self.coordinates * np.sqrt(weight))[weight > 0.0]]
        if self.problem.close is not None:
            place, times = self.problem.close
            known.append(((self.coordinates - place) * np.sqrt(times * weight))[weight > 0.0])
        return np.concatenate([self.left, self.problem.scaling.prior_residuals(*self.scale), *known])

    @cached_property
    def cost(self) -> float:
        """Half the sum of squared residuals."""
        return 0.5 * float(self.residual @ self.residual)

    @cached_property
    def jacobian(self) -> Array:
        """(n + priors, k) derivatives of the residual by the coordinates."""
        by_values = -self._changes.T
        weight = self.problem.prior_weight
        known = [np.diag(np.sqrt(weight))[weight > 0.0]]
        if self.problem.close is not None:
            known.append(math.sqrt(self.problem.close[1]) * known[0])
        return np.vstack([by_values @ self.chain, *known])

    @cached_property
    def chain(self) -> Array:
        """(k, k) derivatives of the values by the coordinates."""
        parts = self.problem.split(self.coordinates)
        slopes = (block.slopes(part) for block, part in zip(self.problem.blocks, parts, strict=True))
        return np.asarray(block_diag(*slopes))

    @cached_property
    def _changes(self) -> Array:
        """(k, n + priors) whitened derivatives by the values, less what gain and offsets can make of them."""
        gain, _ = self.scale

        def changes(view: View) -> Array:
            liquid = self.liquids[view.dose]
            by_liquid = view.slopes(liquid)
            for block in self.problem.blocks:
                by_liquid = by_liquid + block.turned(self.values, liquid)
            found = [
                block.changes_in(view.number, self.values, view.dose, liquid, by_liquid)
                for block in self.problem.blocks
            ]
            return view.whitened(gain * np.concatenate(found))

        return self.project_out(np.hstack(self.problem.of_views(changes)))

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """What the fit responds to; steps need no more of it than `_changes`."""
        *parts, priors = np.split(self._changes, np.cumsum([model.size for model in self.models]), axis=1)
        noise = [self._products_of_noise(number) for number in range(len(parts))]
        responses = tuple(
            Response(part, view.whitening, view.observation.used, products)
            for part, products, view in zip(parts, noise, self.problem.views, strict=True)
        )
        widest = np.concatenate([block.widest(self.values) for block in self.problem.blocks])
        weight = self.problem.prior_weight
        return Sensitivity(responses, priors, widest, np.where(weight > 0.0, weight, 1.0))

    def _products_of_noise(self, number: int) -> Array | None:
        """(k, k) what the derivatives' noise in a view adds to their products; None where it is not known."""
        view, (gain, _) = self.problem.views[number], self.scale
        if view.slopes_noise is None:
            return None
        liquid, ends = self.liquids[view.dose], np.cumsum([0, *(model.size for model in self.models)])

        def changes(pattern: Image) -> Image:
            none = np.zeros(pattern.shape[1:])
            found = [
                block.changes_in(view.number, self.values, view.dose, liquid, pattern) if block.of_liquid
                else np.broadcast_to(none, (len(block.names), *none.shape)) for block in self.problem.blocks
            ]  # fmt: skip
            return np.concatenate(found)

        count = sum(len(block.names) for block in self.problem.blocks)
        found, moved = np.zeros((count, count)), np.zeros((count, ends[-1]))
        for pattern in view.slopes_noise(liquid):
            moved[:, ends[number] : ends[number + 1]] = view.whitened(gain * changes(pattern))
            left = self.project_out(moved)
            found += left @ left.T
        return found

    def changes_at(self, gain: float) -> Array:
        """(k, n) whitened derivatives of the images times a gain, with all that gain and offsets could make of them."""
        return replace(self.problem, scaling=Scaling(gain, 0.0)).at(self.coordinates).sensitivity.changes

    def project_out(self, changes: Array) -> Array:
        """Part of whitened changes (k, n) that no gain and no offset could make of the images, then of priors."""
        return self.problem.scaling.project_out(changes, self.models, [view.one for view in self.problem.views])

"""What a fit minimises: weighted least squares of any number of images, gain and offsets eliminated."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.forward import Forward, Slopes
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import Block, Scaling, Values
from tankrig.estimation.uncertainty import ModelError, Response, Sensitivity, Whitening
from tankrig.scene import Medium

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
    """

    observation: Observation
    forward: Forward
    slopes: Slopes
    error: ModelError
    dose: int = 0

    @cached_property
    def whitening(self) -> Whitening:
        """Of the errors assumed, on the pixels that are used."""
        return self.error.whitening(self.observation.noise, self.observation.used)

    def whitened(self, images: Image) -> Array:
        """The used pixels of images, (…, rows, columns), in standard deviations."""
        return self.whitening.whiten(np.asarray(images[..., self.observation.used], float))

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
    threads
        That ask models at a time: one for models that answer sooner than a thread begins.
    """

    views: tuple[View, ...]
    blocks: tuple[Block, ...]
    scaling: Scaling
    threads: int = 1

    @property
    def box(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates."""
        return np.concatenate([one.low for one in self.blocks]), np.concatenate([one.high for one in self.blocks])

    @property
    def longest_step(self) -> Array:
        """Of each coordinate."""
        return np.concatenate([one.longest_step for one in self.blocks])

    @property
    def pixels(self) -> int:
        """Used, in all images."""
        return sum(int(view.observation.used.sum()) for view in self.views)

    def start(self, densest: Medium) -> Array:
        """Coordinates to begin from when the densest liquid is about this."""
        return np.concatenate([one.start(densest) for one in self.blocks])

    def values(self, coordinates: Array) -> dict[str, Array]:
        """Of each block, by its name."""
        return {one.name: one.values(part) for one, part in zip(self.blocks, self._split(coordinates), strict=True)}

    def liquid(self, coordinates: Array, dose: int = 0) -> Medium:
        """The liquid of views at a dose."""
        return self._liquid(self.values(coordinates), dose)

    def _liquid(self, values: Values, dose: int) -> Medium:
        liquid = UNKNOWN
        for block in self.blocks:
            liquid = block.liquid(values, dose, liquid)
        return liquid

    def at_edge(self, coordinates: Array) -> tuple[str, ...]:
        """Names of values at an edge of the range, where no optimum is."""
        values = self.values(coordinates)
        return tuple(name for block in self.blocks for name in block.at_edge(values))

    def images(self, coordinates: Array) -> list[Image]:
        """Radiance, (rows, columns), of each view."""
        values = self.values(coordinates)
        liquids = {dose: self._liquid(values, dose) for dose in self._doses}

        def image(view: View) -> Image:
            liquid = liquids[view.dose]
            found = view.forward(liquid)
            for block in self.blocks:
                found = found + block.added(values, liquid)
            return found

        return self.of_views(image)

    def scale(self, images: Sequence[Image]) -> tuple[float, list[float]]:
        """The best gain for all model images, and the best offset of each."""
        return self._scale(self._models(images))

    def residual(self, coordinates: Array) -> Array:
        """Observed less fitted, whitened, one image after the other; then expected less found of what is known."""
        return self._residual(self._models(self.images(coordinates)), coordinates)

    def residual_and_jacobian(self, coordinates: Array) -> tuple[Array, Array]:
        """The same with its derivatives by the coordinates, (n + priors, k)."""
        images = self.images(coordinates)
        found = self.sensitivity(coordinates, images)
        turned = -np.concatenate([found.changes, found.priors], axis=1).T
        at = 0
        for block, part in zip(self.blocks, self._split(coordinates), strict=True):
            turned[:, at : at + part.size] = turned[:, at : at + part.size] @ block.slopes(part)
            at += part.size
        weight = self._prior_weight
        known = np.diag(np.sqrt(weight))[weight > 0.0]
        return self._residual(self._models(images), coordinates), np.vstack([turned, known])

    def sensitivity(self, coordinates: Array, images: Sequence[Image]) -> Sensitivity:
        """What the fit responds to at some coordinates, whose images are given."""
        values, models = self.values(coordinates), self._models(images)
        gain, _ = self._scale(models)
        liquids = {dose: self._liquid(values, dose) for dose in self._doses}

        def changes(view: View) -> Array:
            liquid = liquids[view.dose]
            by_liquid = view.slopes(liquid)
            found = [block.changes(values, view.dose, liquid, by_liquid) for block in self.blocks]
            return view.whitened(gain * np.concatenate(found))

        left = self.project_out(np.hstack(self.of_views(changes)), models)
        cuts = np.cumsum([model.size for model in models])
        parts = np.split(left, cuts, axis=1)
        responses = tuple(
            Response(part, view.whitening, view.observation.used)
            for part, view in zip(parts[:-1], self.views, strict=True)
        )
        widest = np.concatenate([block.widest(values) for block in self.blocks])
        weight = self._prior_weight
        return Sensitivity(responses, parts[-1], widest, np.where(weight > 0.0, weight, 1.0))

    def project_out(self, changes: Array, models: Sequence[Array]) -> Array:
        """Part of whitened changes (k, n) that no gain and no offset could make of whitened models, then of priors."""
        return self.scaling.project_out(changes, models, [view.one for view in self.views])

    def believed(self, block: Block) -> NDArray[np.bool_]:
        """(k,) which values are a block's."""
        return np.concatenate([np.full(len(one.names), one is block) for one in self.blocks])

    def of(self, few: Sequence[int]) -> "Problem":
        """The problem of some of the images."""
        return replace(self, views=tuple(self.views[k] for k in few))

    def of_views(self, answer: Callable[[View], Answer]) -> list[Answer]:
        """What a function says of each view; of several at a time."""
        if self.threads == 1 or len(self.views) == 1:
            return [answer(view) for view in self.views]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(answer, self.views))

    @cached_property
    def _doses(self) -> set[int]:
        return {view.dose for view in self.views}

    @property
    def _prior_weight(self) -> Array:
        return np.concatenate([block.prior_weight for block in self.blocks])

    def _split(self, coordinates: Array) -> list[Array]:
        return np.split(coordinates, np.cumsum([len(block.names) for block in self.blocks])[:-1])

    def _models(self, images: Sequence[Image]) -> list[Array]:
        return [view.whitened(image) for view, image in zip(self.views, images, strict=True)]

    def _scale(self, models: Sequence[Array]) -> tuple[float, list[float]]:
        return self.scaling.solve(models, [view.one for view in self.views], [view.observed for view in self.views])

    def _residual(self, models: Sequence[Array], coordinates: Array) -> Array:
        gain, offsets = self._scale(models)
        left = [
            view.observed - gain * model - offset * view.one
            for view, model, offset in zip(self.views, models, offsets, strict=True)
        ]
        weight = self._prior_weight
        known = (coordinates * np.sqrt(weight))[weight > 0.0]
        return np.concatenate([*left, self.scaling.prior_residuals(gain, offsets), known])

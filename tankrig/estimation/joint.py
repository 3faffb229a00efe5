"""Images at several doses as one least-squares problem with one gain: what the series' fit minimises.

The liquid at a dose of d ml has σa = water + ink·d, σs = ink·d and the ink's g. The true dose of each group of images
is d + sd·u, where u is normal with standard deviation 1 and is fitted along. Gain and offsets are eliminated at every
step by variable projection: one gain for all images, an offset for each.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import ALBEDO, ASYMMETRY, MEAN_FREE_PATHS, NAMES
from tankrig.estimation.parameters import slopes as ink_slopes
from tankrig.estimation.projection import Scaling
from tankrig.estimation.search import LONGEST_STEP
from tankrig.scene import Medium

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Forward = Callable[[Medium], Image]

THREADS = 2
STEP = 0.03
"""Relative, of differences; of (1 − g²) for g, and of 1/length for σa near 0."""
INK = 4
"""Coordinates before those of the doses: log σs, logit ϖ and atanh g of the ink, σa·length of the water."""
MOST_WATER = 5.0


@dataclass(frozen=True)
class Doses:
    """Ink in the tank.

    Parameters
    ----------
    ml, sd_ml
        (K,) different doses and their standard deviations.
    of_image
        (N,) which of them each image was taken at.
    """

    ml: Array
    sd_ml: Array
    of_image: NDArray[np.int_]

    def of(self, images: Sequence[int]) -> "Doses":
        """For some of the images; the doses stay."""
        return replace(self, of_image=self.of_image[list(images)])


@dataclass(frozen=True)
class Mixture:
    """Ink per mm and ml, and the water it is in; `off` are the doses' errors in standard deviations, (K,)."""

    ink: Medium
    water: float
    off: Array

    def at(self, dose_ml: float) -> Medium:
        """The liquid that holds so much ink."""
        return Medium(self.water + self.ink.sigma_a * dose_ml, self.ink.sigma_s * dose_ml, self.ink.g)


@dataclass(frozen=True)
class Joint:
    """Weighted least squares of all images.

    Parameters
    ----------
    forwards, slopes
        A model of each image, and its derivatives (of a cheaper one, perhaps), see `slopes_of`.
    observations
        What to explain.
    errors
        (rows, columns) standard deviation of each model's error, counted into the weights.
    doses
        As measured.
    scaling
        Common gain and the offsets' common value, or None where free.
    length_mm
        Longest side of the tank.
    """

    forwards: Sequence[Forward]
    slopes: Sequence[Forward]
    observations: Sequence[Observation]
    errors: Sequence[Image]
    doses: Doses
    scaling: Scaling
    length_mm: float

    def of(self, few: Sequence[int]) -> "Joint":
        """The problem of some of the images."""
        return replace(
            self,
            forwards=[self.forwards[k] for k in few],
            slopes=[self.slopes[k] for k in few],
            observations=[self.observations[k] for k in few],
            errors=[self.errors[k] for k in few],
            doses=self.doses.of(few),
        )

    def mixture(self, coordinates: Array) -> Mixture:
        """What coordinates stand for."""
        scattering, logit, asymmetry, depth = (float(value) for value in coordinates[:INK])
        sigma_s = math.exp(scattering)
        ink = Medium(sigma_s * math.exp(-logit), sigma_s, math.tanh(asymmetry))
        return Mixture(ink, depth / self.length_mm, coordinates[INK:])

    def coordinates(self, mixture: Mixture) -> Array:
        """The inverse of `mixture`."""
        ink = mixture.ink
        head = [
            math.log(ink.sigma_s), math.log(ink.sigma_s / ink.sigma_a), math.atanh(ink.g),
            mixture.water * self.length_mm,
        ]  # fmt: skip
        return np.array([*head, *mixture.off])

    @property
    def most_water(self) -> float:
        """Absorption lengths of water along the tank at most; none at one dose, where it is the same as the ink's."""
        return MOST_WATER if self.doses.ml.size > 1 else 0.0

    @property
    def box(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates."""
        edges = []
        for k, water, sigmas in ((0, 0.0, -5.0), (1, self.most_water, 5.0)):
            scattering = math.log(MEAN_FREE_PATHS[k] / self.length_mm / float(self.doses.ml.max()))
            logit = math.log(ALBEDO[k] / (1.0 - ALBEDO[k]))
            edges.append(np.array([scattering, logit, math.atanh(ASYMMETRY[k]), water, *[sigmas] * self.doses.ml.size]))
        return edges[0], edges[1]

    @property
    def longest_step(self) -> Array:
        """See `minimise`."""
        return np.array([*LONGEST_STEP, 0.3, *[1.0] * self.doses.ml.size])

    @property
    def weights(self) -> list[Array]:
        """1/√(noise² + model error²) of each image's used pixels."""
        return [
            1.0 / np.hypot(seen.noise[seen.used], np.asarray(error[seen.used], float))
            for seen, error in zip(self.observations, self.errors, strict=True)
        ]

    def media(self, mixture: Mixture) -> list[Medium]:
        """The liquid in each image."""
        doses_ml = np.maximum(self.doses.ml + self.doses.sd_ml * mixture.off, 0.01 * self.doses.ml)
        return [mixture.at(float(doses_ml[group])) for group in self.doses.of_image]

    def at_highest(self, mixture: Mixture) -> Medium:
        """The liquid at the highest dose."""
        return mixture.at(float(self.doses.ml.max()))

    def images(self, mixture: Mixture) -> list[Image]:
        """Model images, without gain and offset."""
        return _all(self.forwards, self.media(mixture))

    def scale(self, images: Sequence[Image]) -> tuple[float, list[float]]:
        """The best gain for all, and the best offset of each image."""
        return self._scale([np.asarray(i[s.used], float) for i, s in zip(images, self.observations, strict=True)])

    def residual(self, coordinates: Array) -> Array:
        """Observed less fitted in standard deviations, all images one after the other, then the doses' errors."""
        mixture = self.mixture(coordinates)
        return self._residual(self._pixels(mixture), mixture)

    def residual_and_jacobian(self, coordinates: Array) -> tuple[Array, Array]:
        """The same with its derivatives by the coordinates."""
        mixture = self.mixture(coordinates)
        pixels = self._pixels(mixture)
        turn = np.eye(coordinates.size)
        turn[:3, :3] = ink_slopes(mixture.ink)
        turn[3, 3] = 1.0 / self.length_mm
        by_doses = np.eye(coordinates.size)[:, INK:]
        jacobian = np.hstack([-self.changes(mixture, pixels), by_doses]).T @ turn
        return self._residual(pixels, mixture), jacobian

    def changes(self, mixture: Mixture, pixels: Sequence[Array] | None = None) -> Array:
        """What (ink σa, ink σs, g, water σa, dose errors …) change in all fitted images, in standard deviations.

        Returns
        -------
        (4 + K, n), less what gain and offsets imitate
        """
        pixels = self._pixels(mixture) if pixels is None else pixels
        gain, _ = self._scale(pixels)
        slopes = _all(self.slopes, self.media(mixture))
        parts, ink, doses = [], mixture.ink, self.doses
        for slope, seen, weight, group in zip(slopes, self.observations, self.weights, doses.of_image, strict=True):
            chain = np.zeros((INK + doses.ml.size, 3))
            dose_ml = doses.ml[group] + doses.sd_ml[group] * mixture.off[group]
            chain[[0, 1], [0, 1]] = dose_ml
            chain[2, 2] = chain[3, 0] = 1.0
            chain[INK + group, :2] = doses.sd_ml[group] * np.array([ink.sigma_a, ink.sigma_s])
            parts.append(gain * (chain @ slope[:, seen.used]) * weight)
        return self.unhidden(np.hstack(parts), pixels)

    def unhidden(self, changes: Array, pixels: Sequence[Array]) -> Array:
        """Part of weighted changes (k, n) that no gain and no offsets could make."""
        weights = self.weights
        left = self._centred(changes, weights)
        if self.scaling.gain is None:
            model = self._centred(_weighted(pixels, weights)[None], weights)[0]
            left = left - np.outer(left @ model, model) / float(model @ model)
        return left

    def split(self, stacked: Array) -> list[Array]:
        """Cut (…, n) into the images that it was stacked from."""
        ends = np.cumsum([int(seen.used.sum()) for seen in self.observations])[:-1]
        return np.split(stacked, ends, axis=-1)

    def _pixels(self, mixture: Mixture) -> list[Array]:
        return [np.asarray(i[s.used], float) for i, s in zip(self.images(mixture), self.observations, strict=True)]

    def _scale(self, pixels: Sequence[Array]) -> tuple[float, list[float]]:
        weights, observed = self.weights, [seen.image[seen.used] for seen in self.observations]
        gain = self.scaling.gain
        if gain is None:
            model = self._centred(_weighted(pixels, weights)[None], weights)[0]
            target = _weighted([one - (self.scaling.offset or 0.0) for one in observed], weights)
            gain = float(model @ target) / max(float(model @ model), 1e-300)
        if self.scaling.offset is not None:
            return gain, [self.scaling.offset] * len(weights)
        triples = zip(observed, pixels, weights, strict=True)
        return gain, [float(np.average(seen - gain * one, weights=weight**2)) for seen, one, weight in triples]

    def _residual(self, pixels: Sequence[Array], mixture: Mixture) -> Array:
        gain, offsets = self._scale(pixels)
        parts = zip(self.observations, pixels, offsets, self.weights, strict=True)
        left = [(seen.image[seen.used] - gain * one - offset) * weight for seen, one, offset, weight in parts]
        return np.concatenate([*left, mixture.off])

    def _centred(self, stacked: Array, weights: Sequence[Array]) -> Array:
        """Less what an offset of each image could make."""
        if self.scaling.offset is not None:
            return stacked
        parts = []
        for part, weight in zip(self.split(stacked), weights, strict=True):
            along = weight / np.linalg.norm(weight)
            parts.append(part - np.outer(part @ along, along))
        return np.hstack(parts)


def _weighted(pixels: Sequence[Array], weights: Sequence[Array]) -> Array:
    return np.concatenate([one * weight for one, weight in zip(pixels, weights, strict=True)])


def _all(forwards: Sequence[Forward], media: Sequence[Medium]) -> list[Image]:
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(lambda forward, medium: forward(medium), forwards, media))


def slopes_of(forward: Forward, length_mm: float) -> Forward:
    """Derivatives by σa, σs, g, (3, rows, columns), by differences of first order: at several doses they suffice.

    Within a step of where they were computed last, those are given again: there they are as good as new ones.
    """
    last: list[tuple[Medium, Image]] = []

    def slopes(medium: Medium) -> Image:
        steps = (
            STEP * (medium.sigma_a + 1.0 / length_mm),
            STEP * medium.sigma_s,
            STEP * (1.0 - medium.g) * (1.0 + medium.g),
        )
        named = list(zip(NAMES, steps, strict=True))
        if not last or any(abs(getattr(last[0][0], name) - getattr(medium, name)) > step for name, step in named):
            image = forward(medium)
            near = [forward(replace(medium, **{name: getattr(medium, name) + step})) for name, step in named]
            last[:] = [
                (medium, np.stack([(one - image) / step for one, step in zip(near, steps, strict=True)])),
            ]
        return last[0][1]

    return slopes

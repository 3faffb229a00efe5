"""How well a fit knows what it fitted: camera noise, the model's own error, and what the data leave open.

Fitted values respond to an error ε of the images as δθ = F⁻¹ J W ε, F = Σ J W Jᵀ + P over the images, where J are the
images' derivatives less what gain and offset can imitate, W the weights, and P a weak prior that keeps undetermined
directions finite (standard deviations of ten times σt for σa and σs, 1 for g) or what is known besides. Their
covariance is then

    F⁻¹ (Σ J W ⟨ε εᵀ⟩ W Jᵀ + P P') F⁻¹,

where P' is 1, or t for what is believed t times as firmly as it is known, see `overconfidence`. It needs two small
matrices of each image and nothing else of it, so that what another image would add is known without fitting anything.

Of a model's error, noise of light paths and what prepared models err by are known as they lie (`PatternedError`). The
rest is taken to be random, of the size that the model states pixel by pixel (or that the residual shows, where that is
more, in proportion to the image), counted twice, and smooth: one third of its power at each of the correlation lengths
1/32, 1/8 and 1/2 of the tank's length. White errors of that size would average out over thousands of pixels, which
errors of a model don't; intervals that leave it out are fiction.
"""

import functools
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import NAMES
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Mask = NDArray[np.bool_]

CORRELATION_LENGTHS = (1.0 / 32.0, 1.0 / 8.0, 1.0 / 2.0)
"""Lengths over which the model's error is alike, as shares of the tank's length."""
PATTERN = 2.0
"""A model's error is no random draw: where it looks like a change of the medium it moves coefficients further than
random patterns of its size do (two to three times on dense reference images). It is counted with this factor, where
nothing is known of how it lies."""

DETERMINED = 0.2
"""Relative standard deviation of a coefficient up to which it counts as determined."""
DETERMINED_G = 0.1
"""The same for g, absolute."""

PARTS, PARTS_PER_VALUE = 4, 1.5
"""Parts of an image along each side that are asked whether they agree, and of all of it for each value, where that is
more: 24 values leave sixteen parts next to nothing to disagree by, and that, times sixteen for what they have taken, is
3 to 7 times too much. By 36 parts it is .5 to 1.3 times what noise does that Gaussians of 1/32 to 1/10 of an image's
height have smoothed."""

MOSTLY_NOISE = 0.75
"""Share of what changes tell in one direction that may be taken for their noise: more than that, and nobody knows."""
ROUNDING = 1e-12
"""Share of the products of changes below which a direction has none."""
UNBELIEVED = 1e-4
"""Weight of a prior that has no say."""
END = 1.96
"""Standard deviations at which an interval's end is computed."""
BENT = (0.1, 0.1, 0.05)
"""Half widths of σa and σs (of themselves) and of g from which on an interval may be bent."""
STRETCH = (0.5, 3.0)
"""Smallest and largest factor believed."""


class Whitening(Protocol):
    """What makes the errors of an image's used pixels independent and of size 1: W with W⟨ε εᵀ⟩Wᵀ = 1."""

    def whiten(self, rows: Array) -> Array:
        """W applied to images, (…, n)."""
        ...

    def transposed(self, rows: Array) -> Array:
        """Wᵀ applied to them."""
        ...


class ModelError(Protocol):
    """What a model's image may be off by, units of the observed image: a covariance of its pixels."""

    def whitening(self, noise: Image, used: Mask) -> Whitening:
        """How this error and the camera's noise, (rows, columns), are made 1, as the fit weighs pixels."""
        ...

    def between(self, responses: Array, used: Mask) -> Array:
        """Covariance (k, k) that it gives to what responds so, (k, n) per unit of the image's used pixels."""
        ...


@dataclass(frozen=True)
class Weights:
    """Errors that are independent: one over their standard deviations, (n,)."""

    weight: Array

    def whiten(self, rows: Array) -> Array:
        """In standard deviations."""
        return rows * self.weight

    transposed = whiten


@dataclass(frozen=True)
class SmoothError:
    """An error that is alike over neighbouring pixels; a fit weighs pixels as if it were another in each.

    Parameters
    ----------
    sd
        (rows, columns) standard deviation.
    length
        The tank's, in pixels.
    counted
        Factor by which `between` counts it, see `PATTERN`.
    taller
        Height of a pixel over its width.
    """

    sd: Image
    length: float
    counted: float = PATTERN
    taller: float = 1.0

    @classmethod
    def of(cls, scene: Scene, sd: Image, counted: float = PATTERN) -> "SmoothError":
        """The error of an image of a scene."""
        tall, wide = scene.camera.sides_mm
        return cls(sd, max(scene.tank.size_mm) / scene.camera.pixel_mm, counted, tall / wide)

    def whitening(self, noise: Image, used: Mask) -> Whitening:
        """By its size in each pixel."""
        return Weights(1.0 / np.hypot(noise[used], np.asarray(self.sd[used], float)))

    def between(self, responses: Array, used: Mask) -> Array:
        """Mean over the correlation lengths."""
        grid = np.zeros((len(responses), *used.shape))
        grid[:, used] = responses * (self.counted * self.sd[used])
        along_y, along_x = self.length / math.sqrt(self.taller), self.length * math.sqrt(self.taller)
        parts = [_smooth_products(grid, share * along_y, share * along_x) for share in CORRELATION_LENGTHS]
        mean: Array = np.mean(parts, axis=0)
        return mean


@dataclass(frozen=True)
class PatternedError:
    """Noise of which the patterns are known, as light paths and prepared models show theirs, besides a smooth error.

    Parameters
    ----------
    patterns
        (n, rows, columns): the noise's covariance is the sum of their products.
    smooth
        What else there is.
    """

    patterns: Image
    smooth: SmoothError

    @property
    def sd(self) -> Image:
        """(rows, columns) standard deviation of both."""
        return np.asarray(np.hypot(np.sqrt(np.sum(np.square(self.patterns), axis=0)), self.smooth.sd))

    def whitening(self, noise: Image, used: Mask) -> Whitening:
        """By their size in each pixel."""
        return Weights(1.0 / np.hypot(noise[used], np.asarray(self.sd[used], float)))

    def between(self, responses: Array, used: Mask) -> Array:
        """What the patterns do, one by one, and the rest."""
        moved = responses @ np.asarray(self.patterns[:, used], float).T
        found: Array = moved @ moved.T + self.smooth.between(responses, used)
        return found


def _smooth_products(grid: Array, *lengths: float) -> Array:
    """Σ_ij a_i K_ij b_j for all pairs of (k, rows, columns), K a Gaussian correlation of so many rows and columns."""
    along_y, along_x = (
        np.exp(-0.5 * ((np.arange(count)[:, None] - np.arange(count)) / length) ** 2)
        for count, length in zip(grid.shape[1:], lengths, strict=True)
    )
    products: Array = np.tensordot(grid, along_y @ grid @ along_x, ([1, 2], [1, 2]))
    return products


@dataclass(frozen=True)
class Information:
    """What images say about k values; it adds up from one image to the next.

    Parameters
    ----------
    fisher
        (k, k) Σ J W Jᵀ.
    scatter
        (k, k) Σ J W ⟨ε εᵀ⟩ W Jᵀ: what camera noise and the model's own error do to J W ε.

    Examples
    --------
    >>> one = Information(np.array([[4.0]]), np.array([[4.0]]))
    >>> two = total([one, one])
    >>> bool(np.isclose(two.covariance(np.array([1e6]))[0, 0], 1 / 8))
    True
    """

    fisher: Array
    scatter: Array

    def __add__(self, other: "Information") -> "Information":
        return Information(self.fisher + other.fisher, self.scatter + other.scatter)

    def of(self, chain: Array) -> "Information":
        """About m other values; `chain` (m, k) holds the derivatives of these by those."""
        return Information(chain @ self.fisher @ chain.T, chain @ self.scatter @ chain.T)

    def covariance(self, prior_sd: Array, prior_weight: Array | float = 1.0) -> Array:
        """Covariance of the values, (k, k).

        Parameters
        ----------
        prior_sd
            (k,) standard deviations that were known before; they keep finite what no image determines.
        prior_weight
            (k,) how many times its own precision each of them weighs.
        """
        scale, weight = np.outer(prior_sd, prior_sd), np.broadcast_to(prior_weight, prior_sd.shape)
        sizes, ways = np.linalg.eigh(self.scatter * scale + np.diag(weight**2))
        # Of a root of the scatter, so that rounding leaves no variance negative where nothing is determined.
        root = np.linalg.solve(self.fisher * scale + np.diag(weight), ways * np.sqrt(np.maximum(sizes, 0.0)))
        spread: Array = (root @ root.T) * scale
        return spread


def total(parts: Iterable[Information]) -> Information:
    """What images say together; at least one."""
    return functools.reduce(operator.add, parts)


@dataclass(frozen=True)
class Response:
    """What a fit responds to in one image of n used pixels.

    Parameters
    ----------
    changes
        (k, n) derivatives by the values, whitened, less what gain and offset imitate.
    whitening
        As the fit assumed it.
    used
        (rows, columns), n of them True.
    noise
        (k, k) what noise of the changes adds to their products; None where they have none.
    """

    changes: Array
    whitening: Whitening
    used: Mask
    noise: Array | None = None

    @property
    def fisher(self) -> Array:
        """(k, k) products of the changes, without what their noise adds."""
        products = self.changes @ self.changes.T
        return products if self.noise is None else products - within(products, self.noise)

    def information(self, noise: Image, error: ModelError | None) -> Information:
        """What the image says when these are the camera's noise, (rows, columns), and the model's error."""
        responses = self.whitening.transposed(self.changes)
        by_noise = responses * noise[self.used]
        scatter = by_noise @ by_noise.T
        if error is not None:
            scatter = scatter + error.between(responses, self.used)
        return Information(self.fisher, scatter)


def within(products: Array, noise: Array) -> Array:
    """Noise's share (k, k) of products (k, k) of noisy changes, in no direction more than `MOSTLY_NOISE` of them.

    Of changes J + E with noise E that nothing else shares, products are J Jᵀ + ⟨E Eᵀ⟩ on average: noise looks like
    knowledge, and where it is as large as what tells two values apart, steps go half of the way (errors in variables;
    Fuller 1987).

    Examples
    --------
    >>> within(np.diag([4.0, 1.0]), np.diag([1.0, 5.0])).tolist()
    [[1.0, 0.0], [0.0, 0.75]]
    """
    scale = np.sqrt(np.maximum(np.diag(products), 1e-300))
    sizes, ways = np.linalg.eigh(products / np.outer(scale, scale))
    told = sizes > ROUNDING * sizes[-1]
    sizes, ways = np.sqrt(sizes[told]), ways[:, told]
    shares, turn = np.linalg.eigh((ways.T / sizes[:, None]) @ (noise / np.outer(scale, scale)) @ (ways / sizes))
    back = scale[:, None] * (ways * sizes) @ turn
    return np.asarray((back * np.clip(shares, 0.0, MOSTLY_NOISE)) @ back.T)


@dataclass(frozen=True)
class Sensitivity:
    """What a fit of k values responds to.

    Parameters
    ----------
    responses
        In each image.
    priors
        (k, priors) what projecting gain and offset out leaves of their priors.
    widest
        (k,) standard deviations known before.
    weight
        (k,) how many times its own precision each of them weighs.
    """

    responses: tuple[Response, ...]
    priors: Array
    widest: Array
    weight: Array

    @property
    def changes(self) -> Array:
        """(k, n) of all images, one after the other."""
        return np.hstack([one.changes for one in self.responses])

    @property
    def fisher(self) -> Array:
        """(k, k) of all images."""
        return np.asarray(sum(one.fisher for one in self.responses))

    @property
    def noise(self) -> Array:
        """(k, k) what noise of the changes adds to their products, as far as it is taken for that."""
        return self.changes @ self.changes.T - self.fisher

    @property
    def noise_share(self) -> float:
        """The most that noise makes up of these products in any direction of the values."""
        if all(one.noise is None for one in self.responses):
            return 0.0
        products = (self.changes @ self.changes.T + self.priors @ self.priors.T) * np.outer(self.widest, self.widest)
        noise = self.noise * np.outer(self.widest, self.widest)
        return float(np.max(np.linalg.eigvals(np.linalg.solve(products + np.diag(self.weight), noise)).real))

    def covariance(
        self, noise: Sequence[Image], errors: Sequence[ModelError | None], residual: Array | None = None
    ) -> Array:
        """Covariance of the values, (k, k).

        Parameters
        ----------
        noise
            Standard deviation of the camera's noise in each image, (rows, columns).
        errors
            Of the model, in each image; None where it has none.
        residual
            (n,) of all images, whitened, where it holds structure that these do not explain: then what the parts of
            the images say is taken to differ as it does, see `disagreement`.
        """
        known = Information(self.priors @ self.priors.T, self.priors @ self.priors.T)
        seen = zip(self.responses, noise, errors, strict=True)
        found = total([known, *(one.information(sigma, error) for one, sigma, error in seen)])
        if residual is not None:
            found = replace(found, scatter=found.scatter + self.disagreement(residual))
        return found.covariance(self.widest, self.weight)

    def disagreement(self, residual: Array) -> Array:
        """Scatter (k, k) of J W ε as the parts of the images show it: `PARTS` × `PARTS` of each, more for many values.

        At the optimum what the parts pull at the values adds up to nothing. How hard they pull against each other tells
        how far the values would move if one part or another were not there, whatever the reason: a model that does not
        hold is wrong in one place otherwise than in the next (the covariance of clusters; Liang & Zeger 1986). Parts in
        the same place of several images count as one, for a camera that is off is so in all.
        """
        along = max(PARTS, math.ceil(math.sqrt(PARTS_PER_VALUE * len(self.widest))))
        pulls = np.zeros((len(self.widest), along * along))
        ends = np.cumsum([one.changes.shape[1] for one in self.responses])
        for one, left in zip(self.responses, np.split(residual[: ends[-1]], ends[:-1]), strict=True):
            row, column = (at * along // count for at, count in zip(np.nonzero(one.used), one.used.shape, strict=True))
            for pull, change in zip(pulls, one.changes * left, strict=True):
                pull += np.bincount(row * along + column, change, along * along)
        count = int(np.any(pulls != 0.0, axis=0).sum())
        return np.asarray(pulls @ pulls.T * (count / max(count - len(self.widest), 1)))

    @property
    def assumed(self) -> Array:
        """Covariance that the values would have if errors were as the fit weighs them."""
        known = Information(self.priors @ self.priors.T, self.priors @ self.priors.T)
        return (known + Information(self.fisher, self.fisher)).covariance(self.widest, self.weight)

    def step(self, residual: Array) -> Array:
        """(k,) what the values would move by to explain a residual, (n,) whitened, in the linear model."""
        scale = np.outer(self.widest, self.widest)
        curvature = (self.fisher + self.priors @ self.priors.T) * scale + np.diag(self.weight)
        return np.asarray(np.linalg.solve(curvature, self.widest * (self.changes @ residual)) * self.widest)


def overconfidence(
    sensitivity: Sensitivity, believed: NDArray[np.bool_], noise: Sequence[Image], errors: Sequence[ModelError]
) -> Array:
    """How many times more images seem to tell about each believed value than they do, (believed,).

    A fit weighs pixels as if the model's error were another in each. It is smooth, as a misalignment's own image is: in
    a medium liquid that of light too high is nearly another gain and absorption, an error of 0.3 % looked like
    1.2 ± 0.1 mm, and the prior of ± 0.5 mm had no say. Priors must weigh more by as much as the images weigh too much.

    Parameters
    ----------
    sensitivity
        Of the fit.
    believed
        (k,) which values.
    noise, errors
        As for `Sensitivity.covariance`.
    """
    alone = replace(sensitivity, weight=np.where(believed, UNBELIEVED, sensitivity.weight))
    seems, is_so = (np.diag(one)[believed] for one in (alone.assumed, alone.covariance(noise, errors)))
    return np.asarray(np.maximum(is_so / seems, 1.0))


def identifiable(medium: Medium, spread: Array) -> dict[str, bool]:
    """Which of σa, σs, g the data determine: σs and σa to `DETERMINED` of themselves, g to `DETERMINED_G`."""
    sd = np.sqrt(np.diag(spread))
    return {
        "sigma_a": bool(sd[0] <= DETERMINED * medium.sigma_a),
        "sigma_s": bool(sd[1] <= DETERMINED * medium.sigma_s),
        "g": bool(sd[2] <= DETERMINED_G),
    }


def reduced_scattering(medium: Medium, spread: Array) -> tuple[float, float]:
    """σs(1 − g) and its standard deviation: what thick media tell even where σs and g are lost."""
    slope = np.array([0.0, 1.0 - medium.g, -medium.sigma_s])
    return medium.sigma_s * (1.0 - medium.g), math.sqrt(max(float(slope @ spread @ slope), 0.0))


def extinction(medium: Medium, spread: Array) -> tuple[float, float]:
    """σt = σa + σs and its standard deviation: what thin media tell even where σa and σs are lost."""
    slope = np.array([1.0, 1.0, 0.0])
    return medium.sigma_t, math.sqrt(max(float(slope @ spread @ slope), 0.0))  # below 0 by rounding only


def stretches(
    medium: Medium, spread: Array, residual: Array, changes: Array, changed: Callable[[Medium], Array]
) -> dict[str, tuple[float, float]]:
    """Factors by which an interval's halves are too narrow where the image bends, below and above each coefficient.

    Along the ridge of one coefficient the others follow as the covariance says; the image is computed anew at both ends
    of the normal interval, and what everything else fitted could still take back of the change is taken back in the
    linear model. The factor is the root of the linear deviance over the profile deviance. Where the response is
    straight it is 1, and nothing is computed.

    Parameters
    ----------
    medium
        The optimum.
    spread
        (3, 3) covariance.
    residual
        (n,) at the optimum, whitened.
    changes
        (k, n) derivatives of the fitted image, whitened, less what gain and offset imitate; σa, σs and g come first.
    changed
        (n,) of the same, between another medium and the optimum.
    """
    best = np.array([medium.sigma_a, medium.sigma_s, medium.g])
    sd = np.sqrt(np.diag(spread))
    size = np.array([max(medium.sigma_a, 1e-12), max(medium.sigma_s, 1e-12), 1.0])
    found = {}
    for k, name in enumerate(NAMES):
        if END * sd[k] <= BENT[k] * size[k]:
            continue
        others = np.linalg.qr(np.delete(changes, k, 0).T)[0]
        left = residual - others @ (others.T @ residual)
        straight = changes[k] - others @ (others.T @ changes[k])
        factors = []
        for side in (-1.0, 1.0):
            step = side * END * spread[k] / sd[k]
            by = min(1.0, *_rooms(best, step))
            if by < 0.2:  # the edge is nearer than the interval's end
                factors.append(1.0)
                continue
            sigma_a, sigma_s, g = (float(value) for value in best + by * step)
            change = changed(Medium(sigma_a, sigma_s, g))
            change -= others @ (others.T @ change)
            deviance = float(change @ change) - 2.0 * float(change @ left)
            linear = float(np.sum((by * step[k] * straight) ** 2)) - 2.0 * float(by * step[k] * (straight @ left))
            factor = np.sqrt(max(linear, 0.0) / max(deviance, 1e-300)) if linear > 0.0 else 1.0
            factors.append(float(np.clip(factor, *STRETCH)))
        found[name] = (factors[0], factors[1])
    return found


def _rooms(best: Array, step: Array) -> list[float]:
    """Shares of a step after which σa, σs or g leaves what is allowed."""
    low, high = np.array([0.0, 1e-9, -0.98]), np.array([np.inf, np.inf, 0.98])
    rooms = []
    for at, by, least, most in zip(best, step, low, high, strict=True):
        edge = least if by < 0.0 else most
        rooms.append(0.98 * (edge - at) / by if by else 1.0)
    return [max(float(room), 0.0) for room in rooms]

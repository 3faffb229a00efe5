"""From images of media with many phase functions to a model of all between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from tankrig.light.prepared.assembly import LEFT_OUT, common, leading
from tankrig.light.prepared.phases.answer import THIRD, HighOrders, LowOrder, PhaseAnswer, error_terms
from tankrig.light.prepared.phases.low import LowOrders
from tankrig.light.prepared.phases.plan import PhasePlan
from tankrig.light.prepared.polynomials import values
from tankrig.light.prepared.regression import Fit, Regression
from tankrig.light.prepared.sampling import PathImages

Array = NDArray[np.float64]

SHOWN = 40
"""Phase functions whose images choose the patterns."""
NOISY = 0.1
"""Of the squared difference of two images of a medium: what the product of both is uncertain by, about."""
ROUNDS = 4
"""Of finding the error, each weighed by the last."""


@dataclass(frozen=True)
class PhaseImages:
    """What was computed for a plan.

    Parameters
    ----------
    low
        Orders 1 and 2 at each of the plan's σt.
    checks
        (checks, 2, pixels) of orders 1 and 2 over σs and σs², as a prediction computes them.
    paths
        (2, media, albedos, rows, degrees) orders ≥ 3, by different paths.
    """

    low: list[LowOrders]
    checks: Array
    paths: Array


def assemble(plan: PhasePlan, sampling: PathImages, images: PhaseImages, shape: tuple[int, int]) -> PhaseAnswer:
    """The model that fits the images, and its error."""
    builder = _Builder(plan, sampling, images, shape)
    return builder.answer()


class _Builder:
    """Holds what its steps share."""

    def __init__(self, plan: PhasePlan, sampling: PathImages, images: PhaseImages, shape: tuple[int, int]) -> None:
        self._plan, self._sampling, self._images, self._shape = plan, sampling, images, shape
        self._traits = np.array([plan.traits.of(sample.phase) for sample in plan.paths])
        self._u = np.array([u for u, _ in plan.low_sigma_t])
        self._by_degree = np.linalg.inv(values(self._u, self._u.size - 1))
        at_nodes = [np.array([low.images(one) for one in self._traits]) for low in images.low]
        self._shown = np.array([low[:SHOWN] for low in at_nodes])  # (σt, phases, 2, pixels)
        norms = np.log(np.linalg.norm(at_nodes, axis=-1))  # (σt, phases, 2)
        u, self._v, self._z = plan.places
        here = values(u, self._u.size - 1) @ self._by_degree  # (media, σt)
        self._norms = np.exp(np.einsum("ns,snk->nk", here, norms))
        self._mean_norms = norms.mean(axis=1)

    def answer(self) -> PhaseAnswer:
        plan, count = self._plan, len(self._plan.paths)
        even = np.arange(count) % 2 == 0
        regression = self._regression(self._images.paths.mean(axis=0))
        fits = [regression.fit(used) for used in (np.ones(count, bool), even, ~even)]
        fields = [shown_in_pixels(plan, self._sampling, fit.fields) for fit in fits]
        scales = [
            np.linalg.inv(values(plan.base.albedo_places, len(plan.base.albedos) - 1)) @ one.scale for one in fits
        ]
        patterns = self._patterns(fields, scales)
        rest = HighOrders(plan.excess, plan.products, plan.scale_products, fields[0] @ patterns.T, scales[0])
        once, twice = (self._low_order(order, patterns) for order in (1, 2))
        found = PhaseAnswer(
            plan.base.coordinates, plan.traits, once, twice, rest, patterns.astype(np.float32), self._shape, np.zeros(4)
        )
        error = self._error(regression, fits[1], fits[2], even)
        error += self._beside(found)
        return PhaseAnswer(found.coordinates, found.traits, once, twice, rest, found.patterns, self._shape, error)

    def _regression(self, paths: Array) -> Regression:
        plan, grid = self._plan, self._sampling.grid
        u, v, z = plan.places
        light = np.tile(self._sampling.along.sum(axis=0), grid.rows)
        per_cell = self._sampling.scene.camera.pixel_mm / np.sqrt(grid.cell_mm[0] * grid.cell_mm[1])
        scattering = np.array([sample.sigma_t for sample in plan.paths])[:, None] * np.array(plan.base.albedos)
        exact = sum(scattering**order * self._norms[:, order - 1, None] for order in (1, 2))
        return Regression(
            plan.products.values(u, v, z), plan.scale_products.values(u, v, z),
            np.array([2.0 * sample.batches for sample in plan.paths]), scattering,
            paths.reshape(*paths.shape[:2], -1), light, per_cell * np.asarray(exact),
        )  # fmt: skip

    def _patterns(self, fields: list[Array], scales: list[Array]) -> Array:
        """Orthonormal images that hold all media: those of orders 1 and 2, and what either half of the rest has."""
        plan, phases = self._plan, self._shown.shape[1]
        u, sigma_t = np.repeat(self._u, phases), np.repeat([one for _, one in plan.low_sigma_t], phases)
        v, z = np.tile(self._v[:phases], self._u.size), np.tile(self._z[:phases], (self._u.size, 1))
        products, bright = plan.products.values(u, v, z), plan.scale_products.values(u, v, z)
        low = self._shown.reshape(-1, 2, self._shown.shape[-1])
        shown: list[list[Array]] = [[], [], []]
        albedos = plan.base.albedos
        for albedo in (albedos[0], albedos[-1], *albedos[1:-1:3]):
            w = float(plan.base.coordinates.of(1.0, albedo, 0.0)[0][1])
            sigma_s = albedo * sigma_t[:, None]
            parts = [sigma_s * low[:, 0], sigma_s**2 * low[:, 1]]
            for field, scale in zip(fields, scales, strict=True):
                along = values(w, len(field) - 1)
                brightness = np.exp(bright @ (along @ scale))[:, None] * sigma_s**THIRD
                parts.append(brightness * (products @ np.tensordot(along, field, 1)))
            whole = np.linalg.norm(parts[0] + parts[1] + parts[2], axis=1)[:, None]
            shown[0] += [part / whole for part in parts[:2]]
            shown[1].append(parts[3] / whole)
            shown[2].append(parts[4] / whole)
        enough = LEFT_OUT * plan.tolerance
        first = leading(np.concatenate(shown[0]), enough)
        one, other = (half - (half @ first.T) @ first for half in (np.concatenate(shown[1]), np.concatenate(shown[2])))
        return np.linalg.qr(np.concatenate([first, common(one, other, enough)]).T)[0].T

    def _low_order(self, order: int, patterns: Array) -> LowOrder:
        """An order's form along the patterns, its brightness along u taken out."""
        bright = self._mean_norms[:, order - 1]
        images = patterns.reshape(-1, *self._shape)
        along = [low.once @ patterns.T if order == 1 else low.twice.along(images) for low in self._images.low]
        even = np.array([one / np.exp(by) for one, by in zip(along, bright, strict=True)])
        if order == 2:
            even = 0.5 * (even + even.transpose(0, 2, 1, 3))
        by_degree = np.tensordot(self._by_degree, even, 1)
        return LowOrder(
            order, self._by_degree @ bright,
            np.ascontiguousarray(by_degree if order == 1 else by_degree.transpose(1, 0, 2, 3)).astype(np.float32),
        )  # fmt: skip

    def _error(self, regression: Regression, one: Fit, other: Fit, even: NDArray[np.bool_]) -> Array:
        """What the model errs by at media that it was not made from.

        A model of half the media has not seen the others. Two images of each of these have noise of their own, so the
        mean product of what either differs by from that model is its squared error, without the images' noise. Half of
        its own noise, a quarter of the halves' squared difference, is not in the model of all.
        """
        targets, terms, noises = [], [], []
        for index, albedo_place in enumerate(self._plan.base.albedo_places):
            of_even, of_odd = (self._fitted(regression, fit, index) for fit in (one, other))
            known = np.where(even[:, None], of_odd, of_even)
            first, second = (half[:, index].reshape(len(known), -1) for half in self._images.paths)
            whole = np.linalg.norm(known, axis=1) + regression.exact[:, index]
            squares = np.sum((first - known) * (second - known), axis=1)
            targets.append((squares - 0.25 * np.sum((of_even - of_odd) ** 2, axis=1)) / whole**2)
            noises.append(np.sum((first - second) ** 2, axis=1) / whole**2 * NOISY)
            terms.append(np.array([error_terms(float(albedo_place), z) for z in self._z]))
        target, term, noise = (np.concatenate(one) for one in (targets, terms, noises))
        expected = np.full(target.size, float(np.median(np.abs(target))))
        for _ in range(ROUNDS):
            weight = 1.0 / (expected + noise)
            found: Array = nnls(term * weight[:, None], target * weight)[0]
            expected = term @ found
        return found

    def _fitted(self, regression: Regression, fit: Fit, albedo: int) -> Array:
        bright = np.exp(regression.brightness @ fit.scale[albedo])[:, None]
        cubes = regression.scattering[:, albedo, None] ** 3
        return np.asarray(cubes * bright * (regression.products @ fit.fields[albedo]))

    def _beside(self, answer: PhaseAnswer) -> float:
        """Squared error of orders 1 and 2 together, over 1 plus the mean square of z, by what a prediction computes.

        The median over a few media beside the plan's σt: steep phase functions, whose z are large, err by more.
        """
        squares, traits = [], answer.traits
        for sample, truth in zip(self._plan.checks, self._images.checks, strict=True):
            numbers = traits.of(sample.phase)
            first = answer.once.at(sample.u, numbers[traits.once])[0] @ answer.patterns
            second = answer.twice.at(sample.u, numbers[traits.twice])[0] @ answer.patterns
            found, exact = (sample.sigma_t * (one + sample.sigma_t * two) for one, two in ((first, second), truth))
            unlike = float(np.mean(self._plan.excess.at(numbers[traits.moments]) ** 2))
            squares.append(float(np.sum((found - exact) ** 2) / np.sum(exact**2)) / (1.0 + unlike))
        return float(np.median(squares))


def shown_in_pixels(plan: PhasePlan, sampling: PathImages, fields: Array) -> Array:
    """(degrees in w, products, pixels) of fitted fields (albedos, products, cells)."""
    albedos, products, _ = fields.shape
    pixels = sampling.to_pixels(fields.reshape(albedos * products, *sampling.shape[1:]))
    by_degree = np.linalg.inv(values(plan.base.albedo_places, albedos - 1))
    return np.tensordot(by_degree, pixels.reshape(albedos, products, -1), 1)

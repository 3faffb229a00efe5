"""Orders ≥ 3 of liquids with any phase function, where light or sight may slant and lenses blur: prepared alone.

Orders 1 and 2 are left to whoever asks: there they are no forms of a few numbers, and a fit computes them as they are.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.light.behind_lenses import BehindLenses
from tankrig.light.entering import edged_and_smooth
from tankrig.light.prepared.assembly import LEFT_OUT, common
from tankrig.light.prepared.box import Box, Coordinates
from tankrig.light.prepared.cache import Arrays, Place
from tankrig.light.prepared.phases.answer import THIRD, HighOrders
from tankrig.light.prepared.phases.assembly import shown_in_pixels
from tankrig.light.prepared.phases.plan import PhasePlan
from tankrig.light.prepared.phases.products import Excess
from tankrig.light.prepared.phases.traits import PhaseTraits
from tankrig.light.prepared.polynomials import nodes, values
from tankrig.light.prepared.regression import Fit, Regression
from tankrig.light.prepared.sampling import PathImages
from tankrig.scene import Medium, Scene
from tankrig.scene.optics import ALL_BLACK, PINHOLE
from tankrig.scene.phase_functions import HenyeyGreenstein
from tankrig.scene.phase_table import PhaseFunction
from tankrig.threads import THREADS

Array = NDArray[np.float64]
Progress = Callable[[float], object]

SHOWN = 48
"""Media whose images choose the patterns."""
ROUGH_TABLES = 0.05
"""Tolerance of order 2 where only its size matters, which says how much an image's noise weighs."""
BESIDE = 0.7
"""Coordinates ± of σt at which that is looked at."""
UNFOLLOWED = 1_000_000
"""Seeds from here on are none of training images."""
HIGHEST = PhaseTraits.highest
"""Degree of the last Legendre moment that orders ≥ 3 go by."""


@dataclass(frozen=True, eq=False)
class HighAnswer:
    """Images of orders ≥ 3, as sums of spatial patterns.

    Parameters
    ----------
    sampling
        Of the scene.
    coordinates
        Of the box that it answers for, whose g is the mean cosine.
    rest
        Amplitudes of the patterns.
    patterns
        (patterns, pixels), orthonormal.
    """

    sampling: PathImages
    coordinates: Coordinates
    rest: HighOrders
    patterns: NDArray[np.float32]

    @property
    def box(self) -> Box:
        """Media that it answers for; others are answered as the nearest of them, as bright as their σs is."""
        return self.coordinates.box

    def image(self, medium: Medium) -> Array:
        """(rows, columns) of orders ≥ 3, W/mm²/sr; never negative."""
        place, z, near = self._place(medium)
        found = near.sigma_s**THIRD * (self.rest.at(place, z)[0] @ self.patterns)
        return np.maximum(found, 0.0).reshape(self._shape)

    def image_and_slopes(self, medium: Medium, others: Sequence[PhaseFunction]) -> tuple[Array, Array]:
        """The image, and (2 + others, rows, columns) its derivatives by σa, σs and the share of the way to each of the
        other phase functions."""
        near = self.box.nearest(medium)
        moments, sigma_t, albedo = near.phase_function.moments(HIGHEST), near.sigma_t, near.albedo
        found, by_sigma_t, by_albedo, by_moments = self.rest.of(near, moments, self.coordinates)
        ways = np.array([one.moments(HIGHEST) - moments for one in others]).reshape(-1, moments.size)
        by_sigma_a = by_sigma_t - albedo / sigma_t * by_albedo
        by_sigma_s = by_sigma_t + (1.0 - albedo) / sigma_t * by_albedo
        amplitudes = np.concatenate([[found, by_sigma_a, by_sigma_s], ways @ by_moments])
        images = np.asarray(amplitudes @ self.patterns, float).reshape(-1, *self._shape)
        return np.maximum(images[0], 0.0), images[1:]

    def by_paths(self, medium: Medium, seed: int) -> Array:
        """(pixels,) the same by a lattice of light paths of its own, which none of the model's images has followed."""
        place, _, near = self._place(medium)
        lit = Medium(0.0, near.sigma_t, phase=near.phase_function)
        degree = len(self.sampling.albedos) - 1
        between = values(float(place[1]), degree) @ np.linalg.inv(values(nodes(degree + 1), degree))
        cells = np.tensordot(between, self.sampling.beyond_two(lit, UNFOLLOWED + seed, range(1)), 1)
        return np.asarray(self.sampling.to_pixels(cells[None])[0])

    @property
    def _shape(self) -> tuple[int, int]:
        return self.sampling.scene.camera.shape

    def _place(self, medium: Medium) -> tuple[Array, Array, Medium]:
        """Coordinates u, w, v and z of a medium, or of the nearest one in the box, and that."""
        near = self.box.nearest(medium)
        moments = near.phase_function.moments(HIGHEST)
        place, _ = self.coordinates.of(near.sigma_t, near.albedo, float(moments[1]))
        return place, self.rest.excess.at(moments), near


def high_orders_prepared(
    scene: Scene, box: Box, tolerance: float, progress: Progress = lambda _: None, threads: int = THREADS
) -> HighAnswer:
    """Orders ≥ 3 of a scene for a box, from the cache or made now.

    Parameters
    ----------
    scene
        Any; its medium does not matter. What its faces send back, but for order 1 by way of clear ones, counts as
        higher orders.
    box
        Media to answer for; g is the mean cosine.
    tolerance
        Relative L2 error to aim for, of the whole image.
    progress
        Called with the share of the work that is done, 0 … 1.
    threads
        That it is prepared with.

    Raises
    ------
    CacheError
        When there is no room for it.
    """
    scene = replace(scene, medium=Medium(0.0, 0.01, 0.0), source="")
    place = Place.of("orders above two of any phase function", scene, box, float(tolerance))
    plan = PhasePlan(box, scene.tank.size_mm[0], tolerance, slanted=True)
    sampling = PathImages(scene, plan.base.albedos)
    known = place.kept(place.model)
    if known is not None:
        try:
            return _unpacked(known, plan, sampling)
        except (KeyError, TypeError, ValueError):
            known = None
    place.require_room(8 * int(np.prod(sampling.shape)) * len(plan.paths))
    found = _assembled(plan, sampling, _followed(plan, sampling, progress, threads))
    place.keep(place.model, _packed(found))
    progress(1.0)
    return found


def _followed(plan: PhasePlan, sampling: PathImages, progress: Progress, threads: int) -> Array:
    """(media, albedos, rows, degrees) of the plan's media."""
    images = np.zeros((len(plan.paths), *sampling.shape))
    total, done = sum(sample.batches for sample in plan.paths), 0

    def one(index: int) -> int:
        sample = plan.paths[index]
        medium = Medium(0.0, sample.sigma_t, phase=sample.phase)
        images[index] = sampling.beyond_two(medium, index, range(sample.batches))
        return sample.batches

    pool = ThreadPoolExecutor(threads)
    try:
        for future in as_completed([pool.submit(one, index) for index in range(len(plan.paths))]):
            done += future.result()
            progress(0.95 * done / total)
    finally:
        pool.shutdown(cancel_futures=True)
    return images


def _assembled(plan: PhasePlan, sampling: PathImages, images: Array) -> HighAnswer:
    """The model that fits the images of the plan's media."""
    u, v, z = plan.places
    scattering = np.array([sample.sigma_t for sample in plan.paths])[:, None] * np.array(plan.base.albedos)
    light = np.tile(sampling.along.sum(axis=0), sampling.grid.rows)
    regression = Regression(
        plan.products.values(u, v, z), plan.scale_products.values(u, v, z),
        np.array([float(sample.batches) for sample in plan.paths]), scattering, images.reshape(*images.shape[:2], -1),
        light, _size_of_low_orders(plan, sampling, u, scattering),
    )  # fmt: skip
    even = np.arange(len(images)) % 2 == 0
    fits = [regression.fit(used) for used in (np.ones(len(images), bool), even, ~even)]
    fields = [shown_in_pixels(plan, sampling, one.fields) for one in fits]
    by_degree = np.linalg.inv(values(plan.base.albedo_places, len(plan.base.albedos) - 1))
    one, other = (_shown(plan, regression, *half) for half in zip(fields[1:], fits[1:], strict=True))
    patterns = np.linalg.qr(common(one, other, LEFT_OUT * plan.tolerance).T)[0].T
    rest = HighOrders(
        plan.excess, plan.products, plan.scale_products, fields[0] @ patterns.T, by_degree @ fits[0].scale
    )
    return HighAnswer(sampling, plan.base.coordinates, rest, patterns.astype(np.float32))


def _size_of_low_orders(plan: PhasePlan, sampling: PathImages, u: Array, scattering: Array) -> Array:
    """(media, albedos) L2 norm of orders 1 and 2 in the unit of cells, about: as of Henyey–Greenstein's there.

    Of the beams alone: what walls and lenses add is little, and took a third of a thin dose's model behind glass.
    """
    scene, grid = sampling.scene, sampling.grid
    camera, light = scene.camera, edged_and_smooth(scene)[0].projector
    beams = replace(scene, tank=replace(scene.tank, faces=ALL_BLACK), projector=replace(light, wide_lens=PINHOLE))
    g = 0.5 * sum(plan.box.g)
    sizes = []
    for place in (-BESIDE, BESIDE):
        sigma_t = float(plan.base.coordinates.back([place, 0.0, 0.0])[0])
        medium = Medium(0.0, sigma_t, phase=HenyeyGreenstein(g))
        behind = BehindLenses(replace(beams, medium=medium))
        low = behind.once([medium])[0], behind.twice([medium], ROUGH_TABLES)[0]
        sizes.append([np.linalg.norm(one) / sigma_t**order for order, one in enumerate(low, 1)])
    logarithm = np.log(np.maximum(np.array(sizes), 1e-300))  # (2, orders)
    middle, rise = logarithm.mean(axis=0), (logarithm[1] - logarithm[0]) / (2.0 * BESIDE)
    norms = np.exp(middle + u[:, None] * rise)
    per_cell = math.sqrt(math.prod(camera.sides_mm) / (grid.cell_mm[0] * grid.cell_mm[1]))
    return np.asarray(per_cell * (scattering * norms[:, :1] + scattering**2 * norms[:, 1:]))


def _shown(plan: PhasePlan, regression: Regression, field: Array, fit: Fit) -> Array:
    """Images of some media at the lowest and the highest albedo by one fit, over those media's whole light."""
    few = np.linspace(0, len(regression.products) - 1, min(SHOWN, len(regression.products))).astype(int)
    images = []
    for albedo in (0, -1):
        along = values(float(plan.base.albedo_places[albedo]), len(field) - 1)
        bright = regression.scattering[few, albedo] ** THIRD * np.exp(regression.brightness[few] @ fit.scale[albedo])
        seen = bright[:, None] * (regression.products[few] @ np.tensordot(along, field, 1))
        images.append(seen / (np.linalg.norm(seen, axis=1) + regression.exact[few, albedo])[:, None])
    return np.concatenate(images)


def _packed(answer: HighAnswer) -> Arrays:
    """All that the scene and the plan don't say."""
    rest = answer.rest
    return {
        "patterns": answer.patterns, "mean": rest.excess.mean, "directions": rest.excess.directions,
        "rest": rest.amplitudes, "rest_scale": rest.scale,
    }  # fmt: skip


def _unpacked(arrays: Arrays, plan: PhasePlan, sampling: PathImages) -> HighAnswer:
    """The model again.

    Raises
    ------
    KeyError, TypeError, ValueError
        When the arrays are not those of a model of that plan and scene.
    """
    known = {name: np.asarray(one, np.float32 if name == "patterns" else float) for name, one in arrays.items()}
    albedos, products, count = len(plan.base.albedos), plan.products.size, len(known["patterns"])
    expected = {
        "patterns": (count, math.prod(sampling.scene.camera.shape)), "mean": (HIGHEST - 1,),
        "directions": (HIGHEST - 1, plan.products.directions), "rest": (albedos, products, count),
        "rest_scale": (albedos, plan.scale_products.size),
    }  # fmt: skip
    if count == 0 or any(
        known[name].shape != size or not np.isfinite(known[name]).all() for name, size in expected.items()
    ):
        raise ValueError("not the arrays of prepared orders")
    rest = HighOrders(
        Excess(known["mean"], known["directions"]), plan.products, plan.scale_products, known["rest"],
        known["rest_scale"],
    )  # fmt: skip
    return HighAnswer(sampling, plan.base.coordinates, rest, known["patterns"])

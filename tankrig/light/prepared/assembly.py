"""From images at chosen media to a model that answers for all between."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.light.double import table_error
from tankrig.light.prepared.answer import Answer
from tankrig.light.prepared.low_orders import DARK, interpolated
from tankrig.light.prepared.noise import Noise, signs_of_chance
from tankrig.light.prepared.plan import PreparationPlan
from tankrig.light.prepared.polynomials import values
from tankrig.light.prepared.regression import Regression
from tankrig.light.prepared.sampling import PathImages, order_2_tolerance
from tankrig.light.prepared.term import Term
from tankrig.light.rays import shift_invariant

Array = NDArray[np.float64]

THIRD = 3
MOST_PATTERNS = 32
"""Of orders 1 and 2, and again of the rest."""
LEFT_OUT = 0.025
"""Share of the tolerance that leaving out patterns may cost."""
UNSEEN = 300
"""Media at which the error is estimated, denser towards the box's ends."""
DRAWS = 2
"""Of the noise, by which the error is estimated over the box."""
ERROR_DEGREES = (4, 2, 4)
"""Of its logarithm: within .13 in the root mean square over the whole box; (2, 1, 2) was .28, and 1.1 at most."""


@dataclass(frozen=True)
class Images:
    """What was computed for a plan.

    Parameters
    ----------
    exact, checks
        (media, 2, pixels) orders 1 and 2 on the polynomials' grid, and at other media.
    paths
        (media, albedos, rows, degrees) orders ≥ 3.
    share
        Of the light of orders ≥ 3 that all of these may be off by alike.
    off
        (n, pixels) what orders 1 and 2 may be off by, over their norm: root mean square of the rows.
    """

    exact: Array
    checks: Array
    paths: Array
    share: float = 0.0
    off: NDArray[np.floating] | None = None


def assemble(plan: PreparationPlan, sampling: PathImages, images: Images, shape: tuple[int, int]) -> Answer:
    """The model that fits the images, and its error.

    The error of orders ≥ 3 is what the noise of the images leaves in their fit, see `Noise`, before patterns are
    chosen: where few patterns do, those hold the noise themselves. The error of orders 1 and 2 is seen at media beside
    their grid, and what tables of order 2 err by is added.
    """
    exact = [interpolated(plan.exact, plan.exact_plane, images.exact[:, order - 1], order) for order in (1, 2)]
    regression = _regression(plan, sampling, images.paths, exact)
    count = len(plan.paths)
    even = np.arange(count) % 2 == 0
    fits = [regression.fit(used) for used in (np.ones(count, bool), even, ~even)]
    rest = [_rest_term(plan, sampling, fit.scale, fit.fields) for fit in fits]
    patterns = _patterns(plan, exact, rest, every=shift_invariant(sampling.scene))
    terms = tuple(_projected(term, patterns) for term in (*exact, rest[0]))
    misses = _both(_misses(plan, images.checks, terms[:2], patterns), images.off)
    tables = table_error(sampling.scene, order_2_tolerance(sampling.scene, plan.tolerance))
    fit = fits[0]
    noise = Noise(THIRD, plan.paths_plane, plan.brightness_plane, fit.scale, fit.pull, fit.left)
    if images.share > 0.0:
        noise = noise.and_share(images.share, fit.fields)
    signs = math.sqrt(DRAWS) * signs_of_chance(DRAWS, len(noise.left))
    draws = [_rest_term(plan, sampling, fit.scale, noise.fields(one)) for one in signs]
    beside = math.hypot(tables, float(np.sqrt(np.mean(np.sum(misses**2, axis=1)))))
    error = _error_over_box(plan, draws, terms, beside)
    found = patterns.astype(np.float32), misses.astype(np.float32)
    return Answer(plan.coordinates, terms, found[0], shape, error, noise, found[1], tables)


def _regression(plan: PreparationPlan, sampling: PathImages, paths: Array, exact: list[Term]) -> Regression:
    grid = sampling.grid
    light = np.tile(sampling.along.sum(axis=0), grid.rows)
    per_cell = sampling.scene.camera.pixel_mm / np.sqrt(grid.cell_mm[0] * grid.cell_mm[1])
    places = np.array([sample.place for sample in plan.paths])
    products = plan.exact_plane.values(*places.T)
    sigma_t = np.array([sample.sigma_t for sample in plan.paths])
    norms = np.stack([sigma_t**term.power * np.exp(products @ term.scale[0]) for term in exact])
    powers = np.array(plan.albedos)[:, None] ** np.array([1, 2])
    flat = paths.reshape(*paths.shape[:2], -1)
    batches = np.array([sample.batches for sample in plan.paths], float)
    return Regression(
        plan.paths_plane.values(*places.T), plan.brightness_plane.values(*places.T), batches,
        sigma_t[:, None] * np.array(plan.albedos), flat, light, per_cell * (powers @ norms).T,
    )  # fmt: skip


def _rest_term(plan: PreparationPlan, sampling: PathImages, scale: Array, fields: Array) -> Term:
    """Orders ≥ 3 as polynomials in all three coordinates; their patterns are still pixels."""
    albedos, products, _ = fields.shape
    pixels = sampling.to_pixels(fields.reshape(albedos * products, *sampling.shape[1:]))
    by_degree = np.linalg.inv(values(plan.albedo_places, albedos - 1))
    fields = np.tensordot(by_degree, pixels.reshape(albedos, products, -1), 1)
    return Term(THIRD, plan.paths_plane, plan.brightness_plane, fields, by_degree @ scale)


def _patterns(plan: PreparationPlan, exact: list[Term], rest: list[Term], every: bool) -> Array:
    """Orthonormal images that hold the image all over the box: those of orders 1 and 2, and what the rest adds.

    Parameters
    ----------
    exact
        Orders 1 and 2.
    rest
        The rest as fitted to all media, and to either half.
    every
        Whether what all media show is kept as well, where the halves do not share it: where a path stands for all
        starts along a beam, noise is as small as what is lost with it (five of six dose boxes: .16 to .28 % off, and
        far ends by 5 %, which all are .06 to .17 and 1 without).
    """
    shown: list[list[Array]] = [[], [], [], []]
    for albedo in (plan.albedos[0], plan.albedos[-1], *plan.albedos[1:-1:3]):
        parts = [_shown(plan, term, albedo) for term in (*exact, *rest)]
        whole = np.linalg.norm(np.sum(parts[:3], axis=0), axis=1)[:, None] + DARK
        shown[0] += [part / whole for part in parts[:2]]
        shown[1].append(parts[3] / whole)
        shown[2].append(parts[4] / whole)
        shown[3].append(parts[2] / whole)
    enough = LEFT_OUT * plan.tolerance
    first = leading(np.concatenate(shown[0]), enough)
    one, other, both = (_without(np.concatenate(images), first) for images in shown[1:])
    patterns = np.linalg.qr(np.concatenate([first, common(one, other, enough)]).T)[0].T
    room = MOST_PATTERNS + len(first) - len(patterns)
    if not every or room <= 0:
        return np.asarray(patterns)
    noise = 0.5 * np.linalg.norm(one - other, axis=1)
    unshared = _without(both, patterns) / np.hypot(1.0, noise / enough)[:, None]
    return np.asarray(np.linalg.qr(np.concatenate([patterns, leading(unshared, enough)[:room]]).T)[0].T)


def _without(images: Array, patterns: Array) -> Array:
    """What orthonormal patterns do not hold of images."""
    return np.asarray(images - (images @ patterns.T) @ patterns)


def leading(images: Array, enough: float) -> Array:
    """The fewest patterns without which the images' root mean square is `enough`, but no more than a limit."""
    strength, mixing = np.linalg.eigh(images @ images.T / len(images))
    strength, mixing = np.maximum(strength[::-1], 0.0), mixing[:, ::-1]
    left_out = np.sqrt(strength[::-1].cumsum()[::-1])
    kept = max(1, min(MOST_PATTERNS, int(np.sum(left_out > enough)), int(np.sum(strength > 1e-12 * strength[0]))))
    return np.asarray(mixing[:, :kept].T @ images / np.sqrt(strength[:kept, None] * len(images)))


def common(one: Array, other: Array, enough: float) -> Array:
    """The patterns that two noisy versions of the same images share.

    Eigenvectors of the cross-covariance ½(XᵀY + YᵀX): noise, which is not shared, has eigenvalues of either sign, so
    the most negative one tells how large chance makes them.
    """
    count = len(one)
    noise = 0.5 * np.linalg.norm(one - other, axis=1)
    weight = (1.0 / np.hypot(1.0, noise / enough))[:, None]  # or the noisiest images would choose the patterns
    both = np.concatenate([weight * one, weight * other])
    size, mixing = np.linalg.eigh(both @ both.T / count)
    kept = size > 1e-12 * size[-1]
    size, mixing = size[kept], mixing[:, kept] * np.sqrt(size[kept])
    crossed = mixing[:count].T @ mixing[count:]
    shared, rotation = np.linalg.eigh(0.5 * (crossed + crossed.T))
    chance = max(-float(shared[0]), 1e-4 * enough**2)
    signal = np.flatnonzero(shared > chance)[::-1][:MOST_PATTERNS]
    images = (mixing / size) @ rotation[:, signal]
    return np.asarray(images.T @ both / np.sqrt(count))


def _shown(plan: PreparationPlan, term: Term, albedo: float) -> Array:
    """A term's images at the exact orders' media with one albedo."""
    u, v = np.array([sample.place for sample in plan.exact]).T
    w = plan.coordinates.of(1.0, albedo, 0.0)[0][1]
    field = np.tensordot(values(w, len(term.amplitudes) - 1), term.amplitudes, 1)
    scale = term.scale_plane.values(u, v) @ (values(w, len(term.scale) - 1) @ term.scale)
    scattering = albedo * np.array([sample.sigma_t for sample in plan.exact])
    return np.asarray((np.exp(scale) * scattering**term.power)[:, None] * (term.plane.values(u, v) @ field))


def _projected(term: Term, patterns: Array) -> Term:
    return Term(term.power, term.plane, term.scale_plane, term.amplitudes @ patterns.T, term.scale)


def _only_norms(term: Term) -> Term:
    """A term of far fewer patterns whose sums have the same norms."""
    flat = term.amplitudes.reshape(-1, term.amplitudes.shape[-1])
    factor = np.linalg.qr(flat.T)[1].T
    return replace(term, amplitudes=factor.reshape(*term.amplitudes.shape[:2], -1))


def _misses(plan: PreparationPlan, checks: Array, terms: tuple[Term, ...], patterns: Array) -> Array:
    """(media, pixels) what orders 1 and 2 together are off by at media beside their grid, over their norm."""
    albedo = plan.albedos[0]
    found = []
    for sample, orders in zip(plan.checks, checks, strict=True):
        truth = albedo * orders[0] + albedo**2 * orders[1]
        at = (*plan.coordinates.of(sample.sigma_t, albedo, sample.g), sample.sigma_t, albedo)
        amplitudes = np.sum([term.at(*at)[0] for term in terms], axis=0)
        found.append((amplitudes @ patterns - truth) / np.linalg.norm(truth))
    return np.array(found)


def _both(misses: Array, off: NDArray[np.floating] | None) -> Array:
    """(n, pixels) two kinds of errors, whose squares add up, of which each is the root mean square of its rows."""
    if off is None:
        return misses
    count = len(misses) + len(off)
    return np.concatenate([math.sqrt(count / len(one)) * one for one in (misses, off)])


def _error_over_box(plan: PreparationPlan, draws: list[Term], terms: tuple[Term, ...], beside: float) -> Array:
    """Logarithm of the relative error, as Chebyshev coefficients over the box.

    Parameters
    ----------
    draws
        Of the noise of orders ≥ 3, in pixels.
    terms
        Of the model.
    beside
        Error of orders 1 and 2, of their norm.
    """
    places = np.sin(0.5 * np.pi * np.random.default_rng(1).uniform(-1.0, 1.0, (UNSEEN, 3)))
    logarithms, draws = [], [_only_norms(draw) for draw in draws]
    for place in places:
        sigma_t, albedo, g = (float(value) for value in plan.coordinates.back(place))
        at = (*plan.coordinates.of(sigma_t, albedo, g), sigma_t, albedo)
        *low, rest = (term.at(*at)[0] for term in terms)
        noise = np.sqrt(np.mean([np.sum(draw.at(*at)[0] ** 2) for draw in draws]))
        size = max(float(np.linalg.norm(sum(low) + rest)), DARK)
        logarithms.append(np.log(np.hypot(noise, beside * np.linalg.norm(sum(low))) / size))
    first, second, third = (values(places[:, axis], degree) for axis, degree in enumerate(ERROR_DEGREES))
    products = np.einsum("ni,nj,nk->nijk", first, second, third).reshape(UNSEEN, -1)
    coefficients = np.linalg.lstsq(products, np.array(logarithms), rcond=None)[0]
    beyond = np.exp(np.array(logarithms) - products @ coefficients)
    coefficients[0] += 0.5 * np.log(np.mean(beyond**2))  # from the mean of logarithms to the root mean square
    return np.asarray(coefficients.reshape([degree + 1 for degree in ERROR_DEGREES]))

"""Particles of many sizes as a family of phase functions: what calculated liquids have in common.

Emulsions, milk, clays and cells hold particles whose sizes differ by factors, of one kind or of several. Their phase
functions are smooth, but neither Henyey–Greenstein's nor anything a free phase function expects: of 2,000 calculated
liquids (one to three kinds of spheres, each of a log-normal volume) ln p at 90° is on average .2 to .6 below
Henyey–Greenstein's of the same mean cosine, and the amplitudes of the free shapes are mostly in a few directions. So
the family is the free phase functions whose amplitudes are those liquids' mean for a mean cosine and their principal
components, as a Gaussian has them:

    z(g, x) = m(atanh g) + Σ_k x_k c_k,    x_k expected to be 0 ± 1.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.phase_families import PLACES, Family, amplitudes_of
from tankrig.estimation.spheres import WATER_INDEX, WAVELENGTH_NM
from tankrig.scene.free_phase import FreePhase
from tankrig.scene.mie_series import scattered_by

Array = NDArray[np.float64]

LIQUIDS = 2000
MOST_KINDS = 3
RATIOS = (1.03, 1.05, 1.08, 1.1, 1.15, 1.19, 1.24)
"""Indices over water's: cells, proteins, oil, silica, acrylic, polystyrene, melamine."""
DIAMETERS_UM, STEP = (0.04, 9.0), 0.02
"""Smallest and largest single sphere, and the step from one to the next, as a share."""
MEDIAN_UM, WIDTH = (0.08, 3.0), (0.15, 0.8)
"""Range of the median diameter of a kind, by volume, and of the standard deviation of its logarithm."""
USUAL_G = (0.3, 0.97)
"""Mean cosines of the liquids whose components are taken."""
LEAST_G = 0.05
COMPONENTS, DEGREE = 8, 3
"""Components, of which the last is .09 of an amplitude, and degree of the mean's polynomial."""


def polydisperse() -> Family:
    """atanh of the asymmetry that amplitudes start from, and what they are off those liquids' mean.

    Examples
    --------
    >>> family = polydisperse()
    >>> usual = family.phase(family.like(0.8))
    >>> bool(-0.6 < math.log(usual.at(0.0) / FreePhase(usual.mean_cosine, ()).at(0.0)) < -0.1)
    True
    """
    mean, components = _liquids()
    none, count = np.zeros(COMPONENTS), COMPONENTS

    def usual(base: float) -> Array:
        return np.asarray(_powers(np.clip(base, *np.arctanh((LEAST_G, USUAL_G[1])))) @ mean)

    def member(at: Array) -> FreePhase:
        return FreePhase(math.tanh(float(at[0])), tuple((usual(float(at[0])) + components @ at[1:]).tolist()))

    def coordinates(one: FreePhase) -> Array:
        base, amplitudes = math.atanh(one.base_g), np.zeros(len(components))
        amplitudes[: len(one.amplitudes)] = one.amplitudes
        return np.concatenate([[base], np.linalg.lstsq(components, amplitudes - usual(base), rcond=None)[0]])

    def like(g: float) -> Array:
        return np.concatenate([[math.atanh(min(max(g, LEAST_G), USUAL_G[1]))], none])

    return Family(
        "polydisperse", ("atanh base_g", *(f"component {k}" for k in range(1, count + 1))),
        np.array([-1.8, *(none - 5.0)]), np.array([2.8, *(none + 5.0)]), np.array([0.3, *(none + 1.5)]),
        np.array([0.02, *(none + 0.1)]), np.array([0.5, *(none + 1.0)]), member, coordinates, like,
        np.array([False, *[True] * count]), kind=FreePhase.kind,
    )  # fmt: skip


def _powers(base: float | Array) -> Array:
    return np.asarray(np.power.outer(np.asarray(base, float), np.arange(DEGREE + 1)))


@lru_cache(maxsize=1)
def _liquids() -> tuple[Array, Array]:
    """(powers, shapes) of the mean amplitudes by atanh of the mean cosine, and (shapes, components) in standard
    deviations."""
    base, amplitudes = _drawn(np.random.default_rng(0))
    powers = _powers(base)
    mean = np.asarray(np.linalg.lstsq(powers, amplitudes, rcond=None)[0])
    low, high = np.arctanh(USUAL_G)
    off = (amplitudes - powers @ mean)[(base > low) & (base < high)]
    variances, ways = np.linalg.eigh(np.cov(off.T))
    components = ways * np.sqrt(np.maximum(variances, 0.0))
    return mean, np.asarray(components[:, ::-1][:, :COMPONENTS])


def _drawn(rng: np.random.Generator) -> tuple[Array, Array]:
    """(liquids,) atanh of their mean cosines, and (liquids, shapes) amplitudes of their phase functions about
    Henyey–Greenstein's of these."""
    sizes = np.arange(math.log(DIAMETERS_UM[0]), math.log(DIAMETERS_UM[1]), STEP)
    single = [_single(np.exp(sizes), ratio) for ratio in RATIOS]
    total, forward, whole = (np.concatenate(part) for part in zip(*single, strict=True))
    kinds = (LIQUIDS, MOST_KINDS)
    median, width = rng.uniform(math.log(MEDIAN_UM[0]), math.log(MEDIAN_UM[1]), kinds), rng.uniform(*WIDTH, kinds)
    substance, count = rng.integers(len(RATIOS), size=kinds), rng.integers(1, MOST_KINDS + 1, LIQUIDS)
    light = np.where(np.arange(MOST_KINDS) < count[:, None], rng.exponential(size=kinds), 0.0)
    numbers = np.zeros((LIQUIDS, total.size))
    for kind in range(MOST_KINDS):
        volume = np.exp(-0.5 * ((sizes - median[:, kind, None]) / width[:, kind, None]) ** 2)
        of_kind = np.zeros((LIQUIDS, len(RATIOS), sizes.size))
        of_kind[np.arange(LIQUIDS), substance[:, kind]] = volume * np.exp(-3.0 * sizes)
        of_all = of_kind.reshape(LIQUIDS, -1)
        numbers += of_all * (light[:, kind] / (of_all @ total))[:, None]
    base = np.arctanh(numbers @ forward / (numbers @ total))
    return base, np.array([amplitudes_of(*one) for one in zip(numbers @ whole, base, strict=True)])


def _single(diameters_um: Array, ratio: float) -> tuple[Array, Array, Array]:
    """Cross-sections (n,) of single spheres, these times the mean cosine, and (n, places) times p at `PLACES`."""
    _, whole, _ = scattered_by(diameters_um, ratio, 2e3 * math.pi * WATER_INDEX / WAVELENGTH_NM, PLACES)
    angles = np.arccos(PLACES)
    ring = 2.0 * math.pi * whole * np.sin(angles)
    return np.trapezoid(ring, angles), np.trapezoid(ring * PLACES, angles), whole

"""What all phase functions have in common: a table, and what follows from it.

A phase function says its density p(cos θ) in 1/sr, ∫ p dω = 1. Its table, linear between even steps of s = sin(θ/2),
is dense where p may be steep, and its light between two angles, ∫ 8π p s ds, has a closed form. Mean cosine, Legendre
moments, drawing and the record that kernels read follow from it.
"""

import math
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NODES = 4097
"""Of a table: a step is 0.03° at the forward peak."""
SHARP = 0.005
"""Width of a peak, see `TableRecord`, below which it is as sharp as one with a pole."""
BLUNT = 36
"""Steps of 1° together."""
STEEP, STEEPLY = 64, 30.0
"""Steps, 1.8° together, within which a peak may fall too fast for straight lines between nodes, and by how much it does
then at least: one like 1/θ does by 64."""


class HenyeyGreensteinRecord(NamedTuple):
    """Henyey–Greenstein, for kernels: its asymmetry, and `TableRecord.width`."""

    g: float
    width: float


class TableRecord(NamedTuple):
    """Any other phase function, for kernels.

    Parameters
    ----------
    g
        Mean cosine; also of the Henyey–Greenstein lobes that guide paths, whatever p is.
    width
        tan(θ/2) at which p has fallen to a third from where it is largest, about which quadratures are graded.
    density
        (n,) p in 1/sr at even steps of sin(θ/2) from 0 to 1.
    cosines
        (n,) cos θ of the inverse of the distribution; see `drawn_cosine`.
    """

    g: float
    width: float
    density: Array
    cosines: Array


PhaseRecord = HenyeyGreensteinRecord | TableRecord
"""Kernels tell them apart by their length."""


def henyey_greenstein_record(g: float) -> HenyeyGreensteinRecord:
    """Henyey–Greenstein with asymmetry g, for kernels."""
    return HenyeyGreensteinRecord(float(g), 0.5 * (1.0 - abs(g)))


class PhaseFunction:
    """What all phase functions have in common; see `density`."""

    kind: str
    """What files call it."""

    def density(self, cosine: Array) -> Array:
        """p(cos θ) in 1/sr up to a factor, at an array of cosines."""
        raise NotImplementedError

    def at(self, cosine: Array | float) -> Array:
        """p(cos θ) in 1/sr, as it is used: normalised, and linear in sin(θ/2) between the nodes of its table."""
        return np.interp(np.sqrt(np.clip(0.5 - 0.5 * np.asarray(cosine, float), 0.0, 1.0)), sines(), self.table)

    @cached_property
    def table(self) -> Array:
        """(`NODES`,) p in 1/sr, normalised, at the nodes `sines`."""
        values = self.density(1.0 - 2.0 * sines() ** 2)
        values[0] = _straight_on(self.density, values)
        return np.asarray(values / _light_to(values)[-1])

    def share_within(self, cosine: Array) -> Array:
        """Share of the light that turns by less than θ, for an array of cos θ."""
        sine = np.sqrt(np.clip(0.5 - 0.5 * cosine, 0.0, 1.0))
        step = np.minimum((sine * (NODES - 1)).astype(np.intp), NODES - 2)
        return np.asarray(_light_to(self.table)[step] + _light_in_step(self.table, step, sine))

    @cached_property
    def blunted(self) -> Array:
        """`table`, with what a peak sharper than `SHARP` has in its first `BLUNT` steps spread evenly over them.

        Where p has a pole, paths that by chance end almost in line with a sight carry most of an image's noise: without
        them that of natural waters is a third. Light that has turned before is as good as the same over a degree.
        """
        table = self.table
        if self.record.width >= SHARP:
            return table
        before, beyond = np.zeros(NODES), table.copy()
        before[:BLUNT], beyond[:BLUNT] = 1.0, 0.0
        light, evenly, last = (_light_to(one)[BLUNT] for one in (table, before, beyond))
        return np.asarray(beyond + (light - last) / evenly * before)

    @cached_property
    def mean_cosine(self) -> float:
        """⟨cos θ⟩, which diffusion and reduced scattering know it by."""
        return float(self.moments(1)[1])

    def moments(self, highest: int) -> Array:
        """(highest + 1,) Legendre moments ∫ p P_l dω, the factors that scattering multiplies degree l by (Eq. 11)."""
        return np.asarray(moments_of_nodes(highest) @ self.table)

    @cached_property
    def record(self) -> PhaseRecord:
        """For kernels."""
        table = self.table
        fallen = int(np.argmax(table[:-1] < table[0] / 2.8))  # straight backwards there is no width
        sine = float(sines()[max(fallen, 1)])
        width = sine / math.sqrt(1.0 - sine**2) if fallen else 0.5
        return TableRecord(self.mean_cosine, width, table, _quantiles(table))

    @property
    def path_record(self) -> PhaseRecord:
        """For kernels that follow paths: directions are drawn as by `record`, and p is read off `blunted`."""
        record = self.record
        return record._replace(density=self.blunted) if isinstance(record, TableRecord) else record


@lru_cache(maxsize=1)
def sines() -> Array:
    """sin(θ/2) of the nodes."""
    return np.linspace(0.0, 1.0, NODES)


@lru_cache(maxsize=1)
def phase_quadrature() -> tuple[Array, Array]:
    """Three Gauss points and weights in each step of s = sin(θ/2): exact for what is linear there, times polynomials of
    degree 4; ∫ f dω = ∫ 8π f s ds."""
    points, weights = np.polynomial.legendre.leggauss(3)
    steps, half = sines(), 0.5 / (NODES - 1)
    return (steps[:-1, None] + half * (1.0 + points)).ravel(), np.tile(half * weights, NODES - 1)


@lru_cache(maxsize=8)
def moments_of_nodes(highest: int) -> Array:
    """(highest + 1, NODES): times a table of p, its Legendre moments."""
    nodes, weights = phase_quadrature()
    legendre = (
        np.polynomial.legendre.legvander(1.0 - 2.0 * nodes**2, highest) * (8.0 * math.pi * weights * nodes)[:, None]
    )
    return by_nodes(legendre)


def by_nodes(values: Array) -> Array:
    """(k, NODES) sums over a table that is linear between nodes, of sums over the points of `phase_quadrature`.

    Parameters
    ----------
    values
        (points, k) what each point counts.

    Examples
    --------

    >>> round(float(by_nodes(np.ones((3 * (NODES - 1), 1))).sum()))
    12288
    """
    nodes, _ = phase_quadrature()
    step = np.repeat(np.arange(NODES - 1), 3)
    share = (nodes * (NODES - 1) - step)[:, None]
    found = np.zeros((NODES, values.shape[1]))
    found[:-1] += (values * (1.0 - share)).reshape(NODES - 1, 3, -1).sum(axis=1)
    found[1:] += (values * share).reshape(NODES - 1, 3, -1).sum(axis=1)
    return found.T


def _straight_on(density: Callable[[Array], Array], values: Array) -> float:
    """p at θ = 0 with which the table's first step holds the light that p has there, where p may have a pole.

    Light that falls as fast as from one is more in straight lines between the nodes than there is: .4 % of all light in
    natural waters, which is then taken off the first step.
    """
    share, weights = _towards_pole()
    light = float(weights @ density(1.0 - 2.0 * (share / (NODES - 1)) ** 2))
    if values[1] > STEEPLY * values[STEEP]:
        nodes, quadrature = phase_quadrature()
        few = slice(3, 3 * STEEP)
        there = 8.0 * math.pi * (quadrature * nodes)[few] @ density(1.0 - 2.0 * nodes[few] ** 2)
        straight = _light_to(values)
        light += float(there + straight[1] - straight[STEEP]) * (NODES - 1) ** 2 / (8.0 * math.pi)
    return max(6.0 * light - 2.0 * float(values[1]), 0.0)


@lru_cache(maxsize=1)
def _towards_pole() -> tuple[Array, Array]:
    """Places s in steps of a table, 0 … 1, and weights of ∫ s p ds there: s = x¹², in which a pole like s^−1.9 is
    smooth."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    power, x = 12.0, 0.5 + 0.5 * nodes
    return x**power, 0.5 * weights * power * x ** (2.0 * power - 1.0)


def _light_in_step(table: Array, step: NDArray[np.intp], sine: Array) -> Array:
    """∫ 8π p s ds from where steps begin to `sine`, p linear in s = sin(θ/2)."""
    first, slope = sines()[step], (table[step + 1] - table[step]) * (NODES - 1)
    start = table[step] - slope * first  # p = start + slope s
    return np.asarray(8.0 * math.pi * (0.5 * start * (sine**2 - first**2) + slope * (sine**3 - first**3) / 3.0))


def _light_to(table: Array) -> Array:
    """(NODES,) light that turns by less than each node's θ: ∫ 8π p s ds."""
    step = np.arange(NODES - 1)
    return np.concatenate([[0.0], np.cumsum(_light_in_step(table, step, sines()[1:]))])


def _quantiles(table: Array) -> Array:
    """cos θ at even steps of 1 − (1 − u)^(1/4), u the light that turns by less than θ."""
    turned = _light_to(table)
    wanted = turned[-1] * (1.0 - (1.0 - np.linspace(0.0, 1.0, NODES)) ** 4)
    # Within a step the light goes about as s²: interpolating s² keeps the forward peak's shape.
    rising = np.concatenate([[True], np.diff(turned) > 0.0])
    return np.asarray(1.0 - 2.0 * np.interp(wanted, turned[rising], sines()[rising] ** 2))

"""Phase functions of liquids: families, Mie scattering by particles, tables and mixtures.

Each says its density p(cos θ) in 1/sr, ∫ p dω = 1; `PhaseFunction` works out all else: mean cosine, Legendre moments,
and the record that kernels read.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.checks import CLOSED, number, require

Array = NDArray[np.float64]

NODES = 4097
"""Of a table: a step is 0.03° at the forward peak."""

_UNNORMALISED = 0.02
"""Relative error of a table's own integral that is taken for rounding of its numbers."""
_RATIO = 50.0
"""Of neighbouring values of a table, from which on what is between them is anybody's guess."""


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


def phase_function(cosine: NDArray[np.floating], g: float) -> NDArray[np.floating]:
    """Phase function p(cos θ) in 1/sr, for arrays (Eq. 5 with its exponent corrected to 3/2).

    Parameters
    ----------
    cosine
        cos θ of each scattering, any shape.
    g
        Asymmetry; −1 < g < 1.

    Returns
    -------
    array of the shape and precision of `cosine`

    Examples
    --------
    >>> import numpy as np
    >>> nodes, weights = np.polynomial.legendre.leggauss(200)
    >>> float(np.round(2 * np.pi * np.sum(weights * phase_function(nodes, 0.8)), 9))
    1.0
    """
    cosine = np.asarray(cosine)
    spread = (1.0 - abs(g)) ** 2 + 2.0 * abs(g) * (1.0 - np.sign(g or 1.0) * cosine)
    value: NDArray[np.floating] = (1.0 - g) * (1.0 + g) / (4.0 * np.pi * spread**1.5)
    return value


class PhaseFunction:
    """What all phase functions have in common; see `density`."""

    def density(self, cosine: Array) -> Array:
        """p(cos θ) in 1/sr up to a factor, for an array of cosines."""
        raise NotImplementedError

    def at(self, cosine: Array | float) -> Array:
        """p(cos θ) in 1/sr, as it is used: normalised, and linear in sin(θ/2) between the nodes of its table."""
        return np.interp(np.sqrt(np.clip(0.5 - 0.5 * np.asarray(cosine, float), 0.0, 1.0)), _steps(), self._table)

    @cached_property
    def _table(self) -> Array:
        values = self.density(1.0 - 2.0 * _steps() ** 2)
        values[0] = _straight_on(self.density, float(values[1]))
        return _normalised(values)

    def share_within(self, cosine: Array) -> Array:
        """Share of the light that turns by less than θ, for an array of cos θ."""
        sine = np.sqrt(np.clip(0.5 - 0.5 * cosine, 0.0, 1.0))
        steps, table = _steps(), self._table
        slopes = np.diff(table) * (NODES - 1)
        starts = table[:-1] - slopes * steps[:-1]  # p = start + slope s in each step

        def until(step: NDArray[np.intp], s: Array) -> Array:
            """∫ 8π p s ds of a step from where it begins to s."""
            first = steps[step]
            light = 0.5 * starts[step] * (s**2 - first**2) + slopes[step] * (s**3 - first**3) / 3.0
            return np.asarray(8.0 * math.pi * light)

        every = np.arange(NODES - 1)
        before = np.concatenate([[0.0], np.cumsum(until(every, steps[1:]))])
        at = np.minimum((sine * (NODES - 1)).astype(np.intp), NODES - 2)
        return np.asarray((before[at] + until(at, sine)) / before[-1])

    @cached_property
    def mean_cosine(self) -> float:
        """⟨cos θ⟩, which diffusion and reduced scattering know it by."""
        return float(self.moments(1)[1])

    def moments(self, highest: int) -> Array:
        """(highest + 1,) Legendre moments ∫ p P_l dω, the factors that scattering multiplies degree l by (Eq. 11)."""
        nodes, weights = _quadrature()
        weighted = weights * np.interp(nodes, _steps(), self._table) * 8.0 * math.pi * nodes
        return np.asarray(np.polynomial.legendre.legvander(1.0 - 2.0 * nodes**2, highest).T @ weighted)

    @cached_property
    def record(self) -> PhaseRecord:
        """For kernels."""
        table = self._table
        fallen = int(np.argmax(table < table[0] / 2.8))
        sine = float(_steps()[max(fallen, 1)])
        width = sine / math.sqrt(1.0 - sine**2) if fallen else 0.5
        return TableRecord(self.mean_cosine, width, table, _quantiles(table))


@dataclass(frozen=True)
class HenyeyGreenstein(PhaseFunction):
    """p = (1 − g²) / (4π (1 + g² − 2 g cos θ)^(3/2)) (Henyey and Greenstein 1941).

    Parameters
    ----------
    g
        Mean cosine, −1 < g < 1.

    Examples
    --------
    >>> HenyeyGreenstein(0.8).moments(3).round(6).tolist()
    [1.0, 0.8, 0.64, 0.512]
    """

    __pydantic_config__ = CLOSED
    g: float
    kind: Literal["henyey-greenstein"] = field(default="henyey-greenstein", repr=False)

    def __post_init__(self) -> None:
        g = number(self, "g")
        require(-1.0 < g < 1.0, f"g = {g} is outside −1 < g < 1; give the mean cosine of one scattering")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        return np.asarray(phase_function(cosine, self.g))

    def at(self, cosine: Array | float) -> Array:
        """p(cos θ) in 1/sr, by its formula."""
        return self.density(np.asarray(cosine, float))

    @cached_property
    def mean_cosine(self) -> float:
        """⟨cos θ⟩ = g."""
        return self.g

    def moments(self, highest: int) -> Array:
        """(highest + 1,) powers of g."""
        return np.asarray(np.power(self.g, np.arange(highest + 1)))

    @cached_property
    def record(self) -> PhaseRecord:
        """For kernels."""
        return henyey_greenstein_record(self.g)


@dataclass(frozen=True)
class TwoTerm(PhaseFunction):
    """A forward and a backward Henyey–Greenstein lobe.

    Parameters
    ----------
    forward, backward
        Their asymmetries, 0 ≤ forward < 1, −1 < backward ≤ 0.
    share
        Of the light in the forward lobe, 0 … 1.

    Examples
    --------
    >>> round(TwoTerm(0.9, -0.4, 0.9).mean_cosine, 4)
    0.77
    """

    __pydantic_config__ = CLOSED
    forward: float
    backward: float
    share: float
    kind: Literal["two-term"] = field(default="two-term", repr=False)

    def __post_init__(self) -> None:
        forward, backward, share = (number(self, name) for name in ("forward", "backward", "share"))
        require(0.0 <= forward < 1.0, f"forward = {forward} is outside 0 … 1; give the forward lobe's asymmetry")
        require(-1.0 < backward <= 0.0, f"backward = {backward} is outside −1 … 0; give the backward lobe's asymmetry")
        require(0.0 <= share <= 1.0, f"share = {share} is outside 0 … 1; give the forward lobe's share of the light")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        ahead, back = phase_function(cosine, self.forward), phase_function(cosine, self.backward)
        return np.asarray(self.share * ahead + (1.0 - self.share) * back)


@dataclass(frozen=True)
class ReynoldsMcCormick(PhaseFunction):
    """p ∝ (1 + g² − 2 g cos θ)^−(1+α) (Reynolds and McCormick 1980); Henyey–Greenstein at α = 1/2.

    Parameters
    ----------
    g
        0 < g < 1; the mean cosine only at α = 1/2.
    alpha
        > −1/2.

    Examples
    --------
    >>> round(ReynoldsMcCormick(0.7, 0.5).mean_cosine, 5)
    0.7
    """

    __pydantic_config__ = CLOSED
    g: float
    alpha: float
    kind: Literal["reynolds-mccormick"] = field(default="reynolds-mccormick", repr=False)

    def __post_init__(self) -> None:
        g, alpha = (number(self, name) for name in ("g", "alpha"))
        require(0.0 < g < 1.0, f"g = {g} is outside 0 … 1")
        require(-0.5 < alpha <= 20.0, f"alpha = {alpha} is outside −0.5 … 20; Henyey–Greenstein is 0.5")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        spread = ((1.0 - self.g) ** 2 + 2.0 * self.g * (1.0 - cosine)) / (1.0 + self.g) ** 2
        return np.asarray(spread ** -(1.0 + self.alpha))


@dataclass(frozen=True)
class FournierForand(PhaseFunction):
    """Particles with a Junge distribution of sizes, as in natural waters (Fournier and Forand 1994; Jonasz 1999).

    Parameters
    ----------
    index
        Of the particles relative to the water, 1 … 1.35.
    slope
        Of the sizes' distribution, 3 … 5.

    Examples
    --------
    >>> 0.9 < FournierForand(1.1, 3.5835).mean_cosine < 0.95
    True
    """

    __pydantic_config__ = CLOSED
    index: float
    slope: float
    kind: Literal["fournier-forand"] = field(default="fournier-forand", repr=False)

    def __post_init__(self) -> None:
        index, slope = (number(self, name) for name in ("index", "slope"))
        require(1.0 < index <= 1.35, f"index = {index} is outside 1 … 1.35; give particles over water")
        require(3.0 < slope < 5.0, f"slope = {slope} is outside 3 … 5; give the Junge exponent of the sizes")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        squared = np.maximum(2.0 - 2.0 * cosine, 1e-15)  # u² with u = 2 sin(θ/2); p has a pole at 0
        power = 0.5 * (3.0 - self.slope)
        delta, behind = (one / (3.0 * (self.index - 1.0) ** 2) for one in (squared, 4.0))
        delta = np.where(np.abs(delta - 1.0) < 1e-6, 1.0 + 1e-6, delta)  # 0/0 there
        raised = delta**power
        peak = power * (1.0 - delta) - (1.0 - raised)
        peak += 4.0 / squared * (delta * (1.0 - raised) - power * (1.0 - delta))
        forward = peak / (4.0 * math.pi * (1.0 - delta) ** 2 * raised)
        behind_raised = behind**power
        backward = (1.0 - behind_raised) / (16.0 * math.pi * (behind - 1.0) * behind_raised) * (3.0 * cosine**2 - 1.0)
        return np.asarray(np.maximum(forward + backward, 0.0))


@dataclass(frozen=True)
class Tabulated(PhaseFunction):
    """As an instrument or another program gives it: p at cosines, linear between them.

    Parameters
    ----------
    cosines
        From −1 to 1, rising.
    values
        p there, in 1/sr; a scale that is off by less than 2 % counts as rounding.

    Examples
    --------
    >>> round(Tabulated((-1.0, 1.0), (0.05305, 0.1061)).mean_cosine, 4)
    0.1111
    """

    __pydantic_config__ = CLOSED
    cosines: tuple[float, ...]
    values: tuple[float, ...]
    kind: Literal["table"] = field(default="table", repr=False)

    def __post_init__(self) -> None:
        x, p = np.array(self.cosines, float), np.array(self.values, float)
        require(x.size == p.size and x.size >= 2, f"the table has {x.size} cosines and {p.size} values; give pairs")
        require(bool(np.isfinite(x).all() and np.isfinite(p).all()), "the table holds a number that is not finite")
        require(bool((np.diff(x) > 0.0).all()), "the table's cosines do not rise; sort its rows, each cosine once")
        require(
            x[0] <= -0.9999 and x[-1] >= 0.9999,
            f"the table's cosines go from {x[0]:g} to {x[-1]:g}; give all from −1 to 1",
        )
        require(bool((p >= 0.0).all()), f"the table has a negative value, {p.min():g}; a density is zero or more")
        require(bool(p.max() > 0.0), "the table is zero everywhere")
        low, high = np.minimum(p[1:], p[:-1]), np.maximum(p[1:], p[:-1])
        steep = high > _RATIO * low + 1e-3 * float(p.mean())
        require(
            not steep.any(),
            f"the table is too coarse about cosine {x[1:][steep][0] if steep.any() else 0.0:.6g}: p changes by more "
            f"than {_RATIO:g} times from row to row; give more rows there",
        )
        integral = 2.0 * math.pi * float(np.trapezoid(p, x))
        require(
            abs(integral - 1.0) <= _UNNORMALISED,
            f"the table's integral over all directions is {integral:.4g} and not 1; scale its values, in 1/sr",
        )

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        return np.interp(cosine, self.cosines, self.values)


@dataclass(frozen=True)
class Mie(PhaseFunction):
    """Spheres in water in unpolarised light, by `miepython`.

    Parameters
    ----------
    diameter_um
        Of the spheres: the mean by number.
    particle_index, water_index
        Refractive indices.
    wavelength_nm
        Of the light, in vacuum.
    spread
        Standard deviation of the diameters over their mean (log-normal); 0: all alike.
    band_nm
        Full width at half maximum of the light's band (Gaussian); 0: one wavelength.

    Examples
    --------
    >>> round(Mie(1.0, 1.5868, 1.3317, 633.0).mean_cosine, 3)
    0.918
    """

    __pydantic_config__ = CLOSED
    diameter_um: float
    particle_index: float
    water_index: float
    wavelength_nm: float
    spread: float = 0.0
    band_nm: float = 0.0
    kind: Literal["mie"] = field(default="mie", repr=False)

    def __post_init__(self) -> None:
        names = ("diameter_um", "particle_index", "water_index", "wavelength_nm", "spread", "band_nm")
        diameter, particle, water, wavelength, spread, band = (number(self, name) for name in names)
        require(0.001 <= diameter <= 50.0, f"diameter_um = {diameter} is outside 0.001 … 50")
        require(1.0 <= particle <= 4.0, f"particle_index = {particle} is outside 1 … 4")
        require(1.0 <= water <= 2.0, f"water_index = {water} is outside 1 … 2")
        require(particle != water, "particle_index equals water_index: such spheres scatter nothing")
        require(200.0 <= wavelength <= 2000.0, f"wavelength_nm = {wavelength} is outside 200 … 2000")
        require(0.0 <= spread <= 0.6, f"spread = {spread} is outside 0 … 0.6; give a share of the diameter")
        require(0.0 <= band < wavelength, f"band_nm = {band} is negative or as wide as the wavelength")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        return np.asarray(np.interp(np.sqrt(0.5 - 0.5 * cosine), _steps(), _spheres(self)[1]))

    @cached_property
    def cross_section_um2(self) -> float:
        """Mean scattering cross-section of a sphere, µm²."""
        return _spheres(self)[0]


@dataclass(frozen=True)
class Mixture(PhaseFunction):
    """Liquids in one tank, each with its own phase function.

    Parameters
    ----------
    parts
        Phase functions.
    shares
        Of the scattering coefficient, which add up to 1.
    """

    parts: tuple[PhaseFunction, ...]
    shares: tuple[float, ...]

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        return np.asarray(sum(share * part.at(cosine) for part, share in zip(self.parts, self.shares, strict=True)))


class _ByKind:
    """Has a file's `kind` choose; pydantic itself is loaded when a file is read, and not with every scene."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic import Discriminator

        return handler.generate_schema(Annotated[source, Discriminator("kind")])


AnyPhase = Annotated[HenyeyGreenstein | TwoTerm | ReynoldsMcCormick | FournierForand | Tabulated | Mie, _ByKind()]
"""Those that files name by their `kind`."""


@lru_cache(maxsize=1)
def _steps() -> Array:
    """sin(θ/2) of the nodes."""
    return np.linspace(0.0, 1.0, NODES)


@lru_cache(maxsize=1)
def _quadrature() -> tuple[Array, Array]:
    """Three Gauss points in each step of sin(θ/2): exact for what is linear there, times polynomials of degree 4."""
    points, weights = np.polynomial.legendre.leggauss(3)
    steps, half = _steps(), 0.5 / (NODES - 1)
    return (steps[:-1, None] + half * (1.0 + points)).ravel(), np.tile(half * weights, NODES - 1)


def _straight_on(density: Callable[[Array], Array], first: float) -> float:
    """p at θ = 0 with which the table's first step holds the light that p has there, where p may have a pole."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    power = 12.0  # s = h x¹²: a pole like s^−1.9 is smooth in x
    x = 0.5 + 0.5 * nodes
    share = x**power
    light = float(0.5 * weights @ (power * x ** (2.0 * power - 1.0) * density(1.0 - 2.0 * (share / (NODES - 1)) ** 2)))
    return max(6.0 * light - 2.0 * first, 0.0)


def _normalised(table: Array) -> Array:
    """Scaled so that 8π ∫ p s ds = 1, s = sin(θ/2)."""
    nodes, weights = _quadrature()
    return np.asarray(table / float(weights @ (8.0 * math.pi * nodes * np.interp(nodes, _steps(), table))))


def _quantiles(table: Array) -> Array:
    """cos θ at even steps of 1 − (1 − u)^(1/4), u the light that turns by less than θ."""
    steps = _steps()
    low, high, width = table[:-1], table[1:], steps[1] - steps[0]
    # ∫ 8π p s ds over a step, p linear in s.
    mean, slope = 0.5 * (low + high), (high - low) / width
    middle = 0.5 * (steps[:-1] + steps[1:])
    masses = 8.0 * math.pi * width * (mean * middle + slope * width**2 / 12.0)
    turned = np.concatenate([[0.0], np.cumsum(masses)])
    turned /= turned[-1]
    wanted = 1.0 - (1.0 - np.linspace(0.0, 1.0, NODES)) ** 4
    # Within a step the light goes about as s²: interpolating s² keeps the forward peak's shape.
    rising = np.concatenate([[True], np.diff(turned) > 0.0])
    return np.asarray(1.0 - 2.0 * np.interp(wanted, turned[rising], steps[rising] ** 2))


@lru_cache(maxsize=64)
def _spheres(mie: Mie) -> tuple[float, Array]:
    """Mean scattering cross-section in µm², and p at the nodes, by the coefficients of Mie's series."""
    import miepython

    ratio = mie.particle_index / mie.water_index
    kinds = [(light * number, diameter, 2e3 * math.pi * mie.water_index / wavelength)
             for wavelength, light in _band(mie) for diameter, number in _diameters(mie)]  # fmt: skip
    series = [miepython.coefficients(ratio, 0.5 * diameter * per_um) for _, diameter, per_um in kinds]
    odd, even = _angular(max(len(a) for a, _ in series))
    total, density = 0.0, np.zeros(NODES)
    for (share, _, per_um), (a, b) in zip(kinds, series, strict=True):
        n = np.arange(1, len(a) + 1)
        by = (2.0 * n + 1.0) / (n * (n + 1.0))
        across = (by * a) @ odd[: len(a)] + (by * b) @ even[: len(a)]
        along = (by * a) @ even[: len(a)] + (by * b) @ odd[: len(a)]
        density += share / (2.0 * per_um**2) * (np.abs(across) ** 2 + np.abs(along) ** 2)
        total += share * 2.0 * math.pi / per_um**2 * float((2.0 * n + 1.0) @ (np.abs(a) ** 2 + np.abs(b) ** 2))
    require(bool(np.isfinite(density).all() and 0.0 < total < math.inf), f"Mie's series fails for {mie}")
    return total, density / total


def _angular(terms: int) -> tuple[Array, Array]:
    """(terms, NODES) angular functions π_n and τ_n at the nodes (Bohren and Huffman 1983, Eq. 4.47)."""
    cosine = 1.0 - 2.0 * _steps() ** 2
    odd, even = np.zeros((terms + 1, NODES)), np.zeros((terms + 1, NODES))
    odd[1], even[1] = 1.0, cosine
    for n in range(2, terms + 1):
        odd[n] = ((2 * n - 1) * cosine * odd[n - 1] - n * odd[n - 2]) / (n - 1)
        even[n] = n * cosine * odd[n] - (n + 1) * odd[n - 1]
    return odd[1:], even[1:]


def _diameters(mie: Mie) -> list[tuple[float, float]]:
    """Diameters in µm with shares of the number."""
    if mie.spread == 0.0:
        return [(mie.diameter_um, 1.0)]
    width = math.sqrt(math.log1p(mie.spread**2))
    count = 9 + 2 * math.ceil(60.0 * width)
    at = np.linspace(-4.0, 4.0, count)
    shares = np.exp(-0.5 * at**2)
    return list(zip(mie.diameter_um * np.exp(width * at - 0.5 * width**2), shares / shares.sum(), strict=True))


def _band(mie: Mie) -> list[tuple[float, float]]:
    """Wavelengths in nm with shares of the light."""
    if mie.band_nm == 0.0:
        return [(mie.wavelength_nm, 1.0)]
    at = np.linspace(-2.5, 2.5, 11)
    shares = np.exp(-0.5 * at**2)
    return list(zip(mie.wavelength_nm + mie.band_nm / 2.3548 * at, shares / shares.sum(), strict=True))

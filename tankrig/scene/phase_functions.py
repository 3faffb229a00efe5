"""Phase functions that files name by their kind: families, tables, and mixtures of any."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tankrig.ranges import Within
from tankrig.scene.checks import CLOSED, in_ranges, require
from tankrig.scene.mie import Mie
from tankrig.scene.phase_table import PhaseFunction, PhaseRecord, henyey_greenstein_record

Array = NDArray[np.float64]

_UNNORMALISED = 0.02
"""Relative error of a table's own integral that is taken for rounding of its numbers."""
_RATIO = 50.0
"""Of neighbouring values of a table, from which on what is between them is anybody's guess."""


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
    g: Annotated[
        float,
        Within(-1.0, 1.0, "is outside −1 < g < 1; give the mean cosine of one scattering", above=True, below=True),
    ]
    kind: Literal["henyey-greenstein"] = field(default="henyey-greenstein", repr=False)

    def __post_init__(self) -> None:
        in_ranges(self)

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
    forward: Annotated[float, Within(0.0, 1.0, "is outside 0 ≤ forward < 1; give that lobe's asymmetry", below=True)]
    backward: Annotated[
        float, Within(-1.0, 0.0, "is outside −1 < backward ≤ 0; give that lobe's asymmetry", above=True)
    ]
    share: Annotated[float, Within(0.0, 1.0, "is outside 0 … 1; give the forward lobe's share of the light")]
    kind: Literal["two-term"] = field(default="two-term", repr=False)

    def __post_init__(self) -> None:
        in_ranges(self)

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
    g: Annotated[float, Within(0.0, 1.0, "is outside 0 < g < 1; give the family's own g", above=True, below=True)]
    alpha: Annotated[float, Within(-0.5, 20.0, "is outside −0.5 < alpha ≤ 20; Henyey–Greenstein is 0.5", above=True)]
    kind: Literal["reynolds-mccormick"] = field(default="reynolds-mccormick", repr=False)

    def __post_init__(self) -> None:
        in_ranges(self)

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
    index: Annotated[float, Within(1.0, 1.35, "is outside 1 < index ≤ 1.35; give particles over water", above=True)]
    slope: Annotated[
        float,
        Within(3.0, 5.0, "is outside 3 < slope < 5; give the Junge exponent of the sizes", above=True, below=True),
    ]
    kind: Literal["fournier-forand"] = field(default="fournier-forand", repr=False)

    def __post_init__(self) -> None:
        in_ranges(self)

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
        require(x.size == p.size and x.size >= 2, f"cosines are {x.size} and values {p.size}; give at least two pairs")
        require(
            bool(np.isfinite(x).all() and np.isfinite(p).all()),
            "cosines or values hold a number that is not finite; mend it",
        )
        require(bool((np.diff(x) > 0.0).all()), "cosines do not rise; sort them, each once")
        require(
            x[0] <= -0.9999 and x[-1] >= 0.9999,
            f"cosines go from {x[0]:g} to {x[-1]:g}; give all from −1 to 1",
        )
        require(bool((p >= 0.0).all()), f"values have a negative one, {p.min():g}; give densities of zero or more")
        require(bool(p.max() > 0.0), "values are zero everywhere; give densities in 1/sr")
        low, high = np.minimum(p[1:], p[:-1]), np.maximum(p[1:], p[:-1])
        steep = high > _RATIO * low + 1e-3 * float(p.mean())
        require(
            not steep.any(),
            f"cosines are too coarse about {x[1:][steep][0] if steep.any() else 0.0:.6g}: p changes by more "
            f"than {_RATIO:g} times from row to row; give more rows there",
        )
        integral = 2.0 * math.pi * float(np.trapezoid(p, x))
        require(
            abs(integral - 1.0) <= _UNNORMALISED,
            f"values have the integral {integral:.4g} over all directions and not 1; scale them, in 1/sr",
        )

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        return np.interp(cosine, self.cosines, self.values)


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
    kind: Literal["mixture"] = field(default="mixture", repr=False)

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        return np.asarray(sum(share * part.at(cosine) for part, share in zip(self.parts, self.shares, strict=True)))


class _ByKind:
    """Has a file's `kind` choose; pydantic itself is loaded when a file is read, and not with every scene."""

    def __get_pydantic_core_schema__(self, _: Any, handler: Any) -> Any:
        from pydantic import Discriminator

        named = HenyeyGreenstein | TwoTerm | ReynoldsMcCormick | FournierForand | Tabulated | Mie
        return handler.generate_schema(Annotated[named, Discriminator("kind")])


AnyPhase = Annotated[PhaseFunction, _ByKind()]
"""Any phase function; in files one of those that have a `kind` there."""

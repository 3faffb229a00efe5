"""A phase function of no family: Henyey–Greenstein times the exponential of smooth shapes.

    ln p(θ) = ln p_HG(θ; g) + Σ_k z_k √λ_k ψ_k(θ) + a constant that normalises it,

with the eigenfunctions ψ_k and eigenvalues λ_k of a Gaussian process over u = ln(θ + 30°) whose values have a standard
deviation of `SPREAD` and are alike over `ALIKE` in u: 4° straight on, 16° at a right angle. Amplitudes z that are
independently normal with standard deviation 1 are what is expected before anything was seen (Karhunen and Loève; their
even part, which normalising takes back, is left out).
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from tankrig.ranges import Within
from tankrig.scene.checks import CLOSED, in_ranges, numbers, require
from tankrig.scene.phase_functions import phase_function
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

SHAPES = 16
"""The next ones are below .03 of ln p."""
SPREAD = 1.0
"""Of ln p about Henyey–Greenstein: beads of .2 to 2 µm are within a factor of 1.1 to 5 of it."""
ALIKE = 0.13
"""Beads of .5 µm are then described to .04 of ln p, 1 µm to .17, milk-like droplets to .005. Finer shapes describe them
better, and fits of images lose their way among them (decision 209)."""
FORWARD_DEG = 30.0
_PLACES = 400


@dataclass(frozen=True)
class FreePhase(PhaseFunction):
    """A phase function of no family; see the top of this file.

    Parameters
    ----------
    base_g
        Asymmetry of the Henyey–Greenstein function that it starts from; the mean cosine only where all amplitudes are
        zero.
    amplitudes
        z_k, at most `SHAPES` of them.
    alike
        Distance in u over which the shapes are alike.

    Examples
    --------
    >>> round(FreePhase(0.8, (0.0, 0.0)).mean_cosine, 5)
    0.8
    """

    __pydantic_config__ = CLOSED
    base_g: Annotated[float, Within(-1.0, 1.0, "is outside −1 < base_g < 1", above=True, below=True)]
    amplitudes: tuple[float, ...]
    alike: Annotated[float, Within(0.02, 2.0, "is outside 0.02 … 2")] = ALIKE
    kind: Literal["free"] = field(default="free", repr=False)

    def __post_init__(self) -> None:
        in_ranges(self)
        amplitudes = numbers(self, "amplitudes", len(self.amplitudes))
        require(len(amplitudes) <= SHAPES, f"amplitudes has {len(amplitudes)} numbers; give {SHAPES} at most")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        places, shapes = _shapes(self.alike)
        log = np.interp(_place(cosine), places, np.array(self.amplitudes) @ shapes[: len(self.amplitudes)])
        return np.asarray(phase_function(cosine, self.base_g) * np.exp(log))


@dataclass(frozen=True)
class Shaped(PhaseFunction):
    """Another phase function times the exponential of the shapes of a free one.

    Parameters
    ----------
    base
        The other.
    amplitudes
        z_k, at most `SHAPES` of them.

    Examples
    --------
    >>> from tankrig.scene.phase_functions import TwoTerm
    >>> one, none = TwoTerm(0.9, -0.3, 0.95), (0.0, 0.0)
    >>> bool(abs(Shaped(one, none).mean_cosine - one.mean_cosine) < 1e-9)
    True
    """

    __pydantic_config__ = CLOSED
    base: PhaseFunction
    amplitudes: tuple[float, ...]
    kind: Literal["shaped"] = field(default="shaped", repr=False)

    def __post_init__(self) -> None:
        require(len(self.amplitudes) <= SHAPES, f"amplitudes has {len(self.amplitudes)} numbers; give {SHAPES} at most")

    def density(self, cosine: Array) -> Array:
        """See `PhaseFunction.density`."""
        shapes = shapes_at(cosine)[: len(self.amplitudes)]
        return np.asarray(self.base.density(cosine) * np.exp(np.array(self.amplitudes) @ shapes))


def shapes_at(cosine: Array) -> Array:
    """(`SHAPES`, n) √λ ψ at n cosines: what one standard deviation of each amplitude adds to ln p."""
    places, shapes = _shapes(ALIKE)
    return np.array([np.interp(_place(cosine), places, shape) for shape in shapes])


def _place(cosine: Array) -> Array:
    """u = ln(θ + 30°)."""
    return np.log(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) + FORWARD_DEG)


@lru_cache(maxsize=4)
def _shapes(length: float) -> tuple[Array, Array]:
    """(places,) u, and (shapes, places) √λ ψ, each with a sign that makes it positive straight on."""
    low, high = _place(np.array([1.0, -1.0])).tolist()
    places = np.linspace(low, high, _PLACES)
    alike = SPREAD**2 * np.exp(-0.5 * ((places[:, None] - places) / length) ** 2)
    alike -= alike.mean(axis=0)
    alike -= alike.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(alike)
    largest = np.argsort(values)[::-1][:SHAPES]
    shapes = np.sqrt(np.maximum(values[largest], 0.0))[:, None] * vectors[:, largest].T
    return places, np.asarray(shapes * np.where(shapes[:, :1] < 0.0, -1.0, 1.0))

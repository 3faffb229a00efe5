"""Random numbers and the directions drawn with them."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import part
from tankrig.scene.phase import henyey_greenstein
from tankrig.scene.phase_functions import HenyeyGreenstein
from tankrig.scene.phase_table import PhaseFunction

_STRIDE = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


STEPS = 16_384
"""Of a phase function's table: 0.011° each."""


class Asymmetry(NamedTuple):
    """Henyey–Greenstein, which needs no table."""

    g: float


class PhaseTable(NamedTuple):
    """A phase function for the Monte Carlo, which keeps a table of its own: even steps of θ, p linear in cos θ.

    Parameters
    ----------
    g
        Mean cosine.
    cosines, values, below
        (n,) cos θ from 1 to −1, p in 1/sr there, and the share of the light that turns by less.
    """

    g: float
    cosines: NDArray[np.float64]
    values: NDArray[np.float64]
    below: NDArray[np.float64]


AnyTable = Asymmetry | PhaseTable


def phase_table(phase: PhaseFunction) -> AnyTable:
    """A phase function's table."""
    if isinstance(phase, HenyeyGreenstein):
        return Asymmetry(phase.g)
    cosines = np.cos(np.linspace(0.0, math.pi, STEPS + 1))
    values = phase.at(cosines)
    return PhaseTable(phase.mean_cosine, cosines, values, phase.share_within(cosines))


@part
def turning(cosine: float, phase: AnyTable) -> float:
    """p(cos θ), 1/sr."""
    if len(phase) == 1:
        return henyey_greenstein(cosine, phase.g)
    place = math.acos(min(max(cosine, -1.0), 1.0)) * (STEPS / math.pi)
    step = min(int(place), STEPS - 1)
    share = (phase.cosines[step] - cosine) / (phase.cosines[step] - phase.cosines[step + 1])
    density: float = phase.values[step] + share * (phase.values[step + 1] - phase.values[step])
    return density


@part
def scrambled(state: np.uint64) -> np.uint64:
    """A hash of `state`: neighbouring states give unrelated ones (the output function of SplitMix64)."""
    z = (state ^ (state >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@part
def draw(state: np.uint64) -> tuple[float, np.uint64]:
    """Next number, uniform in [0, 1), and the state after it (SplitMix64; Steele, Lea and Flood 2014)."""
    state = state + _STRIDE
    return np.float64(scrambled(state) >> _11) * 2.0**-53, state


@part
def draw_azimuth(state: np.uint64) -> tuple[float, float, np.uint64]:
    """Cosine and sine of a uniform angle, by a point in the unit disc: half the time of the functions themselves."""
    while True:
        u, state = draw(state)
        v, state = draw(state)
        a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
        squared = a * a + b * b
        if 1e-12 < squared <= 1.0:
            scale = 1.0 / math.sqrt(squared)
            return a * scale, b * scale, state


@part
def draw_turn(ux: float, uy: float, uz: float, g: float, state: np.uint64) -> tuple[float, float, float, np.uint64]:
    """Direction after a Henyey–Greenstein scattering from direction u."""
    u, state = draw(state)
    # The inverse of the distribution of cos θ, arranged so that g → 0 and g → ±1 lose no digits.
    mu = 2.0 * u - 1.0
    scale = 1.0 / (1.0 + g * mu)
    cosine = 0.5 * ((mu + g) * (1.0 + (1.0 - g * g) * scale) * scale + g)
    return _turned(ux, uy, uz, cosine, state)


@part
def draw_scattered(
    ux: float, uy: float, uz: float, phase: AnyTable, state: np.uint64
) -> tuple[float, float, float, np.uint64]:
    """Direction after a scattering from direction u."""
    if len(phase) == 1:
        return draw_turn(ux, uy, uz, phase.g, state)
    u, state = draw(state)
    step = min(max(int(np.searchsorted(phase.below, u, side="right")) - 1, 0), phase.values.size - 2)
    # p goes linearly from `here` to `there` with cos θ, which falls; the root of a quadratic, without cancellation.
    width = phase.cosines[step] - phase.cosines[step + 1]
    here, there = phase.values[step], phase.values[step + 1]
    wanted = (u - phase.below[step]) / (2.0 * math.pi)
    root = math.sqrt(max(here * here + 2.0 * (there - here) / width * wanted, 0.0))
    cosine = phase.cosines[step] - min(2.0 * wanted / max(here + root, 1e-300), width)
    return _turned(ux, uy, uz, cosine, state)


@part
def _turned(ux: float, uy: float, uz: float, cosine: float, state: np.uint64) -> tuple[float, float, float, np.uint64]:
    """Direction at an angle from direction u, anywhere around it."""
    a, b, state = draw_azimuth(state)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    a, b = a * sine, b * sine
    # Orthonormal frame about u that has no singular direction (Duff et al. 2017).
    sign = 1.0 if uz >= 0.0 else -1.0
    c = -1.0 / (sign + uz)
    d = ux * uy * c
    return (
        a * (1.0 + sign * ux * ux * c) + b * d + cosine * ux,
        a * sign * d + b * (sign + uy * uy * c) + cosine * uy,
        -a * sign * ux - b * uy + cosine * uz,
        state,
    )

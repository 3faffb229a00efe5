"""Random numbers and the directions drawn with them."""

import math

import numpy as np

from tankrig.compiled import part

_STRIDE = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


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
    a, b, state = draw_azimuth(state)
    # The inverse of the distribution of cos θ, arranged so that g → 0 and g → ±1 lose no digits.
    mu = 2.0 * u - 1.0
    scale = 1.0 / (1.0 + g * mu)
    cosine = 0.5 * ((mu + g) * (1.0 + (1.0 - g * g) * scale) * scale + g)
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

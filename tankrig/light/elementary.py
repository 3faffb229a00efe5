"""Logarithm, exponential and circular functions that compilers can work out for several numbers at once.

The mathematical library's take one number per call, and a loop with a call in it is not vectorised. These are plain
arithmetic, without branches, as exact as double precision allows to a few units in the last places.
"""

import math

import numpy as np

from tankrig.compiled import part

_LN_2 = 0.6931471805599453
_ROOT_2 = 1.4142135623730951


@part
def log_one_minus(v: float) -> float:
    """ln(1 − v) for 0 ≤ v ≤ 1, exact for small v; about −709 at 1.

    Examples
    --------
    >>> round(log_one_minus(0.5) / math.log(0.5), 14), log_one_minus(1e-12) / -1e-12
    (1.0, 1.0000000000005)
    """
    kept = 1.0 - v
    bits = np.float64(kept).view(np.int64)
    exponent = float((bits >> 52) - 1023)
    mantissa = np.int64((bits & 0xFFFFFFFFFFFFF) | 0x3FF0000000000000).view(np.float64)
    large = mantissa > _ROOT_2
    mantissa = 0.5 * mantissa if large else mantissa
    exponent = exponent + 1.0 if large else exponent
    near = kept > 1.0 / _ROOT_2  # then the mantissa is 1 − v, and −v all that should be left of it less 1
    s = (-v if near else mantissa - 1.0) / (2.0 - v if near else mantissa + 1.0)
    square = s * s
    series = 1 / 11 + square * (1 / 13 + square * (1 / 15 + square * (1 / 17 + square * (1 / 19 + square / 21))))
    series = 1 / 3 + square * (1 / 5 + square * (1 / 7 + square * (1 / 9 + square * series)))
    return exponent * _LN_2 + 2.0 * s * (1.0 + square * series)


@part
def exponential(x: float) -> float:
    """eˣ for x ≤ 0; 0 below −700.

    Examples
    --------
    >>> round(exponential(-3.2) / math.exp(-3.2), 14)
    1.0
    """
    power, change = _halvings(x)
    return power * (1.0 + change) if x > -700.0 else 0.0


@part
def one_minus_exponential(x: float) -> float:
    """1 − eˣ for x ≤ 0, exact for small x.

    Examples
    --------
    >>> round(one_minus_exponential(-1e-12) / 1e-12, 9), one_minus_exponential(-1e5)
    (1.0, 1.0)
    """
    power, change = _halvings(x)
    return (1.0 - power) - power * change if x > -700.0 else 1.0


@part
def _halvings(x: float) -> tuple[float, float]:
    """2ᵏ and eʳ − 1 with eˣ = 2ᵏ eʳ and |r| ≤ ln 2 / 2."""
    x = max(x, -700.0)
    k = math.floor(x / _LN_2 + 0.5)
    r = x - k * _LN_2
    series = 1 / 720 + r * (1 / 5040 + r * (1 / 40320 + r * (1 / 362880 + r * (1 / 3628800 + r / 39916800))))
    series = 0.5 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120 + r * series)))
    return np.int64((np.int64(k) + 1023) << 52).view(np.float64), r * (1.0 + r * series)


@part
def circle(turns: float) -> tuple[float, float]:
    """cos and sin of 2π · turns, 0 ≤ turns ≤ 1.

    Examples
    --------
    >>> [round(value, 12) for value in circle(1 / 3)]
    [-0.5, 0.866025403784]
    """
    quarter = math.floor(4.0 * turns + 0.5)
    r = (turns - 0.25 * quarter) * (2.0 * math.pi)
    q = r * r
    even = 1 / 40320 + q * (-1 / 3628800 + q * (1 / 479001600 + q * (-1 / 87178291200 + q / 20922789888000)))
    even = 1.0 + q * (-0.5 + q * (1 / 24 + q * (-1 / 720 + q * even)))
    odd = 1 / 362880 + q * (-1 / 39916800 + q * (1 / 6227020800 - q / 1307674368000))
    odd = r * (1.0 + q * (-1 / 6 + q * (1 / 120 + q * (-1 / 5040 + q * odd))))
    swap = quarter == 1.0 or quarter == 3.0
    cosine, sine = (odd, even) if swap else (even, odd)
    cosine = -cosine if quarter == 1.0 or quarter == 2.0 else cosine
    return cosine, -sine if quarter == 2.0 or quarter == 3.0 else sine

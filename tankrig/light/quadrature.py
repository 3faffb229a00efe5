"""Quadratures as kernels read them."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Rule = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Nodes and weights on [−1, 1]."""

PANEL = 0.5
"""Free paths along a line of sight that two nodes are enough for: they err by 1e-5 of the light there."""


@cache
def gauss_legendre(count: int) -> Rule:
    """The rule of so many nodes that is exact for polynomials of twice that degree, less one.

    A fit asks for the same few rules thousands of times, and each is an eigenvalue problem. Nobody writes into them:
    numba would compile kernels anew for arrays that cannot be written.

    Examples
    --------
    >>> nodes, weights = gauss_legendre(3)
    >>> round(float(weights @ nodes**4), 12)
    0.4
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights


class SightRules(NamedTuple):
    """What is integrated with over the lines of sight through one x: along y, and along each of them."""

    y: Rule
    depth: Rule


class PixelRules(NamedTuple):
    """What is integrated with over a pixel."""

    x: Rule
    sights: SightRules


def pixel_rules() -> PixelRules:
    """As many nodes as order 1 needs."""
    return PixelRules(gauss_legendre(2), SightRules(gauss_legendre(3), gauss_legendre(2)))

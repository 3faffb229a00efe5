"""Mie's series for many spheres at once (Bohren and Huffman 1983, chapter 4), as `miepython` has it for each."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOGETHER = 16
"""Spheres whose series are summed by one product of matrices, with as many terms as the largest of them needs."""


def scattered_by(diameters_um: Array, ratio: float, per_um: float, cosine: Array) -> tuple[Array, Array, Array]:
    """How single spheres scatter unpolarised light.

    Parameters
    ----------
    diameters_um
        (n,) of the spheres; in order of size the sums are fastest.
    ratio
        Their refractive index over water's.
    per_um
        Wavenumber in water, 1/µm.
    cosine
        (m,) of scattering angles.

    Returns
    -------
    cross_section
        (n,) for scattering, µm².
    whole
        (n, m) σ p, µm²/sr.
    across
        (n, m) the part of it across the plane of scattering.
    """
    a, b, terms = coefficients(ratio, 0.5 * np.asarray(diameters_um, float) * per_um)
    odd, even = _angular(a.shape[1], cosine)
    n = np.arange(1, a.shape[1] + 1)
    by = (2.0 * n + 1.0) / (n * (n + 1.0))
    whole, across = np.zeros((2, len(a), cosine.size))
    for first in range(0, len(a), TOGETHER):
        some = slice(first, first + TOGETHER)
        most = slice(0, int(terms[some].max()))
        # Real and imaginary parts as rows: times complex numbers, the tables of π and τ would be copied as such.
        a_by, b_by = (np.stack([one[some, most].real, one[some, most].imag]) * by[most] for one in (a, b))
        squares = np.sum((a_by @ odd[most] + b_by @ even[most]) ** 2, axis=0)
        along = np.sum((a_by @ even[most] + b_by @ odd[most]) ** 2, axis=0)
        across[some], whole[some] = squares / (2.0 * per_um**2), (squares + along) / (2.0 * per_um**2)
    total = 2.0 * math.pi / per_um**2 * (np.abs(a) ** 2 + np.abs(b) ** 2) @ (2.0 * n + 1.0)
    return total, whole, across


def coefficients(ratio: float, sizes: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.intp]]:
    """(n, terms) coefficients a and b of spheres, 0 beyond the terms of each, and (n,) how many these are.

    Parameters
    ----------
    ratio
        Refractive index of the spheres over that of what surrounds them.
    sizes
        (n,) size parameters: circumferences over the wavelength there.
    """
    terms = (sizes + 4.05 * sizes ** (1.0 / 3.0) + 2.0).astype(np.intp)  # Wiscombe 1980
    n = np.arange(1, int(terms.max()) + 1)[:, None]
    outside, inside = _logarithmic_derivatives(np.stack([sizes, ratio * sizes]), len(n))
    to_next = outside + n / sizes  # ψₙ₋₁/ψₙ
    sine, cosine = np.sin(sizes), np.cos(sizes)
    first = sine / sizes - cosine
    start = np.where(np.abs(first) > np.abs(sine), first * to_next[0], sine)  # ψ₀, where one of both is next to 0
    psi = np.cumprod(np.vstack([start, 1.0 / to_next]), axis=0)
    chi = np.empty_like(psi)
    chi[0], chi[1] = cosine, cosine / sizes + sine
    with np.errstate(over="ignore", invalid="ignore"):  # far beyond a small sphere's terms, which are left out
        for k in range(2, len(chi)):
            chi[k] = (2 * k - 1) / sizes * chi[k - 1] - chi[k - 2]
        a, b = (_coefficient(inside * by + n / sizes, psi, chi) for by in (1.0 / ratio, ratio))
    own = np.arange(len(n)) < terms[:, None]
    return np.where(own, a.T, 0.0), np.where(own, b.T, 0.0), terms


def _coefficient(factor: Array, psi: Array, chi: Array) -> NDArray[np.complex128]:
    """(terms, n) a or b, for spheres that absorb nothing (Eq. 4.88)."""
    wave, other = factor * psi[1:] - psi[:-1], factor * chi[1:] - chi[:-1]
    return np.asarray(wave * (wave + 1j * other) / (wave**2 + other**2))


def _logarithmic_derivatives(at: Array, count: int) -> NDArray[np.float64]:
    """(k, count, n) ψₙ′/ψₙ of the Riccati–Bessel functions 1 … count, by downward recurrence (Eq. 4.89)."""
    largest = float(at.max())
    beyond = max(count, math.ceil(largest)) + 25 + math.ceil(1.5 * math.sqrt(largest))
    found, last = np.empty((len(at), count + 1, at.shape[1])), np.zeros_like(at)
    for n in range(beyond, 0, -1):
        over = n / at
        last = over - 1.0 / (last + over)
        if n <= count + 1:
            found[:, n - 1] = last
    return found[:, 1:]


def _angular(terms: int, cosine: Array) -> tuple[Array, Array]:
    """(terms, m) angular functions π_n and τ_n at cosines (Eq. 4.47)."""
    odd, even = np.zeros((terms + 1, cosine.size)), np.zeros((terms + 1, cosine.size))
    odd[1], even[1] = 1.0, cosine
    for n in range(2, terms + 1):
        odd[n] = ((2 * n - 1) * cosine * odd[n - 1] - n * odd[n - 2]) / (n - 1)
        even[n] = n * cosine * odd[n] - (n + 1) * odd[n - 1]
    return odd[1:], even[1:]

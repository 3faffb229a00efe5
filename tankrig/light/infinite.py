"""Light in an infinite medium, solved per wave vector: a tridiagonal system that holds every order of scattering.

With k ∥ z the light field's spherical-harmonic coefficients ψ_lm of each azimuthal order m obey (the paper's Eq. 12–14
for all orders at once, its two convolutions being the operator product K S)

    (σt − σs g^l) ψ_lm + i k (b_{l+1,m} ψ_{l+1,m} + b_{l,m} ψ_{l−1,m}) = q_lm,    b²_lm = (l² − m²)/(4l² − 1).

Written for χ_lm = i^l ψ_lm the system is real, which is how it is solved here.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import SceneError
from tankrig.scene import Medium

Floats = NDArray[np.float64]
Numbers = NDArray[Any]
"""Real or complex, double precision."""

_RAY = np.exp(0.25j * np.pi)
"""Direction of the contour: half-way between the real axis, where e^{ikr} oscillates, and the imaginary one, with its
pole and its cut."""
_STEP = 0.12
"""Of ln|k| along the contour: singularities lie π/4 off it, so the trapezoid's error is exp(−2π·π/4/step) = 1e−18."""
_LONGEST = 50_000
"""Degrees kept at most; only reached within a fiftieth of a mean free path, where scattered light hardly matters."""
_MOST_MOMENTS, _NO_MOMENT = 1000, 1e-9
"""Of a tabulated phase function: its degrees, and what of them is its table's rounding."""


def require_absorption(medium: Medium) -> None:
    """Refuse a medium that absorbs nothing: without walls its light never ends.

    Raises
    ------
    SceneError
        When σa = 0.
    """
    if medium.sigma_a <= 0.0:
        raise SceneError(
            "medium.sigma_a = 0 in an infinite medium, whose light then never ends (∫φ dV = 1/sigma_a); give "
            'sigma_a > 0, or use model = "tank", which has walls'
        )


def coupling_squared(degree: ArrayLike, order: int) -> Floats:
    """b²_lm = (l² − m²)/(4l² − 1), which streaming couples degrees l − 1 and l with.

    Examples
    --------
    >>> coupling_squared([1, 2], 0).round(6).tolist()
    [0.333333, 0.266667]
    """
    squared = np.square(np.asarray(degree, dtype=np.float64))
    value: Floats = (squared - order * order) / (4.0 * squared - 1.0)
    return value


def continued_fraction(
    wave_number: Numbers,
    sigma_t: float,
    scattering: Floats,
    order: int = 0,
    first: int = 0,
    precision: float = 1e-16,
) -> Numbers:
    """a_l + k² b²_{l+1}/(a_{l+1} + k² b²_{l+2}/(…)) from degree l = `first` up, a_l = σt − scattering[l − first].

    Its reciprocal at `first` = m is ψ_mm for a source in that degree alone. At `first` = L + 1, without scattering, it
    tells what all degrees above L do, exactly: k² b²_{L+1}/fraction joins the last diagonal entry of a system cut at L.

    Parameters
    ----------
    wave_number
        k in 1/mm, any shape; real, or complex off the imaginary axis.
    sigma_t
        Extinction in 1/mm.
    scattering
        σs g^l for l = first, first + 1, …, in 1/mm; zero beyond its end.
    order, first
        Azimuthal order m and lowest degree.
    precision
        Relative error at which the fraction may be cut.

    Returns
    -------
    array of the shape of `wave_number`, 1/mm
    """
    squared = wave_number**2
    root = np.sqrt(sigma_t**2 + squared)
    # An error in the fraction shrinks per degree by this factor; where it hardly shrinks, what counts is that the
    # fraction's start below is itself wrong by no more than about (1 + m²)/l³.
    shrinking = float(np.max(np.abs((root - sigma_t) / (root + sigma_t)), initial=1e-3))
    shrunk = math.log(precision) / math.log(min(shrinking, 1.0 - 1e-12))
    depth = math.ceil(min(shrunk, ((1.0 + order**2) / precision) ** (1.0 / 3.0), _LONGEST))
    last = first + len(scattering) + depth
    diagonal = np.full(last - first + 1, sigma_t)
    diagonal[: len(scattering)] -= scattering
    coupling = coupling_squared(np.arange(first, last + 2), order)
    # From here on as if b² stayed what it is.
    fraction: Numbers = 0.5 * (sigma_t + np.sqrt(sigma_t**2 + 4.0 * coupling[-1] * squared))
    for index in range(last - first, -1, -1):
        fraction = diagonal[index] + squared * (coupling[index + 1] / fraction)
    return fraction


def _scattering(medium: Medium) -> Floats:
    """σs χ_l for all degrees above rounding; χ_l = g^l for Henyey–Greenstein."""
    if medium.phase is not None:
        moments = medium.phase.moments(_MOST_MOMENTS)
        above = np.flatnonzero(np.abs(moments) > _NO_MOMENT)
        return np.asarray(medium.sigma_s * moments[: above[-1] + 1])
    count = 1 if medium.g == 0.0 else 1 + math.ceil(37.0 / -math.log(abs(medium.g)))
    return medium.sigma_s * np.power(medium.g, np.arange(min(count, _LONGEST)))


def fluence_transform(wave_number: Numbers, medium: Medium) -> Numbers:
    """Fourier transform over space of the fluence rate around an isotropic point source of 1 W, all orders.

    Parameters
    ----------
    wave_number
        k in 1/mm, any shape, real or complex.
    medium
        Coefficients in 1/mm.

    Returns
    -------
    array of the shape of `wave_number`, mm

    Examples
    --------
    >>> bool(abs(fluence_transform(np.zeros(1), Medium(0.1, 0.9, 0.5))[0] - 10.0) < 1e-12)  # ∫ φ dV = 1/σa
    True
    """
    scattering = _scattering(medium)
    above = continued_fraction(wave_number, medium.sigma_t, scattering[1:], first=1)
    # σt − σs is σa: taken as given, so that nothing cancels when the medium hardly absorbs.
    inverse: Numbers = medium.sigma_a + wave_number**2 / (3.0 * above)
    return 1.0 / inverse


def point_source_fluence(radius_mm: ArrayLike, medium: Medium) -> Floats:
    """Fluence rate at a distance from an isotropic point source of 1 W in an infinite medium, all orders of scattering.

    The uncollided part e^{−σt r}/(4π r²) is added in closed form. The scattered rest is
    (2π² r)⁻¹ Im ∫ k e^{ikr} (φ̂ − φ̂₀) dk along a ray 45° into the complex plane, where the integrand neither oscillates
    nor comes near the diffusion pole k = iν (ν → 0 with σa), by the trapezoid rule in ln |k|.

    Parameters
    ----------
    radius_mm
        Distances r > 0 in mm, any shape.
    medium
        Coefficients in 1/mm; σa > 0.

    Returns
    -------
    array of the shape of `radius_mm`, W/mm²
        Relative error about 1e−15 e^{νr}; 1e−10 or better to r = 10/ν.

    Raises
    ------
    SceneError
        When σa = 0.

    Examples
    --------
    >>> medium = Medium(sigma_a=0.1, sigma_s=0.9, g=0.0)
    >>> float(point_source_fluence(1.0, medium).round(12))
    0.143283861525
    """
    require_absorption(medium)
    radius = np.asarray(radius_mm, dtype=np.float64)
    if not np.all(radius > 0.0):
        raise ValueError("radius_mm must be positive: the fluence rate of a point source is infinite at the source")
    scattered = [_scattered_fluence(float(one), medium) for one in radius.ravel()]
    value: Floats = np.reshape(scattered, radius.shape) + np.exp(-medium.sigma_t * radius) / (4.0 * np.pi * radius**2)
    return value


def _scattered_fluence(radius_mm: float, medium: Medium) -> float:
    slowest = min(1.0 / radius_mm, math.sqrt(3.0 * medium.sigma_a * (medium.sigma_t - medium.g * medium.sigma_s)))
    log_k = np.arange(math.log(slowest) - 19.0, math.log(60.0 / radius_mm), _STEP)
    wave_number = np.exp(log_k) * _RAY
    uncollided = np.arctan(wave_number / medium.sigma_t) / wave_number
    scattered = fluence_transform(wave_number, medium) - uncollided
    integrand = wave_number**2 * np.exp(1j * wave_number * radius_mm) * scattered
    return float(np.sum(integrand).imag) * _STEP / (2.0 * math.pi**2 * radius_mm)


def streaming_inverse(wave_number: Floats, sigma_t: float, order: int, degree: int) -> Floats:
    """K for one azimuthal order: the field χ that an emission makes on its way to its next collision (Eq. 8–10).

    Parameters
    ----------
    wave_number
        k ≥ 0 in 1/mm, shape (K,).
    sigma_t
        Extinction in 1/mm.
    order, degree
        Azimuthal order m and highest degree L of emission and of field; no field in higher degrees is neglected.

    Returns
    -------
    array (K, L − m + 1, L − m + 1), mm
        Real, for χ_l = i^l ψ_l of an emission given as i^l q_l.
    """
    size = degree - order + 1
    matrix = np.zeros((len(wave_number), size, size))
    inner = np.arange(size - 1)
    coupling = np.sqrt(coupling_squared(np.arange(order + 1, degree + 1), order))
    diagonal = np.arange(size)
    matrix[:, diagonal, diagonal] = sigma_t
    matrix[:, inner, inner + 1] = wave_number[:, None] * coupling
    matrix[:, inner + 1, inner] = -wave_number[:, None] * coupling
    above = continued_fraction(wave_number, sigma_t, np.zeros(0), order, degree + 1, precision=1e-6)
    matrix[:, -1, -1] += wave_number**2 * coupling_squared(degree + 1, order) / above
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)

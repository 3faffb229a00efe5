"""The convolution kernel in space: from its spectrum by harmonics of the separation, so without any periodic box.

A box of the fast Fourier transform would have to be many diffusion lengths wide. Here the kernel is transformed
analytically, one spherical Bessel transform per harmonic, and only needed where both ends lie in the tank.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.lightfield.harmonics import legendre
from tankrig.light.lightfield.spectrum import Orders, spectrum
from tankrig.scene import Medium

Floats = NDArray[np.float64]

_BLUR = 0.015
"""The kernel is smoothed by a Gaussian of this fraction of the separation, which bounds the wave numbers needed."""
_CUT = 4.0
"""Wave numbers end at this many inverse widths of that Gaussian, where it has fallen to 3e−4."""
_PER_E_FOLD = 4
"""Wave numbers at which the spectrum is computed, per factor e; cubic splines in ln k between them."""


@dataclass(frozen=True)
class Kernel:
    """Emission towards the camera per lit volume and fluence rate, 1/(mm · mm³ · sr), by separation camera ray − light.

    Held in polar coordinates about y: separation, angle from the y axis (the kernel is even in y), angle from the
    diagonal x = z in the x–z plane (exchanging light and camera exchanges x and z).
    """

    radius_mm: Floats
    table: Floats
    """(radius, θ ∈ [0, π/2], φ ∈ [0, π])."""

    def __call__(self, x: Floats, y: Floats, z: Floats) -> Floats:
        """Kernel at separations in mm, any shapes that broadcast."""
        from scipy.ndimage import map_coordinates

        x, y, z = np.broadcast_arrays(x, y, z)
        radius = np.sqrt(x**2 + y**2 + z**2)
        index = np.interp(radius, self.radius_mm, np.arange(len(self.radius_mm)))
        theta = np.arccos(np.abs(y) / np.maximum(radius, 1e-12))
        phi = np.arctan2(np.abs(x - z), x + z)
        _, thetas, phis = self.table.shape
        places = np.stack([index, theta * (2 / math.pi) * (thetas - 1), phi / math.pi * (phis - 1)])
        value: Floats = map_coordinates(self.table, places, order=3, mode="mirror")
        return value


def scattering_kernel(
    medium: Medium, orders: Orders, width_mm: float, reach_mm: float, degree: int, detail: int
) -> Kernel:
    """Kernel that turns fluence rate of unscattered light along +x into emission along +z after several scatterings.

    Parameters
    ----------
    medium
        Coefficients in 1/mm.
    orders
        First and last order of scattering; the last is None for all.
    width_mm
        Standard deviation of the Gaussian that smooths the kernel at small separations.
    reach_mm
        Largest separation needed.
    degree
        Highest degree of the light field's harmonics.
    detail
        Highest degree of the kernel's own harmonics, in the direction of the separation.
    """
    radius = _radii(width_mm, reach_mm)
    low, high = 0.01 / reach_mm, _CUT / width_mm
    log_k = np.linspace(math.log(low), math.log(high), int(math.log(high / low) * _PER_E_FOLD) + 2)
    modes = _modes_of_spectrum(medium, orders, np.exp(log_k), degree, detail)
    transform = _bessel_transform(log_k, radius, width_mm, detail)
    thetas, phis = detail + 17, 2 * detail + 33
    theta, phi = np.linspace(0.0, math.pi / 2, thetas), np.linspace(0.0, math.pi, phis)
    table = np.zeros((len(radius), thetas, phis))
    for order in range(detail + 1):
        degrees = np.arange(order, detail + 1, 2)
        radial = np.einsum("lrk,lk->rl", transform[degrees], modes[order])
        shape = legendre(order, detail, np.cos(theta))[:, ::2]
        table += (radial @ shape.T)[:, :, None] * np.cos(order * phi)
    return Kernel(radius, table)


def _radii(width_mm: float, reach_mm: float) -> Floats:
    radius = [0.0]
    while radius[-1] < 1.1 * reach_mm:
        radius.append(radius[-1] + max(0.5 * width_mm, 0.08 * radius[-1]))
    return np.array(radius)


def _modes_of_spectrum(medium: Medium, orders: Orders, wave_number: Floats, degree: int, detail: int) -> list[Floats]:
    """Coefficients of Ĥ over the directions of k: per M = 0 … detail, an array (degrees M, M + 2, …; K).

    Only one eighth of the sphere is computed: Ĥ is even in k_y and in k_x − k_z, and Ĥ(−k) is its conjugate. Real parts
    belong to even degrees and imaginary parts to odd ones; the factor i^degree of the transform makes all real.
    """
    half = (detail + 2) // 2
    nodes, weights = np.polynomial.legendre.leggauss(2 * half)
    cosine, weight = nodes[half:], 2.0 * weights[half:]
    angles = half + 1
    phi = (np.arange(angles) + 0.5) * (math.pi / 2 / angles)
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    light, camera = sine * np.cos(phi - math.pi / 4), sine * np.cos(phi + math.pi / 4)
    parts = spectrum(medium, orders, wave_number, light.ravel(), camera.ravel(), degree)
    parity = [part.reshape(len(wave_number), half, angles) for part in parts]
    modes = []
    for order in range(detail + 1):
        around = parity[order % 2] @ np.cos(order * phi) * (2.0 * math.pi / angles * (1.0 if order == 0 else 2.0))
        shape = legendre(order, detail, cosine)[:, ::2]
        sign = (-1.0) ** ((np.arange(order, detail + 1, 2) + 1) // 2)
        modes.append(sign[:, None] * ((shape.T * weight) @ around.T))
    return modes


def _bessel_transform(log_k: Floats, radius: Floats, width_mm: float, detail: int) -> Floats:
    """Matrix (degree, radius, k): (2π²)⁻¹ ∫ k² j_l(kr) e^{−k²w²/2} … dk of cubic splines in ln k; w grows with r.

    In x = kr one grid of nodes, dense enough for the oscillations, serves all radii.
    """
    from scipy.interpolate import CubicSpline
    from scipy.special import spherical_jn

    nodes, weights = np.polynomial.legendre.leggauss(8)
    graded = np.concatenate([[0.0], np.geomspace(1e-3, 4.0, 12)])
    edges = np.concatenate([graded, np.arange(8.0, _CUT / _BLUR + 4.0, 4.0)])
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    x = (middle[:, None] + half[:, None] * nodes).ravel()
    x_weight = (half[:, None] * weights).ravel()
    bessel = np.stack([spherical_jn(degree, x) for degree in range(detail + 1)])
    basis = CubicSpline(log_k, np.eye(len(log_k)))
    transform = np.empty((detail + 1, len(radius), len(log_k)))
    for index, r in enumerate(np.maximum(radius, 1e-2 * width_mm)):
        blur = max(width_mm / r, _BLUR)
        splines = basis(np.log(np.clip(x / r, math.exp(log_k[0]), math.exp(log_k[-1]))))
        measure = x_weight * x**2 * np.exp(-0.5 * (x * blur) ** 2) / (2.0 * math.pi**2 * r**3)
        transform[:, index] = (bessel * measure) @ splines
    return transform

"""The convolution kernel per wave vector: what light scattered n times sends to the camera, per lit point."""

import numpy as np
from numpy.typing import NDArray

from tankrig.light.infinite import streaming_inverse
from tankrig.light.lightfield.harmonics import legendre
from tankrig.scene import Medium

Floats = NDArray[np.float64]
Orders = tuple[int, int | None]
"""First and last order of scattering of a sum; None: all the rest."""


def order_sum(medium: Medium, orders: Orders, wave_number: Floats, order: int, degree: int) -> Floats:
    """Σₙ (S K)ⁿ⁻¹ S for one azimuthal order: emission after n scatterings, per unscattered light (Eq. 12–14).

    Finite sums are differences of two all-order solves, (1 − S K)⁻¹ ((S K)^{first−1} − (S K)^last) S. The last degrees
    kept fade out: cut off sharply, a forward peak leaves ripples that drown the little light that turns by 90°
    (g = .95, L = 24: order 3 wrong by 112 %, faded 9 %; at g = .85 both within .4 %).

    Parameters
    ----------
    medium
        Coefficients in 1/mm.
    orders
        First and last order n ≥ 1.
    wave_number
        k in 1/mm, shape (K,).
    order, degree
        Azimuthal order m and highest degree L.

    Returns
    -------
    array (K, L − m + 1, L − m + 1), 1/mm; real, in the basis i^l of `streaming_inverse`
    """
    first, last = orders
    degrees = np.arange(order, degree + 1)
    scattering = (
        medium.sigma_s * medium.phase_function.moments(degree)[order:] * np.exp(-2.0 * (degrees / max(degree, 1)) ** 8)
    )
    step = scattering[:, None] * streaming_inverse(wave_number, medium.sigma_t, order, degree)
    power = np.linalg.matrix_power(step, first - 1)
    if last != first:
        if last is not None:
            power = power - np.linalg.matrix_power(step, last)
        power = np.linalg.solve(np.eye(len(scattering)) - step, power)
    value: Floats = power * scattering
    return value


def spectrum(
    medium: Medium, orders: Orders, wave_number: Floats, light: Floats, camera: Floats, degree: int
) -> tuple[Floats, Floats]:
    """Fourier transform Ĥ of the kernel from fluence rate of light along +x to emission along +z.

    Ĥ(k) = Σ_m Σ_{l,l'} Y_lm(ẑ) i^{l'−l} Pᵐ_{ll'}(|k|) Y*_{l'm}(x̂) with k as polar axis, for synthesis with e^{+ik·x}.

    Parameters
    ----------
    medium, orders
        As in `order_sum`.
    wave_number
        |k| in 1/mm, shape (K,).
    light, camera
        Cosines x̂·k̂ and ẑ·k̂ of the directions of k, shape (Q,).
    degree
        Highest degree L kept in the emission.

    Returns
    -------
    real, imaginary
        Two arrays (K, Q), 1/mm; the real part is even in k, the imaginary part odd.
    """
    turn = np.arccos(np.clip(-light * camera / np.sqrt((1.0 - light**2) * (1.0 - camera**2)), -1.0, 1.0))
    real = np.zeros((len(wave_number), len(light)))
    imaginary = np.zeros_like(real)
    for order in range(degree + 1):
        sums = order_sum(medium, orders, wave_number, order, degree)
        into, out = legendre(order, degree, light), legendre(order, degree, camera)
        weight = (1.0 if order == 0 else 2.0) * np.cos(order * turn)
        # i^{l'−l} is ±1 between degrees of one parity and ±i between parities.
        sign = np.array([1.0, 1.0, -1.0, -1.0])[np.arange(order, degree + 1) % 4]
        into, out = into * sign, out * sign
        even, odd = slice(order % 2, None, 2), slice(1 - order % 2, None, 2)
        for part, (first, second), factor in (
            (real, (even, even), 1.0),
            (real, (odd, odd), 1.0),
            (imaginary, (even, odd), 1.0),
            (imaginary, (odd, even), -1.0),
        ):
            through = np.ascontiguousarray(out[:, first]) @ np.ascontiguousarray(sums[:, first, second])
            part += factor * weight * np.einsum("kql,ql->kq", through, into[:, second])
    return real, imaginary

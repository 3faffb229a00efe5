"""A part of the image as a function of the medium: polynomials whose coefficients are spatial patterns."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.prepared.polynomials import Plane, values_and_slopes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Term:
    """Amplitudes of spatial patterns as a function of extinction, albedo and asymmetry.

        amplitudes(u, w, v) = σs^power · exp(Σ S_mp T_m(w) R_p(u, v)) · Σ A_mpk T_m(w) P_p(u, v)

    The exponential follows the brightness over its decades, so that the polynomials carry the shape alone and their
    errors are relative ones.

    Parameters
    ----------
    power
        The lowest order of scattering in the term: thin media's light goes with that power of σs.
    plane, scale_plane
        Polynomials P and R of the coordinates u of σt and v of g.
    amplitudes
        A, (degrees in w, plane.size, patterns).
    scale
        S, (degrees in w, scale_plane.size).
    """

    power: int
    plane: Plane
    scale_plane: Plane
    amplitudes: Array
    scale: Array

    def at(self, place: Array, rates: Array, sigma_t: float, albedo: float) -> Array:
        """Amplitudes and their derivatives.

        Parameters
        ----------
        place
            Coordinates u, w, v.
        rates
            Derivatives of the coordinates by σt, ϖ and g.
        sigma_t, albedo
            σt and ϖ themselves.

        Returns
        -------
        (4, patterns) array
            The amplitudes, and their derivatives by σt, ϖ and g.
        """
        u, w, v = place
        by_albedo = values_and_slopes(w, max(self.amplitudes.shape[0], self.scale.shape[0]) - 1)
        bright = _summed(by_albedo, self.scale_plane.values_and_slopes(u, v), self.scale[:, :, None])[:, 0]
        found = _summed(by_albedo, self.plane.values_and_slopes(u, v), self.amplitudes)
        found[1:] = rates[:, None] * (found[1:] + bright[1:, None] * found[0])
        found[1] += self.power / sigma_t * found[0]
        found[2] += self.power / albedo * found[0]
        found *= math.exp(bright[0]) * (albedo * sigma_t) ** self.power
        return found


@kernel
def _summed(by_albedo: Array, products: Array, amplitudes: Array) -> Array:
    """Polynomials times amplitudes, and the derivatives of that by u, w and v, (4, patterns).

    Parameters
    ----------
    by_albedo
        (2, degrees) polynomials of w and their derivatives.
    products
        (3, plane.size) polynomials of u and v and their derivatives by each.
    amplitudes
        (degrees, plane.size, patterns).
    """
    found = np.zeros((4, amplitudes.shape[2]))
    for m in range(amplitudes.shape[0]):
        for p in range(amplitudes.shape[1]):
            value, by_u = by_albedo[0, m] * products[0, p], by_albedo[0, m] * products[1, p]
            by_w, by_v = by_albedo[1, m] * products[0, p], by_albedo[0, m] * products[2, p]
            for k in range(amplitudes.shape[2]):
                amplitude = amplitudes[m, p, k]
                found[0, k] += value * amplitude
                found[1, k] += by_u * amplitude
                found[2, k] += by_w * amplitude
                found[3, k] += by_v * amplitude
    return found

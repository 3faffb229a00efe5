"""A part of the image as a function of the medium: polynomials whose coefficients are spatial patterns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        count, _, patterns = self.amplitudes.shape
        q = values_and_slopes(w, max(count, self.scale.shape[0]) - 1)
        p = self.plane.values_and_slopes(u, v)
        folded = (q[:, :count] @ self.amplitudes.reshape(count, -1)).reshape(2, -1, patterns)
        found = np.empty((4, patterns))
        found[[0, 1, 3]] = p @ folded[0]
        found[2] = p[0] @ folded[1]
        r = self.scale_plane.values_and_slopes(u, v)
        folded_scale = q[:, : self.scale.shape[0]] @ self.scale
        bright, by_u, by_v = r @ folded_scale[0]
        by_w = r[0] @ folded_scale[1]
        found[1:] += np.array([by_u, by_w, by_v])[:, None] * found[0]
        found[1:] *= rates[:, None]
        found[1] += self.power / sigma_t * found[0]
        found[2] += self.power / albedo * found[0]
        return np.asarray(found * (np.exp(bright) * (albedo * sigma_t) ** self.power))

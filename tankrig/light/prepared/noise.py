"""What the noise of its training images leaves in a prepared model, as it lies.

The model's image of orders ≥ 3 is linear in the images that it was fitted to, and each of these has noise of its own:
of light paths, and of what polynomials cannot follow from medium to medium. What it differs by from the fit tells that
noise (a covariance of coefficients that takes no model of it; White 1980), and what it pulls an answer by, the error:

    δ_j(m) = b(m) Σ_p P_p(m) pull_pj left_j,      ⟨δ δᵀ⟩ = Σ_j δ_j δ_jᵀ.

So a fit knows in which directions the model errs, and need not take its size for that of any smooth error.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.polynomials import Plane, nodes, values, values_and_slopes

Array = NDArray[np.float64]

MOST, FEW = 32, 8
"""Patterns of an answer's noise, and of its derivatives'; of more training images, each is a sum over all with signs of
chance."""


@dataclass(frozen=True)
class Noise:
    """Errors of a model's orders ≥ 3.

    Parameters
    ----------
    power
        Of σs, see `Term`.
    plane, scale_plane
        Polynomials of σt and g.
    scale
        (albedos, polynomials): logarithm of the brightness b over σs^power, at the albedos that paths are summed for.
    pull
        (albedos, polynomials, media): what each image adds to each coefficient.
    left
        (media, albedos, cells): what the images differ by from the fit, over b.
    """

    power: int
    plane: Plane
    scale_plane: Plane
    scale: Array
    pull: Array
    left: NDArray[np.float32]

    def images(self, place: Array, sigma_s: float) -> Array:
        """(n, cells): the errors' covariance is the sum of their products.

        Parameters
        ----------
        place
            Coordinates u, w, v of a medium.
        sigma_s
            Its scattering.
        """
        u, w, v = place
        albedos, _, media = self.pull.shape
        between = values(w, albedos - 1) @ self._by_degree
        bright = math.exp(float(self.scale_plane.values(u, v) @ (between @ self.scale))) * sigma_s**self.power
        pulls = bright * between[:, None] * (self.plane.values(u, v) @ self.pull)
        signs = signs_of_chance(MOST, media) if media > MOST else np.eye(media)
        return np.asarray(np.einsum("kj,aj,jac->kc", signs, pulls, self.left, optimize=True))

    def slopes(self, place: Array, rates: Array, sigma_t: float, albedo: float) -> Array:
        """(n, 3, cells): what noise the derivatives by σt, ϖ and g have, likewise, as sums of few.

        Parameters
        ----------
        place
            Coordinates u, w, v of a medium.
        rates
            Derivatives of the coordinates by σt, ϖ and g.
        sigma_t, albedo
            The medium's.
        """
        u, w, v = place
        albedos, _, media = self.pull.shape
        between, steeper = values_and_slopes(w, albedos - 1) @ self._by_degree
        products, scales = self.plane.values_and_slopes(u, v), self.scale_plane.values_and_slopes(u, v)
        along = np.stack([between, between, steeper, between])  # the image, and its changes along u, w and v
        products, scales = (one[[0, 1, 0, 2]] for one in (products, scales))
        logarithm = np.einsum("dp,da,ap->d", scales, along, self.scale)
        pulls = along[:, :, None] * np.einsum("dp,apj->daj", products, self.pull)
        changes = rates[:, None, None] * (pulls[1:] + logarithm[1:, None, None] * pulls[0])
        changes[:2] += np.array([self.power / sigma_t, self.power / albedo])[:, None, None] * pulls[0]
        bright = math.exp(logarithm[0]) * (albedo * sigma_t) ** self.power
        signs = signs_of_chance(min(FEW, media), media)
        return np.asarray(bright * np.einsum("kj,daj,jac->kdc", signs, changes, self.left, optimize=True))

    def and_share(self, share: float, fields: Array) -> "Noise":
        """With one error more: a share of all light of orders ≥ 3, as it lies in the box on average.

        Parameters
        ----------
        share
            Of the light.
        fields
            (albedos, polynomials, cells) of the fit, of which the first are constant over the media.
        """
        alone = np.zeros((*self.pull.shape[:2], 1))
        alone[:, 0] = 1.0
        light = (share * fields[:, 0]).astype(np.float32)[None]
        return replace(self, pull=np.concatenate([self.pull, alone], axis=2), left=np.concatenate([self.left, light]))

    @cached_property
    def _by_degree(self) -> Array:
        """Between the albedos' nodes fields and brightness are polynomials, as the model's are."""
        albedos = len(self.pull)
        return np.asarray(np.linalg.inv(values(nodes(albedos), albedos - 1)))

    def fields(self, signs: Array) -> Array:
        """(albedos, polynomials, cells) of the fit's coefficients, off as they would be by one draw of the noise."""
        return np.stack([pull @ (signs[:, None] * self.left[:, k]) for k, pull in enumerate(self.pull)])


def signs_of_chance(count: int, media: int) -> Array:
    """(count, media) of ±1 over the root of `count`: so many sums over the media have their covariance on average.

    Examples
    --------
    >>> bool(np.allclose(np.sum(signs_of_chance(8, 5) ** 2, axis=0), 1.0))
    True
    """
    signs: Array = np.random.default_rng(0).choice([-1.0, 1.0], (count, media)) / np.sqrt(count)
    return signs

"""A prepared model: image and derivatives of any medium in its box, by one small matrix product."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.box import Coordinates
from tankrig.light.prepared.polynomials import values
from tankrig.light.prepared.term import Term
from tankrig.scene import Medium

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """Images as sums of spatial patterns.

    Parameters
    ----------
    coordinates
        Of the box that it answers for.
    terms
        Amplitudes of the patterns: orders 1, 2 and the rest.
    patterns
        (patterns, pixels).
    shape
        (rows, columns) of the camera.
    error
        Logarithm of the relative L2 error as Chebyshev coefficients over (u, w, v).
    """

    coordinates: Coordinates
    terms: tuple[Term, ...]
    patterns: Array
    shape: tuple[int, int]
    error: Array

    def amplitudes(self, medium: Medium) -> Array:
        """(4, patterns): of the image, and their derivatives by σt, ϖ and g."""
        place, rates = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        return np.asarray(np.sum([term.at(place, rates, medium.sigma_t, medium.albedo) for term in self.terms], axis=0))

    def image(self, medium: Medium) -> Array:
        """(rows, columns) image, W/mm²/sr; never negative."""
        image = np.maximum(self.amplitudes(medium)[0] @ self.patterns, 0.0)
        return np.asarray(image.reshape(self.shape))

    def image_and_derivatives(self, medium: Medium) -> tuple[Array, Array]:
        """The image, and (3, rows, columns) its derivatives by σa, σs and g."""
        value, by_sigma_t, by_albedo, by_g = self.amplitudes(medium)
        by_sigma_a = by_sigma_t - medium.albedo / medium.sigma_t * by_albedo
        by_sigma_s = by_sigma_t + (1.0 - medium.albedo) / medium.sigma_t * by_albedo
        found = np.stack([value, by_sigma_a, by_sigma_s, by_g]) @ self.patterns
        found *= found[0] > 0.0
        return found[0].reshape(self.shape), found[1:].reshape(3, *self.shape)

    def error_at(self, medium: Medium) -> float:
        """Estimated relative L2 error of one medium's image."""
        place, _ = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        u, w, v = (values(at, count - 1) for at, count in zip(place, self.error.shape, strict=True))
        return float(np.exp(np.einsum("i,j,k,ijk", u, w, v, self.error)))

    def error_over_box(self) -> tuple[float, float, Medium]:
        """Estimated relative L2 error over the box: root mean square, the largest, and the medium where that is."""
        places = np.array(np.meshgrid(*[np.linspace(-1.0, 1.0, 7)] * 3, indexing="ij")).reshape(3, -1)
        first, second, third = (values(at, count - 1) for at, count in zip(places, self.error.shape, strict=True))
        errors = np.exp(np.einsum("ni,nj,nk,ijk->n", first, second, third, self.error))
        worst = int(errors.argmax())
        sigma_t, albedo, g = (float(value) for value in self.coordinates.back(places[:, worst]))
        medium = Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, g)
        return float(np.sqrt(np.mean(errors**2))), float(errors[worst]), medium

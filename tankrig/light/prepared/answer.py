"""A prepared model: image and derivatives of any medium in its box, by one small matrix product."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.prepared.box import Coordinates
from tankrig.light.prepared.polynomials import values
from tankrig.light.prepared.term import Term
from tankrig.scene import Medium

Array = NDArray[np.float64]

BLOCK = 512
"""Pixels whose sums stay in the processor's nearest cache."""


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
        (patterns, pixels), in single precision to be read quickly; sums are in double.
    shape
        (rows, columns) of the camera.
    error
        Logarithm of the relative L2 error as Chebyshev coefficients over (u, w, v).
    """

    coordinates: Coordinates
    terms: tuple[Term, ...]
    patterns: NDArray[np.float32]
    shape: tuple[int, int]
    error: Array

    def amplitudes(self, medium: Medium) -> Array:
        """(4, patterns): of the image, and their derivatives by σt, ϖ and g."""
        place, rates = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        return np.asarray(np.sum([term.at(place, rates, medium.sigma_t, medium.albedo) for term in self.terms], axis=0))

    def image(self, medium: Medium) -> Array:
        """(rows, columns) image, W/mm²/sr; never negative."""
        image: Array = _combined(self.amplitudes(medium)[:1], self.patterns)
        return image.reshape(self.shape)

    def image_and_derivatives(self, medium: Medium) -> tuple[Array, Array]:
        """The image, and (3, rows, columns) its derivatives by σa, σs and g."""
        value, by_sigma_t, by_albedo, by_g = self.amplitudes(medium)
        by_sigma_a = by_sigma_t - medium.albedo / medium.sigma_t * by_albedo
        by_sigma_s = by_sigma_t + (1.0 - medium.albedo) / medium.sigma_t * by_albedo
        found = _combined(np.stack([value, by_sigma_a, by_sigma_s, by_g]), self.patterns)
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


@kernel
def _combined(amplitudes: Array, patterns: NDArray[np.float32]) -> Array:
    """amplitudes @ patterns, and nothing where the first row of that is negative.

    A matrix product of a library would use threads, which wait for each other for longer than they work where other
    programs are busy (measured on two busy cores: 7 ms instead of 0.5).
    """
    images, pixels = amplitudes.shape[0], patterns.shape[1]
    found = np.zeros((images, pixels))
    for start in range(0, pixels, BLOCK):
        stop = min(start + BLOCK, pixels)
        for k in range(patterns.shape[0]):
            pattern = patterns[k, start:stop]
            for row in range(images):
                amplitude, part = amplitudes[row, k], found[row, start:stop]
                for pixel in range(pattern.size):
                    part[pixel] += amplitude * pattern[pixel]
        for pixel in range(start, stop):
            if found[0, pixel] < 0.0:
                found[:, pixel] = 0.0
    return found

"""A prepared model: image and derivatives of any medium in its box, by one small matrix product."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.prepared.box import Coordinates
from tankrig.light.prepared.noise import Noise
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
    noise
        What orders ≥ 3 have of it, as it lies.
    misses
        (n, pixels) what orders 1 and 2 were off by at media beside their grid, over their norm there.
    tables
        What tables of order 2 err by, relative L2 of orders 1 and 2.
    """

    coordinates: Coordinates
    terms: tuple[Term, ...]
    patterns: NDArray[np.float32]
    shape: tuple[int, int]
    error: Array
    noise: Noise
    misses: NDArray[np.float32]
    tables: float

    def amplitudes(self, medium: Medium) -> Array:
        """(4, patterns): of the image, and their derivatives by σt, ϖ and g."""
        place, rates = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        return np.asarray(np.sum([term.at(place, rates, medium.sigma_t, medium.albedo) for term in self.terms], axis=0))

    def image(self, medium: Medium) -> Array:
        """(rows, columns) image, W/mm²/sr; never negative."""
        image: Array = _combined(self.amplitudes(medium), self.patterns)[0]
        return image.reshape(self.shape)

    def image_and_derivatives(self, medium: Medium) -> tuple[Array, Array]:
        """The image, and (3, rows, columns) its derivatives by σa, σs and g."""
        value, by_sigma_t, by_albedo, by_g = self.amplitudes(medium)
        found = _combined(np.stack([value, *_by_coefficients(medium, by_sigma_t, by_albedo), by_g]), self.patterns)
        return found[0].reshape(self.shape), found[1:].reshape(3, *self.shape)

    def error_at(self, medium: Medium) -> float:
        """Estimated relative L2 error of one medium's image."""
        place, _ = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        u, w, v = (values(at, count - 1) for at, count in zip(place, self.error.shape, strict=True))
        return float(np.exp(np.einsum("i,j,k,ijk", u, w, v, self.error)))

    def errors_at(self, medium: Medium) -> Array:
        """(n, cells) what noise one medium's image has, as it lies on the cells that paths were recorded in."""
        place, _ = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        return self.noise.images(place, medium.sigma_s)

    def misses_at(self, medium: Medium) -> tuple[Array, float]:
        """What orders 1 and 2 err by, as patterns (n, pixels) whose products add up to a covariance, and their norm."""
        place, rates = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        low = sum(term.at(place, rates, medium.sigma_t, medium.albedo)[0] for term in self.terms[:-1])
        size = float(np.linalg.norm(low))  # patterns are orthonormal
        return self.misses * (size / np.sqrt(len(self.misses))), size

    def errors_of_slopes_at(self, medium: Medium) -> Array:
        """(n, 3, cells) what noise its derivatives by σa, σs and g have."""
        place, rates = self.coordinates.of(medium.sigma_t, medium.albedo, medium.g)
        by_sigma_t, by_albedo, by_g = np.moveaxis(self.noise.slopes(place, rates, medium.sigma_t, medium.albedo), 1, 0)
        return np.stack([*_by_coefficients(medium, by_sigma_t, by_albedo), by_g], axis=1)

    def error_over_box(self) -> tuple[float, float, Medium]:
        """Estimated relative L2 error over the box: root mean square, the largest, and the medium where that is."""
        places = np.array(np.meshgrid(*[np.linspace(-1.0, 1.0, 7)] * 3, indexing="ij")).reshape(3, -1)
        first, second, third = (values(at, count - 1) for at, count in zip(places, self.error.shape, strict=True))
        errors = np.exp(np.einsum("ni,nj,nk,ijk->n", first, second, third, self.error))
        worst = int(errors.argmax())
        sigma_t, albedo, g = (float(value) for value in self.coordinates.back(places[:, worst]))
        medium = Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, g)
        return float(np.sqrt(np.mean(errors**2))), float(errors[worst]), medium


def _by_coefficients(medium: Medium, by_sigma_t: Array, by_albedo: Array) -> tuple[Array, Array]:
    """Derivatives by σa and σs."""
    by_sigma_a = by_sigma_t - medium.albedo / medium.sigma_t * by_albedo
    by_sigma_s = by_sigma_t + (1.0 - medium.albedo) / medium.sigma_t * by_albedo
    return by_sigma_a, by_sigma_s


@kernel
def _combined(amplitudes: Array, patterns: NDArray[np.float32]) -> Array:
    """amplitudes (4, patterns) @ patterns, and nothing where the first row of that is negative.

    Two patterns at a time for all four rows, as the time goes into reading patterns (0.6 → 0.3 ms for 9600 pixels). A
    matrix product of a library would use threads, which wait for each other for longer than they work where other
    programs are busy (measured on two busy cores: 8 ms).
    """
    count, pixels = patterns.shape
    found = np.zeros((4, pixels))
    for start in range(0, pixels, BLOCK):
        stop = min(start + BLOCK, pixels)
        value, by_a, by_s, by_g = found[0, start:stop], found[1, start:stop], found[2, start:stop], found[3, start:stop]
        for k in range(0, count, 2):
            other = min(k + 1, count - 1)
            first, second = patterns[k, start:stop], patterns[other, start:stop]
            a, b, c, d = amplitudes[0, k], amplitudes[1, k], amplitudes[2, k], amplitudes[3, k]
            paired = 1.0 if other > k else 0.0  # the last of an odd number has no partner
            e, f = paired * amplitudes[0, other], paired * amplitudes[1, other]
            g, h = paired * amplitudes[2, other], paired * amplitudes[3, other]
            for pixel in range(first.size):
                p, q = first[pixel], second[pixel]
                value[pixel] += a * p + e * q
                by_a[pixel] += b * p + f * q
                by_s[pixel] += c * p + g * q
                by_g[pixel] += d * p + h * q
        for pixel in range(start, stop):
            if found[0, pixel] < 0.0:
                found[:, pixel] = 0.0
    return found

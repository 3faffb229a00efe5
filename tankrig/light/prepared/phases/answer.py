"""A prepared model of liquids with any phase function: image and derivatives in about a millisecond."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.prepared.box import Coordinates
from tankrig.light.prepared.phases.products import Excess, Products
from tankrig.light.prepared.phases.traits import PhaseTraits
from tankrig.light.prepared.polynomials import values_and_slopes
from tankrig.scene import Medium
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]
Single = NDArray[np.float32]

THIRD = 3


@dataclass(frozen=True)
class LowOrder:
    """Order 1 or 2: linear, or bilinear, in the splines' coefficients.

        σs^order · exp(Σ_m S_m T_m(u)) · Σ_m T_m(u) a · G_m   (· a)

    Parameters
    ----------
    order
        1 or 2.
    scale
        (degrees,) S: the brightness along u.
    amplitudes
        (degrees, n, patterns) for order 1; (n, degrees, n, patterns), symmetric in n and n, for order 2.
    """

    order: int
    scale: Array
    amplitudes: Single

    def at(self, u: float, coefficients: Array) -> tuple[Array, Array, Array]:
        """(patterns,) amplitudes over σs^order, their derivatives by u, and (n, patterns) by coefficients."""
        degrees = values_and_slopes(u, self.scale.size - 1)
        bright, rate = degrees @ self.scale
        single = coefficients.astype(np.float32)
        if self.order == 1:
            by_degree = np.einsum("i,mip->mp", single, self.amplitudes)
            by_coefficient = np.tensordot(degrees[0], self.amplitudes, 1)
        else:
            n = single.size
            each = (single @ self.amplitudes.reshape(n, -1)).reshape(self.scale.size, n, -1)
            by_degree = np.einsum("i,mip->mp", single, each)
            by_coefficient = 2.0 * np.tensordot(degrees[0], each, 1)
        factor = np.exp(bright)
        value, slope = factor * (degrees @ by_degree)
        return value, slope + rate * value, factor * by_coefficient


@dataclass(frozen=True)
class HighOrders:
    """Orders ≥ 3: polynomials of σt, albedo, mean cosine and how moments differ from Henyey–Greenstein's.

        σs³ · exp(Σ S_mp T_m(w) R_p(u, v, z)) · Σ A_mpk T_m(w) P_p(u, v, z)

    Parameters
    ----------
    excess
        What z are.
    products, scale_products
        P and R.
    amplitudes
        (degrees in w, products, patterns).
    scale
        (degrees in w, scale products).
    """

    excess: Excess
    products: Products
    scale_products: Products
    amplitudes: Array
    scale: Array

    def at(self, place: Array, z: Array) -> tuple[Array, Array]:
        """(patterns,) amplitudes over σs³, and (3 + directions, patterns) their derivatives by u, w, v and z."""
        u, w, v = (float(one) for one in place)
        degrees = values_and_slopes(w, max(len(self.amplitudes), len(self.scale)) - 1)
        product, by_place = self.products.values_and_slopes(u, v, z)
        bright_product, bright_by_place = self.scale_products.values_and_slopes(u, v, z)
        shape, shape_by_w = np.tensordot(degrees[:, : len(self.amplitudes)], self.amplitudes, 1)
        scale, scale_by_w = degrees[:, : len(self.scale)] @ self.scale
        value = product @ shape
        slopes = np.empty((3 + z.size, value.size))
        slopes[1] = product @ shape_by_w + bright_product @ scale_by_w * value
        others = by_place @ shape + (bright_by_place @ scale)[:, None] * value
        slopes[0], slopes[2:] = others[0], others[1:]
        factor = np.exp(bright_product @ scale)
        return factor * value, factor * slopes

    def of(self, medium: Medium, moments: Array, coordinates: Coordinates) -> tuple[Array, Array, Array, Array]:
        """(patterns,) amplitudes of a medium and their derivatives by σt and ϖ, and (moments, patterns) by its phase
        function's Legendre moments."""
        place, rates = coordinates.of(medium.sigma_t, medium.albedo, float(moments[1]))
        found, slopes = self.at(place, self.excess.at(moments))
        light = medium.sigma_s**THIRD
        by_sigma_t = rates[0] * slopes[0] + THIRD / medium.sigma_t * found
        by_albedo = rates[1] * slopes[1] + THIRD / medium.albedo * found
        by_moments = self.excess.rates(moments).T @ slopes[3:]
        by_moments[1] += rates[2] * slopes[2]
        return light * found, light * by_sigma_t, light * by_albedo, light * by_moments


@dataclass(frozen=True)
class PhaseAnswer:
    """Images of media with any phase function, as sums of spatial patterns.

    Parameters
    ----------
    coordinates
        Of the box that it answers for, whose g is the mean cosine.
    traits
        What it knows of a phase function.
    once, twice, rest
        Amplitudes of the patterns: orders 1, 2 and the rest.
    patterns
        (patterns, pixels).
    shape
        (rows, columns) of the camera.
    error
        Squared relative L2 error of the image: at the albedo's lower and upper edge, and what is added there for each
        unit of the mean square of z.
    """

    coordinates: Coordinates
    traits: PhaseTraits
    once: LowOrder
    twice: LowOrder
    rest: HighOrders
    patterns: Single
    shape: tuple[int, int]
    error: Array

    def image(self, medium: Medium) -> Array:
        """(rows, columns) image, W/mm²/sr; never negative."""
        return np.asarray(self._images(self._amplitudes(medium)[0][None])[0])

    def image_and_derivatives(self, medium: Medium) -> tuple[Array, Array]:
        """The image, and (3, rows, columns) its derivatives by σa, σs and g, of Henyey–Greenstein."""
        from tankrig.scene.phase_functions import HenyeyGreenstein

        step = 1e-3 * (1.0 - medium.g) * (1.0 + medium.g)
        image, slopes = self.image_and_slopes(medium, [HenyeyGreenstein(medium.g + step)])
        slopes[2] /= step
        return image, slopes

    def image_and_slopes(self, medium: Medium, others: Sequence[PhaseFunction]) -> tuple[Array, Array]:
        """The image, and its derivatives.

        Parameters
        ----------
        medium
            In the box.
        others
            Phase functions near the medium's.

        Returns
        -------
        image
            (rows, columns).
        slopes
            (2 + others, rows, columns) by σa and σs, and by the share of the way to each other phase function.
        """
        value, by_sigma_t, by_albedo, by_traits = self._amplitudes(medium)
        here = self.traits.of(medium.phase_function)
        ways = np.array([self.traits.of(one) - here for one in others]).reshape(-1, here.size)
        by_sigma_a = by_sigma_t - medium.albedo / medium.sigma_t * by_albedo
        by_sigma_s = by_sigma_t + (1.0 - medium.albedo) / medium.sigma_t * by_albedo
        found = self._images(np.concatenate([[value, by_sigma_a, by_sigma_s], ways @ by_traits]))
        return found[0], found[1:]

    def error_at(self, medium: Medium) -> float:
        """Estimated relative L2 error of one medium's image."""
        moments = self.traits.of(medium.phase_function)[self.traits.moments]
        w = float(self.coordinates.of(medium.sigma_t, medium.albedo, float(moments[1]))[0][1])
        return float(np.sqrt(error_terms(w, self.rest.excess.at(moments)) @ self.error))

    def error_over_box(self) -> tuple[float, float]:
        """The same for a usual phase function: root mean square over the box, and the largest."""
        usual = np.ones(self.rest.excess.directions.shape[1])
        squares = [float(error_terms(w, usual) @ self.error) for w in np.linspace(-1.0, 1.0, 9)]
        return float(np.sqrt(np.mean(squares))), float(np.sqrt(np.max(squares)))

    def _images(self, amplitudes: Array) -> Array:
        """(n, rows, columns) of (n, patterns), all of them nothing where the first is negative."""
        images = (amplitudes.astype(np.float32) @ self.patterns).astype(float)
        images[:, images[0] < 0.0] = 0.0
        return np.asarray(images.reshape(-1, *self.shape))

    def _amplitudes(self, medium: Medium) -> tuple[Array, Array, Array, Array]:
        """(patterns,) of the image and its derivatives by σt and ϖ, and (traits, patterns) by those of the phase."""
        numbers, sigma_t, albedo = self.traits.of(medium.phase_function), medium.sigma_t, medium.albedo
        moments = numbers[self.traits.moments]
        place, rates = self.coordinates.of(sigma_t, albedo, float(moments[1]))
        value, by_sigma_t, by_albedo = (np.zeros(len(self.patterns)) for _ in range(3))
        by_traits = np.zeros((numbers.size, value.size))
        for low, part in ((self.once, self.traits.once), (self.twice, self.traits.twice)):
            found, by_u, by_coefficients = low.at(float(place[0]), numbers[part])
            light = medium.sigma_s**low.order
            value += light * found
            by_sigma_t += light * (rates[0] * by_u + low.order / sigma_t * found)
            by_albedo += light * low.order / albedo * found
            by_traits[part] += light * by_coefficients
        found, high_by_sigma_t, high_by_albedo, by_moments = self.rest.of(medium, moments, self.coordinates)
        value += found
        by_sigma_t += high_by_sigma_t
        by_albedo += high_by_albedo
        by_traits[self.traits.moments] += by_moments
        return value, by_sigma_t, by_albedo, by_traits


def error_terms(w: float, z: Array) -> Array:
    """(4,) what the squared error is a sum of: see `PhaseAnswer.error`."""
    high, unlike = 0.5 * (1.0 + w), float(np.mean(z**2))
    return np.array([1.0 - high, high, (1.0 - high) * unlike, high * unlike])

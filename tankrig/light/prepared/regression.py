"""Orders ≥ 3 as polynomials of the medium, fitted to noisy images at many media.

Every image has noise of its own, so a fit with a tenth as many coefficients as images has a third of their noise.
Coefficients are not drawn towards 0 where noise explains them: what that leaves out is light, in all fits alike, which
no comparison of two halves of the images can tell (decision 211).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

POLYNOMIAL_ERROR = 0.002
"""Of the total: no image counts for more than one with this error, or thin media would bend the fit of dense ones."""
ROUNDS = 2
FEWEST_FREE = 3
"""Images more than coefficients, at least, that noise can be told by."""
MOST_OWN = 0.9
"""Share of itself that any image may be taken to put into its fit."""


@dataclass(frozen=True)
class Fit:
    """Fitted fields.

    Parameters
    ----------
    scale
        (albedos, brightness polynomials): logarithm of the light's sum over σs³.
    fields
        (albedos, polynomials, cells): the image over both.
    pull
        (albedos, polynomials, media): what each image over both adds to the coefficients.
    left
        (media, albedos, cells): what each differs by from the fit, as large as its noise: more than what is seen, for
        every image draws the fit towards itself, and as much more as Student has it for so few images.
    """

    scale: Array
    fields: Array
    pull: Array
    left: NDArray[np.float32]


@dataclass(frozen=True)
class Regression:
    """Images at media, to be fitted.

    Parameters
    ----------
    products, brightness
        (media, polynomials) of the images, and of the logarithm of their light.
    batches
        (media,) lattices of paths in each image.
    scattering
        (media, albedos) σs, 1/mm.
    images
        (media, albedos, cells).
    light
        (cells,) such that images @ light is an image's light.
    exact
        (media, albedos) L2 norm of orders 1 and 2 in the same unit.
    """

    products: Array
    brightness: Array
    batches: Array
    scattering: Array
    images: Array
    light: Array
    exact: Array

    def fit(self, used: NDArray[np.bool_]) -> Fit:
        """Fit the media that are `used`, a Boolean for each."""
        brightness, products, batches = self.brightness[used], self.products[used], self.batches[used]
        scales, fields, pulls, lefts = [], [], [], []
        free = max(len(products) - products.shape[1], FEWEST_FREE)
        student = np.sqrt(free / (free - 2.0))
        for albedo in range(self.images.shape[1]):
            images = self.images[used, albedo]
            cubes = self.scattering[used, albedo] ** 3
            logarithm = np.log(np.maximum(images @ self.light, 1e-300) / cubes)
            scale = np.linalg.lstsq(brightness, logarithm, rcond=None)[0]
            bright = (cubes * np.exp(brightness @ scale))[:, None]
            relative = images / bright
            total = (np.linalg.norm(images, axis=1) + self.exact[used, albedo]) / bright[:, 0]
            weight = np.sqrt(batches) / total
            for _ in range(ROUNDS):
                field = np.linalg.lstsq(products * weight[:, None], relative * weight[:, None], rcond=None)[0]
                variance = np.sum((relative - products @ field) ** 2, axis=1) * batches
                smooth = brightness @ np.linalg.lstsq(brightness, np.log(variance + 1e-12 * total**2), rcond=None)[0]
                weight = 1.0 / np.sqrt(np.exp(smooth) / batches + (POLYNOMIAL_ERROR * total) ** 2)
            pull = np.linalg.pinv(products * weight[:, None]) * weight
            field = pull @ relative
            own = np.minimum(np.einsum("jp,pj->j", products, pull), MOST_OWN)
            scales.append(scale)
            fields.append(field)
            pulls.append(pull)
            lefts.append((student * (relative - products @ field) / np.sqrt(1.0 - own)[:, None]).astype(np.float32))
        return Fit(np.array(scales), np.array(fields), np.array(pulls), np.stack(lefts, axis=1))

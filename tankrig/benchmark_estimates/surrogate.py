"""A model's image near one medium as a polynomial of second degree, for many fits to the same truth."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import Range, slopes, to_coordinates, to_medium
from tankrig.estimation.followed import remembered
from tankrig.estimation.versions import Models
from tankrig.prediction import Prediction
from tankrig.scene import Medium

Array = NDArray[np.float64]

EDGES = np.array([(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)], float)
"""Directions in which two coordinates change together."""


def near(predict: Callable[[Medium], Prediction], centre: Medium, reach: Array) -> Models:
    """Models that answer within `reach` of a medium's coordinates by a polynomial through 13 images of `predict`.

    Parameters
    ----------
    predict
        A smooth function of the medium.
    centre
        Medium.
    reach
        (3,) in log σs, logit ϖ and atanh g.
    """
    middle = to_coordinates(centre)
    places = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3), EDGES])
    at_centre = predict(centre)
    images = np.stack([predict(to_medium(middle + place * reach)).image for place in places])
    coefficients = np.linalg.lstsq(_terms(places), images.reshape(len(places), -1), rcond=None)[0]
    shape = images.shape[1:]

    @remembered
    def predicted(medium: Medium) -> Prediction:
        place = (to_coordinates(medium) - middle) / reach
        return replace(at_centre, image=(_terms(place[None]) @ coefficients).reshape(shape))

    def differentiated(medium: Medium) -> Array:
        place = (to_coordinates(medium) - middle) / reach
        by_coordinates = (_slopes(place) @ coefficients) / reach[:, None]
        # (3, 3) ∂coordinates/∂(σa, σs, g) by rows of coordinates
        chain = np.linalg.inv(slopes(medium))
        found: Array = (chain.T @ by_coordinates).reshape(3, *shape)
        return found

    return Models(predicted, lambda _: (predicted, predicted), differentiated, Range(middle - reach, middle + reach))


def _terms(places: Array) -> Array:
    """(n, 10) 1, x, y, z, x², y², z², xy, xz, yz."""
    x, y, z = places.T
    return np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], axis=1)


def _slopes(place: Array) -> Array:
    """(3, 10) their derivatives."""
    x, y, z = place
    return np.array([
        [0, 1, 0, 0, 2 * x, 0, 0, y, z, 0],
        [0, 0, 1, 0, 0, 2 * y, 0, x, 0, z],
        [0, 0, 0, 1, 0, 0, 2 * z, 0, x, y],
    ])  # fmt: skip

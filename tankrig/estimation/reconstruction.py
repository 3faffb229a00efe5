"""The paper's central comparison: an image rebuilt from more and more orders of scattering beside the observed one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.estimate import Estimate
from tankrig.orders import ORDER_CLASSES
from tankrig.prediction import Prediction

Image = NDArray[np.floating]


@dataclass(frozen=True)
class Reconstruction:
    """An image from some orders of scattering, at a fit's medium, gain and offset.

    Parameters
    ----------
    orders
        "1", "1–3", "1–20" or "all".
    image
        gain · radiance + offset, units of the observed image.
    residual
        Observed less `image`; NaN where a pixel was left out.
    rmse
        Root mean square of the residual.
    """

    orders: str
    image: Image
    residual: Image
    rmse: float


def by_order(estimate: Estimate, prediction: Prediction) -> tuple[Reconstruction, ...]:
    """Rebuild a fitted image from orders 1, 1–3, 1–20 and all (the paper's Figs. 6 and 7).

    Parameters
    ----------
    estimate
        The fit; medium, gain and offset stay the same for every reconstruction.
    prediction
        The model's image at the fitted medium, with its orders; without them only "all" can be shown.
    """
    observed = estimate.image + estimate.residual
    sums: dict[str, Image] = {}
    if all(order in prediction.orders for order in ORDER_CLASSES[:4]):
        low, up_to_3, up_to_20 = (
            np.sum([prediction.orders[order] for order in ORDER_CLASSES[:count]], axis=0) for count in (1, 3, 4)
        )
        sums |= {"1": low, "1–3": up_to_3, "1–20": up_to_20}
    sums["all"] = prediction.image
    return tuple(_compared(orders, estimate.gain * image + estimate.offset, observed) for orders, image in sums.items())


def _compared(orders: str, image: Image, observed: Image) -> Reconstruction:
    residual = observed - image
    return Reconstruction(orders, image, residual, float(np.sqrt(np.nanmean(np.square(residual)))))

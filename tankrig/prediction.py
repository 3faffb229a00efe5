"""What a model says a camera would see."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.floating]


@dataclass(frozen=True)
class Skipped:
    """One thing a model left out, and a bound on what that does to the image (relative L2)."""

    what: str
    bound: float


@dataclass(frozen=True)
class Prediction:
    """Radiance leaving the plane z = Lz towards the camera.

    Parameters
    ----------
    image
        Radiance, rows = y, columns = x, W/mm²/sr.
    model
        Name of the model that made it.
    orders
        Images by order of scattering (keys of `tankrig.orders.ORDER_CLASSES`) that add up to `image`; empty
        where the model has none.
    stderr
        One-sigma standard error of `image`, or None where the model has no noise.
    skipped
        What was left out, with bounds.
    """

    image: Image
    model: str
    orders: Mapping[int | str, Image] = field(default_factory=lambda: MappingProxyType({}))
    stderr: Image | None = None
    skipped: tuple[Skipped, ...] = ()

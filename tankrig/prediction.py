"""What a model says a camera would see."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Image = NDArray[np.floating]

UNIT = "W/mm²/sr"
ORDER_CLASSES: tuple[int | str, ...] = (1, 2, 3, "4-20", ">20")
"""Of scattering events, which images are split by; in ascending order, as in the reference images."""


def order_class(order: int) -> int | str:
    """Class that an order of scattering belongs to.

    Examples
    --------
    >>> order_class(2), order_class(4), order_class(21)
    (2, '4-20', '>20')
    """
    if order <= 3:
        return order
    return "4-20" if order <= 20 else ">20"


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
        Images by order of scattering (keys of `ORDER_CLASSES`) that add up to `image`; empty where the model
        has none.
    stderr
        One-sigma standard error of `image`: noise, and what smoothing it, or solving for it, has lost. None where the
        model has neither.
    skipped
        What was left out, with bounds.
    missed
        A sentence where the tolerance that was asked for could not be kept, and why; else empty.
    patterns
        (n, rows, columns) of what noise is in `stderr`, as it lies: its covariance is the sum of their products. None
        where only its size is known.

    Examples
    --------
    >>> Prediction(np.ones((2, 2)), "tank", stderr=np.full((2, 2), 0.03), skipped=(Skipped("tables", 0.04),)).error
    0.05
    """

    image: Image
    model: str
    orders: Mapping[int | str, Image] = field(default_factory=lambda: MappingProxyType({}))
    stderr: Image | None = None
    skipped: tuple[Skipped, ...] = ()
    missed: str = ""
    patterns: Image | None = None

    @property
    def error(self) -> float:
        """Stated error, relative L2 of the image: `stderr` and all finite bounds of what was left out."""
        bounds = [part.bound for part in self.skipped if math.isfinite(part.bound)]
        return math.hypot(self.noise, *bounds)

    @property
    def noise(self) -> float:
        """`stderr`, relative L2 of the image; however faint both are."""
        peak = float(np.max(np.abs(self.image), initial=0.0))
        if self.stderr is None or peak == 0.0:
            return 0.0
        return float(np.linalg.norm(self.stderr / peak) / np.linalg.norm(self.image / peak))

    def plot(self) -> "Figure":
        """The image, and its parts by order of scattering, in false colour; a figure of matplotlib."""
        from tankrig.notebook import pictures

        parts = {f"order {order}": part for order, part in self.orders.items()}
        return pictures({f"{self.model}, all orders": self.image, **(parts if len(parts) > 1 else {})}, unit=UNIT)

    def _repr_html_(self) -> str:
        """For notebooks: what it is, what was left out, and the figure."""
        from tankrig.notebook import page

        rows, columns = self.image.shape
        said = [("pixels", f"{rows} × {columns}"), ("brightest", f"{float(np.max(self.image)):.4g} {UNIT}")]
        said += [("left out", f"{one.what} (changes the image by at most {one.bound:.2g})") for one in self.skipped]
        return page(f"prediction of model {self.model}", said, self.plot())

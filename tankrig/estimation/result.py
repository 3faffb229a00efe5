"""What fits say: of one image, of several images of one liquid, of a dilution series, and order by order."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.ink_blocks import in_tank
from tankrig.estimation.phase_result import Scattering
from tankrig.prediction import ORDER_CLASSES, Prediction
from tankrig.scene import Medium
from tankrig.scene.phase_table import PhaseFunction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Image = NDArray[np.floating]

DOUBTED = 0.01
"""Structure beyond what the models state, as a share of an image, from which on a Henyey–Greenstein fit determines
neither σs nor g of ink: an emulsion leaves 6 %, beads 14 %, and σs is off by a third or more. One of g .56 on a bench
left 1.5 to 2.3 % in its doses, with σs 7 to 13 % off; ink of Henyey–Greenstein's there .5 % at most."""
UNDESCRIBED = 0.02
"""The same of a free phase function's fit."""


@dataclass(frozen=True)
class Estimate:
    """Coefficients fitted to an image, with what is known about them.

    Parameters
    ----------
    medium
        Fitted σa, σs, g.
    covariance
        (3, 3), of (σa, σs, g), g the mean cosine: camera noise and the model's own error, gain and offset as free as
        they were.
    identifiable
        Which of "sigma_a", "sigma_s", "g" the image determines.
    gain, offset
        Fitted, or as given.
    image
        Fitted image, gain · radiance + offset, in units of the observed one.
    residual
        Observed less fitted; NaN where a pixel was left out.
    rmse
        Root mean square of the residual over the pixels used, image units.
    verdict
        What is determined, which combination is where not all are, and what the residual says; plain sentences.
    model
        Name of the model fitted.
    noise
        RMS standard deviation of the image's noise, image units: as given or estimated, or as the residual shows where
        that is more.
    model_error
        The model's error that the covariance counts with: relative L2 of the image.
    nuisance
        What was fitted along, as name: (value, standard deviation), in the unit of the name.
    structure
        (rows, columns) residual averaged over neighbouring pixels, in standard deviations of what noise leaves of it:
        beyond ±4 there is something that noise does not explain. NaN where no pixel was used.
    stretch
        Factors by which a coefficient's interval reaches further below and above than a normal one, where its profile
        likelihood was computed; missing where the image responds in proportion.
    scattering
        How the liquid scatters: curve of the phase function with its band, what follows from it, and the families that
        it was found with.
    """

    medium: Medium
    covariance: NDArray[np.float64]
    identifiable: dict[str, bool]
    gain: float
    offset: float
    image: Image
    residual: Image
    rmse: float
    verdict: str
    model: str
    noise: float
    model_error: float
    nuisance: dict[str, tuple[float, float]] = field(default_factory=dict)
    structure: Image | None = None
    stretch: dict[str, tuple[float, float]] = field(default_factory=dict)
    scattering: Scattering | None = None

    @property
    def phase(self) -> PhaseFunction:
        """The fitted phase function."""
        return self.medium.phase_function

    def interval(self, level: float = 0.95, profile: bool = True) -> dict[str, tuple[float, float]]:
        """Where each coefficient lies with probability `level`, cut at the range allowed.

        Parameters
        ----------
        level
            0 < level < 1.
        profile
            Follow the profile likelihood where the image bends; False for normal intervals throughout.

        Returns
        -------
        {"sigma_a": (low, high), "sigma_s": …, "g": …}, σ ≥ 0 and −1 ≤ g ≤ 1
        """
        from scipy.special import ndtri

        if not 0.0 < level < 1.0:
            raise ValueError(f"level = {level} is no probability; give one between 0 and 1, such as 0.95")
        reach = float(ndtri(0.5 + 0.5 * level)) * np.sqrt(np.diag(self.covariance))
        allowed = {"sigma_a": (0.0, math.inf), "sigma_s": (0.0, math.inf), "g": (-1.0, 1.0)}
        intervals = {}
        for (name, (low, high)), half in zip(allowed.items(), reach, strict=True):
            best = getattr(self.medium, name)
            below, above = self.stretch.get(name, (1.0, 1.0)) if profile else (1.0, 1.0)
            intervals[name] = (max(low, best - below * float(half)), min(high, best + above * float(half)))
        return intervals

    def plot(self) -> "Figure":
        """The observed image, the fitted one and what is left over; a figure of matplotlib."""
        from tankrig.notebook import pictures

        shown = {"observed": self.image + self.residual, "fitted": self.image, "residual": self.residual}
        return pictures(shown, residuals=("residual",))

    def _repr_html_(self) -> str:
        """For notebooks: the coefficients with intervals, the verdict, and the figure."""
        from tankrig.notebook import page

        said = _coefficients(self.medium, self.covariance, self.identifiable)
        said += [("gain, offset", f"{self.gain:.5g}, {self.offset:.3g}"), ("left over, RMS", f"{self.rmse:.3g}")]
        said += [(name, f"{value:.4g} ± {sd:.2g}") for name, (value, sd) in self.nuisance.items()]
        return page(f"estimate by model {self.model}", [*said, ("verdict", self.verdict)], self.plot())


def _coefficients(medium: Medium, covariance: Array, identifiable: Mapping[str, bool]) -> list[tuple[str, str]]:
    """Rows of σa, σs and g with their standard deviations, and whether they are determined."""
    units = {"sigma_a": "/mm", "sigma_s": "/mm", "g": ""}
    return [
        (
            name,
            f"{getattr(medium, name):.5g} ± {math.sqrt(max(0.0, covariance[k, k])):.2g}{unit}"
            + ("" if identifiable[name] else ", not determined"),
        )
        for k, (name, unit) in enumerate(units.items())
    ]


@dataclass(frozen=True)
class LiquidEstimate:
    """One liquid, from images of several patterns with one gain.

    Parameters
    ----------
    medium
        Fitted σa, σs, g.
    covariance
        (3, 3), of (σa, σs, g): camera noise and the models' own errors.
    gain
        Common.
    rmse
        Root mean square of the residuals, all images.
    model_error
        Counted, relative L2: what the models state or, where that is more, what the residuals show.
    identifiable
        Which of "sigma_a", "sigma_s", "g" the images determine.
    beyond
        Structure of the residuals beyond what the models state, relative L2.
    scattering
        How the liquid scatters, as in an `Estimate`.
    nuisance
        Value and standard deviation of each that was fitted along, the same in all images.
    """

    medium: Medium
    covariance: Array
    gain: float
    rmse: float
    model_error: float
    identifiable: dict[str, bool]
    beyond: float
    scattering: Scattering | None = None
    nuisance: dict[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Linearity:
    """By how much the ink does more (+) or less (−) than in proportion to its dose, at the highest: share and error."""

    bend: float
    sd: float

    @property
    def holds(self) -> bool:
        """Whether the bend is within three standard deviations of none."""
        return abs(self.bend) <= 3.0 * self.sd


@dataclass(frozen=True)
class SeriesEstimate:
    """What a dilution series says about ink and water.

    Parameters
    ----------
    ink
        σa and σs per mm and ml, and g.
    water
        What the tank holds without ink: absorption only.
    covariance
        (4, 4), of (ink σa, ink σs, g, water σa): camera noise, the models' own error, and the doses'.
    identifiable
        Which of "sigma_a", "sigma_s", "g", "water_sigma_a" the series determines.
    gain, offsets
        Common gain; offset of each image.
    doses_ml
        (K,) the different doses, each moved within its uncertainty to where the images want it.
    images, residuals
        Fitted images and observed less fitted, NaN where a pixel was left out; in the order given.
    rmse
        (N,) root mean square residual of each image.
    linearity
        By how much the ink does more (+) or less (−) than in proportion to the dose; None below three doses.
    verdict
        What is determined, whether the ink acts in proportion to its dose, and what the residuals say.
    scattering
        How the ink scatters, per ml, as in an `Estimate`.
    nuisance
        Value and standard deviation of each that was fitted along, the same in all images.
    doubted
        Whether Henyey–Greenstein's was fitted and leaves so much that the ink may well have another phase function.
    beyond
        Structure of the residuals beyond what the models state, relative L2, of the image that has most.
    """

    ink: Medium
    water: Medium
    covariance: NDArray[np.float64]
    identifiable: dict[str, bool]
    gain: float
    offsets: tuple[float, ...]
    doses_ml: Array
    images: tuple[Image, ...]
    residuals: tuple[Image, ...]
    rmse: Array
    linearity: Linearity | None
    verdict: str
    scattering: Scattering | None = None
    nuisance: dict[str, tuple[float, float]] = field(default_factory=dict)
    doubted: bool = False
    beyond: float = 0.0

    def at(self, dose_ml: float) -> Medium:
        """The liquid at a dose."""
        return in_tank(self.ink, self.water.sigma_a, dose_ml)

    def plot(self) -> "Figure":
        """What each fitted image leaves over; a figure of matplotlib."""
        from tankrig.notebook import pictures

        titles = [f"image {number}: left over" for number in range(1, len(self.residuals) + 1)]
        return pictures(dict(zip(titles, self.residuals, strict=True)), residuals=titles)

    def _repr_html_(self) -> str:
        """For notebooks: the ink per ml with its errors, the verdict, and the figure."""
        from tankrig.notebook import page

        said = [(f"ink, per ml: {name}", value) for name, value in
                _coefficients(self.ink, self.covariance, self.identifiable)]  # fmt: skip
        said += [("water: sigma_a", f"{self.water.sigma_a:.4g} ± {math.sqrt(max(0.0, self.covariance[3, 3])):.2g}/mm")]
        return page("estimate of a dilution series", [*said, ("verdict", self.verdict)], self.plot())


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


ALL_ORDERS = "all orders"
_LIGHT = {
    "single": "order 1 alone",
    "convolution": "all orders in an infinite medium",
    "diffuse": "the diffuse limit",
}


def light_of(model: str, max_order: int | None = None) -> str:
    """What light the whole image of a model holds, in words: `Reconstruction.orders` calls it "all" of any.

    >>> light_of("tank"), light_of("tank", 3), light_of("single"), light_of("diffuse")
    ('all orders', 'orders 1–3', 'order 1 alone', 'the diffuse limit')
    """
    if model == "single" or max_order == 1:
        return _LIGHT["single"]
    if max_order is not None:
        return f"orders 1–{max_order}" + (" in an infinite medium" if model == "convolution" else "")
    return _LIGHT.get(model, ALL_ORDERS)


def told_apart(rebuilt: Sequence[Reconstruction], max_order: int | None) -> list[Reconstruction]:
    """Reconstructions that are not the same as the whole, where no more than orders 1 … `max_order` were fitted."""
    highest = {"1": 1, "1–3": 3, "1–20": 20}
    return [one for one in rebuilt if max_order is None or highest.get(one.orders, 0) < max_order]


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

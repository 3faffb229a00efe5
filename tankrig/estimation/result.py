"""`Estimate`: coefficients fitted to an image, with what is known about them."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Medium

Image = NDArray[np.floating]


@dataclass(frozen=True)
class Estimate:
    """Coefficients fitted to an image, with what is known about them.

    Parameters
    ----------
    medium
        Fitted σa, σs, g.
    covariance
        (3, 3), of (σa, σs, g): camera noise and the model's own error, gain and offset as free as they were.
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

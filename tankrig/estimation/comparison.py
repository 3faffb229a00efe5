"""The same image explained by different models: how well, with what coefficients, and what that says about each model.

The paper compares single scattering with its own model by eye and by RMSE. An information criterion adds what the
number of coefficients and of pixels says about chance. Residuals of neighbouring pixels are alike where a model errs,
so that an image of n pixels is not n observations: the effective number is n/(1 + 2 Σ ρ), with the correlation of the
best model's residual, and the criteria

    AIC = n_eff ln(RSS/n) + 2 k,        BIC = n_eff ln(RSS/n) + k ln n_eff,

are those of errors of unknown size (Burnham and Anderson 2002), taken relative to the best.
"""

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.errors import TankrigError
from tankrig.estimation.estimate import Estimate, estimate
from tankrig.estimation.phase_families import FAMILIES
from tankrig.scene import Scene

Array = NDArray[np.float64]
Free = Literal["free"]

FARTHEST = 16
"""Pixels over which correlations of a residual are summed."""


@dataclass(frozen=True)
class Contender:
    """A model that is compared: what it is called, and `estimate`'s model, highest order and phase function."""

    name: str
    model: str
    max_order: int | None = None
    phase: str | None = None

    @property
    def more(self) -> int:
        """Coordinates that it is fitted with, beyond the three of Henyey–Greenstein's."""
        return 0 if self.phase in (None, "hg") else len(FAMILIES[self.phase]().names) - 1


CONTENDERS = (
    Contender("single scattering", "single"),
    Contender("orders 1–3", "tank", 3),
    Contender("orders 1–20", "tank", 20),
    Contender("tank, all orders", "tank"),
    Contender("infinite medium", "convolution"),
    Contender("diffuse limit", "diffuse"),
)
"""Single scattering is orders 1 … 1."""
PHASES = tuple(Contender(f"tank, {phase} p(θ)", "tank", phase=phase) for phase in ("hg", *FAMILIES))
"""Families of phase functions, all orders."""


@dataclass(frozen=True)
class Compared:
    """A model beside the others.

    Parameters
    ----------
    contender
        Which.
    estimate
        Its fit; None where it could not be fitted.
    seconds
        That took.
    aic, bic
        Above the best model's; infinite where there is no fit.
    refusal
        Why there is no fit; else empty.
    """

    contender: Contender
    estimate: Estimate | None
    seconds: float
    aic: float = math.inf
    bic: float = math.inf
    refusal: str = ""


@dataclass(frozen=True)
class Comparison:
    """Models compared.

    Parameters
    ----------
    rows
        In the order given.
    pixels, effective
        Used, and how many independent ones they count for.
    """

    rows: tuple[Compared, ...]
    pixels: int
    effective: float


def compare_models(
    image: ArrayLike,
    scene: Scene,
    gain: float | Free = "free",
    offset: float | Free = "free",
    noise: ArrayLike | None = None,
    contenders: Sequence[Contender] = CONTENDERS,
    progress: Callable[[str], None] | None = None,
    *,
    mask: ArrayLike | None = None,
) -> Comparison:
    """Fit an image by several models.

    Parameters
    ----------
    image, scene, gain, offset, noise, mask
        As for `tankrig.estimate`.
    contenders
        The models.
    progress
        Told in a few words what is being done.

    Raises
    ------
    TankrigError
        When no model can be fitted: the first one's reason.
    """
    told = progress or (lambda _: None)
    fits: list[Compared] = []
    errors: list[TankrigError] = []
    for number, one in enumerate(contenders, 1):
        told(f"fitting {one.name}, {number} of {len(contenders)}")
        began = time.perf_counter()
        found, refusal = None, ""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # what a model leaves out is in its verdict
                phase = one.phase or (None if scene.medium.phase else "hg")  # a model that is not taken for another
                found = estimate(image, scene, gain, offset, noise, mask, one.model, one.max_order, phase=phase)
        except TankrigError as error:
            errors.append(error)
            refusal = str(error)
        fits.append(Compared(one, found, time.perf_counter() - began, refusal=refusal))
    fitted = [fit.estimate for fit in fits if fit.estimate is not None]
    if not fitted:
        raise errors[0]
    best = min(fitted, key=lambda fit: fit.rmse)
    pixels = int(np.isfinite(best.residual).sum())
    effective = effective_pixels(np.asarray(best.residual, float))
    rows = [_criteria(fit, best.rmse, effective) for fit in fits]
    aic, bic = min(row.aic for row in rows), min(row.bic for row in rows)
    rows = [replace(row, aic=row.aic - aic, bic=row.bic - bic) if row.estimate else row for row in rows]
    return Comparison(tuple(rows), pixels, effective)


def _criteria(fit: Compared, least: float, effective: float) -> Compared:
    """AIC and BIC less what three coefficients cost in each model."""
    if fit.estimate is None:
        return fit
    worse, more = 2.0 * effective * math.log(fit.estimate.rmse / least), fit.contender.more
    return replace(fit, aic=worse + 2.0 * more, bic=worse + more * math.log(effective))


def effective_pixels(residual: Array) -> float:
    """How many independent pixels a residual counts for; NaN where a pixel was left out.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=(60, 80))
    >>> effective_pixels(noise) > 4000, effective_pixels(np.kron(noise, np.ones((4, 4)))) < 8000
    (True, True)
    """
    used = np.isfinite(residual)
    values = np.where(used, residual - np.nanmean(residual), 0.0)
    power = float(np.sum(values**2)) / used.sum()
    shares = 1.0
    for axis in (0, 1):
        along, counts = np.moveaxis(values, axis, 0), np.moveaxis(used, axis, 0)
        total = 1.0
        for lag in range(1, min(FARTHEST, len(along))):
            pairs = counts[lag:] & counts[:-lag]
            correlation = float(np.sum(along[lag:] * along[:-lag])) / max(int(pairs.sum()), 1) / power
            if correlation < 2.0 / math.sqrt(max(int(pairs.sum()), 1)):
                break
            total += 2.0 * correlation
        shares *= total
    return max(float(used.sum() / shares), 10.0)

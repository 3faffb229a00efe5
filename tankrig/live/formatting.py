"""Fits of a run as text, for whoever watches it."""

import math
from typing import TYPE_CHECKING

from tankrig.estimation.verdict import SYMBOLS
from tankrig.live.results import FIRST_LOOK, DoseFit, FailedFit, Fit, SeriesFit

if TYPE_CHECKING:
    from tankrig.live.preparing import Preparation  # it brings numba along, which words do not need


def with_error(value: float, sd: float) -> str:
    """A value to two digits of its standard deviation.

    >>> with_error(0.0123456, 0.00012)
    '0.01235 ± 0.00012'
    """
    if not sd > 0.0:
        return f"{value:.4g} ± 0"
    digits = min(8, max(0, 1 - math.floor(math.log10(sd))))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def fit_in_words(fit: Fit | None) -> str:
    """A fit as one sentence: what is in the tank, or in a ml of ink, with standard deviations.

    Examples
    --------
    >>> from tankrig.scene import Medium
    >>> fit_in_words(DoseFit(0.4, Medium(2.6e-4, 0.0048, 0.71), (8e-6, 2e-5, 5e-4)))
    'with 0.4 ml: σs 0.004800 ± 0.000020, g 0.71000 ± 0.00050, σa 0.0002600 ± 0.0000080 per mm'
    >>> fit_in_words(None)
    'nothing fitted yet'
    """
    if fit is None:
        return "nothing fitted yet"
    dose_ml = None if isinstance(fit, SeriesFit) else fit.dose_ml
    subject = "ink" if dose_ml is None else f"with {dose_ml:.4g} ml"
    if isinstance(fit, FailedFit):
        return f"{subject}: could not be fitted ({fit.error})"
    found = fit.medium if isinstance(fit, DoseFit) else fit.ink
    shown = ((found.sigma_s, fit.sd[1]), (found.g, fit.sd[2]), (found.sigma_a, fit.sd[0]))
    sigma_s, g, sigma_a = (with_error(*one) for one in shown)
    unit = "per mm" if isinstance(fit, DoseFit) else "per mm and ml"
    return f"{subject}: σs {sigma_s}, g {g}, σa {sigma_a} {unit}{doubts(fit)}"


def doubts(fit: DoseFit | SeriesFit) -> str:
    """What must not be taken from a fit's numbers, to be added to them; empty where there is nothing.

    Examples
    --------
    >>> from tankrig.scene import Medium
    >>> doubts(DoseFit(0.4, Medium(2.6e-4, 0.0048, 0.71), identifiable={"sigma_a": False, "g": True}, structure=0.012))
    '; not determined: σa; 1.2 % of the light is not as the model has it, and counted in the errors'
    """
    no = [symbol for name, symbol in SYMBOLS.items() if not fit.identifiable.get(name, True)]
    said = f"; not determined: {', '.join(no)}" if no else ""
    if isinstance(fit, DoseFit) and fit.model == FIRST_LOOK:
        said += "; a first look at one pattern, the fit is to come"
    if isinstance(fit, DoseFit) and fit.first:
        said += "; by a model of few light paths, a closer fit is to come"
    if isinstance(fit, DoseFit) and fit.structure:
        said += f"; {100.0 * fit.structure:.2g} % of the light is not as the model has it, and counted in the errors"
    if isinstance(fit, DoseFit) and fit.order_one:
        said += f"; {fit.order_one.rstrip('.')}"
    return said


def preparation_in_words(left: "Preparation") -> str:
    """What fits wait for, and for how long; empty where they wait for nothing.

    Examples
    --------
    >>> from tankrig.live.preparing import Preparation
    >>> preparation_in_words(Preparation(3, 42.0))
    '3 models are being prepared for the fit, about 42 s left'
    >>> preparation_in_words(Preparation(0, 0.0))
    ''
    """
    if left.models == 0:
        return ""
    what = "1 model is" if left.models == 1 else f"{left.models} models are"
    how_long = "" if left.seconds_left is None else f", about {left.seconds_left:.0f} s left"
    why = f"; {left.note}" if left.note else ""
    return f"{what} being prepared for the fit{how_long}{why}"

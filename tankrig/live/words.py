"""Fits of a run in words, for whoever watches it."""

import math
from collections.abc import Mapping
from typing import Any


def with_error(value: float, sd: float) -> str:
    """A value to two digits of its standard deviation.

    >>> with_error(0.0123456, 0.00012)
    '0.01235 ± 0.00012'
    """
    if not sd > 0.0:
        return f"{value:.4g} ± 0"
    digits = min(8, max(0, 1 - math.floor(math.log10(sd))))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"


def fit_in_words(table: Mapping[str, Any] | None) -> str:
    """A `fit` line of the journal as one sentence: what is in the tank, or in a ml of ink, with standard deviations.

    Examples
    --------
    >>> found = {"sigma_s": 0.0048, "g": 0.71, "sigma_a": 2.6e-4, "sd": [8e-6, 2e-5, 5e-4]}
    >>> fit_in_words({"fit": "dose", "dose_ml": 0.4, **found})
    'with 0.4 ml: σs 0.004800 ± 0.000020, g 0.71000 ± 0.00050, σa 0.0002600 ± 0.0000080 per mm'
    >>> fit_in_words(None)
    'nothing fitted yet'
    """
    if table is None:
        return "nothing fitted yet"
    of_dose = table["fit"] == "dose"
    subject = f"with {table['dose_ml']:.4g} ml" if of_dose else "ink"
    if "error" in table:
        return f"{subject}: could not be fitted ({table['error']})"
    found, sd = (table if of_dose else table["ink"]), table["sd"]
    sigma_s, g, sigma_a = (with_error(found[name], sd[i]) for name, i in (("sigma_s", 1), ("g", 2), ("sigma_a", 0)))
    return f"{subject}: σs {sigma_s}, g {g}, σa {sigma_a} per mm{'' if of_dose else ' and ml'}"

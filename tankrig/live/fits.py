"""The fits of a run, as the plain tables that its journal keeps: one dose, the series, single scattering."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from tankrig.estimation.series import SeriesEstimate, estimate_series, estimate_together
from tankrig.live.exposures import Photograph
from tankrig.live.single import fit_single
from tankrig.scene.description import Medium

Table = dict[str, Any]


def fit_dose(photographs: Sequence[Photograph], start: Medium | None = None) -> tuple[Table, SeriesEstimate]:
    """Fit all photographs of one dose by the tank model, and by single scattering beside it.

    Parameters
    ----------
    photographs
        Of one dose.
    start
        Where to begin, where that is known.

    Raises
    ------
    ImageError
        When they cannot be fitted.
    """
    began = time.perf_counter()
    given = [one.image for one in photographs], [one.scene for one in photographs]
    noise, offset = [one.noise for one in photographs], photographs[0].offset
    found = estimate_together(*given, offset, noise, start=start)
    sigma_t, rmse = fit_single(photographs, found.ink)
    sd = np.sqrt(np.diag(found.covariance))[:3]
    table = {
        "fit": "dose",
        "dose_ml": photographs[0].dose_ml,
        "dose_sd_ml": photographs[0].dose_sd_ml,
        **_medium(found.ink),
        "sd": sd.tolist(),
        "identifiable": {name: known for name, known in found.identifiable.items() if name != "water_sigma_a"},
        "gain": found.gain,
        "rmse": float(np.sqrt(np.mean(found.rmse**2))),
        "frames": sum(one.frames for one in photographs),
        "patterns": [one.pattern for one in photographs],
        "single": {"sigma_t": sigma_t, "rmse": rmse},
        "seconds": round(time.perf_counter() - began, 3),
    }
    return table, found


def fit_all(
    photographs: Sequence[Photograph], start: SeriesEstimate | Medium | None = None
) -> tuple[Table, SeriesEstimate]:
    """Fit the series: all photographs of all doses.

    Raises
    ------
    ImageError
        When they are no series.
    """
    began = time.perf_counter()
    found = estimate_series(
        [one.image for one in photographs],
        [one.scene for one in photographs],
        [one.dose_ml for one in photographs],
        [one.dose_sd_ml for one in photographs],
        offset=photographs[0].offset,
        noise=[one.noise for one in photographs],
        start=start,
    )
    bend = found.linearity
    table = {
        "fit": "series",
        "doses_ml": sorted({one.dose_ml for one in photographs}),
        "ink": _medium(found.ink),
        "water_sigma_a": found.water.sigma_a,
        "sd": np.sqrt(np.diag(found.covariance)).tolist(),
        "covariance": found.covariance.tolist(),
        "identifiable": found.identifiable,
        "gain": found.gain,
        "linearity": None if bend is None else {"bend": bend.bend, "sd": bend.sd},
        "rmse": found.rmse.tolist(),
        "patterns": [one.pattern for one in photographs],
        "verdict": found.verdict,
        "seconds": round(time.perf_counter() - began, 3),
    }
    return table, found


def diluted(liquid: Medium, from_ml: float, to_ml: float) -> Medium:
    """About what a liquid with `from_ml` of ink would be with `to_ml`."""
    grown = to_ml / from_ml
    return Medium(liquid.sigma_a * grown, liquid.sigma_s * grown, liquid.g)


def _medium(medium: Medium) -> Table:
    return {"sigma_a": medium.sigma_a, "sigma_s": medium.sigma_s, "g": medium.g}

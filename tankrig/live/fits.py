"""The fits of a run, as the plain tables that its journal keeps: one dose, the series, single scattering."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from tankrig.estimation.series import SeriesEstimate, estimate_series, estimate_together
from tankrig.estimation.series_model import PURE_WATER_SIGMA_S, tank_model
from tankrig.estimation.uncertainty import identifiable
from tankrig.image.prepare import Prepared
from tankrig.live.exposures import Photograph
from tankrig.live.prepared_fit import fit_prepared
from tankrig.live.prepared_series import prepared_model
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
    table = {
        **_dose(photographs, found.ink, found.covariance),
        "gain": found.gain,
        "rmse": float(np.sqrt(np.mean(found.rmse**2))),
        "model": "tank",
    }
    return with_single(table, photographs, began), found


def fit_dose_prepared(
    photographs: Sequence[Photograph], models: Sequence[Prepared], start: Medium
) -> tuple[Table, Medium] | None:
    """The same by prepared models, one for each photograph, in milliseconds; without single scattering.

    None where the photographs want a medium that the models were not prepared for.

    Raises
    ------
    ImageError
        When they cannot be fitted.
    """
    began = time.perf_counter()
    found = fit_prepared(photographs, models, start)
    if found is None:
        return None
    table = {
        **_dose(photographs, found.medium, found.covariance),
        "gain": found.gain,
        "rmse": found.rmse,
        "model": "prepared",
        "model_error": found.model_error,
        "seconds": round(time.perf_counter() - began, 4),
    }
    return table, found.medium


def with_single(table: Table, photographs: Sequence[Photograph], began: float | None = None) -> Table:
    """A dose's table with single scattering beside it; `began` is when its fit did, by `time.perf_counter`."""
    sigma_t, rmse = fit_single(photographs, Medium(table["sigma_a"], table["sigma_s"], table["g"]))
    seconds = table["seconds"] if began is None else round(time.perf_counter() - began, 3)
    return {**table, "single": {"sigma_t": sigma_t, "rmse": rmse}, "seconds": seconds}


def fit_all(
    photographs: Sequence[Photograph],
    start: SeriesEstimate | Medium | None = None,
    models: Sequence[Prepared] = (),
) -> tuple[Table, SeriesEstimate]:
    """Fit the series: all photographs of all doses, by prepared models where there are any that hold the media.

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
        model_of=prepared_model(models) if models else tank_model,
        water_sigma_s=PURE_WATER_SIGMA_S,
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


def _dose(photographs: Sequence[Photograph], liquid: Medium, covariance: np.ndarray) -> Table:
    spread = covariance[:3, :3]
    return {
        "fit": "dose",
        "dose_ml": photographs[0].dose_ml,
        "dose_sd_ml": photographs[0].dose_sd_ml,
        **_medium(liquid),
        "sd": np.sqrt(np.diag(spread)).tolist(),
        "identifiable": identifiable(liquid, spread),
        "frames": sum(one.frames for one in photographs),
        "patterns": [one.pattern for one in photographs],
    }


def _medium(medium: Medium) -> Table:
    return {"sigma_a": medium.sigma_a, "sigma_s": medium.sigma_s, "g": medium.g}

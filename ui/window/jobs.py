"""What the window has done in its background process: each a plain function of things that can be sent there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tankrig.scene.description import Camera, Medium, Tank

if TYPE_CHECKING:
    from tankrig.live.exposures import Photograph
    from tankrig.live.results import DoseFit, SeriesFit

Image = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Comparison:
    """One photograph beside the model's image of it.

    Parameters
    ----------
    pattern, dose_ml
        What it is of.
    observed, model, residual
        (rows, columns), counts per ms; the residual is NaN where a pixel was left out.
    rmse
        Root mean square of what each sum of orders leaves, as a part of the observed peak; "single" is single
        scattering at its own best σt.
    tank, camera
        Where the pixels lie.
    """

    pattern: str
    dose_ml: float
    observed: Image
    model: Image
    residual: Image
    rmse: dict[str, float]
    tank: Tank
    camera: Camera


def compare(photograph: "Photograph", fit: "DoseFit") -> Comparison:
    """The model's image of a photograph at a fit's coefficients, by orders of scattering."""
    from tankrig.report.pictures import by_order, predicted

    prediction = predicted(photograph, fit.medium)
    gain, peak = fit.gain, float(photograph.image.max())
    left = (photograph.image - gain * prediction.image)[photograph.used]
    offset = 0.0 if photograph.offset == 0.0 else float(np.median(left))
    rebuilt = by_order(photograph, prediction, gain, offset)
    rmse = {one.orders: one.rmse / peak for one in rebuilt}
    if fit.single is not None:
        rmse["single"] = _single(photograph, fit.medium, fit.single.sigma_t) / peak
    scene = photograph.scene
    return Comparison(
        photograph.pattern, photograph.dose_ml, photograph.image, rebuilt[-1].image, rebuilt[-1].residual, rmse,
        scene.tank, scene.camera,
    )  # fmt: skip


def _single(photograph: "Photograph", medium: Medium, sigma_t: float) -> float:
    """RMSE of this photograph by single scattering at the σt that is best for all of the dose's, at its own gain."""
    from tankrig.light.single import single_scattering

    by = sigma_t / medium.sigma_t
    thinned = replace(photograph.scene, medium=Medium(by * medium.sigma_a, by * medium.sigma_s, medium.g))
    image, observed = single_scattering(thinned)[photograph.used], photograph.image[photograph.used]
    gain = float(np.vdot(image, observed) / np.vdot(image, image))
    return float(np.sqrt(np.mean((observed - gain * image) ** 2)))


def fits_of(path: Path) -> "tuple[list[DoseFit], SeriesFit | None, list[Photograph]]":
    """The last fits of a run: one for each dose, of the series, and what they are of."""
    from tankrig.report.results import results_of
    from tankrig.run.reading import open_run

    results = results_of(open_run(path))
    return results.doses, results.series, results.photographs


def refit(path: Path, patterns: Sequence[str], free_offset: bool) -> "tuple[list[DoseFit], SeriesFit | None]":
    """Fit a run anew, with some of its patterns only, or with a background that is fitted rather than subtracted.

    Returns
    -------
    The fit of each dose, and that of the series where there are two doses or more.
    """
    from tankrig.live.exposures import exposures_of
    from tankrig.live.fits import fit_all, fit_dose
    from tankrig.live.results import diluted
    from tankrig.run.reading import open_run

    photographs = [one for one in exposures_of(open_run(path)).photographs() if one.pattern in patterns]
    if free_offset:
        photographs = [replace(one, offset="free") for one in photographs]
    fits: list[DoseFit] = []
    for dose_ml in sorted({one.dose_ml for one in photographs}):
        here = [one for one in photographs if one.dose_ml == dose_ml]
        fits.append(fit_dose(here, diluted(fits[-1].medium, fits[-1].dose_ml, dose_ml) if fits else None))
    return fits, fit_all(photographs) if len(fits) > 1 else None


def report(path: Path) -> Path:
    """Write a run's report, once what it lacks is fitted."""
    from tankrig.live.refit import refit as fit_what_is_missing
    from tankrig.report import write_report

    fit_what_is_missing(path)
    return write_report(path)


def export(path: Path, target: Path) -> Path:
    """Write a run's frames as NetCDF where the target ends in .nc, else as a folder of TIFFs."""
    from tankrig.run.export import export_netcdf, export_tiff
    from tankrig.run.reading import open_run

    (export_netcdf if target.suffix == ".nc" else export_tiff)(open_run(path), target)
    return target

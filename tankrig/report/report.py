"""`write_report`: a run as one page that needs nothing but itself."""

import os
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.errors import ImageError
from tankrig.figures.tank_image import STYLE
from tankrig.files import require_writable, whole_file
from tankrig.live.exposures import Photograph
from tankrig.live.formatting import with_error
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.recorded import wave_names
from tankrig.live.results import DoseFit
from tankrig.report import curves, pictures
from tankrig.report.inlined import inlined, rendered
from tankrig.report.results import Results, known_sigma_t, results_of
from tankrig.report.settings import settings_of, skipped_of
from tankrig.report.timing import spans_of, totals
from tankrig.run.reading import Run, open_run
from tankrig.separation.recorded import separations_of_run

if TYPE_CHECKING:
    pass

ALONG = {"halo_width": "logarithm of the halo's width"}
"""What is fitted along, where its name in the journal is no word."""
WORDS = {"1": "order 1", "1–3": "orders 1–3", "1–20": "orders 1–20", "all": "all orders"}


def write_report(
    path: str | os.PathLike[str], out: Path | None = None, progress: Callable[[str], None] = lambda _: None
) -> Path:
    """Write a run's report from the fits that it has recorded: one HTML file with all pictures in it.

    What has not been fitted is left out, and the page says so; `tankrig.refit` fits it.

    Parameters
    ----------
    path
        The run's folder.
    out
        The file, or a folder for report.html; the run's own folder where None.
    progress
        Told in a few words what is being done; what it raises ends it.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    StoreError
        When the run cannot be read or the file not be written.
    ImageError
        When the run has nothing to report, or nothing of it has been fitted.
    """
    run, path = open_run(path), Path(path)
    target = path / "report.html" if out is None else out if out.suffix == ".html" else out / "report.html"
    require_writable(target.parent)
    page = report_page(run, progress)
    with whole_file(target) as unfinished:
        unfinished.write_text(page, encoding="utf-8")
    return target


def report_page(run: Run, progress: Callable[[str], None] = lambda _: None) -> str:
    """The report as HTML."""
    import matplotlib as mpl

    results = results_of(run)
    if not results.doses:
        raise ImageError(f"{run.path}: nothing of it is fitted, so there is nothing to report; {results.left_out[0]}")
    spans = spans_of(run)
    progress("drawing")
    with mpl.rc_context(STYLE):
        shown = {
            "observations": inlined(pictures.observations(results.photographs)),
            "coefficients": inlined(curves.coefficients(results.doses, results.series), "svg"),
            "timeline": inlined(curves.timeline(spans), "svg"),
        }
        rebuilt, faintest = _reconstructions(results, progress)
        separated = _separated(run, results, progress)
    began = run.journal[0].moment.utc[:19].replace("T", " ") if run.journal else "?"
    ending = run.end["reason"] if run.end else "not finished"
    return rendered(
        "page.html",
        title=str(run.settings.get("name", run.path.name)),
        subtitle=f"{run.path.name} · {run.settings.get('rig', '')} · {began} UTC · {ending}",
        headline=_headline(results),
        verdict=results.series.verdict if results.series else "",
        pictures=shown,
        separated=separated,
        doses=[_dose_row(one, known_sigma_t(one, results.series)) for one in results.doses],
        along=[_along(one) for one in results.doses if one.astray],
        compared="the series fit" if results.series else "the tank model",
        shown_pattern=_shown(results.photographs)[0].pattern,
        reconstructions=rebuilt,
        series=_series(results),
        totals=totals(spans),
        spans=spans,
        skipped=[*results.left_out, *skipped_of(run, PhotographPlan.of_run(run), faintest)],
        settings=settings_of(run),
        footer=f"made by tankrig {version('tankrig')}",
    )


def _headline(results: Results) -> list[dict[str, str]]:
    series = results.series
    if series is None:
        return []
    ink, sd = series.ink, series.sd
    numbers = [
        (ink.sigma_s, sd[1], "ink σs, 1/mm per ml"),
        (ink.g, sd[2], "ink g"),
        (ink.sigma_a, sd[0], "ink σa, 1/mm per ml"),
        (series.water.sigma_a, sd[3], "water σa, 1/mm"),
    ]
    parts = [(*with_error(value, error).split(" ± "), name) for value, error, name in numbers]
    return [{"value": value, "error": error, "name": name} for value, error, name in parts]


def _separated(run: Run, results: Results, progress: Callable[[str], None]) -> list[dict[str, Any]]:
    """One picture for each sheet that the run separated, and what it tells beside the fits."""
    from tankrig.figures.separation_figure import separation_figure
    from tankrig.live.separated import told_of

    if not wave_names(run):
        return []
    progress("separating waves")
    fits = {one.dose_ml: one for one in results.doses}
    found = []
    try:
        separations = separations_of_run(run)
    except ImageError:  # none is complete
        return []
    for one in separations:
        told = told_of(one, fits.get(one.dose_ml))
        if one.transfers:
            found.append(
                {"picture": inlined(separation_figure(one)), "about": told.sentence, "doubts": list(told.doubts)}
            )
    return found


def _dose_row(one: DoseFit, sigma_t: float) -> dict[str, str]:
    known = [symbol for name, symbol in (("sigma_s", "σs"), ("g", "g"), ("sigma_a", "σa")) if one.identifiable[name]]
    single = one.single
    return {
        "dose": f"{one.dose_ml:.4g}",
        "sigma_s": with_error(one.medium.sigma_s, one.sd[1]),
        "g": with_error(one.medium.g, one.sd[2]),
        "sigma_a": with_error(one.medium.sigma_a, one.sd[0]),
        "known": (", ".join(known) or "none")
        + (f"; {100.0 * one.structure:.2g} % of the light is not as the model has it" if one.structure else ""),
        "single": "–" if single is None else f"{100.0 * (single.sigma_t / sigma_t - 1.0):+.0f} %",
        "single_rmse": "–" if single is None else f"{single.rmse / one.rmse:.1f} ×",
    }


def _along(one: DoseFit) -> str:
    """What was fitted along at a dose, as nobody has measured it."""
    sizes = ", ".join(f"{ALONG.get(name, name)} {with_error(value, sd)}" for name, (value, sd) in one.astray.items())
    return f"{one.dose_ml:.4g} ml: {sizes}"


def _shown(photographs: list[Photograph]) -> list[Photograph]:
    """Photographs of the pattern with the most edges, on which orders of scattering look most different."""
    beams = {one.pattern: len(one.scene.projector.beams) for one in photographs}
    narrow = {
        one.pattern: sum(beam.y_mm[1] - beam.y_mm[0] for beam in one.scene.projector.beams) for one in photographs
    }
    best = min(beams, key=lambda name: narrow[name])
    return [one for one in photographs if one.pattern == best]


def _reconstructions(results: Results, progress: Callable[[str], None]) -> tuple[list[dict[str, Any]], float]:
    """One picture for each dose, the thinnest and the thickest shown at once; and the largest bound on what was cut."""
    shown = _shown(results.photographs)
    rebuilt, bound = [], 0.0
    fits = {one.dose_ml: one for one in results.doses}
    for one in shown:
        progress(f"rebuilding {one.dose_ml:g} ml by order")
        fit = fits[one.dose_ml]
        prediction = pictures.predicted(one, fit)
        offset = 0.0 if one.offset == 0.0 else float(np.median((one.image - fit.gain * prediction.image)[one.used]))
        steps = pictures.by_order(one, prediction, fit.gain, offset)
        bound = max(bound, *(part.bound for part in prediction.skipped))
        peak = float(one.image.max())
        rmses = [f"{100.0 * step.rmse / peak:.2g} % ({WORDS.get(step.orders, step.orders)})" for step in steps]
        rebuilt.append({
            "dose": f"{one.dose_ml:.4g}",
            "rmse": ", ".join(rmses),
            "picture": inlined(pictures.reconstructions(one, steps)),
            "open": one in (shown[0], shown[-1]),
        })  # fmt: skip
    return rebuilt, bound


def _series(results: Results) -> dict[str, Any] | None:
    series = results.series
    if series is None:
        return None
    peaks = [float(one.image.max()) for one in results.photographs]
    cells = {
        (one.pattern, one.dose_ml): f"{100.0 * rmse / peak:.2g} %"
        for one, rmse, peak in zip(results.photographs, series.rmse, peaks, strict=True)
    }
    bend = series.linearity
    linearity = "" if bend is None else (
        f"At the highest dose the ink does {100.0 * abs(bend.bend):.2g} ± {100.0 * bend.sd:.2g} % "
        f"{'more' if bend.bend > 0.0 else 'less'} than in proportion to the lowest."
    )  # fmt: skip
    patterns = dict.fromkeys(one.pattern for one in results.photographs)
    rows = [
        {"pattern": name, "cells": [cells.get((name, dose_ml), "") for dose_ml in series.doses_ml]} for name in patterns
    ]
    return {"doses": [f"{dose_ml:.4g}" for dose_ml in series.doses_ml], "rows": rows, "linearity": linearity}

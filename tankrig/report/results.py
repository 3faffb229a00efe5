"""What a run found: its fits from the journal, or made now where the run did not make them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tankrig.errors import ImageError
from tankrig.live.exposures import Photograph, exposures_of, fits_that_hold
from tankrig.live.fits import diluted, fit_all, fit_dose
from tankrig.run.reading import Run
from tankrig.scene.description import Medium

Table = dict[str, Any]


@dataclass(frozen=True)
class Results:
    """The last fits of a run.

    Parameters
    ----------
    photographs
        What was fitted, in the order of the doses.
    doses
        A `fit_dose` table for each dose that could be fitted.
    series
        The `fit_all` table of all doses; None below two doses.
    """

    photographs: list[Photograph]
    doses: list[Table]
    series: Table | None


def results_of(run: Run, progress: Callable[[str], None] = lambda _: None) -> Results:
    """The last fits of each dose and of the whole series.

    Parameters
    ----------
    run
        Recorded, finished or not.
    progress
        Told in a few words what is being fitted.

    Raises
    ------
    ImageError
        When the run has no photograph of ink.
    """
    photographs = exposures_of(run).photographs()
    if not photographs:
        raise ImageError(
            f"{run.path}: has no photograph of a lit pattern with ink in the tank, so there is nothing to report; "
            "record some first"
        )
    doses_ml = sorted({one.dose_ml for one in photographs})
    made, series = recorded(run)
    doses: list[Table] = []
    for dose_ml in doses_ml:
        here = [one for one in photographs if one.dose_ml == dose_ml]
        table = next((one for one in made if one["dose_ml"] == dose_ml), None)
        if table is None or table["frames"] != sum(one.frames for one in here):
            progress(f"fitting {dose_ml:g} ml")
            table = fit_dose(here, _near(doses, dose_ml))[0]
        doses.append(table)
    if len(doses_ml) > 1 and (series is None or series["doses_ml"] != doses_ml):
        progress("fitting the series")
        series = fit_all(photographs)[0]
    return Results(photographs, doses, series)


def recorded(run: Run) -> tuple[list[Table], Table | None]:
    """The last fit of each dose that the run made while it went on, by dose, and its last fit of the series."""
    tables = [dict(event.fields) for event in fits_that_hold(run) if "error" not in event.fields]
    doses = {one["dose_ml"]: one for one in tables if one["fit"] == "dose"}
    return [doses[dose_ml] for dose_ml in sorted(doses)], next(
        (one for one in reversed(tables) if one["fit"] == "series"), None
    )


def _near(doses: list[Table], dose_ml: float) -> Medium | None:
    """Where to begin: what the dose before would be with so much ink."""
    if not doses:
        return None
    last = doses[-1]
    return diluted(Medium(last["sigma_a"], last["sigma_s"], last["g"]), last["dose_ml"], dose_ml)

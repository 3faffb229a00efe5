"""What a run found: its fits from the journal, or made now where the run did not make them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tankrig.errors import ImageError
from tankrig.live.exposures import Photograph, exposures_of
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
    tables = [dict(event.fields) for event in run.fits if "error" not in event.fields]
    doses: list[Table] = []
    for dose_ml in doses_ml:
        here = [one for one in photographs if one.dose_ml == dose_ml]
        frames = sum(one.frames for one in here)
        made = [one for one in tables if one["fit"] == "dose" and one["dose_ml"] == dose_ml and one["frames"] == frames]
        if not made:
            progress(f"fitting {dose_ml:g} ml")
            made = [fit_dose(here, _near(doses, dose_ml))[0]]
        doses.append(made[-1])
    series = next((one for one in reversed(tables) if one["fit"] == "series" and one["doses_ml"] == doses_ml), None)
    if series is None and len(doses_ml) > 1:
        progress("fitting the series")
        series = fit_all(photographs)[0]
    return Results(photographs, doses, series)


def _near(doses: list[Table], dose_ml: float) -> Medium | None:
    """Where to begin: what the dose before would be with so much ink."""
    if not doses:
        return None
    last = doses[-1]
    return diluted(Medium(last["sigma_a"], last["sigma_s"], last["g"]), last["dose_ml"], dose_ml)

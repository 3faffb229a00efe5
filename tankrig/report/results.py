"""What a run found: its fits from the journal, or made now where the run did not make them."""

from collections.abc import Callable
from dataclasses import dataclass

from tankrig.errors import ImageError
from tankrig.live.exposures import Photograph, exposures_of, fits_that_hold
from tankrig.live.fits import fit_all, fit_dose
from tankrig.live.results import DoseFit, SeriesFit, diluted, fits_in
from tankrig.run.reading import Run
from tankrig.scene import Medium


@dataclass(frozen=True)
class Results:
    """The last fits of a run.

    Parameters
    ----------
    photographs
        What was fitted, in the order of the doses.
    doses
        Of each dose that could be fitted.
    series
        Of all doses; None below two doses.
    """

    photographs: list[Photograph]
    doses: list[DoseFit]
    series: SeriesFit | None


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
    doses: list[DoseFit] = []
    for dose_ml in doses_ml:
        here = [one for one in photographs if one.dose_ml == dose_ml]
        fit = next((one for one in made if one.dose_ml == dose_ml), None)
        if fit is None or fit.frames != sum(one.frames for one in here):
            progress(f"fitting {dose_ml:g} ml")
            fit = fit_dose(here, _near(doses, dose_ml))
        doses.append(fit)
    if len(doses_ml) > 1 and (series is None or series.doses_ml != tuple(doses_ml)):
        progress("fitting the series")
        series = fit_all(photographs)
    return Results(photographs, doses, series)


def recorded(run: Run) -> tuple[list[DoseFit], SeriesFit | None]:
    """The last fit of each dose that the run made while it went on, by dose, and its last fit of the series."""
    return fits_in([event.fields for event in fits_that_hold(run)])


def _near(doses: list[DoseFit], dose_ml: float) -> Medium | None:
    """Where to begin: what the dose before would be with so much ink."""
    return diluted(doses[-1].medium, doses[-1].dose_ml, dose_ml) if doses else None

"""What a run found: the last fits in its journal, and what they are of."""

from dataclasses import dataclass

from tankrig.errors import ImageError
from tankrig.live.exposures import Photograph, exposures_of
from tankrig.live.recorded import fits_that_hold, wave_names
from tankrig.live.refit import unfitted
from tankrig.live.results import DoseFit, SeriesFit, fits_in
from tankrig.run.reading import Run


@dataclass(frozen=True)
class Results:
    """The last fits of a run.

    Parameters
    ----------
    photographs
        What was fitted, in the order of the doses.
    doses
        Of each dose that is fitted.
    series
        Of all these doses; None where there is none.
    left_out
        What is not fitted, and how to fit it, in sentences.
    """

    photographs: list[Photograph]
    doses: list[DoseFit]
    series: SeriesFit | None
    left_out: tuple[str, ...] = ()


def results_of(run: Run) -> Results:
    """The last fits of each dose and of the whole series, as the run has recorded them.

    Parameters
    ----------
    run
        Recorded, finished or not.

    Raises
    ------
    ImageError
        When the run has no photograph of ink.
    """
    photographs = exposures_of(run).photographs()
    if not photographs:
        raise ImageError(
            f"{run.path}: has no photograph of a lit pattern with ink in the tank, so there is nothing to report; "
            + ("separate its waves: tankrig separate " + str(run.path) if wave_names(run) else "record some first")
        )
    doses_ml = {one.dose_ml for one in photographs}
    made, series = recorded(run)
    doses = [one for one in made if one.dose_ml in doses_ml]
    fitted = {one.dose_ml for one in doses}
    missing = unfitted(run)
    of_all = series is not None and fitted == set(series.doses_ml)
    left_out = (missing.sentence(run.path),) if missing else ()
    shown = [one for one in photographs if one.dose_ml in fitted]
    return Results(shown, doses, series if of_all else None, left_out)


def recorded(run: Run) -> tuple[list[DoseFit], SeriesFit | None]:
    """The last fit of each dose that the run made while it went on, by dose, and its last fit of the series."""
    return fits_in([event.fields for event in fits_that_hold(run)])


def known_sigma_t(dose: DoseFit, series: SeriesFit | None) -> float:
    """What single scattering's σt at a dose is compared with, 1/mm: the series' where there is one, else the fit's."""
    return (dose.medium if series is None else series.at(dose.dose_ml)).sigma_t

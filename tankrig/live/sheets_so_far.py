"""Sheets of waves that a run has recorded so far, separated when a fit asks for them."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tankrig.live.exposures import Exposures
from tankrig.live.results import DoseFit, SeriesFit
from tankrig.scene.description import Medium

if TYPE_CHECKING:
    from tankrig.live.separated import Separated

_log = logging.getLogger(__name__)


class SheetsSoFar:
    """What waves say of fits: where a search can begin, and what order 1 has against what was found.

    A dose's waves are read back from disk when that is asked, and again once there are more of them. Of a run without
    waves nothing is read. Whatever goes wrong with them is a doubt that the fit tells, and never its end.

    Parameters
    ----------
    path
        Of the run; None where nothing is recorded.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._whole: dict[float, int] = {}
        self._known: dict[float, tuple[int, Separated | Exception]] = {}
        self._starts: dict[float, tuple[int, tuple[Medium, ...]]] = {}

    def look(self, exposures: Exposures) -> None:
        """See which sheets are whole by now."""
        if self._path is not None:
            counts = {exposures.volume_ml(dose): exposures.sheets(dose) for dose in exposures.doses}
            self._whole = {dose_ml: count for dose_ml, count in counts.items() if count}

    def count(self, dose_ml: float) -> int:
        """Sheets of a dose that are whole."""
        return self._whole.get(dose_ml, 0)

    def media(self, dose_ml: float) -> tuple[Medium, ...]:
        """Liquids that the fit of a dose can begin from; see `OrderOneFit.media`."""
        count = self.count(dose_ml)
        if not count:
            return ()
        known = self._starts.get(dose_ml)
        if known is None or known[0] < count:
            found: tuple[Medium, ...] = ()
            try:
                found = self._at(dose_ml).media.get(dose_ml, ())
            except Exception:  # `beside` says what it was, and the fit begins as it would without waves
                _log.exception("the waves at %g ml tell no start", dose_ml)
            known = self._starts[dose_ml] = count, found
        return known[1]

    def beside(self, fit: DoseFit) -> DoseFit:
        """A dose's fit with what order 1 has against it, or why it says nothing."""
        if not self.count(fit.dose_ml):
            return fit
        try:
            return self._at(fit.dose_ml).beside(fit)
        except Exception as error:
            return replace(fit, order_one=_not_known(fit.dose_ml, error))

    def beside_series(self, series: SeriesFit) -> SeriesFit:
        """The same of a series, in its verdict."""
        for dose_ml in series.doses_ml:
            if self.count(dose_ml):
                try:
                    series = self._at(dose_ml).beside_series(series)
                except Exception as error:
                    series = replace(series, verdict=f"{series.verdict} {_not_known(dose_ml, error)}".lstrip())
        return series

    def _at(self, dose_ml: float) -> "Separated":
        from tankrig.live.separated import Separated
        from tankrig.run.reading import open_run

        assert self._path is not None
        count, known = self.count(dose_ml), self._known.get(dose_ml)
        if known is None or known[0] < count:
            found: Separated | Exception
            try:
                found = Separated.of_run(open_run(self._path), dose_ml)
            except Exception as error:  # it is not read again before there are more waves
                found = error
            known = self._known[dose_ml] = count, found
        if isinstance(known[1], Exception):
            raise known[1]
        return known[1]


def _not_known(dose_ml: float, error: Exception) -> str:
    _log.warning("the waves at %g ml could not be separated", dose_ml, exc_info=error)
    return f"order 1 at {dose_ml:.4g} ml is not known, for its waves could not be separated: {error}"

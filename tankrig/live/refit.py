"""Fits of a run that has been recorded: what it lacks, and making that as the live fit would have."""

import math
import os
import threading
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from tankrig.live.exposures import Exposures, exposures_of
from tankrig.live.fits import fit_all, fit_dose
from tankrig.live.next_fit import Fitter, fit_all_there_is
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import Preparation, Preparing, phases_prepared
from tankrig.live.recorded import fits_that_hold, wave_names
from tankrig.live.results import DoseFit, Fit, SeriesFit, diluted, fits_in, to_fields
from tankrig.live.sheets_so_far import SheetsSoFar
from tankrig.run.reading import Run, open_run
from tankrig.run.writer import RunWriter
from tankrig.scene.phase_table import PhaseFunction

POLL_S = 0.2

Told = Callable[[str, Preparation], object]
"""Told in a few words what is being done, and how far the models are; what it raises ends the fitting."""


@dataclass(frozen=True)
class Unfitted:
    """What a run has recorded and not fitted.

    Parameters
    ----------
    doses_ml
        Rising.
    series
        Whether it has two doses or more, and no fit of all of them together.
    phase
        Whether the series' fit shows that the ink has another phase function than Henyey–Greenstein's, nobody has said
        which to fit, and others have not been fitted.
    """

    doses_ml: tuple[float, ...] = ()
    series: bool = False
    phase: bool = False

    def __bool__(self) -> bool:
        return bool(self.doses_ml) or self.series or self.phase

    def __str__(self) -> str:
        """In words.

        >>> str(Unfitted((0.1, 0.4), True))
        '0.1 ml, 0.4 ml and the series'
        """
        names = [f"{dose_ml:g} ml" for dose_ml in self.doses_ml] + ["the series"] * self.series
        names += ["the ink's own phase function"] * self.phase
        return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)

    def sentence(self, path: Path) -> str:
        """What is missing, and how to get it."""
        several = len(self.doses_ml) + self.series + self.phase > 1
        return f"{self} {'are' if several else 'is'} not fitted: tankrig refit {path}"


def unfitted(run: Run) -> Unfitted:
    """What a run lacks, by its journal alone: doses whose lit frames are not all in their last fit, and the series.

    Nor are they in a rough fit, whose run was too busy for another one; but where all doses show that the ink has
    another phase function than Henyey–Greenstein's, finer fits by that tell no more. A fit made after the run's end has
    seen all that can be read.
    """
    waves = wave_names(run)
    lit = {key for key, pattern in run.patterns.items() if pattern.pixels.any() and pattern.name not in waves}
    frames: dict[float, int] = {}
    for event in run.events("frame"):
        dose_ml = run.conditions[event["index"]].tank.volume_ul / 1000.0
        if event["pattern_hash"] in lit and dose_ml > 0.0 and event["index"] not in run.unsure_doses:
            frames[dose_ml] = frames.get(dose_ml, 0) + 1
    doses, series = fits_in([event.fields for event in fits_that_hold(run)])
    ended = run.end.seq if run.end is not None else math.inf
    since = {event.get("dose_ml") for event in run.fits if event.seq > ended and "error" not in event.fields}
    straight_on = _goes_straight_on(doses, frames) and PhotographPlan.of_run(run).may_go_further
    counted = {one.dose_ml: 0 if one.rough and not straight_on else one.frames + one.left_out for one in doses}
    fitted = {dose_ml: math.inf if dose_ml in since else seen for dose_ml, seen in counted.items()}
    missing = tuple(dose_ml for dose_ml in sorted(frames) if fitted.get(dose_ml, 0) < frames[dose_ml])
    whole = series is not None and len(series.doses_ml) >= len(frames)
    further = whole and series is not None and series.doubted and PhotographPlan.of_run(run).may_go_further
    return Unfitted(missing, len(frames) > 1 and not whole, further)


def _goes_straight_on(doses: Iterable[DoseFit], doses_ml: Collection[float]) -> bool:
    """Whether the series' fit by Henyey–Greenstein's phase function would tell nothing: all doses show another one."""
    doubted = {one.dose_ml for one in doses if one.doubted}
    return len(doses_ml) > 1 and doubted.issuperset(doses_ml)


def refit(
    path: str | os.PathLike[str],
    everything: bool = False,
    model: str = "prepared",
    progress: Told = lambda *_: None,
    phase: str | PhaseFunction | None = None,
    further: bool = True,
) -> list[Fit]:
    """Fit what a run lacks, or everything anew, and record each fit in its journal as soon as it is made.

    Where all doses show that the ink has another phase function than Henyey–Greenstein's, or the series' fit by that
    does, and nobody has said which to search, the series is fitted with others: a free one, families, and spheres of
    any size.

    What ends it, be it an error, Ctrl-C or what `progress` raises, loses no fit that was made: the next call goes on.

    Parameters
    ----------
    path
        Of the run, which nobody is recording.
    everything
        Whether what is fitted already is fitted anew.
    model
        "prepared": as the live fit does; "tank": by following light paths at every step, which takes longer.
    progress
        Told what is being done, in this thread.
    phase
        Which phase functions are searched, as in `tankrig.estimate`; None: those of the run's sequence.
    further
        Whether a series that shows another phase function is fitted with others, which takes ten minutes and more; else
        it is fitted by Henyey–Greenstein's.

    Returns
    -------
    list
        The fits, in the order in which they were made; empty when nothing was missing.

    Raises
    ------
    StoreError
        When the run is being recorded, cannot be read, or no fit can be recorded in it.
    """
    made: list[Fit] = []
    path = Path(path)
    missing = unfitted(open_run(path))
    if not everything and not (missing if further else missing.doses_ml or missing.series):
        return made
    with RunWriter(path) as writer:
        run = open_run(path)
        for fit in fits_made(run, everything, model, progress, phase, further):
            writer.put("fit", **to_fields(fit))
            writer.flush()
            made.append(fit)
    return made


def fits_made(
    run: Run,
    everything: bool = False,
    model: str = "prepared",
    progress: Told = lambda *_: None,
    phase: str | PhaseFunction | None = None,
    further: bool = True,
) -> Iterator[Fit]:
    """The fits that a run lacks, or all of them, one after the other; see `refit`.

    Where the run separated orders of scattering, a search begins from what order 1 says by itself, and each fit tells
    where order 1 disagrees with it. The waves are no photographs: no fit sees them.
    """
    nothing = Preparation(0, 0.0)
    progress("reading the frames", nothing)
    exposures, plan, sheets = exposures_of(run), PhotographPlan.of_run(run), SheetsSoFar(run.path)
    plan = plan if phase is None else replace(plan, phase=phase, phase_said=True)
    doses, series = ([], None) if everything else fits_in([event.fields for event in fits_that_hold(run)])

    def told(words: str) -> None:
        progress(words, nothing)

    missing, further = unfitted(run), further and plan.may_go_further
    photographs = exposures.photographs()
    doses_ml = {one.dose_ml for one in photographs}
    found = {one.dose_ml: one for one in doses if one.dose_ml not in missing.doses_ml}
    straight_on = further and missing.series and _goes_straight_on(found.values(), doses_ml)
    if not straight_on and (everything or missing.doses_ml or missing.series):
        by_tank = model == "tank"
        made = _by_tank_model(exposures, plan, doses, series, sheets, told) if by_tank else _as_live(
            plan, exposures, doses, sheets, progress, further
        )  # fmt: skip
        with closing(made):
            for fit in made:
                yield fit
                if isinstance(fit, SeriesFit):
                    series = fit
                elif isinstance(fit, DoseFit):
                    found[fit.dose_ml] = fit
                    straight_on = further and _goes_straight_on(found.values(), doses_ml)
                if straight_on:
                    break
    if straight_on or (further and series is not None and series.doubted):
        told("fitting the series with other phase functions")
        densest = max(found.values(), key=lambda one: one.dose_ml) if straight_on else None
        start = series if densest is None else diluted(densest.medium, densest.dose_ml, 1.0)
        yield sheets.beside_series(fit_all(photographs, start, progress=told, phase="any"))


def _by_tank_model(
    exposures: Exposures,
    plan: PhotographPlan,
    doses: list[DoseFit],
    series: SeriesFit | None,
    sheets: SheetsSoFar,
    progress: Callable[[str], None],
) -> Generator[Fit, None, None]:
    sheets.look(exposures)
    # Henyey–Greenstein's three numbers are found from anywhere; other phase functions from what is expected.
    # A label's spheres are searched all about it, and not begun from.
    named = isinstance(plan.phase, str) and plan.phase != "hg"
    latest = (plan.ink, 1.0) if named and plan.ink is not None and plan.ink.phase is not None else None
    known = {one.dose_ml: one for one in doses}
    photographs = exposures.photographs()
    doses_ml = sorted({one.dose_ml for one in photographs})
    for dose_ml in doses_ml:
        here = [one for one in photographs if one.dose_ml == dose_ml]
        fit = known.get(dose_ml)
        if fit is None or fit.frames < sum(one.frames for one in here):
            start = None if latest is None else diluted(*latest, dose_ml)
            progress(f"fitting {dose_ml:g} ml")
            told = () if start is not None else sheets.media(dose_ml)
            fit = sheets.beside(fit_dose(here, start, progress, plan.phase, told))
            yield fit
        latest = fit.medium, fit.dose_ml
    if len(doses_ml) > 1 and (series is None or series.doses_ml != tuple(doses_ml)):
        progress("fitting the series")
        start = None if latest is None or latest[0].phase is None else diluted(*latest, 1.0)
        yield sheets.beside_series(fit_all(photographs, start, progress=progress, phase=plan.phase))


def _as_live(
    plan: PhotographPlan,
    exposures: Exposures,
    doses: list[DoseFit],
    sheets: SheetsSoFar,
    progress: Told,
    further: bool,
) -> Generator[Fit, None, None]:
    """By the live fit's own decisions, with all frames there at once.

    Where the series may be fitted with other phase functions, and a dose's earlier fit shows one, first models are made
    before whole ones, and fits by them are given where they show one too.
    """
    news = threading.Event()
    first = further and any(one.doubted for one in doses)
    preparing = Preparing(lambda _: news.set(), phases=phases_prepared(plan) or "hg", first=first)
    photographs = Counter(one.dose_ml for one in exposures.photographs())

    def told(words: str) -> None:
        progress(words, preparing.left)

    def wait(_: float | None) -> bool:
        while not news.wait(POLL_S):
            progress("preparing models", preparing.left)
        news.clear()
        return True

    try:
        fitter = Fitter(doses, preparing, plan, told, sheets)
        for fit in fit_all_there_is(fitter, lambda: (exposures, True), wait):
            if not isinstance(fit, DoseFit) or (fit.single is not None and not fit.passing):
                yield fit  # nobody waits for what lacks single scattering
            elif further and fit.first and fit.doubted and len(fit.patterns) == photographs[fit.dose_ml]:
                yield fit
            told("fitting")
    finally:
        preparing.close()

"""Which fit comes next: the newest dose first, by models that are prepared for it, then the series of what is over."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import TankrigError
from tankrig.light.prepared.box import Box
from tankrig.live.asked_models import AskedModels
from tankrig.live.exposures import Exposures, Photograph, has_changed
from tankrig.live.fits import fit_all, fit_dose, fit_dose_prepared, with_single
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import LOOK, LOOK_START, Preparing, phases_prepared
from tankrig.live.results import FIRST_LOOK, DoseFit, FailedFit, Fit, SeriesFit, diluted
from tankrig.live.sheets_so_far import SheetsSoFar
from tankrig.scene.description import Medium
from tankrig.scene.phase_table import PhaseFunction

QUIET_S = 0.3
"""Without new frames for so long, what takes longer is done too: single scattering for comparison, and the series."""
ANOTHER_DOSE = -1
"""Newest frame of a fit that is not of the newest."""


class Fitter:
    """Decides what to fit next: the dose under way first, then the series of the doses that are over.

    A dose is fitted by models prepared for what is foreseen of it: from another dose, from the ink that the run is
    expected to have, or from a first look at one of its photographs, by a model of nearly all media that is prepared
    before there is any ink. While models are being prepared they are waited for; where they cannot be prepared, or do
    not hold the liquid, the dose is fitted by the tank model, which takes half a minute instead of milliseconds, and on
    a bench some minutes. So it is on a bench where another phase function than Henyey–Greenstein's is asked for: models
    of any are prepared where light and sight run straight.

    Parameters
    ----------
    earlier
        What was fitted before.
    preparing
        Of models; None to do without.
    plan
        Of the run; needed for preparing.
    progress
        Told in a few words what the tank model's fit, or that of the series, is doing; what it raises ends the fit.
    sheets
        Of waves: where nothing else is known, fits begin from what order 1 by itself tells of a dose; once frames have
        stopped to come for a moment, they are told what order 1 has against them.
    """

    def __init__(
        self,
        earlier: Iterable[Fit] = (),
        preparing: Preparing | None = None,
        plan: PhotographPlan | None = None,
        progress: Callable[[str], None] = lambda _: None,
        sheets: SheetsSoFar | None = None,
    ) -> None:
        self._sheets = sheets or SheetsSoFar()
        self._judged: dict[float, tuple[DoseFit, int]] = {}
        self._phase: str | PhaseFunction = "hg" if plan is None else plan.phase
        known = plan is None or phases_prepared(plan) is not None
        self._plan, self._progress = plan, progress
        self._fitted: dict[float, int] = {}
        self._liquid: dict[float, Medium] = {}
        self._looked: dict[float, DoseFit | None] = {}
        self._told: set[float] = set()
        self._ahead: dict[float, NDArray[np.floating]] = {}
        self._latest: tuple[Medium, float] | None = None
        self._in_series = 0
        self._series: SeriesFit | None = None
        self._passing: dict[float, tuple[DoseFit, list[Photograph]]] = {}
        self._bare: dict[float, tuple[DoseFit, list[Photograph]]] = {}
        self._stages: dict[float, int] = {}
        self.waiting = False
        self._awaited = False
        self._awaited_in: tuple[Box, Medium] = LOOK, LOOK_START
        self._asked = AskedModels(preparing, plan) if known and preparing is not None else None
        for fit in earlier:
            if isinstance(fit, DoseFit):
                self._fitted[fit.dose_ml] = 0 if fit.rough else fit.frames + fit.left_out
                self._keep(fit)
        if self._latest is None and self._asked is not None:
            self._asked.begin()

    @property
    def unfinished(self) -> bool:
        """Whether a dose's last fit has not been recorded, or lacks what takes longer: `finish` gives that.

        What takes longer waits for the fits of all doses whose models are being prepared.
        """
        return bool(self._passing or ((self._bare or self._unjudged) and not self.waiting))

    @property
    def _unjudged(self) -> list[DoseFit]:
        """Fits that are whole, and of whose doses more waves have come since."""
        return [fit for fit, sheets in self._judged.values() if self._sheets.count(fit.dose_ml) > sheets]

    def finish(self) -> Fit | None:
        """A fit to be recorded: first each dose's last one as it is, then again with single scattering beside it.

        Light by way of a floor without its noise takes seconds on a bench, single scattering too, and order 1 a second
        or so; whoever waits for numbers does without them. None where waves that came later have changed nothing.
        """
        if self._passing:
            dose_ml = next(iter(self._passing))
            fit, photographs = self._passing.pop(dose_ml)
            self._bare[dose_ml] = fit, photographs
            return replace(fit, passing=False)
        if self._bare:
            fit, photographs = self._bare.pop(next(iter(self._bare)))
            return self._beside(with_single(self._finely(fit, photographs), photographs))
        for fit in self._unjudged:
            judged = self._beside(fit)
            if judged.order_one != fit.order_one:
                return judged
        return None

    def _finely(self, fit: DoseFit, photographs: list[Photograph]) -> DoseFit:
        """The fit anew by many light paths by way of the floor, for which nobody waits; as it is where it has none."""
        if self._asked is None or "floor" not in fit.astray:
            return fit
        models = self._asked.preparing.models([one.scene for one in photographs], self._asked.fitted_in(fit.dose_ml))
        assert models is not None  # which the fit is by
        try:
            fine = fit_dose_prepared(photographs, models, fit.medium, self._phase)
        except TankrigError:
            return fit
        if fine is None:
            return fit
        return replace(fine, left_out=fit.left_out, not_seen=fit.not_seen, newest=fit.newest)

    def _beside(self, fit: DoseFit) -> DoseFit:
        """A fit that is whole, with what order 1 has against it."""
        fit = self._sheets.beside(fit)
        self._judged[fit.dose_ml] = fit, self._sheets.count(fit.dose_ml)
        return fit

    def next(self, exposures: Exposures, last: bool) -> Fit | None:
        """Fit what is newest and not fitted yet; None when there is nothing to do."""
        self.waiting = False
        self._sheets.look(exposures)
        for dose in self._in_turn(exposures):
            photographs = exposures.photographs(dose)
            seen = sum(one.frames for one in photographs) + exposures.left_out(dose)
            if not photographs or seen <= self._fitted.get(photographs[0].dose_ml, 0):
                continue
            if exposures.settling(dose) and not last:
                self.waiting = True
                continue
            newest = exposures.newest if dose == exposures.dose else ANOTHER_DOSE
            about: Callable[[DoseFit], DoseFit] = partial(
                replace, left_out=exposures.left_out(dose), not_seen=exposures.not_seen, newest=newest
            )
            fit = self._dose(photographs, about)
            if fit is not None:
                self._fitted[photographs[0].dose_ml] = seen
                self._stages[photographs[0].dose_ml] = 2 * len(photographs)
                return replace(fit, newest=newest)
            self.waiting = True
            if (first := self._of_some(photographs, about)) is not None:
                return first
            if (look := self._look_to_tell(photographs)) is not None:
                return replace(about(look), newest=ANOTHER_DOSE)
            if not self._foresees:
                break
        over = exposures.photographs() if last else [
            one for one in exposures.photographs() if one.dose_ml < exposures.dose_ml
        ]  # fmt: skip
        doses = len({one.dose_ml for one in over})
        if doses >= 2 and doses > self._in_series and not self.waiting and not self.unfinished:
            self.waiting = self._awaits_models_of(over)
            if not self.waiting:
                self._in_series = doses
                return self._all(over)
        if not self._foresees:
            self._look_ahead(exposures)
            for dose in exposures.doses:  # what a first look will begin from, found while there is nothing to fit
                self._sheets.media(exposures.volume_ml(dose))
        return None

    @property
    def _foresees(self) -> bool:
        """Whether no first look is needed, as something tells what ink it is."""
        expected = self._plan is not None and self._plan.ink is not None
        return self._asked is None or self._latest is not None or expected

    def _in_turn(self, exposures: Exposures) -> list[int]:
        """Doses, the newest first; where nothing is known of the ink, the thinnest, which a first look tells best."""
        if self._foresees:
            return exposures.doses
        return sorted(exposures.doses, key=exposures.volume_ml)

    def _dose(self, photographs: list[Photograph], about: Callable[[DoseFit], DoseFit]) -> DoseFit | FailedFit | None:
        """The fit of a dose, with what is to be said about its frames; None while its models are being prepared."""
        dose_ml = photographs[0].dose_ml
        self._passing.pop(dose_ml, None)
        self._bare.pop(dose_ml, None)
        self._judged.pop(dose_ml, None)
        try:
            quick = self._quick(photographs)
            if self._awaited:
                return None
            if quick is not None:
                quick = about(quick)
                self._keep(quick)
                self._passing[dose_ml] = quick, photographs
                return replace(quick, passing=True)
            look = self._looked.get(dose_ml)
            start = self._start(dose_ml) or (None if look is None else look.medium)
            told = () if start is not None else self._sheets.media(dose_ml)
            fit = about(fit_dose(photographs, start, self._progress, self._phase, told))
        except TankrigError as error:
            return FailedFit(dose_ml, str(error))
        self._keep(fit)
        return self._beside(fit)

    def _quick(self, photographs: list[Photograph]) -> DoseFit | None:
        """The fit by prepared models; None where they cannot be had, or while they are `_awaited`."""
        self._awaited = False
        if self._asked is None:
            return None
        dose_ml = photographs[0].dose_ml
        start = self._start(dose_ml)
        if start is not None:
            found = self._fit_within(self._asked.box_of(dose_ml, start), photographs, start)
            if found is not None or self._awaited:
                return found
        if dose_ml not in self._looked:
            look = self._fit_within(LOOK, photographs[:1], self._look_start(dose_ml))
            if self._awaited:
                return None
            self._looked[dose_ml] = look
        seen = self._looked[dose_ml]
        return (
            None if seen is None else self._fit_within(self._asked.preparing.box(seen.medium), photographs, seen.medium)
        )

    def _of_some(self, photographs: list[Photograph], about: Callable[[DoseFit], DoseFit]) -> DoseFit | None:
        """The fit by those patterns that have models so far, and by first ones, while whole ones are prepared.

        On a bench it comes much sooner than the fit by whole models of all patterns, and tells better than a first look
        which media models are to be prepared for.
        """
        dose_ml, (box, start) = photographs[0].dose_ml, self._awaited_in
        if self._asked is None or box == LOOK:
            return None
        preparing = self._asked.preparing
        so_far = [(one, preparing.model_so_far(one.scene, box)) for one in photographs]
        ready = [(one, model) for one, model in so_far if model is not None]
        stages = sum(1 if model.first else 2 for _, model in ready)
        if stages <= self._stages.get(dose_ml, 0):
            return None
        self._stages[dose_ml] = stages
        some, models = zip(*ready, strict=True)
        try:
            fit = fit_dose_prepared(some, models, start, self._phase, quick=True)
        except TankrigError:
            return None  # the fit of all patterns says why
        if fit is None:
            return None
        fit = about(fit)
        self._asked.keep_box(dose_ml, box)
        self._keep(fit)
        return fit

    def _look_to_tell(self, photographs: list[Photograph]) -> DoseFit | None:
        """What a first look says of a dose whose models are being prepared, once; None where there is none to tell, or
        another dose tells better what to expect.

        A person sees about what it is, with the look's own error in the errors; the journal waits for the fit.
        """
        dose_ml = photographs[0].dose_ml
        if self._asked is None or dose_ml in self._told or self._latest is not None:
            return None
        models = self._asked.preparing.models([photographs[0].scene], LOOK)
        if models is None:
            return None
        self._told.add(dose_ml)
        look = self._looked.get(dose_ml)
        if look is None:
            try:
                start = self._start(dose_ml) or self._look_start(dose_ml)
                look = fit_dose_prepared(photographs[:1], models, start, self._phase, quick=True)
            except TankrigError:
                return None
        return None if look is None else replace(look, model=FIRST_LOOK, passing=True)

    def _fit_within(self, box: Box, photographs: list[Photograph], start: Medium) -> DoseFit | None:
        """The fit by models of a box, or None; `_awaited` where they are not ready yet."""
        assert self._asked is not None
        scenes = [one.scene for one in photographs]
        models = self._asked.preparing.models(scenes, box)
        if models is None:
            self._awaited = self._asked.preparing.under_way(scenes, box)
            if self._awaited:
                self._awaited_in = box, start
                self._asked.await_models(photographs[0].dose_ml, scenes, box)
            return None
        found = fit_dose_prepared(photographs, models, start, self._phase, quick=True)
        if found is not None and box != LOOK:
            self._asked.keep_box(photographs[0].dose_ml, box)
        return found

    def _keep(self, fit: DoseFit) -> None:
        """Remember what a dose is, and have models prepared for it and for all that are to follow."""
        self._liquid[fit.dose_ml], self._latest = fit.medium, (fit.medium, fit.dose_ml)
        if self._asked is not None:
            self._asked.foresee(fit)

    def _look_ahead(self, exposures: Exposures) -> None:
        """Have models prepared by a first look at ink that still mixes: it has minutes for that, frames have seconds.

        Where ink is still so uneven that the look cannot explain the picture nothing is prepared: a bench's ink of
        g .61, of which a tenth had not mixed, passed for one of .45 to .91. It is looked at anew as it changes, and so
        are the dose's own frames.
        """
        photograph = exposures.while_mixing
        if photograph is None:
            return
        before = self._ahead.get(photograph.dose_ml)
        if before is not None and not has_changed(photograph.image, before):
            return
        self._awaited = False
        try:
            look = self._fit_within(LOOK, [photograph], self._look_start(photograph.dose_ml))
        except TankrigError:
            look = None
        if not self._awaited:
            self._ahead[photograph.dose_ml] = photograph.image
            if self._asked is not None and look is not None and look.structure is None:
                self._asked.foresee(look, at_once=False)

    def _start(self, dose_ml: float) -> Medium | None:
        """Where to begin: the dose's own last fit, what the series foresees, another dose's liquid, diluted, or the ink
        expected."""
        own = self._liquid.get(dose_ml)
        if own is not None:
            return own
        if self._series is not None:
            return self._series.at(dose_ml)
        if self._latest is not None:
            return diluted(*self._latest, dose_ml)
        expected = None if self._plan is None else self._plan.ink
        return None if expected is None else diluted(expected, 1.0, dose_ml)

    def _look_start(self, dose_ml: float) -> Medium:
        """Where a first look begins: at the σt that order 1 by itself tells, or in the middle of all."""
        told = [one for one in self._sheets.media(dose_ml) if LOOK.holds(one)]
        return min(told, key=lambda one: abs(one.g - LOOK_START.g), default=LOOK_START)

    def _awaits_models_of(self, photographs: list[Photograph]) -> bool:
        """Whether models of some doses are not ready yet, as of those that were fitted before a run went on.

        Without them the series would follow light paths: an image at each step, seconds to minutes on a bench.
        """
        awaited = False
        for dose_ml in sorted({one.dose_ml for one in photographs}):
            liquid = self._start(dose_ml)
            if self._asked is None or liquid is None:
                continue
            scenes = [one.scene for one in photographs if one.dose_ml == dose_ml]
            box = self._asked.box_of(dose_ml, liquid)
            if self._asked.preparing.models(scenes, box) is None and self._asked.preparing.under_way(scenes, box):
                self._asked.await_models(dose_ml, scenes, box)
                awaited = True
        return awaited

    def _all(self, photographs: list[Photograph]) -> Fit:
        models = self._asked.preparing.all_models if self._asked else ()
        start = None if self._latest is None else diluted(*self._latest, 1.0)
        try:
            self._series = fit_all(photographs, self._series or start, models, self._progress, self._phase)
        except TankrigError as error:
            return FailedFit(None, str(error))
        return self._sheets.beside_series(self._series)


def fit_all_there_is(
    fitter: Fitter,
    look: Callable[[], tuple[Exposures | None, bool]],
    wait: Callable[[float | None], bool],
) -> Iterator[Fit]:
    """Fits of whatever is newest, again and again, until the last frame is in and all is fitted.

    Parameters
    ----------
    fitter
        Decides what is next.
    look
        Gives the sums as they are now, None where they could not be read in some seconds, and whether no more frames
        will come.
    wait
        Waits for new frames or models, for so many seconds or for ever; whether there are any.
    """
    while True:
        exposures, last = look()
        if exposures is None:
            continue
        fit = fitter.next(exposures, last)
        if fit is not None:
            yield fit
        elif fitter.unfinished and (last or not wait(QUIET_S)):
            whole = fitter.finish()
            if whole is not None:
                yield whole
        elif last and not fitter.waiting:
            return
        elif not fitter.unfinished:
            wait(None)

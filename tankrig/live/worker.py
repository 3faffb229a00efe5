"""The process that fits: it looks at shared sums of frames, always at the newest, and sends back what it found."""

import os
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from multiprocessing.synchronize import Event as Signal
from multiprocessing.synchronize import Lock
from typing import Any

import numpy as np

from tankrig.errors import TankrigError
from tankrig.live.exposures import Exposures, Photograph, PhotographPlan
from tankrig.live.fits import fit_all, fit_dose, fit_dose_prepared, with_single
from tankrig.live.preparing import Preparing
from tankrig.live.results import DoseFit, FailedFit, Fit, SeriesFit, diluted
from tankrig.scene.description import Medium

NICENESS = 10
LOCK_S = 5.0
QUIET_S = 0.3
"""Without new frames for so long, what takes longer is done too: single scattering for comparison, and the series."""


@dataclass(frozen=True)
class Shared:
    """What the two processes share.

    Parameters
    ----------
    memory
        Name of the shared memory that holds the sums.
    plan
        What they are sums of.
    lock
        Held while they are read or written, for less than a millisecond.
    news, last
        Set when there are new frames, and when no more will come.
    results
        Where fits go.
    earlier
        What was fitted before, where a run goes on.
    """

    memory: str
    plan: PhotographPlan
    lock: Lock
    news: Signal
    last: Signal
    results: Connection
    earlier: tuple[Fit, ...] = ()


def work(shared: Shared) -> None:
    """Fit until told that the last frame is in and all is fitted, or until the program that started this is gone."""
    os.nice(NICENESS)
    memory = SharedMemory(shared.memory)
    threading.Thread(target=_end_with_parent, args=(memory,), name="live-guard", daemon=True).start()
    try:
        _fit(shared, memory)
    except (BrokenPipeError, ConnectionResetError):
        pass  # nobody listens any more
    finally:
        shared.results.close()
        memory.close()


def _end_with_parent(memory: SharedMemory) -> None:
    """Wait for the parent's death; then take the shared memory along, which nobody else would."""
    parent = parent_process()
    if parent is None:
        return
    connection.wait([parent.sentinel])
    try:
        memory.unlink()
    finally:
        os._exit(1)


def _fit(shared: Shared, memory: SharedMemory) -> None:
    preparing = Preparing(lambda _: shared.news.set())
    fitter = Fitter(shared.earlier, preparing, shared.plan)
    try:
        while True:
            last = shared.last.is_set()
            shared.news.clear()
            exposures = _copy(shared, memory)
            if exposures is not None and _send(shared, fitter.next(exposures, last)):
                continue
            if fitter.unfinished and (last or not shared.news.wait(QUIET_S)):
                _send(shared, fitter.finish())
            elif last and not fitter.waiting:
                return
            elif not fitter.unfinished:
                shared.news.wait()
    finally:
        shared.results.close()  # the run need not wait for what is being computed
        preparing.close()


def _copy(shared: Shared, memory: SharedMemory) -> Exposures | None:
    """The sums as they are now."""
    if not shared.lock.acquire(timeout=LOCK_S):
        return None
    try:
        numbers: Any = np.ndarray((shared.plan.size,), np.float64, memory.buf).copy()
    finally:
        shared.lock.release()
    return Exposures(shared.plan, numbers)


def _send(shared: Shared, fit: Fit | None) -> bool:
    if fit is not None:
        shared.results.send(fit)
    return fit is not None


class Fitter:
    """Decides what to fit next: the dose under way first, then the series of the doses that are over.

    A dose is fitted by models prepared for what is foreseen of it. Where nothing is foreseen, or they cannot be
    prepared, it is fitted by the tank model, which takes half a minute instead of milliseconds; while they are being
    prepared, they are waited for.

    Parameters
    ----------
    earlier
        What was fitted before.
    preparing
        Of models; None to do without.
    plan
        Of the run; needed for preparing.
    """

    def __init__(
        self, earlier: Iterable[Fit] = (), preparing: Preparing | None = None, plan: PhotographPlan | None = None
    ) -> None:
        self._preparing, self._plan = preparing, plan
        self._fitted: dict[float, int] = {}
        self._liquid: dict[float, Medium] = {}
        self._latest: tuple[Medium, float] | None = None
        self._in_series = 0
        self._series: SeriesFit | None = None
        self._passing: tuple[DoseFit, list[Photograph]] | None = None
        self.waiting = False
        for fit in earlier:
            if isinstance(fit, DoseFit):
                self._fitted[fit.dose_ml] = fit.frames + fit.left_out
                self._keep(fit)

    @property
    def unfinished(self) -> bool:
        """Whether the last fit lacks what takes longer: `finish` gives that."""
        return self._passing is not None

    def finish(self) -> Fit | None:
        """The last passing fit, whole."""
        if self._passing is None:
            return None
        (fit, photographs), self._passing = self._passing, None
        return with_single(fit, photographs)

    def next(self, exposures: Exposures, last: bool) -> Fit | None:
        """Fit what is newest and not fitted yet; None when there is nothing to do."""
        self.waiting = False
        if self._passing is not None and self._passing[0].dose_ml != exposures.dose_ml:
            return self.finish()
        for dose in exposures.doses:
            photographs = exposures.photographs(dose)
            seen = sum(one.frames for one in photographs) + exposures.left_out(dose)
            if not photographs or seen <= self._fitted.get(photographs[0].dose_ml, 0):
                continue
            if exposures.settling(dose) and not last:
                self.waiting = True
                continue
            newest = exposures.newest if dose == exposures.dose else -1
            about: Callable[[DoseFit], DoseFit] = partial(
                replace, left_out=exposures.left_out(dose), not_seen=exposures.not_seen, newest=newest
            )
            fit = self._dose(photographs, about)
            if fit is not None:
                self._fitted[photographs[0].dose_ml] = seen
                return replace(fit, newest=newest)
            self.waiting = True
        over = exposures.photographs() if last else [
            one for one in exposures.photographs() if one.dose_ml < exposures.dose_ml
        ]  # fmt: skip
        doses = len({one.dose_ml for one in over})
        if doses >= 2 and doses > self._in_series and not self.waiting and self._passing is None:
            self._in_series = doses
            return self._all(over)
        return None

    def _dose(self, photographs: list[Photograph], about: Callable[[DoseFit], DoseFit]) -> DoseFit | FailedFit | None:
        """The fit of a dose, with what is to be said about its frames; None while its models are being prepared."""
        dose_ml = photographs[0].dose_ml
        start, scenes = self._start(dose_ml), [one.scene for one in photographs]
        self._passing = None
        try:
            if start is not None and self._preparing is not None:
                box = self._preparing.box(start)
                models = self._preparing.models(scenes, box)
                if models is None and self._preparing.under_way(scenes, box):
                    self._preparing.want(scenes, box)
                    return None
                quick = fit_dose_prepared(photographs, models, start) if models else None
                if quick:
                    quick = about(quick)
                    self._keep(quick)
                    self._passing = quick, photographs
                    return replace(quick, passing=True)
            fit = about(fit_dose(photographs, start))
        except TankrigError as error:
            return FailedFit(dose_ml, str(error))
        self._keep(fit)
        return fit

    def _keep(self, fit: DoseFit) -> None:
        """Remember what a dose is, and have models prepared for it and for the next one."""
        self._liquid[fit.dose_ml], self._latest = fit.medium, (fit.medium, fit.dose_ml)
        if self._preparing is None or self._plan is None:
            return
        scenes = self._plan.scenes.values()
        following = next((one for one in self._plan.doses_ml if one > 1.001 * fit.dose_ml), None)
        if following is not None:
            self._preparing.want(scenes, self._preparing.box(diluted(fit.medium, fit.dose_ml, following)))
        self._preparing.want(scenes, self._preparing.box(fit.medium))

    def _start(self, dose_ml: float) -> Medium | None:
        """Where to begin: the dose's own last fit, what the series foresees, or another dose's liquid, diluted."""
        if dose_ml in self._liquid:
            return self._liquid[dose_ml]
        if self._series is not None:
            return self._series.at(dose_ml)
        return None if self._latest is None else diluted(*self._latest, dose_ml)

    def _all(self, photographs: list[Photograph]) -> Fit:
        models = self._preparing.all_models if self._preparing else ()
        start = None if self._latest is None else diluted(*self._latest, 1.0)
        try:
            self._series = fit_all(photographs, self._series or start, models)
        except TankrigError as error:
            return FailedFit(None, str(error))
        return self._series

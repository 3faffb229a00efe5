"""The process that fits: it looks at shared sums of frames, always at the newest, and sends back what it found."""

import os
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from multiprocessing.synchronize import Event as Signal
from multiprocessing.synchronize import Lock
from typing import Any

import numpy as np

from tankrig.errors import TankrigError
from tankrig.estimation.series import SeriesEstimate
from tankrig.live.exposures import Exposures, Photograph, Plan
from tankrig.live.fits import diluted, fit_all, fit_dose
from tankrig.scene.description import Medium

NICENESS = 10
LOCK_S = 5.0


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
        Where tables go.
    earlier
        Tables of what was fitted before, where a run goes on.
    """

    memory: str
    plan: Plan
    lock: Lock
    news: Signal
    last: Signal
    results: Connection
    earlier: tuple[dict[str, Any], ...] = ()


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
    fitter = Fitter(shared.earlier)
    while True:
        last = shared.last.is_set()
        shared.news.clear()
        exposures = _copy(shared, memory)
        if exposures is not None and not _send(shared, fitter.next(exposures, last)):
            if last:
                return
            shared.news.wait()


def _copy(shared: Shared, memory: SharedMemory) -> Exposures | None:
    """The sums as they are now."""
    if not shared.lock.acquire(timeout=LOCK_S):
        return None
    try:
        numbers: Any = np.ndarray((shared.plan.size,), np.float64, memory.buf).copy()
    finally:
        shared.lock.release()
    return Exposures(shared.plan, numbers)


def _send(shared: Shared, table: dict[str, Any] | None) -> bool:
    if table is not None:
        shared.results.send(table)
    return table is not None


class Fitter:
    """Decides what to fit next: the dose under way first, then the series of the doses that are over.

    Parameters
    ----------
    earlier
        Tables of what was fitted before.
    """

    def __init__(self, earlier: Iterable[dict[str, Any]] = ()) -> None:
        self._fitted: dict[float, int] = {}
        self._liquid: dict[float, Medium] = {}
        self._latest: tuple[Medium, float] | None = None
        self._in_series = 0
        self._series: SeriesEstimate | None = None
        for table in earlier:
            if table.get("fit") == "dose" and "error" not in table:
                self._fitted[table["dose_ml"]] = table["frames"]
                self._keep(table["dose_ml"], Medium(table["sigma_a"], table["sigma_s"], table["g"]))

    def next(self, exposures: Exposures, last: bool) -> dict[str, Any] | None:
        """Fit what is newest and not fitted yet; its table, or None when there is nothing to do."""
        for dose in range(exposures.dose, -1, -1):
            photographs = exposures.photographs(dose)
            frames = sum(one.frames for one in photographs)
            if photographs and frames > self._fitted.get(photographs[0].dose_ml, 0):
                self._fitted[photographs[0].dose_ml] = frames
                return self._dose(photographs[0].dose_ml, photographs)
        over = exposures.photographs() if last else [
            one for one in exposures.photographs() if one.dose_ml < exposures.dose_ml
        ]  # fmt: skip
        doses = len({one.dose_ml for one in over})
        if doses >= 2 and doses > self._in_series:
            self._in_series = doses
            return self._all(over)
        return None

    def _dose(self, dose_ml: float, photographs: list[Photograph]) -> dict[str, Any]:
        try:
            table, found = fit_dose(photographs, self._start(dose_ml))
        except TankrigError as error:
            return {"fit": "dose", "dose_ml": dose_ml, "error": str(error)}
        self._keep(dose_ml, found.ink)
        return table

    def _keep(self, dose_ml: float, liquid: Medium) -> None:
        self._liquid[dose_ml], self._latest = liquid, (liquid, dose_ml)

    def _start(self, dose_ml: float) -> Medium | None:
        """Where to begin: the dose's own last fit, what the series foresees, or another dose's liquid, diluted."""
        if dose_ml in self._liquid:
            return self._liquid[dose_ml]
        if self._series is not None:
            return self._series.at(dose_ml)
        return None if self._latest is None else diluted(*self._latest, dose_ml)

    def _all(self, photographs: list[Photograph]) -> dict[str, Any]:
        try:
            start = self._latest and self._series is None and diluted(*self._latest, 1.0)
            table, self._series = fit_all(photographs, self._series or start or None)
        except TankrigError as error:
            return {"fit": "series", "error": str(error)}
        return table

"""The process that fits: it looks at shared sums of frames, always at the newest, and sends back what it found."""

import os
import threading
import time
from dataclasses import dataclass
from multiprocessing import connection, parent_process
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from multiprocessing.synchronize import Event as Signal
from multiprocessing.synchronize import Lock
from pathlib import Path
from typing import Any

import numpy as np

from tankrig.live.exposures import Exposures
from tankrig.live.next_fit import Fitter, fit_all_there_is
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import Preparation, Preparing, phases_prepared
from tankrig.live.results import Fit
from tankrig.live.sheets_so_far import SheetsSoFar

NICENESS = 10
LOCK_S = 5.0
TOLD_S = 1.0
"""From one word on how far models are to the next."""


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
        Where fits go, and how far the models are that they wait for.
    earlier
        What was fitted before, where a run goes on.
    path
        Of the run, to read its waves back from; None where it is not recorded.
    """

    memory: str
    plan: PhotographPlan
    lock: Lock
    news: Signal
    last: Signal
    results: Connection
    earlier: tuple[Fit, ...] = ()
    path: Path | None = None


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
    phases = phases_prepared(shared.plan) or "hg"
    preparing = Preparing(lambda _: shared.news.set(), phases=phases, first=True)
    fitter = Fitter(shared.earlier, preparing, shared.plan, sheets=SheetsSoFar(shared.path))
    told: list[Preparation] = []

    def wait(seconds: float | None) -> bool:
        """Until there is news; meanwhile it is told how far the models are."""
        begun_s = time.monotonic()
        while True:
            left = preparing.left
            if [left] != told:
                told[:] = [left]
                shared.results.send(left)
            passed_s = time.monotonic() - begun_s
            longest_s = TOLD_S if seconds is None else min(TOLD_S, max(0.0, seconds - passed_s))
            if shared.news.wait(longest_s):
                return True
            if seconds is not None and passed_s >= seconds:
                return False

    try:
        for fit in fit_all_there_is(fitter, lambda: newest(shared, memory), wait):
            shared.results.send(fit)
    finally:
        shared.results.close()  # the run need not wait for what is being computed
        preparing.close()


def newest(shared: Shared, memory: SharedMemory) -> tuple[Exposures | None, bool]:
    """The sums as they are now, None where they could not be read in time, and whether no more frames will come."""
    shared.news.clear()  # first: whatever comes after this line is news again, and looked at once more
    last = shared.last.is_set()
    return _copy(shared, memory), last


def _copy(shared: Shared, memory: SharedMemory) -> Exposures | None:
    """The sums as they are now."""
    if not shared.lock.acquire(timeout=LOCK_S):
        return None
    try:
        numbers: Any = np.ndarray((shared.plan.size,), np.float64, memory.buf).copy()
    finally:
        shared.lock.release()
    return Exposures(shared.plan, numbers)

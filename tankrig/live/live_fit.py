"""The live fit's side in the experiment's process: it hands frames over, and what comes back it passes on."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType
from typing import Any, Self

import numpy as np

from tankrig.devices import Pixels
from tankrig.live.exposures import Exposures, Photograph, Plan, replayed
from tankrig.live.worker import Shared, work
from tankrig.run.journal import Event
from tankrig.run.reading import Run

_LOCK_S = 0.1
_JOIN_S = 5.0
_POLL_S = 0.2
_BLAS = "OPENBLAS_NUM_THREADS"

OnResult = Callable[[dict[str, Any]], object]


@contextmanager
def _inherited() -> Iterator[None]:
    """What a process that is started now keeps for good: Ctrl-C is the run's to answer, and sums take one thread."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    threads = os.environ.get(_BLAS)
    os.environ[_BLAS] = "1"
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        del os.environ[_BLAS]
        if threads is not None:
            os.environ[_BLAS] = threads


class LiveFit:
    """Fits the frames of a run in a niced process of its own while the run goes on.

    Frames are added to sums in shared memory, so that nothing queues: the process looks at all there is by then, and
    fits the newest. It never makes the run wait. When this program dies, the process ends within two seconds and takes
    the shared memory along.

    Parameters
    ----------
    plan
        What the run is going to photograph.
    on_result
        Called with each fit's table, in a thread of this object.
    earlier
        A run that goes on: its frames are taken in first, and what it has fitted is not fitted again.
    """

    def __init__(self, plan: Plan, on_result: OnResult, earlier: Run | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._memory = SharedMemory(create=True, size=plan.size * 8)
        self._numbers: Any = np.ndarray((plan.size,), np.float64, self._memory.buf)
        self._numbers[:] = 0.0
        self._exposures = Exposures(plan, self._numbers)
        self._results, results = context.Pipe(duplex=False)
        self._lock, self._news, self._last = context.Lock(), context.Event(), context.Event()
        fits = tuple(dict(event.fields) for event in earlier.fits) if earlier else ()
        shared = Shared(self._memory.name, plan, self._lock, self._news, self._last, results, fits)
        self._process = context.Process(target=work, args=(shared,), name="live-fit", daemon=True)
        self._on_result = on_result
        self._closing = threading.Event()
        self._last_step = len(plan.settings) - 1
        try:
            for event, pixels in replayed(earlier) if earlier else ():
                self.see(event, pixels)
            with _inherited():
                self._process.start()
        except BaseException:
            self._release()
            raise
        results.close()
        self._thread = threading.Thread(target=self._listen, name="live-fit-results", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """Of the process that fits."""
        return self._process.pid

    def see(self, event: Event, pixels: Pixels | None) -> None:
        """Take a recorded event of the run in; give this to `Runner.listen`."""
        if event.kind == "step" and event["state"] == "done" and event["step"] == self._last_step:
            self._last.set()
            self._news.set()
        if self._closing.is_set() or not self._lock.acquire(timeout=_LOCK_S):
            return  # a preview may be lost; what was recorded is on disk
        try:
            new = self._exposures.take(event, pixels)
        finally:
            self._lock.release()
        if new:
            self._news.set()

    def photographs(self, dose_ml: float) -> list[Photograph]:
        """What has been photographed so far with so much ink in the tank; empty when that cannot be told at once."""
        if self._closing.is_set() or not self._lock.acquire(timeout=_LOCK_S):
            return []
        try:
            by_dose = (self._exposures.photographs(dose) for dose in range(self._exposures.dose, -1, -1))
            return next((found for found in by_dose if found and found[0].dose_ml == dose_ml), [])
        finally:
            self._lock.release()

    @property
    def finished(self) -> bool:
        """Whether the last fits are in; they are asked for once the plan's last step has been seen."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """End the process, at once if need be, and free the shared memory; may be called any number of times."""
        if self._closing.is_set():
            return
        self._closing.set()
        if self._process.is_alive():
            self._process.terminate()
        self._process.join(_JOIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_JOIN_S)
        self._thread.join(_JOIN_S)
        self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _release(self) -> None:
        del self._exposures, self._numbers
        self._memory.close()
        self._memory.unlink()

    def _listen(self) -> None:
        """Pass results on until the process has closed its end."""
        while not self._closing.is_set():
            try:
                if self._results.poll(_POLL_S):
                    self._on_result(self._results.recv())
            except (EOFError, OSError):
                return

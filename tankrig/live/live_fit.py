"""The live fit's side in the experiment's process: it hands frames over, and what comes back it passes on."""

import logging
import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.shared_memory import SharedMemory
from types import TracebackType
from typing import Any, Self

import numpy as np

from tankrig.devices import Pixels
from tankrig.errors import StoreError
from tankrig.live.exposures import Exposures, Photograph
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import Preparation
from tankrig.live.recorded import fits_that_hold
from tankrig.live.results import Fit, from_fields
from tankrig.live.worker import Shared, work
from tankrig.pattern import Pattern
from tankrig.run.conditions import Conditions
from tankrig.run.event_dispatcher import EventDispatcher
from tankrig.run.journal import Event
from tankrig.run.reading import Run, StoredFrames

_log = logging.getLogger(__name__)

_LOCK_S = 0.1
_JOIN_S = 5.0
_POLL_S = 0.2
_BLAS = "OPENBLAS_NUM_THREADS"
_TOLD_S = 30.0
"""From one sentence on what could not be taken in to the next: on a slow disk it may be every frame."""

OnResult = Callable[[Fit], object]


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

    Frames are added to sums in shared memory: the process looks at all there is by then, and fits the newest. A thread
    of this object adds them, so that nobody else waits while the process reads. It takes in every event, in the order
    of the journal; where it has fallen behind, pixels are let go and read back from the disk. When this program dies,
    the process ends within two seconds and takes the shared memory along.

    Parameters
    ----------
    plan
        What the run is going to photograph.
    on_result
        Called with each fit, in a thread of this object.
    run
        Where frames can be read back from. What it holds already is taken in first, and what it has fitted is not
        fitted again.
    on_trouble
        Called, in a thread of this object, with a sentence on frames that could not be taken in: at once on the first,
        then every half a minute on all since.
    clock
        Seconds; for that.
    """

    def __init__(
        self,
        plan: PhotographPlan,
        on_result: OnResult,
        run: Run | None = None,
        on_trouble: Callable[[str], object] = lambda _: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._memory = SharedMemory(create=True, size=plan.size * 8)
        self._numbers: Any = np.ndarray((plan.size,), np.float64, self._memory.buf)
        self._numbers[:] = 0.0
        self._exposures = Exposures(plan, self._numbers)
        self._results, results = context.Pipe(duplex=False)
        self._lock, self._news, self._last = context.Lock(), context.Event(), context.Event()
        fits = tuple(from_fields(event.fields) for event in fits_that_hold(run)) if run else ()
        self._path = run.path if run else None
        shared = Shared(self._memory.name, plan, self._lock, self._news, self._last, results, fits, self._path)
        self._process = context.Process(target=work, args=(shared,), name="live-fit", daemon=True)
        self._on_result, self._on_trouble, self._clock = on_result, on_trouble, clock
        self._not_told, self._told_s = "", -math.inf
        self._without = 0
        self._closing = threading.Event()
        self.preparation = Preparation(0, 0.0)
        """How far the models are that fits wait for, as it was told last."""
        self._last_step = len(plan.settings) - 1
        try:
            for event in run.journal if run else ():
                self._take(event, None)
            with _inherited():
                self._process.start()
        except BaseException:
            self._release()
            raise
        results.close()
        self._taking = EventDispatcher()
        self._taking.listen(self._take)
        self._thread = threading.Thread(target=self._listen, name="live-fit-results", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int | None:
        """Of the process that fits."""
        return self._process.pid

    def see(self, event: Event, pixels: Pixels | None) -> None:
        """Take a recorded event of the run in, and return at once; give this to `Runner.listen`."""
        self._taking.dispatch(event, pixels)

    def watch(self, pattern: Pattern, pixels: Pixels, conditions: Conditions) -> None:
        """Look at a picture of ink that has nearly mixed; give this to `Runner.while_mixing`.

        Models can then be prepared while ink mixes. It returns at once: where the process reads the sums just then, the
        picture is let go, and the next will do. The run goes on whatever is wrong with a picture.
        """
        if self._closing.is_set() or not self._lock.acquire(block=False):
            return
        try:
            if not self._closing.is_set() and self._exposures.watch(pattern, pixels, conditions):
                self._news.set()
        except Exception:
            _log.exception("the live fit could not look at ink that mixes")
        finally:
            self._lock.release()

    def _take(self, event: Event, pixels: Pixels | None) -> None:
        """Add an event to the sums, however long that has to wait for the process that reads them."""
        if self._closing.is_set():
            return
        why = ""
        if event.kind == "frame" and pixels is None:
            pixels, why = self._read_back(event)
        while not self._lock.acquire(timeout=_LOCK_S):
            if self._closing.is_set():
                return
        new = False
        try:
            if self._closing.is_set():
                return
            before, new = self._exposures.not_seen, self._exposures.take(event, pixels)
            if self._exposures.not_seen > before:
                why = why or "its dose, its gain or its pixels are none that the fit was told of"
        except Exception as error:  # the next events are taken in all the same
            _log.exception("the live fit could not take an event in")
            why = f"{type(error).__name__}: {error}"
        finally:
            self._lock.release()
        if why:
            self._without += 1
            self._not_told = f"{event.kind} {event.get('index', event.seq)}: {why}"
        last = event.kind == "step" and event["state"] == "done" and event["step"] == self._last_step
        self._tell_trouble(at_once=last)
        if last:
            self._last.set()
        if new or last:
            self._news.set()

    def _tell_trouble(self, at_once: bool) -> None:
        """Say what could not be taken in, if there is any, and if the last sentence on it is some time ago."""
        if not self._without or not (at_once or self._clock() - self._told_s >= _TOLD_S):
            return
        more = f"{self._without} more frames, the last of them " if self._without > 1 else ""
        self._on_trouble(f"the live fit goes on without {more}{self._not_told}")
        self._without, self._told_s = 0, self._clock()

    def _read_back(self, event: Event) -> tuple[Pixels | None, str]:
        """The pixels of a frame that had to be let go, or why they cannot be had."""
        if self._path is None:
            return None, "its pixels were let go"
        try:
            return StoredFrames(self._path).read(event), ""
        except StoreError as error:
            return None, str(error)

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
        self._taking.close()
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

    def _tell_of_a_sudden_end(self) -> None:
        """Say so where the process has died, and did not end because all is fitted or nothing more is wanted."""
        self._process.join(_JOIN_S)
        if self._process.exitcode and not self._closing.is_set():
            self._on_trouble(
                f"the live fit's process has ended (exit status {self._process.exitcode}), so that what comes now is "
                "recorded and not fitted; fit the run again when it has ended"
            )

    def _release(self) -> None:
        del self._exposures, self._numbers
        self._memory.close()
        self._memory.unlink()

    def _listen(self) -> None:
        """Pass results on until the process has closed its end."""
        while not self._closing.is_set():
            try:
                if not self._results.poll(_POLL_S):
                    continue
                found: Fit | Preparation = self._results.recv()
            except (EOFError, OSError):
                self._tell_of_a_sudden_end()
                return
            if isinstance(found, Preparation):
                self.preparation = found
                continue
            try:
                self._on_result(found)
            except Exception:
                _log.exception("a fit could not be passed on; the next ones are")

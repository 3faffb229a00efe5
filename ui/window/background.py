"""Work that takes seconds, in one spawned process of low priority, so that the window never waits for it."""

import logging
import multiprocessing
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import connection, parent_process
from multiprocessing.process import BaseProcess
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from ui.window import progress

_log = logging.getLogger(__name__)

NICENESS = 12
IDLE_END_S = 0.5
"""In which a process that has nothing to do ends by itself; one that works is ended."""
DIED = (
    "the process that computes in the background has ended by itself (out of memory, or somebody ended it); "
    "nothing that was recorded is lost: ask for it again"
)


@dataclass(eq=False)
class Task:
    """Something that was asked for and has not come yet.

    Parameters
    ----------
    name
        For people; empty where it need not be listed.
    work, arguments, then, failed
        See `Background.run`.
    began_s
        When it was begun, on the monotonic clock; None while it waits.
    share
        How much of it is done, 0 … 1; None where that is not known.
    cancelled
        Whether somebody has called it off.
    """

    name: str
    work: Callable[..., Any]
    arguments: tuple[Any, ...]
    then: Callable[[Any], object]
    failed: Callable[[str], object] | None
    began_s: float | None = None
    share: float | None = None
    cancelled: bool = False

    @property
    def left_s(self) -> float | None:
        """About how long it will still take; None where that is not known."""
        if self.began_s is None or not self.share:
            return None
        return (time.monotonic() - self.began_s) * (1.0 - self.share) / self.share


class Background(QObject):
    """Runs functions of modules in a process of its own, one after the other.

    When the window's program dies, the process ends, too. When the process dies, that is told to whoever had asked, and
    the next function gets a new one.
    """

    changed = Signal()
    """What is in work or waits."""
    _done = Signal(object, object)
    _told = Signal(float)

    def __init__(self) -> None:
        super().__init__()
        self._pool: ProcessPoolExecutor | None = None
        self._tasks: list[Task] = []
        self._closed = False
        queued = Qt.ConnectionType.QueuedConnection
        self._done.connect(self._hand_over, queued)
        self._told.connect(self._take_share, queued)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """What is in work, first, and what waits."""
        return tuple(self._tasks)

    @property
    def waiting(self) -> int:
        """How many have not come yet."""
        return len(self._tasks)

    def run(
        self,
        work: Callable[..., Any],
        *arguments: Any,
        then: Callable[[Any], object],
        failed: Callable[[str], object] | None = None,
        name: str = "",
    ) -> Task:
        """Call `work(*arguments)` there, and `then(result)` or `failed(sentence)` in the window's thread."""
        task = Task(name, work, arguments, then, failed)
        self._tasks.append(task)
        self._begin_next()
        return task

    def cancel(self, task: Task) -> None:
        """Call something off: what it has done so far is lost, and who asked for it is told so."""
        if task not in self._tasks:
            return
        task.cancelled = True
        if task.began_s is not None:
            self._end_process()  # the future fails, and what waits goes on in a new process
        else:
            self._tasks.remove(task)
            self._fail(task, "cancelled")
        self.changed.emit()

    def close(self) -> None:
        """End the process, and what it does."""
        self._closed = True
        pool, self._pool = self._pool, None
        if pool is not None:
            processes = _processes_of(pool)
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.join(IDLE_END_S)
                process.terminate()
            pool.shutdown(wait=True)
            self._writing.close()
            self._listener.join(IDLE_END_S)

    def _begin_next(self) -> None:
        task = self._tasks[0] if self._tasks else None
        if task is not None and task.began_s is None and not self._closed:
            task.began_s = time.monotonic()
            try:
                future = self._ready_pool().submit(task.work, *task.arguments)
            except BrokenProcessPool:  # it died while it had nothing to do
                self._drop_pool()
                future = self._ready_pool().submit(task.work, *task.arguments)
            future.add_done_callback(lambda done: self._done.emit(done, task))
        self.changed.emit()

    def _ready_pool(self) -> ProcessPoolExecutor:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            reading, writing = context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(1, context, initializer=_begin, initargs=(writing,))
            self._listener = threading.Thread(
                target=self._listen, args=(reading,), name="background-share", daemon=True
            )
            self._listener.start()
            self._writing = writing  # handed over when the process starts
        return self._pool

    def _listen(self, reading: Any) -> None:
        """Pass on how far the process is; ends with it."""
        try:
            while True:
                self._told.emit(reading.recv())
        except (EOFError, OSError, RuntimeError):
            return

    def _end_process(self) -> None:
        for process in _processes_of(self._pool) if self._pool is not None else ():
            process.terminate()

    def _drop_pool(self) -> None:
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)
            self._writing.close()

    def _take_share(self, share: float) -> None:
        if self._tasks and self._tasks[0].began_s is not None:
            self._tasks[0].share = share
            self.changed.emit()

    def _hand_over(self, done: "Future[Any]", task: Task) -> None:
        if task in self._tasks:
            self._tasks.remove(task)
        if self._closed or done.cancelled():
            return
        error = done.exception()
        if isinstance(error, BrokenProcessPool):
            self._drop_pool()
            self._fail(task, "cancelled" if task.cancelled else DIED)
        elif error is not None:
            self._fail(task, str(error))
        else:
            task.then(done.result())
        self._begin_next()

    def _fail(self, task: Task, sentence: str) -> None:
        (_log.info if task.cancelled else _log.error)("%s: %s", task.name or "background", sentence)
        if task.failed is not None:
            task.failed(sentence)


def _processes_of(pool: ProcessPoolExecutor) -> list[BaseProcess]:
    """Those that work: Python names them publicly, and ends them, from 3.14 on."""
    return list((pool._processes or {}).values())  # noqa: SLF001


def _begin(telling: Any) -> None:
    os.nice(NICENESS)
    progress.tell_to(telling)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)

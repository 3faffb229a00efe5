"""Work that takes seconds, in one spawned process of low priority, so that the window never waits for it."""

import logging
import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import connection, parent_process
from typing import Any

from PySide6.QtCore import QObject, Signal

_log = logging.getLogger(__name__)

NICENESS = 12
IDLE_END_S = 0.5
"""In which a process that has nothing to do ends by itself; one that works is ended."""


class Background(QObject):
    """Runs functions of modules in a process of its own, one after the other.

    When the window's program dies, the process ends, too.
    """

    _done = Signal(object, object)

    def __init__(self) -> None:
        super().__init__()
        self._pool: ProcessPoolExecutor | None = None
        self._done.connect(self._hand_over)
        self.waiting = 0

    def run(
        self,
        work: Callable[..., Any],
        *arguments: Any,
        then: Callable[[Any], object],
        failed: Callable[[str], object] | None = None,
    ) -> None:
        """Call `work(*arguments)` there, and `then(result)` or `failed(sentence)` in the window's thread."""
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, context, initializer=_begin)
        self.waiting += 1
        future = self._pool.submit(work, *arguments)
        future.add_done_callback(lambda done: self._done.emit(done, (then, failed)))

    def close(self) -> None:
        """End the process, and what it does."""
        pool, self._pool = self._pool, None
        if pool is not None:
            processes = list((pool._processes or {}).values())
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.join(IDLE_END_S)
                process.terminate()
            pool.shutdown(wait=True)

    def _hand_over(self, done: "Future[Any]", what: tuple[Callable[..., Any], Callable[..., Any] | None]) -> None:
        self.waiting -= 1
        then, failed = what
        if done.cancelled() or self._pool is None:
            return
        error = done.exception()
        if error is None:
            then(done.result())
            return
        _log.error("%s", error)
        if failed is not None:
            failed(str(error))


def _begin() -> None:
    os.nice(NICENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)

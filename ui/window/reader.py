"""Reading from disk in a thread of its own, so that the window never waits for it."""

import logging
import queue
import threading
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from tankrig.errors import TankrigError
from ui.window.threads import OwnedThread

_log = logging.getLogger(__name__)

END_S = 10.0
_Task = tuple[Callable[..., Any], tuple[Any, ...], Callable[[Any], object], Callable[[str], object] | None]


class Reader(QObject):
    """Calls functions that read, one after the other, and hands on what they found."""

    _done = Signal(object, object)

    def __init__(self) -> None:
        super().__init__()
        self._tasks: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()
        self._done.connect(self._hand_over, Qt.ConnectionType.QueuedConnection)
        self._thread = OwnedThread("reader", self._work, END_S)

    def run(
        self,
        work: Callable[..., Any],
        *arguments: Any,
        then: Callable[[Any], object],
        failed: Callable[[str], object] | None = None,
    ) -> None:
        """Call `work(*arguments)` there, then `then(result)` or `failed(sentence)` in the window's thread."""
        self._tasks.put((work, arguments, then, failed))

    def close(self) -> None:
        """End the thread."""
        self._thread.ending.set()
        self._tasks.put(None)
        self._thread.close()

    def _work(self, ending: threading.Event) -> None:
        while (task := self._tasks.get()) is not None and not ending.is_set():
            work, arguments, then, failed = task
            try:
                found = work(*arguments)
            except (TankrigError, OSError) as error:
                self._done.emit(failed, str(error))
            except Exception as error:
                _log.exception("what was to be read cannot be")
                self._done.emit(failed, f"it cannot be read ({type(error).__name__}: {error}); the log tells where")
            else:
                self._done.emit(then, found)

    def _hand_over(self, take: Callable[[Any], object] | None, found: Any) -> None:
        if take is not None and not self._thread.ending.is_set():
            take(found)

"""Passing on to listeners what a run has recorded, without ever waiting for them."""

import logging
import threading
from collections import deque
from collections.abc import Callable

from tankrig.devices import Pixels
from tankrig.run.journal import Event

Listener = Callable[[Event, Pixels | None], object]

_PREVIEWS = 8
_CLOSE_S = 5.0

_log = logging.getLogger(__name__)


class EventDispatcher:
    """Calls listeners in a thread of its own, in the order of the journal.

    When listeners are slow, events wait and previews do not: beyond a few frames, the pixels of the oldest are let go
    and their event comes with None.
    """

    def __init__(self) -> None:
        self._listeners: tuple[Listener, ...] = ()
        self._waiting: deque[tuple[Event, Pixels | None]] = deque()
        self._change = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="run-dispatcher", daemon=True)
        self._thread.start()

    def listen(self, listener: Listener) -> None:
        """Call `listener` with every event from now on; one that raises is not called again."""
        with self._change:
            self._listeners = (*self._listeners, listener)

    def dispatch(self, event: Event, pixels: Pixels | None) -> None:
        """Pass on an acknowledged event; returns at once."""
        with self._change:
            self._waiting.append((event, pixels))
            if sum(waiting[1] is not None for waiting in self._waiting) > _PREVIEWS:
                oldest = next(i for i, waiting in enumerate(self._waiting) if waiting[1] is not None)
                self._waiting[oldest] = (self._waiting[oldest][0], None)
            self._change.notify_all()

    def close(self) -> None:
        """Pass on what is waiting, for a few seconds at most, and end; may be called any number of times."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(_CLOSE_S)

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                event, pixels = self._waiting.popleft()
                listeners = self._listeners
            for listener in listeners:
                self._tell(listener, event, pixels)

    def _tell(self, listener: Listener, event: Event, pixels: Pixels | None) -> None:
        try:
            listener(event, pixels)
        except BaseException:  # whatever it is, the others still hear the run
            _log.exception("a listener failed and hears no more of the run")
            with self._change:
                self._listeners = tuple(other for other in self._listeners if other is not listener)

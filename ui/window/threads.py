"""The window's own threads: each has an owner, an end and a time in which that end has to come."""

import logging
import threading
from collections.abc import Callable

_log = logging.getLogger(__name__)


class OwnedThread:
    """A thread that ends when it is told to.

    Parameters
    ----------
    name
        For the log.
    work
        Called with an event that is set when it is to end; must come back soon after.
    end_s
        How long `close` waits for that.
    """

    def __init__(self, name: str, work: Callable[[threading.Event], object], end_s: float) -> None:
        self.ending = threading.Event()
        self._end_s = end_s
        self._thread = threading.Thread(target=work, args=(self.ending,), name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether it is at work."""
        return self._thread.is_alive()

    def close(self) -> bool:
        """End it; whether it has ended in time. May be called any number of times."""
        self.ending.set()
        self._thread.join(self._end_s)
        if self._thread.is_alive():
            _log.error("%s: has not ended within %g s; it is left behind", self._thread.name, self._end_s)
        return not self._thread.is_alive()


class StopThread:
    """Stops the doser, from a thread that never waits for anything else.

    It acts when `press` is called, and by itself when `alive` has not been called for `patience_s` while `dosing` says
    that ink moves: a window that hangs cannot be asked to stop.

    Parameters
    ----------
    stop
        Puts the stop on the wire.
    dosing
        Whether ink may be moving.
    patience_s
        Without a sign of life from the window.
    """

    def __init__(self, stop: Callable[[], object], dosing: Callable[[], bool], patience_s: float = 5.0) -> None:
        self._stop, self._dosing, self._patience_s = stop, dosing, patience_s
        self._pressed, self._sign = threading.Event(), threading.Event()
        self._thread = OwnedThread("stop", self._work, 2.0)

    def press(self) -> None:
        """Stop now; returns at once."""
        self._pressed.set()
        self._sign.set()

    def alive(self) -> None:
        """The window is."""
        self._sign.set()

    def close(self) -> None:
        """End the thread, after a stop that was asked for."""
        self._thread.ending.set()
        self._sign.set()
        self._thread.close()

    def _work(self, ending: threading.Event) -> None:
        while not ending.is_set() or self._pressed.is_set():
            silent = not self._sign.wait(self._patience_s)
            self._sign.clear()
            hung = silent and self._dosing()
            if self._pressed.is_set() or hung:
                self._pressed.clear()
                if hung:
                    _log.error("the window did not answer for %g s while ink was dosed: stopped", self._patience_s)
                try:
                    self._stop()
                except Exception:
                    _log.exception("the stop failed; pull the doser's power")

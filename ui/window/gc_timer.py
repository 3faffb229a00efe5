"""Python's garbage is collected in the window's thread only, for Qt's objects may not end in another."""

import gc
from collections.abc import Callable

from PySide6.QtCore import QObject, QTimer

EVERY_MS = 1000
OLDEST_EVERY, ALL_EVERY = 60, 600
"""Turns of the timer after which what has survived so far is looked at, and, where nobody minds, all there is."""


class GcTimer(QObject):
    """Takes over from Python's own collector, which runs in whatever thread happens to allocate, until `close`.

    Parameters
    ----------
    idle
        Whether nobody minds if the window stands still for a moment: then, every ten minutes and after a run, all there
        is is looked at, which takes up to a fifth of a second of processor time; otherwise only what has come since,
        which takes a few milliseconds.
    """

    def __init__(self, idle: Callable[[], bool]) -> None:
        super().__init__()
        self._idle = idle
        gc.collect()
        gc.freeze()  # what was imported stays; without it a collection takes longer than a person may wait
        gc.disable()
        self._count, self._was_idle = 0, True
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._collect)
        self._timer.start(EVERY_MS)

    def close(self) -> None:
        """Hand back."""
        self._timer.stop()
        gc.unfreeze()
        gc.enable()

    def _collect(self) -> None:
        was_idle, self._was_idle = self._was_idle, self._idle()
        self._count += 1
        if was_idle is not self._was_idle:
            self._count = 0  # a run begins or has ended: now what came before it may be looked at
        if self._count % OLDEST_EVERY:
            gc.collect(1)
            return
        if self._was_idle and (not was_idle or self._count % ALL_EVERY == 0):
            gc.unfreeze()
        gc.collect(2)
        gc.freeze()

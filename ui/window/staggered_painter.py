"""Painting in parts: what would hold the live picture up if it were painted at once takes turns with it."""

from collections.abc import Callable, Iterable

from PySide6.QtCore import QObject, QTimer

TURN_MS = 40


class StaggeredPainter(QObject):
    """Calls one thing after another, with the event loop free in between.

    Parameters
    ----------
    owner
        What is painted on: when that goes, what still waits goes with it.
    """

    def __init__(self, owner: QObject) -> None:
        super().__init__(owner)
        self._waiting: list[Callable[[], None]] = []
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._next)

    def take(self, calls: Iterable[Callable[[], None]]) -> None:
        """Call these, instead of what still waits."""
        self._waiting = list(calls)
        self._timer.start(TURN_MS)

    def _next(self) -> None:
        if not self._waiting:
            self._timer.stop()
            return
        self._waiting.pop(0)()

"""Painting in parts: what would hold the live picture up if it were painted at once takes turns with it."""

from collections.abc import Callable, Iterable

from PySide6.QtCore import QObject, QTimer
from PySide6.QtWidgets import QWidget

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
        self._held: list[QWidget] = []
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._next)

    @property
    def busy(self) -> bool:
        """Whether something waits for its turn to be called."""
        return bool(self._waiting)

    def take(self, calls: Iterable[Callable[[], None]]) -> None:
        """Call these, instead of what still waits."""
        self._waiting = list(calls)
        self._timer.start(TURN_MS)

    def hold(self, widgets: Iterable[QWidget]) -> None:
        """Paint none of these before its turn: what a page has not shown yet costs most when it is painted first.

        Each has its turn after all calls that are taken, whatever becomes of those.
        """
        for widget in widgets:
            widget.setUpdatesEnabled(False)
            self._held.append(widget)
        self._timer.start(TURN_MS)

    def _next(self) -> None:
        if self._waiting:
            self._waiting.pop(0)()
        elif self._held:
            self._held.pop(0).setUpdatesEnabled(True)
        else:
            self._timer.stop()

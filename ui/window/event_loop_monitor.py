"""How long the window keeps a person waiting: gaps between the ticks of a short timer."""

import time
from collections import deque

from PySide6.QtCore import QObject, Qt, QTimer, Signal

TICK_MS = 10


class EventLoopMonitor(QObject):
    """Measures the time between ticks that should come every 10 ms.

    Attributes
    ----------
    worst_ms
        The longest since the last `reset`.
    """

    ticked = Signal(float)
    """Time since the tick before, ms."""

    def __init__(self) -> None:
        super().__init__()
        self._timer = QTimer(self)
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._tick)
        self._last = time.perf_counter()
        self._recent: deque[tuple[float, float]] = deque(maxlen=2000)
        self.worst_ms = 0.0
        self._timer.start(TICK_MS)

    def reset(self) -> None:
        """Begin anew."""
        self.worst_ms, self._last = 0.0, time.perf_counter()
        self._recent.clear()

    def longest(self, count: int) -> list[float]:
        """The longest gaps among the last 2000, ms, longest first."""
        return sorted((gap for _, gap in self._recent), reverse=True)[:count]

    def _tick(self) -> None:
        now = time.perf_counter()
        gap_ms = 1e3 * (now - self._last)
        self._last = now
        self.worst_ms = max(self.worst_ms, gap_ms)
        self._recent.append((now, gap_ms))
        self.ticked.emit(gap_ms)

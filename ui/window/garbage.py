"""Python's garbage is collected in the window's thread only, for Qt's objects may not end in another."""

import gc

from PySide6.QtCore import QObject, QTimer

EVERY_MS = 1000
OLDEST_EVERY = 60


class GarbageTimer(QObject):
    """Takes over from Python's own collector, which runs in whatever thread happens to allocate, until `close`."""

    def __init__(self) -> None:
        super().__init__()
        gc.collect()
        gc.freeze()  # what was imported stays; without it a collection takes longer than a person may wait
        gc.disable()
        self._count = 0
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._collect)
        self._timer.start(EVERY_MS)

    def close(self) -> None:
        """Hand back."""
        self._timer.stop()
        gc.unfreeze()
        gc.enable()

    def _collect(self) -> None:
        self._count += 1
        gc.collect(2 if self._count % OLDEST_EVERY == 0 else 1)

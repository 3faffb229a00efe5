"""F12 stops always, and Esc while something moves, whatever window, field, list or menu has the keyboard."""

from collections.abc import Callable

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QGuiApplication, QKeyEvent, QKeySequence, QShortcut, QWindow
from PySide6.QtWidgets import QWidget


class StopKeys(QObject):
    """Watches for the keys in two places.

    Shortcuts of the whole program come before fields and dialogs; but while a menu or a drop-down list is open Qt asks
    no shortcut, so that the windows themselves are watched, too, to which all keys go first.

    Parameters
    ----------
    window
        The main window.
    stop
        Stops.
    in_motion
        Whether a run, a dose or a calibration goes on: only then is Esc a stop; otherwise it closes dialogs as usual.
    """

    def __init__(self, window: QWidget, stop: Callable[[], object], in_motion: Callable[[], bool]) -> None:
        super().__init__(window)
        self._stop, self._in_motion = stop, in_motion
        always, moving = QShortcut(QKeySequence("F12"), window), QShortcut(QKeySequence("Esc"), window)
        for shortcut in (always, moving):
            shortcut.setContext(Qt.ShortcutContext.ApplicationShortcut)
            shortcut.setAutoRepeat(False)
            shortcut.activated.connect(stop)
            shortcut.activatedAmbiguously.connect(stop)
        self._moving = moving
        self.follow()
        app = QGuiApplication.instance()
        assert isinstance(app, QGuiApplication)
        app.focusWindowChanged.connect(self._watch)

    def follow(self) -> None:
        """Something has begun to move, or has ended."""
        moving = self._in_motion()
        if self._moving.isEnabled() != moving:
            self._moving.setEnabled(moving)

    def end(self) -> None:
        """Watch no more."""
        app = QGuiApplication.instance()
        assert isinstance(app, QGuiApplication)
        app.focusWindowChanged.disconnect(self._watch)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 - Qt's name
        """Stop on a key that no shortcut has taken."""
        if event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent) and not event.isAutoRepeat():
            key = event.key()
            if key == Qt.Key.Key_F12 or (key == Qt.Key.Key_Escape and self._in_motion()):
                self._stop()
                return True
        return super().eventFilter(watched, event)

    def _watch(self, window: QWindow | None) -> None:
        if window is not None:
            window.removeEventFilter(self)  # no more than once
            window.installEventFilter(self)

"""A ring around whatever has the keyboard, so that a person who uses no mouse sees where they are."""

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, Qt, QTimer
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QRegion
from PySide6.QtWidgets import QAbstractScrollArea, QApplication, QWidget
from shiboken6 import isValid

from ui.window import theme

WIDTH_PX = 3
OUTSIDE_PX = 2


class FocusRing(QWidget):
    """Follows the focus in one window; dialogs and floating pages draw their own, see `theme`.

    It is a mask of four thin sides: what lies inside is not painted anew when the ring is.

    Parameters
    ----------
    window
        Which.
    """

    def __init__(self, window: QWidget) -> None:
        super().__init__(window)
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._around: QWidget | None = None
        self._home = window
        self._soon = QTimer(self)  # never in the middle of what Qt does with the widgets that are watched
        self._soon.setSingleShot(True)
        self._soon.timeout.connect(self._place)
        self.hide()
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        app.focusChanged.connect(self._follow)

    @property
    def around(self) -> QWidget | None:
        """What it is drawn around; None where nothing has the keyboard, or what had it is gone."""
        return self._around if self._around is not None and isValid(self._around) else None

    def end(self) -> None:
        """Follow no more."""
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        app.focusChanged.disconnect(self._follow)
        self._leave()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 - Qt's name
        """Stay around what moves, and go when it does."""
        kind = event.type()
        if kind in (QEvent.Type.Move, QEvent.Type.Resize, QEvent.Type.Show, QEvent.Type.Hide):
            self._soon.start(0)
        return super().eventFilter(watched, event)

    def paintEvent(self, _: QPaintEvent) -> None:  # noqa: N802 - Qt's name
        """Draw it."""
        painter = QPainter(self)
        painter.setPen(QPen(QColor(theme.current().focus), WIDTH_PX))
        inset = WIDTH_PX // 2
        painter.drawRect(self.rect().adjusted(inset, inset, -inset - 1, -inset - 1))
        painter.end()

    def _follow(self, _: QWidget | None, now: QWidget | None) -> None:
        self._leave()
        if now is None or now.window() is now:
            return
        self._around = now
        for widget in self._watched():
            widget.installEventFilter(self)
        self._soon.start(0)

    def _leave(self) -> None:
        for widget in self._watched():
            widget.removeEventFilter(self)
        self._around = None
        self._soon.start(0)

    def _watched(self) -> list[QWidget]:
        """What has the keyboard and all that it lies in."""
        found, widget = [], self.around
        while widget is not None and not widget.isWindow():
            found.append(widget)
            widget = widget.parentWidget()
        return found

    def _place(self) -> None:
        around = self.around
        window = around.window() if around is not None else None
        if around is None or window is not self._home or not around.isVisible():
            self.hide()
            return
        inside = QRect(around.mapTo(window, QPoint(0, 0)), around.size())
        inside = inside.adjusted(-OUTSIDE_PX, -OUTSIDE_PX, OUTSIDE_PX, OUTSIDE_PX)
        area = around.parentWidget()
        while area is not None and not area.isWindow():  # no further than what can be seen of it
            if isinstance(area.parentWidget(), QAbstractScrollArea):
                inside = inside.intersected(QRect(area.mapTo(window, QPoint(0, 0)), area.size()))
            area = area.parentWidget()
        inside = inside.intersected(window.rect())
        if inside.isEmpty():
            self.hide()
            return
        self.setGeometry(inside)
        whole, hole = self.rect(), self.rect().adjusted(WIDTH_PX, WIDTH_PX, -WIDTH_PX, -WIDTH_PX)
        self.setMask(QRegion(whole).subtracted(QRegion(hole)))
        self.raise_()
        self.show()

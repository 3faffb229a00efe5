"""The docks that pages live in: there from the beginning, filled when their pages are made."""

from functools import partial

import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, Qt, QTimer
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QApplication, QDockWidget, QFrame, QMainWindow, QScrollArea, QTabWidget, QWidget

from ui.window.source_frame import SourceFrame
from ui.window.staggered_painter import StaggeredPainter

TITLES = (
    "Sequence", "Fit", "Waves", "Doser", "Projector", "Runs", "Compare", "Regions", "Calibration", "Log"
)  # fmt: skip
PART = 0.57
"""Of the window's width, at first."""


class Docks(QObject):
    """One dock for each title, in tabs on the right until a person moves them.

    Parameters
    ----------
    window
        Which they belong to.
    """

    def __init__(self, window: QMainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._by_title: dict[str, QDockWidget] = {}
        self._by_page: dict[QWidget, QDockWidget] = {}
        self._share, self._width = PART, 0
        self._soon = QTimer(self)
        self._soon.setSingleShot(True)
        self._soon.timeout.connect(self._keep_share)
        window.setDockOptions(QMainWindow.DockOption.AllowTabbedDocks | QMainWindow.DockOption.AllowNestedDocks)
        window.setTabPosition(Qt.DockWidgetArea.RightDockWidgetArea, QTabWidget.TabPosition.North)
        for title in TITLES:
            dock, area = QDockWidget(title), QScrollArea()  # small screens scroll
            area.setWidgetResizable(True)
            area.setFrameShape(QFrame.Shape.NoFrame)
            dock.setObjectName(title)
            dock.setWidget(area)
            area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            dock.installEventFilter(self)
            self._by_title[title] = dock

    def __getitem__(self, page: QWidget) -> QDockWidget:
        """The dock of a page."""
        return self._by_page[page]

    def put(self, title: str, page: QWidget, frame: QWidget) -> None:
        """Fill a dock with its page, in the frame that says whose it is."""
        dock = self._by_title[title]
        area = dock.widget()
        assert isinstance(area, QScrollArea)
        area.setWidget(frame)
        frame.setVisible(not dock.visibleRegion().isEmpty())
        dock.visibilityChanged.connect(frame.setVisible)  # else the keyboard gets to pages behind the one in front
        self._by_page[page] = dock
        dock.visibilityChanged.connect(partial(_appear, page.findChildren(pg.PlotWidget), StaggeredPainter(page)))

    def pages(self) -> list[tuple[str, QWidget]]:
        """Title and page of each dock that has one."""
        titles = {dock: title for title, dock in self._by_title.items()}
        return [(titles[dock], page) for page, dock in self._by_page.items()]

    def in_front(self) -> tuple[str, QWidget]:
        """Title and frame of the page that has the keyboard, or else of the first one that can be seen."""
        seen = [(title, dock) for title, dock in self._by_title.items() if not dock.visibleRegion().isEmpty()]
        focus = QApplication.focusWidget()
        held = [one for one in seen if focus is not None and one[1].isAncestorOf(focus)]
        title, dock = next(iter(held or seen), (TITLES[0], self._by_title[TITLES[0]]))
        frame = dock.findChild(SourceFrame)
        return title, dock if frame is None else frame

    def show(self, page: QWidget) -> None:
        """Bring a page to the front."""
        self._by_page[page].show()
        self._by_page[page].raise_()

    def arrange(self, page: QWidget, share: float) -> None:
        """All docks where they were at first, this page in front, with so much of the window's width."""
        self.reset()
        self.show(page)
        self._share = share
        self._keep_share()

    def window_resized(self) -> None:
        """The window has another width: the pages keep their share of it, however small it was meanwhile."""
        self._soon.start(0)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 - Qt's name
        """A person has moved the edge of the pages: that is their share from now on."""
        held = bool(QGuiApplication.mouseButtons() & Qt.MouseButton.LeftButton)
        settled = held and not self._soon.isActive() and self._window.width() == self._width
        moved = event.type() == QEvent.Type.Resize and settled and isinstance(watched, QDockWidget)
        if moved and self._on_the_right(watched):  # type: ignore[arg-type]
            self._share = watched.width() / max(1, self._width)  # type: ignore[attr-defined]
        return super().eventFilter(watched, event)

    def end(self) -> None:
        """Watch no more."""
        self._soon.stop()
        for dock in self._by_title.values():
            dock.removeEventFilter(self)

    def _keep_share(self) -> None:
        right = next((dock for dock in self._by_title.values() if self._on_the_right(dock)), None)
        if right is not None:
            wide = round(self._share * self._window.width())
            self._window.resizeDocks([right], [wide], Qt.Orientation.Horizontal)
        self._width = self._window.width()

    def _on_the_right(self, dock: QDockWidget) -> bool:
        area = self._window.dockWidgetArea(dock)
        in_front = not dock.visibleRegion().isEmpty()
        return in_front and not dock.isFloating() and area is Qt.DockWidgetArea.RightDockWidgetArea

    def reset(self) -> None:
        """All docks where they were at first."""
        window, docks = self._window, list(self._by_title.values())
        first, size = docks[0], window.size()
        for dock in docks:
            dock.setFloating(False)
            window.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, dock)
            if dock is not first:
                window.tabifyDockWidget(first, dock)
            dock.show()
        window.resize(size)
        window.resizeDocks([first], [int(window.width() * PART)], Qt.Orientation.Horizontal)
        first.raise_()
        self._share, self._width = PART, 0


def _appear(plots: list[pg.PlotWidget], turns: StaggeredPainter, visible: bool) -> None:
    """Paint a page's plots one after another: all at once they would hold the live picture up."""
    if visible:
        turns.hold(plots)

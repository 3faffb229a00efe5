"""The docks that pages live in: there from the beginning, filled when their pages are made."""

from functools import partial

import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QFrame, QMainWindow, QScrollArea, QTabWidget, QWidget

from ui.window.turns import Turns

TITLES = ("Sequence", "Fit", "Doser", "Projector", "Runs", "Calibration", "Log")
PART = 0.54
"""Of the window's width, at first."""


class Docks:
    """One dock for each title, in tabs on the right until a person moves them.

    Parameters
    ----------
    window
        Which they belong to.
    """

    def __init__(self, window: QMainWindow) -> None:
        self._window = window
        self._by_title: dict[str, QDockWidget] = {}
        self._by_page: dict[QWidget, QDockWidget] = {}
        window.setDockOptions(
            QMainWindow.DockOption.AllowTabbedDocks
            | QMainWindow.DockOption.AnimatedDocks
            | QMainWindow.DockOption.AllowNestedDocks
        )
        window.setTabPosition(Qt.DockWidgetArea.RightDockWidgetArea, QTabWidget.TabPosition.North)
        for title in TITLES:
            dock, area = QDockWidget(title), QScrollArea()  # small screens scroll
            area.setWidgetResizable(True)
            area.setFrameShape(QFrame.Shape.NoFrame)
            dock.setObjectName(title)
            dock.setWidget(area)
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
        self._by_page[page] = dock
        dock.visibilityChanged.connect(partial(_appear, page.findChildren(pg.PlotWidget), Turns(page)))

    def show(self, page: QWidget) -> None:
        """Bring a page to the front."""
        self._by_page[page].show()
        self._by_page[page].raise_()

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


def _appear(plots: list[pg.PlotWidget], turns: Turns, visible: bool) -> None:
    """Paint a page's plots one after another: all at once they would hold the live picture up."""
    if visible:
        for plot in plots:
            plot.setUpdatesEnabled(False)
        turns.take([partial(plot.setUpdatesEnabled, True) for plot in plots])

"""Two small curves below the camera's picture: focus over time with its peak held, and counts along a line."""

import time
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QPointF, Signal
from PySide6.QtWidgets import QGraphicsItem

from ui.window.tank_plot import TankPlot, pen

if TYPE_CHECKING:
    from tankrig.devices import Pixels

HEIGHT_PX = 92
SHOWN_S = 60.0
MOST = 2000


class FocusCurve(QObject):
    """Sharpness over the last minute, and the best that was reached since the curve was begun; `widget` is the plot."""

    def __init__(self) -> None:
        super().__init__()
        self.widget = _plot("seconds ago", "focus")
        plot = self.widget.getPlotItem()
        self._curve = plot.plot(pen=pg.mkPen("#4c9fe8", width=2))
        self._line = pg.InfiniteLine(angle=0, pen=pen("#e8833a", 1.5, dashed=True))
        plot.addItem(self._line)
        plot.setXRange(-SHOWN_S, 0.0, padding=0)
        self._values: deque[tuple[float, float]] = deque(maxlen=MOST)
        self.best = 0.0
        self.widget.hide()

    def begin(self) -> None:
        """Forget what was seen: another lens, another place, another exposure."""
        self._values.clear()
        self.best = 0.0
        self._curve.setData([], [])

    def add(self, focus: float) -> None:
        """The next value; drawn while the curve is shown."""
        now = time.monotonic()
        self._values.append((now, focus))
        self.best = max(self.best, focus)
        if not self.widget.isVisible():
            return
        at, values = np.array(self._values).T
        recent = at > now - SHOWN_S
        self._curve.setData(at[recent] - now, values[recent])
        self._line.setValue(self.best)
        self.widget.getPlotItem().setYRange(0.0, 1.1 * self.best or 1.0, padding=0)


class LineProfile(QObject):
    """Counts along a line that a person draws on the picture; `widget` is the plot.

    Parameters
    ----------
    picture
        On which the line lies.
    """

    moved = Signal()

    def __init__(self, picture: TankPlot) -> None:
        super().__init__()
        self._picture = picture
        self.widget = _plot("mm along the line", "counts")
        self._curve = self.widget.getPlotItem().plot(pen=pg.mkPen("#58c08a", width=2))
        self._line = pg.LineSegmentROI([(20.0, 0.0), (200.0, 0.0)], pen=pen("#58c08a", 2.0))
        self._line.hide()
        picture.plot.addItem(self._line)
        self._line.sigRegionChanged.connect(self.moved)
        self.widget.hide()

    def show(self, shown: bool) -> None:
        """Whether line and curve are there."""
        self.widget.setVisible(shown)
        self._line.setVisible(shown)
        self.moved.emit()

    @property
    def shown(self) -> bool:
        """Whether the line is there."""
        return bool(self._line.isVisible())

    @property
    def ends_mm(self) -> NDArray[np.float64]:
        """(2, 2) x and y of its beginning and of its end."""
        ends = [self._line.mapToParent(QPointF(handle["pos"])) for handle in self._line.handles]
        return np.array([[one.x(), one.y()] for one in ends])

    def move(self, ends_mm: NDArray[np.float64]) -> None:
        """Put the line from one place to another."""
        for number, end in enumerate(ends_mm.tolist()):
            self._line.movePoint(self._line.handles[number]["item"], QPointF(*end), coords="parent")

    def draw(self, pixels: "Pixels | None") -> None:
        """Of this picture, while the curve is shown."""
        if not self.widget.isVisible():
            return
        if pixels is None:
            self._curve.setData([], [])
            return
        start, end = self.ends_mm
        at, counts = along(pixels, self._picture, start, end)
        self._curve.setData(at, counts)


def along(
    pixels: "Pixels", picture: TankPlot, start_mm: NDArray[np.float64], end_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Millimetres along a line, and the counts of the nearest pixels; what lies beside the picture is left out."""
    from_row, from_column = picture.pixel_at(*start_mm.tolist())
    to_row, to_column = picture.pixel_at(*end_mm.tolist())
    count = int(min(MOST, max(2.0, np.hypot(to_row - from_row, to_column - from_column) + 1)))
    rows = np.floor(np.linspace(from_row, to_row, count)).astype(int)
    columns = np.floor(np.linspace(from_column, to_column, count)).astype(int)
    inside = (rows >= 0) & (rows < pixels.shape[0]) & (columns >= 0) & (columns < pixels.shape[1])
    length_mm = float(np.hypot(*(end_mm - start_mm)))
    at = np.linspace(0.0, length_mm, count)[inside]
    return at, pixels[rows[inside], columns[inside]].astype(float)


def _plot(bottom: str, left: str) -> pg.PlotWidget:
    widget = pg.PlotWidget(enableMenu=False)
    widget.setFixedHeight(HEIGHT_PX)
    plot = widget.getPlotItem()
    plot.hideButtons()
    plot.setMouseEnabled(False, False)
    plot.setLabel("bottom", bottom)
    plot.setLabel("left", left)
    for side in ("left", "bottom"):
        plot.getAxis(side).enableAutoSIPrefix(False)
        plot.getAxis(side).setTickDensity(0.5)  # numbers have little room
        plot.getAxis(side).setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)
    return widget

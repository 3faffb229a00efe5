"""How often each count occurs in a picture, the colours that counts have, and two edges to drag: the colours' ends."""

import math

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QObject, QRectF, Signal
from PySide6.QtWidgets import QGraphicsItem

from ui.window.tone import Tone

BINS = 256
SEEN = 0.002
"""Share of the axis: a smaller move of the colours' ends is not seen."""
BAR = (-0.34, -0.08)
"""Where the colour bar lies below the histogram, whose highest bar is 1."""


class Histogram(QObject):
    """A plot of a picture's counts above its colour bar; `widget` goes into a layout.

    pyqtgraph's own `HistogramLUTItem` imports matplotlib, 0.45 s before the first picture, and paints three times as
    long.
    """

    levels_moved = Signal(float, float)
    """Counts at the dark and at the bright end, when a person has moved one."""

    def __init__(self) -> None:
        super().__init__()
        self.widget = pg.PlotWidget(enableMenu=False)
        self.widget.setFixedHeight(98)
        plot = self.widget.getPlotItem()
        plot.hideAxis("left")
        plot.hideButtons()
        plot.setMouseEnabled(False, False)
        plot.setYRange(BAR[0], 1.0, padding=0.02)  # a view that follows the highest bar is laid out anew every time
        plot.getAxis("bottom").enableAutoSIPrefix(False)
        plot.getAxis("bottom").setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)
        plot.setLabel("bottom", "counts")
        self._plot = plot
        self._curve = plot.plot(stepMode="center", fillLevel=0.0, brush=(127, 127, 127, 110), pen=None)
        self._bar = pg.ImageItem(axisOrder="row-major")
        plot.addItem(self._bar)
        self._region = pg.LinearRegionItem(brush=(76, 159, 232, 40))
        self._region.setZValue(10)
        plot.addItem(self._region)
        self._full = pg.InfiniteLine(angle=90, pen=pg.mkPen("#00b8d4", width=2))
        plot.addItem(self._full)
        self._region.sigRegionChangeFinished.connect(self._moved)
        self._silent = False
        self._range = (0.0, 0)
        self._coloured: Tone | None = None

        self.clear()

    def clear(self) -> None:
        """Show no counts, and no axis, which would count nothing."""
        self._curve.setData([0.0, 1.0], [0.0])
        self._show(False)

    def _show(self, shown: bool) -> None:
        if self._bar.isVisible() != shown:
            for item in (self._bar, self._region, self._full):
                item.setVisible(shown)
            self._plot.showAxis("bottom", shown)

    def show_counts(self, often: NDArray[np.intp], saturation: int, tone: Tone) -> None:
        """Show how often each count occurs, where the camera saturates, and the colours that are in use."""
        most = min(_rounded_up(max(1.05 * len(often), 1.05 * tone.high, 50.0)), 1.02 * saturation)
        width = max(1, math.ceil(most / BINS))
        counts = np.add.reduceat(often, np.arange(0, len(often), width))
        self._silent = True
        self._show(True)
        heights = np.log1p(counts)
        self._curve.setData(width * np.arange(len(counts) + 1), heights / max(float(heights.max()), 1.0))
        if (most, saturation) != self._range:
            self._range = most, saturation
            self._plot.setXRange(0.0, most, padding=0.01)
            self._full.setValue(saturation)
        ends = tone.low, min(tone.high, most)
        if max(abs(old - new) for old, new in zip(self._region.getRegion(), ends, strict=True)) > SEEN * most:
            self._region.setRegion(ends)
        self._draw_bar(tone)
        self._silent = False

    def _draw_bar(self, tone: Tone) -> None:
        if tone == self._coloured:
            return
        self._coloured = tone
        self._bar.setImage(tone.bar(), autoLevels=False, levels=(0, 255))
        self._bar.setRect(QRectF(tone.low, BAR[0], tone.high - tone.low, BAR[1] - BAR[0]))

    def _moved(self) -> None:
        if not self._silent:
            low, high = self._region.getRegion()
            self.levels_moved.emit(float(low), float(high))


def _rounded_up(value: float) -> float:
    """To one of a few round numbers, so that the axis stays as it is while the picture flickers.

    >>> _rounded_up(51.0), _rounded_up(1999.0), _rounded_up(60000.0)
    (70.0, 2000.0, 70000.0)
    """
    ten = 10.0 ** math.floor(math.log10(value))
    return ten * next(step for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if step * ten >= value)

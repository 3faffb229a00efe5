"""How often each count occurs in a picture, with two edges to drag: the ends of the colours."""

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QObject, Signal

from ui.window.tone import Tone

BINS = 256


class Histogram(QObject):
    """A plot of a picture's counts; `widget` goes into a layout."""

    levels_moved = Signal(float, float)
    """Counts at the dark and at the bright end, when a person has moved one."""

    def __init__(self) -> None:
        super().__init__()
        self.widget = pg.PlotWidget()
        self.widget.setFixedHeight(84)
        plot = self.widget.getPlotItem()
        plot.hideAxis("left")
        plot.hideButtons()
        plot.setMenuEnabled(False)
        plot.setMouseEnabled(False, False)
        plot.getAxis("bottom").enableAutoSIPrefix(False)
        plot.setLabel("bottom", "counts")
        self._plot = plot
        self._curve = plot.plot(stepMode="center", fillLevel=0.0, brush=(127, 127, 127, 110), pen=None)
        self._region = pg.LinearRegionItem(brush=(76, 159, 232, 40))
        self._region.setZValue(10)
        plot.addItem(self._region)
        self._full = pg.InfiniteLine(angle=90, pen=pg.mkPen("#00b8d4", width=2))
        plot.addItem(self._full)
        self._region.sigRegionChangeFinished.connect(self._moved)
        self._silent = False

    def show_counts(self, pixels: NDArray[np.unsignedinteger], saturation: int, tone: Tone) -> None:
        """Show a picture's counts, where it saturates, and the ends that are in use."""
        sample = pixels[::4, ::4] if pixels.size > 100_000 else pixels
        most = float(max(int(sample.max()) * 1.05, tone.high * 1.05, 50.0))
        most = min(most, saturation * 1.02)
        number, edges = np.histogram(sample, BINS, (0.0, most))
        self._silent = True
        self._curve.setData(edges, np.log1p(number))
        self._plot.setXRange(0.0, most, padding=0.01)
        self._region.setRegion((tone.low, min(tone.high, most)))
        self._full.setValue(saturation)
        self._silent = False

    def _moved(self) -> None:
        if not self._silent:
            low, high = self._region.getRegion()
            self.levels_moved.emit(float(low), float(high))

"""A pattern as the projector shows it: seen from the projector, y across and z up, in mm."""

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QRectF
from PySide6.QtWidgets import QSizePolicy

from tankrig.pattern import Pattern
from tankrig.pattern.wall import Wall

GREYS = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)


class PatternPreview:
    """A small picture of a pattern on the wall x = 0; `widget` goes into a layout."""

    def __init__(self, height: int = 190) -> None:
        self.widget = pg.PlotWidget(enableMenu=False)
        self.widget.setMinimumHeight(height)
        self.widget.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        self._plot = self.widget.getPlotItem()
        self._plot.setAspectLocked(True)
        self._plot.hideButtons()
        self._plot.setMouseEnabled(False, False)
        self._plot.setLabel("bottom", "y on the wall (mm)")
        self._plot.setLabel("left", "z (mm)")
        for name in ("bottom", "left"):
            self._plot.getAxis(name).enableAutoSIPrefix(False)
            self._plot.showAxis(name, False)  # before there is a wall there is nothing to measure
        self._image = pg.ImageItem(axisOrder="row-major")
        self._plot.addItem(self._image)
        self._empty = pg.TextItem("", anchor=(0.5, 0.5))
        self._plot.addItem(self._empty)

    def show(self, pattern: Pattern | None, wall: Wall) -> None:
        """Show a pattern, or that there is none."""
        pixels = np.zeros((2, 2), np.uint8) if pattern is None else pattern.pixels
        self._image.setImage(np.ascontiguousarray(pixels[::-1]), autoLevels=False, levels=None, lut=GREYS)
        for name in ("bottom", "left"):
            self._plot.showAxis(name)
        low, high = sorted(wall.y_mm)
        rect = QRectF(low, wall.z_mm[0], high - low, wall.z_mm[1] - wall.z_mm[0])
        self._image.setRect(rect)
        self._plot.setRange(rect, padding=0.02)
        self._empty.setText("no pattern" if pattern is None else "")
        self._empty.setPos(rect.center().x(), rect.center().y())

"""One picture of the tank on axes in mm: x to the right, away from the projector, y up."""

from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QRectF, Qt
from PySide6.QtWidgets import QSizePolicy

from tankrig.scene.description import Camera, Tank


class TankPlot:
    """A plot that shows pictures of the tank; `widget` goes into a layout.

    Parameters
    ----------
    title
        Above the picture.
    axes
        Whether to draw axes.
    """

    def __init__(self, title: str = "", axes: bool = True) -> None:
        self.widget = pg.PlotWidget()
        self.widget.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)  # what room there is
        self.plot = self.widget.getPlotItem()
        self.plot.setAspectLocked(True)
        self.plot.hideButtons()
        self.plot.setMenuEnabled(False)
        self._title = ""
        self.name(title)
        if axes:
            self.plot.setLabel("bottom", "x from the lit wall (mm)")
            self.plot.setLabel("left", "y (mm)")
        else:
            self.plot.hideAxis("bottom")
            self.plot.hideAxis("left")
        for name in ("bottom", "left"):
            self.plot.getAxis(name).enableAutoSIPrefix(False)
        self.image = pg.ImageItem()
        self.plot.addItem(self.image)
        self._place: tuple[Any, ...] = ()

    def show_indices(self, indices: NDArray[np.uint8], palette: NDArray[np.uint8]) -> None:
        """Show (rows, columns) indices into a (256, 3) palette."""
        self.image.setImage(indices, autoLevels=False, levels=None, lut=palette)

    def place(self, tank: Tank, camera: Camera) -> None:
        """Say where the picture lies; the view is moved only when that has changed."""
        if self._place == (tank, camera):
            return
        self._place = (tank, camera)
        rows, columns = camera.shape
        rect = QRectF(0.0, -tank.size_mm[1] / 2, columns * camera.pixel_mm, rows * camera.pixel_mm)
        self.image.setRect(rect)
        self.plot.setRange(rect, padding=0.02)

    def name(self, title: str) -> None:
        """Say above the picture what it is."""
        if title != self._title:
            self._title = title
            self.plot.setTitle(title)

    def fit(self) -> None:
        """Show the whole picture again."""
        self.plot.setRange(self.image.mapRectToParent(self.image.boundingRect()), padding=0.02)


def pen(colour: str, width: float = 1.5, dashed: bool = False) -> Any:
    """A pen that keeps its width on screen."""
    return pg.mkPen(colour, width=width, style=Qt.PenStyle.DashLine if dashed else Qt.PenStyle.SolidLine)

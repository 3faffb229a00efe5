"""One picture of the tank on axes in mm: x to the right, away from the projector, y up."""

from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QImage, QPolygonF, QTransform
from PySide6.QtWidgets import QGraphicsItem, QSizePolicy

from tankrig.scene.description import Camera, Tank
from tankrig.scene.footprint import picture_corners_mm


class IndexedImage(pg.ImageItem):  # type: ignore[misc]
    """An image item of indices into a palette: what pyqtgraph looks into anew for every picture is known here."""

    def __init__(self) -> None:
        super().__init__(axisOrder="row-major")
        self._palette: NDArray[np.uint8] | None = None
        self._colours: list[int] = []

    def show_indices(self, indices: NDArray[np.uint8], palette: NDArray[np.uint8]) -> None:
        """Show (rows, columns) indices into (256, 3) colours."""
        if palette is not self._palette:
            red, green, blue = palette.astype(np.uint32).T
            self._palette, self._colours = palette, (0xFF000000 | red << 16 | green << 8 | blue).tolist()
        self.setImage(np.ascontiguousarray(indices), autoLevels=False)

    def render(self) -> None:
        """The picture as Qt has it; called by `paint`."""
        rows, columns = self.image.shape
        self._kept = self.image  # as long as Qt reads from it
        self.qimage = QImage(self._kept.data, columns, rows, columns, QImage.Format.Format_Indexed8)
        self.qimage.setColorTable(self._colours)
        self._renderRequired = self._unrenderable = False


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
        self.widget = pg.PlotWidget(enableMenu=False)
        self.widget.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)  # what room there is
        self.plot = self.widget.getPlotItem()
        self.plot.setAspectLocked(True)
        self.plot.hideButtons()
        self._title, self._axes = "", axes
        self.name(title)
        if axes:
            self.plot.setLabel("bottom", "x from the lit wall (mm)")
            self.plot.setLabel("left", "y (mm)")
        else:
            self.plot.hideAxis("bottom")
            self.plot.hideAxis("left")
        for name in ("bottom", "left"):
            axis = self.plot.getAxis(name)
            axis.enableAutoSIPrefix(False)
            axis.setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)
        self.image = IndexedImage()
        self.plot.addItem(self.image)
        self._show_axes(False)
        self._place: tuple[Any, ...] = (None, None)
        self._to_pixels = QTransform()

    def show_indices(self, indices: NDArray[np.uint8], palette: NDArray[np.uint8]) -> None:
        """Show (rows, columns) indices into a (256, 3) palette."""
        self.image.show_indices(indices, palette)
        if not self.image.isVisible():
            self._show_axes(True)

    def clear(self) -> None:
        """Show nothing: no picture, and no axes, which would measure nothing."""
        self._show_axes(False)
        self.name("")

    @property
    def empty(self) -> bool:
        """Whether no picture is shown."""
        return not self.image.isVisible()

    def _show_axes(self, shown: bool) -> None:
        self.image.setVisible(shown)
        if self._axes:
            self.plot.showAxis("bottom", shown)
            self.plot.showAxis("left", shown)

    def place(self, tank: Tank, camera: Camera) -> None:
        """Say where the picture lies, whole or thinned; the view is moved only when that has changed."""
        place, shape = (tank, camera), self.image.image.shape
        if (place, shape) == self._place:
            return
        moved, self._place = self._place[0] != place, (place, shape)
        corners = picture_corners_mm(camera, tank)
        self._to_pixels, _ = pixels_to_mm(camera, tank).inverted()
        self.image.setTransform(_projective(_ends(shape), corners.tolist()))
        if moved:
            (left, low), (right, high) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
            self.plot.setRange(QRectF(left, low, right - left, high - low), padding=0.02)

    def pixel_at(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """(row, column) of the camera's picture that shows a place of the water; whole numbers are pixels' edges."""
        at = self._to_pixels.map(QPointF(x_mm, y_mm))
        return float(at.y()), float(at.x())

    @property
    def dot_mm(self) -> float:
        """Side of a pixel of the screen."""
        return float(self.plot.getViewBox().viewPixelSize()[0] / self.widget.devicePixelRatioF())

    def name(self, title: str) -> None:
        """Say above the picture what it is."""
        if title != self._title:
            self._title = title
            self.plot.setTitle(title)

    def fit(self) -> None:
        """Show the whole picture again."""
        self.plot.setRange(self.image.mapRectToParent(self.image.boundingRect()), padding=0.02)


def pixels_to_mm(camera: Camera, tank: Tank) -> QTransform:
    """From (column, row) of a camera's picture, whole numbers being pixels' edges, to x and y on the water in mm."""
    return _projective(_ends(camera.shape), picture_corners_mm(camera, tank).tolist())


def _ends(shape: tuple[int, ...]) -> list[Any]:
    """The corners of a picture as (column, row), in the order of `picture_corners_mm`."""
    rows, columns = shape
    return [(0, 0), (columns, 0), (columns, rows), (0, rows)]


def _projective(here: list[Any], there: list[Any]) -> QTransform:
    """That takes four points to four others."""
    one, other = (QPolygonF([QPointF(*point) for point in points]) for points in (here, there))
    found = QTransform()
    QTransform.quadToQuad(one, other, found)
    return found


def pen(colour: str, width: float = 1.5, dashed: bool = False) -> Any:
    """A pen that keeps its width on screen."""
    return pg.mkPen(colour, width=width, style=Qt.PenStyle.DashLine if dashed else Qt.PenStyle.SolidLine)

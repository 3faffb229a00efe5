"""Rectangles that a person has drawn on the picture, each with a name and a colour of its own."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QObject, QPointF, QRectF, Signal

from tankrig.run.regions import Region
from tankrig.scene.description import Camera, Tank
from ui.window.tank_plot import TankPlot, pen, pixels_to_mm
from ui.window.theme import CURVES

FIRST_MM = QRectF(60.0, -20.0, 60.0, 40.0)
"""Where the first region is put; others a little beside it."""
BESIDE_MM = 8.0


@dataclass(eq=False)
class DrawnRegion:
    """One rectangle on the picture.

    Parameters
    ----------
    name
        Which no other region has.
    colour
        Of its outline, its curve and its row.
    roi, label
        As they are drawn.
    """

    name: str
    colour: str
    roi: Any
    label: Any

    @property
    def rect_mm(self) -> QRectF:
        """Where it lies on the water."""
        at, size = self.roi.pos(), self.roi.size()
        return QRectF(at.x(), at.y(), size.x(), size.y())

    def move(self, rect_mm: QRectF) -> None:
        """Put it there."""
        self.roi.setPos(rect_mm.x(), rect_mm.y(), update=False)
        self.roi.setSize((rect_mm.width(), rect_mm.height()))


class PictureRegions(QObject):
    """The regions on one picture.

    Parameters
    ----------
    picture
        On which they lie.
    """

    moved = Signal()
    """One of them has another place or size."""
    listed = Signal()
    """One has come, or gone, or has another name."""

    def __init__(self, picture: TankPlot) -> None:
        super().__init__()
        self._picture = picture
        self.drawn: list[DrawnRegion] = []

    def add(self, rect_mm: QRectF | None = None, name: str = "") -> DrawnRegion:
        """Draw one more."""
        count = len(self.drawn)
        rect = rect_mm or FIRST_MM.translated(BESIDE_MM * (count % 8), BESIDE_MM * (count % 8))
        taken = {one.name for one in self.drawn}
        free = next(word for number in range(1, count + 2) if (word := f"region {number}") not in taken)
        unused = [colour for colour in CURVES if colour not in {one.colour for one in self.drawn}]
        colour = unused[0] if unused else CURVES[count % len(CURVES)]
        roi = pg.RectROI((rect.x(), rect.y()), (rect.width(), rect.height()), pen=pen(colour, 2.0), removable=True)
        label = pg.TextItem("", color=colour, anchor=(0.0, 0.0))
        one = DrawnRegion(name if name and name not in taken else free, colour, roi, label)
        self.drawn.append(one)
        self._picture.plot.addItem(roi)
        self._picture.plot.addItem(label)
        roi.sigRegionChanged.connect(lambda: self._place(one))
        roi.sigRemoveRequested.connect(lambda: self.remove(one))
        self._place(one)
        self.listed.emit()
        return one

    def rename(self, one: DrawnRegion, name: str) -> bool:
        """Give a region another name; whether it has it, which needs that no other one does."""
        if not name.strip() or any(other.name == name and other is not one for other in self.drawn):
            return False
        one.name = name
        self._place(one)
        self.listed.emit()
        return True

    def remove(self, one: DrawnRegion) -> None:
        """Take one away."""
        if one in self.drawn:
            self.drawn.remove(one)
            for item in (one.roi, one.label):
                self._picture.plot.removeItem(item)
            self.listed.emit()

    def draw(self, regions: Sequence[tuple[str, QRectF]]) -> None:
        """Have these, by name and place in mm, instead of those that are there."""
        before = self.blockSignals(True)
        for one in list(self.drawn):
            self.remove(one)
        for name, rect_mm in regions:
            self.add(rect_mm, name)
        self.blockSignals(before)
        self.listed.emit()

    def replace(self, regions: Sequence[Region], camera: Camera, tank: Tank) -> None:
        """Have these, in pixels of a camera's picture, instead of those that are there."""
        to_mm = pixels_to_mm(camera, tank)
        found = []
        for region in regions:
            (top, bottom), (left, right) = region.rows, region.columns
            first, last = to_mm.map(QPointF(left, top)), to_mm.map(QPointF(right, bottom))
            found.append((region.name, QRectF(first, last).normalized()))
        self.draw(found)

    def in_pixels(self, camera: Camera, tank: Tank) -> tuple[Region, ...]:
        """Those that lie on the picture of a camera, in its pixels."""
        to_pixels, _ = pixels_to_mm(camera, tank).inverted()
        found = []
        for one in self.drawn:
            box = to_pixels.mapRect(one.rect_mm)
            rows, columns = (
                (int(np.clip(round(low), 0, most)), int(np.clip(round(high), 0, most)))
                for low, high, most in (
                    (box.top(), box.bottom(), camera.shape[0]), (box.left(), box.right(), camera.shape[1])
                )
            )  # fmt: skip
            if rows[1] > rows[0] and columns[1] > columns[0]:
                found.append(Region(one.name, rows, columns))
        return tuple(found)

    def _place(self, one: DrawnRegion) -> None:
        rect = one.rect_mm
        one.label.setText(one.name)
        one.label.setPos(rect.left(), rect.bottom())
        self.moved.emit()

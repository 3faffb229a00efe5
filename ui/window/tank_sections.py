"""The tank in three dimensions, as sheets at several heights show it: from the side, and from where the light goes."""

from collections.abc import Sequence

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QRectF

from tankrig.scene.description import Tank
from ui.window.flow import take_rest
from ui.window.tank_plot import IndexedImage

Indices = NDArray[np.uint8]

ROWS = 120
"""Of a section's picture, from the floor to the surface."""
LINE_PX = 2


class TankSection:
    """A vertical section of the tank: a band for each sheet, as high as half-way to its neighbours.

    Parameters
    ----------
    title
        Above it; a plot is at least as wide as its title.
    what
        It shows, as a tooltip.
    across
        Name of the axis below it, with its unit.
    """

    def __init__(self, title: str, what: str, across: str) -> None:
        self.widget = pg.PlotWidget(enableMenu=False)
        self.widget.setToolTip(f"order 1 through the tank, {what}; the line is at the sheet that is looked at")
        take_rest(self.widget, 120)
        self.plot = self.widget.getPlotItem()
        self.plot.setTitle(title, size="9pt")
        self.plot.hideButtons()
        self.plot.setLabel("bottom", across)
        self.plot.setLabel("left", "z (mm)")
        for name in ("bottom", "left"):
            self.plot.getAxis(name).enableAutoSIPrefix(False)
            self.plot.getAxis(name).setTickDensity(0.6)
        self.image = IndexedImage()
        self._here = pg.InfiniteLine(angle=0, pen=pg.mkPen("#ffffff", width=LINE_PX), movable=False)
        self.plot.addItem(self.image)
        self.plot.addItem(self._here)
        self._place: QRectF | None = None

    def show_bands(
        self, heights_mm: Sequence[float], bands: Indices, left_mm: float, right_mm: float, tank: Tank, palette: Indices
    ) -> None:
        """Show (heights, cells) indices into a palette, of cells between two places along the axis below.

        The palette's last colour stands where there is no sheet.
        """
        rows = nearest_rows(heights_mm, tank.size_mm[2], ROWS)
        self.image.show_indices(np.where(rows[:, None] >= 0, bands[rows], np.uint8(255)), palette)
        place = QRectF(left_mm, 0.0, right_mm - left_mm, tank.size_mm[2])
        self.image.setRect(place)
        if place != self._place:
            self._place = place
            self.plot.setRange(place, padding=0.02)

    def mark(self, height_mm: float) -> None:
        """Draw a line at a height."""
        self._here.setValue(height_mm)


def nearest_rows(heights_mm: Sequence[float], top_mm: float, rows: int) -> NDArray[np.intp]:
    """For each row of a section, the sheet nearest to it; −1 further from the ends than half-way between neighbours.

    Parameters
    ----------
    heights_mm
        Of the sheets, rising.
    top_mm
        Of the water; row 0 begins at the floor.
    rows
        How many.

    Examples
    --------
    >>> nearest_rows([30.0, 60.0, 90.0], 120.0, 8).tolist()
    [-1, 0, 0, 1, 1, 2, 2, -1]
    """
    at = np.asarray(heights_mm, float)
    z = (np.arange(rows) + 0.5) * top_mm / rows
    nearest = np.abs(z[:, None] - at[None]).argmin(axis=1)
    half = 0.5 * (float(np.diff(at).min()) if len(at) > 1 else top_mm / rows * 4)
    outside = (z < at[0] - half) | (z > at[-1] + half)
    return np.where(outside, -1, nearest)

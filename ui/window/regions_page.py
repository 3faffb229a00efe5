"""Regions of the picture: where they lie, what is counted in them now, and over a whole run."""

import math
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pyqtgraph as pg
from pyqtgraph.parametertree import Parameter
from PySide6.QtCore import QRectF, Qt, Signal
from PySide6.QtGui import QColor, QGuiApplication
from PySide6.QtWidgets import QComboBox, QLabel, QPushButton, QSplitter, QVBoxLayout, QWidget

from tankrig.run.regions import COLUMNS, REGIONS, Counted
from ui.window.fields import with_name
from ui.window.flow import Flow, take_rest
from ui.window.frame_renderer import RegionNow
from ui.window.live_curves import LineProfile
from ui.window.on_screen import OnScreen
from ui.window.parameter_tree import parameter_tree
from ui.window.picture_regions import DrawnRegion, PictureRegions
from ui.window.shown import Shown
from ui.window.source import Kind

EMPTY = (
    "Press “Add region” and drag the rectangle on the picture: mean and standard deviation of its counts will stand "
    "here over time. Of a run they are counted in all frames and saved with it."
)
ALL = "all patterns"
SIDES = ("x", "y", "width", "height")
SHOWN_S = 60.0
KEPT = 400
LEAST_MM = 0.01


class RegionsPage(QWidget):
    """Draws the regions of one picture as a tree of numbers, and their means as curves.

    Parameters
    ----------
    regions, line
        On the picture.
    on_screen
        What the window looks at: counts of a run belong to its source.
    """

    told = Signal(str)

    def __init__(self, regions: PictureRegions, line: LineProfile, on_screen: OnScreen) -> None:
        super().__init__()
        self._regions, self._line, self._on_screen = regions, line, on_screen
        self._shown: Shown | None = None
        self._rows: dict[DrawnRegion, Any] = {}
        self._now: dict[str, deque[tuple[float, float]]] = {}
        self._curves: dict[str, Any] = {}
        self._bench: Any = None
        self._set_aside: list[tuple[str, QRectF]] | None = None
        """Regions that a person had drawn before a run was opened that brought its own."""
        self._silent = False
        self._lay_out()
        regions.listed.connect(self._list)
        regions.moved.connect(self._follow_regions)
        line.moved.connect(self._follow_line)
        self._list()

    def show_source(self, shown: Shown) -> None:
        """Draw what was counted in this source from now on; regions that were saved with its run come with it."""
        if self._shown is not None:
            self._shown.counted_changed.disconnect(self._draw)
            self._shown.read.disconnect(self._take_saved)
        self._shown = shown
        shown.counted_changed.connect(self._draw)
        shown.read.connect(self._take_saved)
        self._now.clear()
        for row in self._rows.values():
            row.child("now").setValue("")
        if shown.source.kind is Kind.LIVE and self._set_aside is not None:
            self._regions.draw(self._set_aside)
            self._set_aside = None
        self._draw()

    def take(self, counted: Sequence[RegionNow]) -> None:
        """What is counted in the picture that is on screen."""
        now = time.monotonic()
        for one in counted:
            self._now.setdefault(one.region.name, deque(maxlen=KEPT)).append((now, one.mean))
        names = {one.name: one for one in self._regions.drawn}
        for one in counted:
            drawn = names.get(one.region.name)
            if drawn in self._rows:
                self._rows[drawn].child("now").setValue(f"{one.mean:.1f} counts, scatter {one.sd:.1f}")
        if self.isVisible() and not self._of_run:
            self._draw_now(now)

    def add(self) -> None:
        """Draw one more region."""
        one = self._regions.add()
        self._tree.setCurrentItem(next(iter(self._rows[one].items), None))

    def remove(self) -> None:
        """Take away the region whose row is chosen; the last one where none is."""
        drawn = self._regions.drawn
        chosen = self._tree.currentItem()
        rows = {item: one for one, row in self._rows.items() for item in row.items}
        while chosen is not None and chosen not in rows:
            chosen = chosen.parent()
        one = rows.get(chosen, drawn[-1] if drawn else None)
        if one is not None:
            self._regions.remove(one)

    def count(self) -> None:
        """Have the regions counted in all frames of the run on screen, and saved with it."""
        shown = self._shown
        reading = shown.reading if shown is not None else None
        if shown is None or shown.source.run is None:
            self.told.emit("there is no run on screen; open one, then count the regions in its frames")
        else:
            bench = reading.bench if reading is not None else self._bench
            if bench is not None:
                self._on_screen.count_regions(self._regions.in_pixels(bench.camera, bench.tank))

    def set_bench(self, bench: Any) -> None:
        """Where the pixels of the camera lie."""
        self._bench = bench

    # -- from the picture to the tree, and back ------------------------------------------------------------------------

    def _list(self) -> None:
        """A row for each region, and one for the line."""
        self._silent = True
        self._root.clearChildren()
        self._rows = {}
        for one in self._regions.drawn:
            row = Parameter.create(name=one.name, type="group", renamable=True, removable=True, children=[
                *({"name": side, "type": "float", "suffix": " mm", "decimals": 6} for side in SIDES),
                {"name": "now", "type": "str", "value": "", "readonly": True},
            ])  # fmt: skip
            self._root.addChild(row, autoIncrementName=True)
            self._rows[one] = row
            for item in row.items:
                item.setData(0, Qt.ItemDataRole.DecorationRole, QColor(one.colour))  # as text it would be too faint
            row.sigNameChanged.connect(partial(self._rename, one))
            row.sigRemoved.connect(lambda _, one=one: self._regions.remove(one))
            for side in SIDES:
                row.child(side).sigValueChanged.connect(partial(self._move, one))
        ends = ("from x", "from y", "to x", "to y")
        self._ends = Parameter.create(
            name="line (tick “line” beside the picture)", type="group",
            children=[{"name": name, "type": "float", "suffix": " mm", "decimals": 6} for name in ends],
        )  # fmt: skip
        self._root.addChild(self._ends)
        for name in ends:
            self._ends.child(name).sigValueChanged.connect(self._move_line)
        self._silent = False
        self._follow_regions()
        self._follow_line()
        self._now = {name: now for name, now in self._now.items() if name in {one.name for one in self._regions.drawn}}
        self._draw()

    def _follow_regions(self) -> None:
        if self._silent:
            return
        self._silent = True
        for one, row in self._rows.items():
            rect = one.rect_mm
            values = (rect.x(), rect.y(), rect.width(), rect.height())
            for side, value in zip(SIDES, values, strict=True):
                row.child(side).setValue(round(value, 3))
        self._silent = False

    def _follow_line(self) -> None:
        if self._silent:
            return
        self._silent = True
        self._ends.show(self._line.shown)
        for child, value in zip(self._ends.children(), self._line.ends_mm.ravel().tolist(), strict=True):
            child.setValue(round(value, 3))
        self._silent = False

    def _move(self, one: DrawnRegion, *_: object) -> None:
        if self._silent:
            return
        x, y, width, height = (float(self._rows[one].child(side).value()) for side in SIDES)
        self._silent = True
        one.move(QRectF(x, y, max(width, LEAST_MM), max(height, LEAST_MM)))
        self._silent = False

    def _move_line(self, *_: object) -> None:
        if self._silent:
            return
        self._silent = True
        self._line.move(np.array([child.value() for child in self._ends.children()]).reshape(2, 2))
        self._silent = False

    def _rename(self, one: DrawnRegion, row: Any, name: str) -> None:
        if not self._silent and name != one.name and not self._regions.rename(one, name):
            row.setName(one.name)

    def _take_saved(self) -> None:
        shown = self._shown
        reading = shown.reading if shown is not None else None
        saved = tuple(dict.fromkeys(one.region for one in shown.counted)) if shown is not None else ()
        if reading is not None and saved:
            if self._set_aside is None:
                self._set_aside = [(one.name, one.rect_mm) for one in self._regions.drawn]
            self._regions.replace(saved, reading.bench.camera, reading.bench.tank)

    # -- curves --------------------------------------------------------------------------------------------------------

    @property
    def _of_run(self) -> bool:
        return self._shown is not None and bool(self._shown.counted)

    def _draw(self) -> None:
        """What was counted in a whole run; else what is counted now."""
        shown, plot = self._shown, self._plot.getPlotItem()
        counted = shown.counted if shown is not None else ()
        self._remove.setEnabled(bool(self._regions.drawn))
        self._save.setEnabled(bool(self._regions.drawn) and shown is not None and shown.source.run is not None)
        self._copy.setEnabled(bool(counted))
        self._plot.setVisible(bool(self._regions.drawn) or bool(counted))
        patterns = [ALL, *dict.fromkeys(one.pattern for one in counted)]
        if [self._pattern.itemText(row) for row in range(self._pattern.count())] != patterns:
            self._pattern.clear()
            self._pattern.addItems(patterns)
        self._pattern.setEnabled(bool(counted))
        plot.clear()
        self._curves = {}
        if not counted:
            self._says.setText(EMPTY if not self._regions.drawn else "What is counted now, over the last minute.")
            plot.setLabel("bottom", "seconds ago")
            self._draw_now(time.monotonic())
            return
        plot.setLabel("bottom", "time in the run (s)")
        plot.enableAutoRange()
        colours = {one.name: one.colour for one in self._regions.drawn}
        name = self._pattern.currentText()
        chosen = [one for one in counted if name in (ALL, one.pattern)]
        for region in dict.fromkeys(one.region for one in chosen):
            here = [one for one in chosen if one.region == region]
            colour = colours.get(region.name, "#888888")
            at, means = np.array([(one.time_s, one.mean) for one in here]).T
            sd = np.array([one.sd for one in here])
            plot.addItem(pg.ErrorBarItem(x=at, y=means, height=2.0 * sd, pen=pg.mkPen(colour, width=1)))
            plot.plot(at, means, pen=pg.mkPen(colour, width=1), symbol="o", symbolSize=6, symbolBrush=colour,
                      symbolPen=None)  # fmt: skip
        frames = len({one.frame for one in chosen})
        self._says.setText(
            f"Mean ± standard deviation of the counts in {frames} frames, saved with the run as {REGIONS}."
        )

    def _draw_now(self, now: float) -> None:
        plot = self._plot.getPlotItem()
        colours = {one.name: one.colour for one in self._regions.drawn}
        for name, values in self._now.items():
            if name not in colours:
                continue
            if name not in self._curves:
                self._curves[name] = plot.plot(pen=pg.mkPen(colours[name], width=2))
            at, means = np.array(values).T
            recent = at > now - SHOWN_S
            self._curves[name].setData(at[recent] - now, means[recent])
        plot.setXRange(-SHOWN_S, 0.0, padding=0)

    def _copy_table(self) -> None:
        shown = self._shown
        if shown is not None:
            QGuiApplication.clipboard().setText(table(shown.counted))

    def _lay_out(self) -> None:
        add, self._remove = QPushButton("Add region"), QPushButton("Remove region")
        self._save, self._copy, self._pattern = (
            QPushButton("Count in all frames"),
            QPushButton("Copy table"),
            QComboBox(),
        )
        add.setToolTip("one more rectangle on the picture")
        self._remove.setToolTip("take away the region whose row is chosen")
        self._save.setToolTip(f"count in every frame of the run on screen, and save that with the run ({REGIONS})")
        self._copy.setToolTip("a line for each region and frame, for a spreadsheet")
        for button, do in (
            (add, self.add),
            (self._remove, self.remove),
            (self._save, self.count),
            (self._copy, self._copy_table),
        ):
            button.clicked.connect(do)
        self._pattern.setMinimumWidth(110)
        self._pattern.activated.connect(lambda _: self._draw())
        self._root = Parameter.create(name="on the picture", type="group")
        self._tree = parameter_tree(self._root, show_top=False)
        self._tree.setAccessibleName("places of the regions, in mm on the water")
        self._plot = pg.PlotWidget(enableMenu=False)
        self._tree.setMinimumHeight(110)
        self._plot.setMinimumHeight(130)
        item = self._plot.getPlotItem()
        item.hideButtons()
        item.setLabel("left", "counts")
        item.showGrid(x=True, y=True, alpha=0.2)
        for side in ("left", "bottom"):
            item.getAxis(side).enableAutoSIPrefix(False)
        self._says = QLabel(EMPTY)
        self._says.setProperty("role", "faint")
        self._says.setWordWrap(True)
        split = QSplitter(Qt.Orientation.Vertical)
        split.addWidget(self._tree)
        split.addWidget(self._plot)
        split.setChildrenCollapsible(False)
        split.setSizes([220, 220])
        take_rest(split, 250)
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 8, 10, 8)
        column.addLayout(Flow(add, self._remove, self._save, self._copy, with_name("curves of", self._pattern)))
        column.addWidget(self._says)
        column.addWidget(split, 1)


def table(counted: Sequence[Counted]) -> str:
    """What was counted, as lines with tabs between; the first line names the columns.

    >>> from tankrig.run.regions import Region
    >>> table([Counted(Region("a", (0, 2), (0, 3)), 0, 1.5, "rays", 100.0, 20.0, 1.0, 7.25, 0.5, 7, 8)]).split()[-4:]
    ['7.25', '0.5', '7', '8']
    """
    lines = ["\t".join(COLUMNS)]
    for one in counted:
        numbers = (one.ink_ul, one.exposure_ms, one.gain, one.mean, one.sd)
        words = ("" if math.isnan(value) else f"{value:.8g}" for value in numbers)
        place = (*one.region.rows, *one.region.columns, one.frame)
        lines.append("\t".join((one.region.name, *map(str, place), f"{one.time_s:.3f}", one.pattern, *words,
                                str(one.smallest), str(one.largest))))  # fmt: skip
    return "\n".join(lines) + "\n"

"""Light sorted by waves: what follows them, what has forgotten them, order 1, sheet by sheet through the tank."""

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from tankrig.live.formatting import with_error
from ui.window.fields import with_name
from ui.window.flow import Flow
from ui.window.replay_bar import AxisSlider
from ui.window.result import CONFIDENCE, Z
from ui.window.separated import SeparatedSheet, SheetKey, WithSd
from ui.window.shown import Shown
from ui.window.staggered_painter import StaggeredPainter
from ui.window.tank_plot import TankPlot
from ui.window.tank_sections import TankSection
from ui.window.theme import set_role
from ui.window.tone import Tone

Image = NDArray[np.floating]
Indices = NDArray[np.uint8]

TOP = 60_000.0
"""Where the brightest pixel of the sheets lies on the scale of tones."""
UNTOLD = (112, 118, 126)
"""Colour of what cannot be told."""
NEWEST = "newest dose"
KEY = Qt.ItemDataRole.UserRole
EMPTY = (
    "Light that was scattered once, and light that has forgotten where it came from, will stand here apart, for a run "
    "with a step that separates them. It shows waves of light in thin sheets, so that no model of the liquid is needed."
)
LEGEND = (
    f"Under each period: the part of the sheet's light that follows a wave of it. ± {CONFIDENCE}. Grey in a picture: "
    "it cannot be told there."
)
WAITS = "The first sheet is separated when all its waves are recorded."


class SeparationPage(QWidget):
    """Draws the separated sheets of the source on screen, and keeps nothing of its own but which is looked at."""

    step_asked = Signal()
    """A step that separates is wanted in the sequence."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: Shown | None = None
        self._painter = StaggeredPainter(self)
        self._height_mm: float | None = None
        self._lay_out()

    def show_source(self, shown: Shown) -> None:
        """Draw this source from now on, and nothing of the one before."""
        if self._shown is not None:
            self._shown.separated_changed.disconnect(self._draw)
        self._shown, self._height_mm = shown, None
        shown.separated_changed.connect(self._draw)
        self._clear_pictures()
        self._draw()

    @property
    def sheet(self) -> SeparatedSheet | None:
        """The sheet that is looked at."""
        here = self._of_dose()
        if not here:
            return None
        heights = [one.key.height_mm for one in here]
        wanted = self.heights.chosen if self.heights.chosen in heights else heights[len(heights) // 2]
        return here[heights.index(wanted)]

    @property
    def says(self) -> str:
        """What is told in words."""
        return self._says.text()

    # -- what is shown -------------------------------------------------------------------------------------------------

    def _sheets(self) -> list[SeparatedSheet]:
        """All of the source, by dose and height."""
        found = self._shown.separated.values() if self._shown is not None else ()
        return sorted(found, key=lambda one: (one.key.dose_ml, one.key.height_mm))

    def _of_dose(self) -> list[SeparatedSheet]:
        """Those at the dose that is looked at, by height."""
        sheets, chosen = self._sheets(), self._dose.currentData()
        dose_ml = sheets[-1].key.dose_ml if chosen is None and sheets else chosen
        return [one for one in sheets if one.key.dose_ml == dose_ml]

    def _draw(self) -> None:
        sheets = self._sheets()
        self._inside.setVisible(bool(sheets))
        self._empty.setVisible(not sheets)
        self._list(sheets)
        self._fill_table(sheets)
        self._draw_sheet()

    def _list(self, sheets: list[SeparatedSheet]) -> None:
        """Doses, periods and heights to choose from; what was chosen stays chosen where it is still there."""
        doses = sorted({one.key.dose_ml for one in sheets})
        _offer(self._dose, [(NEWEST, None), *((f"{dose_ml:.4g} ml", dose_ml) for dose_ml in doses)])
        periods = sorted({period_mm for one in sheets for period_mm in one.modulated})
        _offer(self._period, [(f"{period_mm:g} mm", period_mm) for period_mm in periods])

    def _draw_sheet(self) -> None:
        here = self._of_dose()
        heights = [one.key.height_mm for one in here]
        self.heights.set_values(heights, lambda height_mm: f"{height_mm:g} mm")
        if heights:
            wanted = heights[len(heights) // 2] if self._height_mm not in heights else self._height_mm
            self.heights.choose(wanted)
        deep, sections = len(heights) > 1, (self._side.widget, self._end.widget)
        if deep and not self._sections.isVisibleTo(self):
            self._painter.hold(sections)
        self._sections.setVisible(deep)
        one = self.sheet
        self._tell(one)
        self._mark(one)
        if one is None:
            self._clear_pictures()
            return
        peak = max(float(sheet.sheet.max()) for sheet in here) or 1.0  # one scale for all heights of a dose
        calls = [*self._pictures(one, peak)]
        if len(here) > 1:
            calls.append(partial(self._draw_sections, here, one, peak))
        self._painter.take(calls)

    def _pictures(self, one: SeparatedSheet, peak: float) -> list[Callable[[], None]]:
        period_mm = self._period.currentData()
        if period_mm not in one.modulated:
            period_mm = next(iter(one.modulated))
        images = {
            "whole sheet": one.sheet,
            f"follows {period_mm:g} mm": one.modulated[period_mm],
            "has forgotten it": one.even[period_mm],
            "order 1" if one.order_1 is not None else "order 1: two waves": one.order_1,
        }

        def show(plot: TankPlot, title: str, indices: Indices | None) -> None:
            if indices is None:
                plot.clear()
            else:
                plot.show_indices(indices, palette())
                plot.place(one.tank, one.camera)
            plot.name(title)

        return [
            partial(show, plot, title, None if image is None else toned(image, peak))
            for plot, (title, image) in zip(self._plots, images.items(), strict=True)
        ]

    def _draw_sections(self, here: list[SeparatedSheet], one: SeparatedSheet, peak: float) -> None:
        """Order 1 through the tank: means over what lies along the line of sight of each section."""
        heights, tank = [sheet.key.height_mm for sheet in here], one.tank
        half = 0.5 * tank.size_mm[1]
        bands = (
            (self._side, np.stack([_mean(sheet.in_tank, 0) for sheet in here]), 0.0, tank.size_mm[0]),
            (self._end, np.stack([_mean(sheet.in_tank, 1) for sheet in here]), -half, half),
        )
        for section, means, left_mm, right_mm in bands:
            section.show_bands(heights, toned(means, peak), left_mm, right_mm, tank, palette())
            section.mark(one.key.height_mm)

    def _tell(self, one: SeparatedSheet | None) -> None:
        shown = self._shown
        waits = shown.separation_says if shown is not None else ""
        if one is None:
            words = waits or (WAITS if shown is not None and shown.awaits_sheets else "")
            self._wanting.setText(words or EMPTY)
            self._add.setVisible(not words)
            return
        head = f"{one.key.dose_ml:.4g} ml, sheet at z = {one.key.height_mm:g} mm"
        told = [*(f"{doubt}." for doubt in one.doubts), *([waits] if waits else [])]
        set_role(self._says, "wrong" if one.doubts else "faint")
        self._says.setText(f"{head}: " + (" ".join(told) or "nothing casts doubt on it."))

    def _fill_table(self, sheets: list[SeparatedSheet]) -> None:
        periods = sorted({period_mm for one in sheets for period_mm in one.follow})
        headings = heading_row(periods)
        self._table.setColumnCount(len(headings))
        self._table.setHorizontalHeaderLabels(headings)
        self._table.setRowCount(len(sheets))
        for row, one in enumerate(sheets):
            for column, text in enumerate(cells_of(one, periods)):
                item = QTableWidgetItem(text)
                item.setData(KEY, one.key)
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                item.setToolTip(" ".join(one.doubts) or headings[column])
                self._table.setItem(row, column, item)

    def _mark(self, one: SeparatedSheet | None) -> None:
        """The row of the sheet that is looked at is marked."""
        self._table.blockSignals(True)
        for row in range(self._table.rowCount()):
            item = self._table.item(row, 0)
            if one is not None and item is not None and item.data(KEY) == one.key:
                self._table.selectRow(row)
        self._table.blockSignals(False)

    def _clear_pictures(self) -> None:
        self._painter.take([])
        for plot in self._plots:
            plot.clear()

    # -- what a person does --------------------------------------------------------------------------------------------

    def look_at(self, key: SheetKey) -> None:
        """Look at one sheet."""
        row = self._dose.findData(key.dose_ml)
        if row >= 0:
            self._dose.setCurrentIndex(row)
        self._height_mm = key.height_mm
        self._draw_sheet()

    def _moved(self) -> None:
        """A person has moved the slider of heights."""
        self._height_mm = self.heights.chosen
        self.heights.say()
        self._draw_sheet()

    def _chose_row(self) -> None:
        items = self._table.selectedItems()
        if items:
            self.look_at(items[0].data(KEY))

    def _copy(self) -> None:
        QGuiApplication.clipboard().setText(table_of(self._sheets()))

    def _lay_out(self) -> None:
        self._wanting, self._add = QLabel(EMPTY), QPushButton("Add the step")
        self._wanting.setWordWrap(True)
        self._wanting.setProperty("role", "faint")
        self._add.setToolTip("append a step that separates orders of scattering to the sequence; nothing moves yet")
        self._add.clicked.connect(self.step_asked)
        self._empty = QWidget()
        wanting = QVBoxLayout(self._empty)
        wanting.setContentsMargins(0, 0, 0, 0)
        wanting.addWidget(self._wanting)
        wanting.addWidget(self._add, 0, Qt.AlignmentFlag.AlignLeft)
        self._dose, self._period, copy = QComboBox(), QComboBox(), QPushButton("Copy table")
        self._dose.setToolTip("of which dose; the newest follows the run")
        self._period.setToolTip("which wave's picture to look at; order 1 rests on the finest two")
        copy.setToolTip("copy what each sheet tells, for a spreadsheet")
        copy.clicked.connect(self._copy)
        for box in (self._dose, self._period):
            box.setMinimumContentsLength(len(NEWEST))
            box.activated.connect(lambda _: self._draw_sheet())  # by a person only
        self.heights = AxisSlider("height", "sheets from the floor to the surface", self._moved)
        slider = QHBoxLayout()
        for widget in (self.heights.name, self.heights.slider, self.heights.value):
            slider.addWidget(widget)
        self._plots = tuple(TankPlot(axes=False) for _ in range(4))
        pictures = QHBoxLayout()
        pictures.setSpacing(4)
        for plot in self._plots:
            plot.widget.setMinimumHeight(120)
            pictures.addWidget(plot.widget, 1)
        self._side = TankSection("from the side", "mean over y", "x from the lit wall (mm)")
        self._end = TankSection("along the light", "mean over x", "y (mm)")
        self._sections, both = QWidget(), QHBoxLayout()
        both.setContentsMargins(0, 0, 0, 0)
        both.addWidget(self._side.widget, 3)
        both.addWidget(self._end.widget, 2)
        self._sections.setLayout(both)
        self._says = QLabel()
        self._says.setWordWrap(True)
        self._says.setProperty("role", "faint")
        self._table = QTableWidget(0, 0)
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self._table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self._table.setTabKeyNavigation(False)
        self._table.setAccessibleName("what each sheet tells")
        self._table.verticalHeader().hide()
        self._table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self._table.setMinimumHeight(90)
        self._table.itemSelectionChanged.connect(self._chose_row)
        legend = QLabel(LEGEND)
        legend.setWordWrap(True)
        legend.setProperty("role", "faint")
        self._inside = QWidget()
        inside = QVBoxLayout(self._inside)
        inside.setContentsMargins(0, 0, 0, 0)
        inside.setSpacing(4)
        inside.addLayout(Flow(with_name("at", self._dose), with_name("wave of", self._period), copy))
        inside.addLayout(slider)
        inside.addLayout(pictures, 4)
        inside.addWidget(self._sections, 4)
        inside.addWidget(self._says)
        inside.addWidget(self._table, 3)
        inside.addWidget(legend)
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 8, 10, 8)
        column.addWidget(self._empty)
        column.addWidget(self._inside, 1)
        column.addStretch(0)


def toned(image: Image, peak: float) -> Indices:
    """(rows, columns) indices into `palette`: from dark to as bright as `peak`; where nothing is known, the last."""
    counts = np.clip(np.nan_to_num(image) * (TOP / peak), 0.0, 65_535.0).astype(np.uint16)
    indices: Indices = _table()[counts]
    indices[~np.isfinite(image)] = 255
    return indices


@lru_cache
def _table() -> Indices:
    return Tone(0.0, TOP, gamma=0.5).table()


@lru_cache
def palette() -> Indices:
    """(256, 3) the colours of pictures; the last is that of what cannot be told."""
    colours = Tone(0.0, TOP, gamma=0.5).palette().copy()
    colours[255] = UNTOLD
    return colours


def heading_row(periods_mm: list[float]) -> list[str]:
    """Headings of the table, see `cells_of`."""
    follow = [f"{period_mm:g} mm, %" for period_mm in periods_mm]
    return ["ink, ml", "z, mm", *follow, "order 1, %", "σt, 1/mm", "order 1 / fit"]


def cells_of(one: SeparatedSheet, periods_mm: list[float]) -> list[str]:
    """What a sheet tells, as `tankrig separate` does, with the window's one confidence."""
    follow = [f"{100.0 * one.follow[p]:.1f}" if p in one.follow else "–" for p in periods_mm]
    part = None if one.part is None else (100.0 * one.part[0], 100.0 * one.part[1])
    numbers = (_interval(number) for number in (part, one.sigma_t, one.over_fit))
    return [f"{one.key.dose_ml:.4g}", f"{one.key.height_mm:g}", *follow, *numbers]


def table_of(sheets: list[SeparatedSheet]) -> str:
    """All sheets as lines of cells with tabs between them: numbers as they are, with half their intervals."""
    periods = sorted({period_mm for one in sheets for period_mm in one.follow})
    names = ("order 1", "σt (1/mm)", "order 1 / fit")
    head = ["ink (ml)", "z (mm)", *(f"follows {period_mm:g} mm" for period_mm in periods)]
    lines = [[*head, *(cell for name in names for cell in (name, f"{name} ± {CONFIDENCE}")), "doubts"]]
    for one in sheets:
        cells = [f"{one.key.dose_ml:.9g}", f"{one.key.height_mm:.9g}"]
        cells += [f"{one.follow[period_mm]:.9g}" if period_mm in one.follow else "" for period_mm in periods]
        for known in (one.part, one.sigma_t, one.over_fit):
            cells += ["", ""] if known is None else [f"{known[0]:.9g}", f"{Z * known[1]:.9g}"]
        lines.append([*cells, " ".join(one.doubts)])
    return "\n".join("\t".join(line) for line in lines)


def _interval(number: WithSd | None) -> str:
    return "–" if number is None else with_error(number[0], Z * number[1])


def _mean(image: Image, axis: int) -> Image:
    """Mean of what is known along an axis; NaN where nothing is."""
    known = np.isfinite(image)
    many = known.sum(axis=axis)
    found: Image = np.where(many > 0, np.where(known, image, 0.0).sum(axis=axis) / np.maximum(many, 1), np.nan)
    return found


def _offer(box: QComboBox, entries: list[tuple[str, float | None]]) -> None:
    """Have these in a box; what was chosen stays chosen where it is still there."""
    if [box.itemText(row) for row in range(box.count())] == [words for words, _ in entries]:
        return
    before = box.currentText()
    box.clear()
    for words, value in entries:
        box.addItem(words, value)
    box.setCurrentText(before if box.findText(before) >= 0 else entries[0][0] if entries else "")

"""Runs, refits and models side by side, and what to photograph next."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QColor, QGuiApplication
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QPushButton,
    QSplitter,
    QTableWidget,
    QTableWidgetItem,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from ui.window.fit_curves import AXIS_PX, COEFFICIENTS
from ui.window.flow import take_rest
from ui.window.next_steps import NextSteps
from ui.window.on_screen import OnScreen
from ui.window.result import CONFIDENCE, NAMES, Result, Z, result_of, table_of
from ui.window.run_catalogue import RunCatalogue
from ui.window.shown import Shown
from ui.window.source import Kind, Source
from ui.window.source_frame import SourceFrame
from ui.window.theme import CURVES

SOURCE = Qt.ItemDataRole.UserRole
NO_RUNS = "No run has been recorded yet. Run two sequences, and compare them here."
EMPTY = "Tick two runs or more: their curves and results will stand here side by side."
HEADINGS = ("", "of", "σs", "σa", "g", "model and settings")


class ComparePage(QWidget):
    """Overlays what several sources have found; beside it, models of one photograph and advice for the next."""

    told = Signal(str)

    def __init__(self, catalogue: RunCatalogue, on_screen: OnScreen) -> None:
        super().__init__()
        self._catalogue, self._on_screen = catalogue, on_screen
        self._compared: dict[Source, Shown] = {}
        self._results: tuple[Result, ...] = ()
        self.next = NextSteps(on_screen)
        self._lay_out()
        catalogue.changed.connect(self._list)
        on_screen.changed.connect(lambda _: self._list())
        on_screen.refitted.connect(lambda _: self._list())
        self._list()

    @property
    def compared(self) -> list[Source]:
        """What is ticked."""
        rows = (self._sources.item(row) for row in range(self._sources.count()))
        return [item.data(SOURCE) for item in rows if item.checkState() is Qt.CheckState.Checked]

    def tick(self, *sources: Source) -> None:
        """Compare these."""
        for row in range(self._sources.count()):
            item = self._sources.item(row)
            item.setCheckState(
                Qt.CheckState.Checked if item.data(SOURCE) in sources else Qt.CheckState.Unchecked
            )  # fmt: skip

    def shown_of(self, source: Source) -> Shown | None:
        """What is known of one that is ticked."""
        return self._compared.get(source)

    def read_anew(self, run: Path) -> None:
        """A run has gone on or has ended, so that what was read of it is no longer all."""
        self._compared = {source: shown for source, shown in self._compared.items() if source.run != run}
        self._fetch()

    def _list(self) -> None:
        """Runs and their refits, with the ticks that there were; what is no more is taken out."""
        ticked = self.compared
        known: list[Source] = []
        for one in self._catalogue.runs:
            known += [Source(Kind.REPLAY, one.path), *self._on_screen.refits_of(one.path)]
        self._sources.blockSignals(True)
        self._sources.clear()
        for source in known:
            assert source.run is not None
            refit = "" if source.settings is None else f", refit: {source.settings.words}"
            item = QListWidgetItem(f"{source.run.name}{refit}")
            item.setData(SOURCE, source)
            item.setFlags(item.flags() | Qt.ItemFlag.ItemIsUserCheckable)
            item.setCheckState(Qt.CheckState.Checked if source in ticked else Qt.CheckState.Unchecked)
            self._sources.addItem(item)
        self._sources.blockSignals(False)
        self._compared = {source: shown for source, shown in self._compared.items() if source in known}
        self._fetch()

    def _fetch(self) -> None:
        """Have what is ticked read, and draw what is there."""
        for source in self.compared:
            if source not in self._compared:
                shown = self._on_screen.look_up(source, self.told.emit)
                self._compared[source] = shown
                shown.fits_changed.connect(self._draw)
        self._draw()

    def _draw(self) -> None:
        ticked = [self._compared[source] for source in self.compared if source in self._compared]
        results = [(shown, result_of(shown)) for shown in ticked]
        found = [(shown, result) for shown, result in results if result is not None]
        self._draw_curves([shown for shown, _ in found])
        self._draw_table([result for _, result in found])
        self._colour(ticked)
        self._says.setText("" if len(found) > 1 else EMPTY if self._sources.count() else NO_RUNS)

    def _draw_curves(self, all_shown: Sequence[Shown]) -> None:
        self._curves.setVisible(bool(all_shown))  # axes of nothing would measure nothing
        for name, plot in self._plots.items():
            plot.clear()
            for number, shown in enumerate(all_shown):
                fits = shown.by_dose
                at = np.array([fit.dose_ml for fit in fits])
                values = np.array([getattr(fit.medium, name) for fit in fits])
                sd = np.array([fit.sd[COEFFICIENTS[name][1]] if fit.sd else 0.0 for fit in fits])
                colour = CURVES[number % len(CURVES)]
                if len(at):
                    plot.addItem(pg.ErrorBarItem(x=at, y=values, height=2.0 * Z * sd, pen=pg.mkPen(colour, width=2)))
                    plot.plot(at, values, pen=pg.mkPen(colour, width=1), symbol="o", symbolSize=8, symbolBrush=colour,
                              symbolPen=None)  # fmt: skip

    def _draw_table(self, results: Sequence[Result]) -> None:
        self._table.setRowCount(len(results))
        for row, one in enumerate(results):
            by_name = {number.name: number for number in one.coefficients}
            cells = [one.title, one.of]
            for name in NAMES:
                number = by_name[name]
                cells.append(number.text + ("" if number.determined else " (not determined)"))
            cells.append(f"{one.model}, {one.phase}, {one.settings}")
            for column, text in enumerate(cells):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                self._table.setItem(row, column, item)
        self._results = tuple(results)
        self._table.setVisible(bool(results))
        self._copy.setVisible(bool(results))
        self._copy.setEnabled(bool(results))

    def _colour(self, ticked: Sequence[Shown]) -> None:
        """Names in the list have the colours of their curves."""
        colours = {
            shown.source: CURVES[number % len(CURVES)]
            for number, shown in enumerate(one for one in ticked if result_of(one) is not None)
        }
        self._sources.blockSignals(True)
        for row in range(self._sources.count()):
            item = self._sources.item(row)
            colour = colours.get(item.data(SOURCE))
            item.setData(Qt.ItemDataRole.DecorationRole, QColor(colour) if colour else None)
        self._sources.blockSignals(False)

    def _copy_table(self) -> None:
        QGuiApplication.clipboard().setText(table_of(self._results))

    def _lay_out(self) -> None:
        self._sources = QListWidget()
        self._sources.setAccessibleName("runs to compare")
        self._sources.itemChanged.connect(lambda _: self._fetch())
        self._plots: dict[str, Any] = {}
        self._curves = QWidget()
        plots = QHBoxLayout(self._curves)
        plots.setContentsMargins(0, 0, 0, 0)
        for name, (symbol, _, unit) in COEFFICIENTS.items():
            widget = pg.PlotWidget(enableMenu=False)
            widget.setMinimumHeight(110)
            plot = widget.getPlotItem()
            plot.setTitle(f"{symbol} {unit}".strip() + f", ± {CONFIDENCE}", size="9pt")
            plot.setLabel("bottom", "ink (ml)")
            plot.hideButtons()
            plot.showGrid(x=True, y=True, alpha=0.2)
            for side in ("left", "bottom"):
                plot.getAxis(side).enableAutoSIPrefix(False)
            plot.getAxis("left").setWidth(AXIS_PX)
            plot.getAxis("bottom").setTickDensity(0.6)
            plots.addWidget(widget, 1)
            self._plots[name] = plot
        self._table = QTableWidget(0, len(HEADINGS))
        self._table.setHorizontalHeaderLabels([f"{h} ± {CONFIDENCE}" if h in NAMES.values() else h for h in HEADINGS])
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setTabKeyNavigation(False)
        self._table.setAccessibleName("results of the runs that are ticked")
        self._table.verticalHeader().hide()
        self._table.setMinimumHeight(90)
        header = self._table.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self._copy = QPushButton("Copy table")
        self._copy.clicked.connect(self._copy_table)
        self._says = QLabel(EMPTY)
        self._says.setProperty("role", "faint")
        self._says.setWordWrap(True)
        right, whole = QWidget(), QVBoxLayout()
        whole.setContentsMargins(0, 0, 0, 0)
        whole.addWidget(self._says)
        whole.addWidget(self._curves, 2)
        whole.addWidget(self._table, 1)
        whole.addWidget(self._copy, 0, Qt.AlignmentFlag.AlignLeft)
        whole.addStretch(0)
        right.setLayout(whole)
        split = QSplitter(Qt.Orientation.Vertical)
        split.addWidget(self._sources)
        split.addWidget(right)
        split.setSizes([120, 420])
        split.setChildrenCollapsible(False)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.addTab(split, "Runs")
        self.frame = SourceFrame(self.next)
        self.tabs.addTab(self.frame, "Models, and what next")
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 8, 10, 8)
        take_rest(self.tabs, 330)
        column.addWidget(self.tabs)

    def show_source(self, shown: Shown) -> None:
        """What is on screen now."""
        self.frame.show_source(shown.source)
        self.next.show_source(shown)

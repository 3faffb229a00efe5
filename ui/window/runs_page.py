"""Runs that were recorded: browse, resume, replay, refit, report, export."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Qt, QUrl, Signal
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import (
    QAbstractItemView,
    QCheckBox,
    QGridLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLineEdit,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from tankrig.errors import TankrigError
from ui.window import jobs
from ui.window.background import Background
from ui.window.files import ask_where_to_save
from ui.window.replay_bar import ReplayBar
from ui.window.run_summary import RunSummary, summaries

if TYPE_CHECKING:
    from tankrig.run.reading import Run

COLUMNS = ("run", "sequence", "began (UTC)", "ending")


class RunsPage(QWidget):
    """Lists the runs of a folder and acts on the one that is chosen."""

    resume_asked = Signal(object)
    """Path of a run."""
    opened = Signal(object)
    """Run that is to be shown."""
    refitted = Signal(object, object)
    """Tables of the doses, and of the series or None."""
    told = Signal(str)

    def __init__(self, folder: Path, background: Background) -> None:
        super().__init__()
        self.folder, self._background = folder, background
        self._rows: list[RunSummary] = []
        self._run: Run | None = None
        self._busy = False
        self.bar = ReplayBar()
        self._boxes: list[QCheckBox] = []
        self._ticks = QHBoxLayout()
        self._lay_out()
        self.refresh()

    def refresh(self) -> None:
        """Look at the folder again."""
        self._rows = summaries(self.folder)
        chosen = self.chosen
        self._table.setRowCount(len(self._rows))
        for row, one in enumerate(self._rows):
            for column, text in enumerate((one.path.name, one.name, one.began, one.ending)):
                item = QTableWidgetItem(text)
                item.setToolTip(one.message or str(one.path))
                self._table.setItem(row, column, item)
        self._sift(self._filter.text())
        self._empty.setVisible(not self._rows)
        if chosen is None and self._rows:
            self._table.selectRow(0)
        self._choose()

    @property
    def chosen(self) -> RunSummary | None:
        """The run that is chosen in the list."""
        row = self._table.currentRow()
        return self._rows[row] if 0 <= row < len(self._rows) else None

    def latest_interrupted(self, rig: str) -> RunSummary | None:
        """The newest run, if it was recorded with this rig and did not come to its end."""
        newest = self._rows[0] if self._rows else None
        return newest if newest is not None and newest.resumable and newest.rig == rig else None

    def set_busy(self, busy: bool) -> None:
        """While the rig is in use nothing can be resumed."""
        if busy != self._busy:
            self._busy = busy
            self._choose()

    # -- what a person does --------------------------------------------------------------------------------------------

    def open_chosen(self) -> None:
        """Show the chosen run in the live view and on the Fit page."""
        from tankrig.run.reading import open_run

        chosen = self.chosen
        if chosen is None:
            return
        try:
            self._run = open_run(chosen.path)
        except TankrigError as error:
            self.told.emit(str(error))
            return
        self._patterns(self._run)
        self.opened.emit(self._run)

    def refit(self) -> None:
        """Fit the chosen run anew with what is ticked."""
        chosen = self.chosen
        if chosen is None:
            return
        patterns = [box.text() for box in self._boxes if box.isChecked()]
        if not patterns:
            self.told.emit("tick at least one pattern to fit to")
            return
        self._work("fitting anew…", jobs.refit, chosen.path, patterns, self._free.isChecked(), then=self._take_fits)

    def report(self) -> None:
        """Write the chosen run's report and show it in the browser."""
        chosen = self.chosen
        if chosen is not None:
            self._work("writing the report…", jobs.report, chosen.path, then=self._show_report)

    def export(self, kind: str) -> None:
        """Ask where to, and export the chosen run's frames: "NetCDF" or "TIFF"."""
        chosen = self.chosen
        if chosen is None:
            return
        name = f"{chosen.path.name}.nc" if kind == "NetCDF" else f"{chosen.path.name}-tiff"
        kinds = "NetCDF (*.nc)" if kind == "NetCDF" else "folder of TIFFs (*)"
        ask_where_to_save(self, f"Export as {kind}", chosen.path.parent.absolute() / name, kinds, self.export_to)

    def export_to(self, target: Path) -> None:
        """Export the chosen run's frames to a file or folder."""
        chosen = self.chosen
        if chosen is not None:
            self._work(f"exporting to {target.name}…", jobs.export, chosen.path, target, then=self._exported)

    def _work(self, words: str, work: Any, *arguments: Any, then: Any) -> None:
        self._says.setText(words)
        self._background.run(work, *arguments, then=then, failed=self._failed)

    def _failed(self, sentence: str) -> None:
        self._says.clear()
        self.told.emit(sentence)

    def _take_fits(self, found: Any) -> None:
        self._says.setText("fitted anew; the Fit page shows it. The run itself keeps its own fits.")
        self.refitted.emit(*found)

    def _show_report(self, path: Path) -> None:
        self._says.setText(f"report: {path}")
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(path.absolute())))

    def _exported(self, target: Path) -> None:
        self._says.setText(f"exported to {target}")

    def _resume(self) -> None:
        if self.chosen is not None:
            self.resume_asked.emit(self.chosen.path)

    def _choose(self) -> None:
        chosen = self.chosen
        for button in self._buttons:
            button.setEnabled(chosen is not None)
        self._resume_button.setEnabled(chosen is not None and chosen.resumable and not self._busy)
        same = chosen is not None and self._run is not None and self._run.path == chosen.path
        self._refit_button.setEnabled(same)
        if chosen is not None and chosen.message:
            self._says.setText(f"{chosen.ending}: {chosen.message}")
        else:
            self._says.clear()

    def _patterns(self, run: "Run") -> None:
        for box in self._boxes:
            self._ticks.removeWidget(box)
            box.deleteLater()
        lit = [pattern.name for pattern in run.patterns.values() if pattern.pixels.any()]
        self._boxes = [QCheckBox(name) for name in lit]
        for box in self._boxes:
            box.setChecked(True)
            self._ticks.addWidget(box)
        self._choose()

    def _sift(self, words: str) -> None:
        for row, one in enumerate(self._rows):
            text = f"{one.path.name} {one.name} {one.began} {one.ending}".lower()
            self._table.setRowHidden(row, not all(word in text for word in words.lower().split()))

    def _lay_out(self) -> None:
        self._table = QTableWidget(0, len(COLUMNS))
        self._table.setHorizontalHeaderLabels(list(COLUMNS))
        self._table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self._table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setTabKeyNavigation(False)
        self._table.verticalHeader().hide()
        self._table.verticalHeader().setDefaultSectionSize(34)
        self._table.setShowGrid(False)
        self._table.setAlternatingRowColors(True)
        header = self._table.horizontalHeader()
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        for narrow in (1, 2, 3):
            header.setSectionResizeMode(narrow, QHeaderView.ResizeMode.ResizeToContents)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self._table.itemSelectionChanged.connect(self._choose)
        self._table.itemDoubleClicked.connect(lambda _: self.open_chosen())
        self._filter = QLineEdit()
        self._filter.setPlaceholderText("only runs with these words")
        self._filter.setClearButtonEnabled(True)
        self._filter.textChanged.connect(self._sift)
        again = QPushButton("Refresh")
        again.clicked.connect(self.refresh)
        head = QHBoxLayout()
        head.addWidget(self._filter, 1)
        head.addWidget(again)
        self._empty = QLabel(f"No runs in {self.folder} yet. Run a sequence, and when it has ended it will be here.")
        self._empty.setProperty("role", "faint")
        self._empty.setWordWrap(True)
        self._says = QLabel()
        self._says.setWordWrap(True)
        column = QVBoxLayout(self)
        column.setContentsMargins(14, 10, 14, 10)
        column.addLayout(head)
        column.addWidget(self._empty)
        column.addWidget(self._table, 1)
        column.addLayout(self._actions())
        column.addWidget(self.bar)
        column.addLayout(self._refit_row())
        column.addWidget(self._says)

    def _actions(self) -> QGridLayout:
        grid = QGridLayout()
        actions = (
            ("Open", self.open_chosen, "show it in the live view and on the Fit page"),
            ("Report", self.report, "write the run as one HTML page and open it"),
            (
                "NetCDF",
                lambda: self.export("NetCDF"),
                "export all frames with their coordinates, for xarray and others",
            ),
            ("TIFF", lambda: self.export("TIFF"), "export a folder of 16-bit pictures"),
        )
        self._buttons = []
        for column, (name, do, tip) in enumerate(actions):
            button = QPushButton(name)
            button.setToolTip(tip)
            button.clicked.connect(do)
            grid.addWidget(button, 0, column)
            self._buttons.append(button)
        self._resume_button = QPushButton("Resume")
        self._resume_button.setToolTip("go on with a run that was interrupted")
        self._resume_button.clicked.connect(self._resume)
        grid.addWidget(self._resume_button, 0, len(actions))
        return grid

    def _refit_row(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self._free = QCheckBox("fit the background")
        self._free.setToolTip("fit a constant background too, rather than trust that the dark frames took it out")
        self._refit_button = QPushButton("Fit anew")
        self._refit_button.setToolTip("fit the opened run to the patterns that are ticked")
        self._refit_button.clicked.connect(self.refit)
        row.addLayout(self._ticks)
        row.addWidget(self._free)
        row.addStretch(1)
        row.addWidget(self._refit_button)
        return row

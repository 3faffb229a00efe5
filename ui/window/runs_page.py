"""Runs that were recorded: browse, open, resume, report, export, delete; and replay and fit anew the one on screen."""

from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QFile, Qt, QTimer, QUrl, Signal
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import (
    QAbstractItemView,
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

from tankrig.run.notes import MOST_LETTERS, write_note
from ui.window import jobs
from ui.window.fields import SURE_MS
from ui.window.files import ask_where_to_save
from ui.window.flow import Flow, take_rest
from ui.window.on_screen import OnScreen, Worker
from ui.window.refit_row import RefitRow
from ui.window.replay_bar import ReplayBar
from ui.window.run_catalogue import RunCatalogue
from ui.window.run_summary import RunSummary
from ui.window.shown import Shown
from ui.window.source_frame import SourceFrame

COLUMNS = ("run", "began", "ending", "doses", "frames", "note", "sequence")
RUN, BEGAN, NOTE = (COLUMNS.index(name) for name in ("run", "began", "note"))
RUN_PX = 122
"""At first, so that all columns can be seen in a window 1280 wide; the line below the list has the whole name."""
PATH = Qt.ItemDataRole.UserRole
DELETE = "Delete"


class RunsPage(QWidget):
    """Lists the runs of a folder and acts on the one that is selected; what is asked for keeps that run's name."""

    resume_asked = Signal(object)
    """Path of a run."""
    open_asked = Signal(object)
    deleted = Signal(object)
    """Folder of a run that is in the trash."""
    report_told = Signal(object, str, str)
    """Folder of a run, what becomes of its report, and the `level` of that notice."""
    told = Signal(str)

    def __init__(self, folder: Path, on_screen: OnScreen, background: Worker) -> None:
        super().__init__()
        self.catalogue, self.on_screen, self._background = RunCatalogue(folder), on_screen, background
        self._busy = False
        self._sure: Path | None = None
        self._noted: Path | None = None
        """The run whose note stands in the field."""
        self.bar, self.refits = ReplayBar(), RefitRow()
        self._lay_out()
        self.catalogue.changed.connect(self._list)
        self.refits.asked.connect(self._refit)
        self.refits.chosen.connect(self._show_refit)
        on_screen.changed.connect(self.show_source)
        on_screen.refitted.connect(lambda _: self._list_refits())
        self.show_source(on_screen.shown)
        self.refresh()

    def refresh(self) -> None:
        """Look at the folder again."""
        self.catalogue.refresh()
        run = self.on_screen.source.recorded
        if run is not None and not run.exists():
            self.told.emit(f"the folder of {run.name} is gone; what was read of it stays on screen until you leave it")

    def latest_interrupted(self, rig: str) -> RunSummary | None:
        """The newest run, if it was recorded with this rig and did not come to its end."""
        newest = self.catalogue.runs[0] if self.catalogue.runs else None
        return newest if newest is not None and newest.resumable and newest.rig == rig else None

    def set_busy(self, busy: bool) -> None:
        """While the rig is in use nothing can be resumed."""
        if busy != self._busy:
            self._busy = busy
            self._able()

    def show_source(self, shown: Shown) -> None:
        """What is on screen now."""
        self.frame.show_source(shown.source)
        self.refits.show_source(shown)
        self._list_refits()

    # -- what a person does: each with the run that is selected when it is asked for -----------------------------------

    def open_selected(self) -> None:
        """Show the selected run in all views."""
        if self.catalogue.selected is not None:
            self.open_asked.emit(self.catalogue.selected.path)

    def resume_selected(self) -> None:
        """Go on with the selected run."""
        if self.catalogue.selected is not None:
            self.resume_asked.emit(self.catalogue.selected.path)

    def report_selected(self) -> None:
        """Write the selected run's report."""
        if self.catalogue.selected is not None:
            self.report(self.catalogue.selected.path)

    def report(self, run: Path) -> None:
        """Write a run's report and show it in the browser."""
        name = f"the report of {run.name}"
        self._says.setText(f"In work: {name}")
        self.report_told.emit(run, f"The report of {run.name} is being written.", "")

        def failed(sentence: str) -> None:
            self._says.clear()
            self.report_told.emit(run, f"The report of {run.name} is not written: {sentence}", "bad")

        self._background.run(jobs.report, run, then=partial(self._show_report, run), failed=failed, name=name)

    def export_selected(self, kind: str) -> None:
        """Ask where to, and export the selected run's frames: "NetCDF" or "TIFF"."""
        selected = self.catalogue.selected
        if selected is None:
            return
        run = selected.path
        name = f"{run.name}.nc" if kind == "NetCDF" else f"{run.name}-tiff"
        kinds = "NetCDF (*.nc)" if kind == "NetCDF" else "folder of TIFFs (*)"
        proposal = run.parent.absolute() / name
        ask_where_to_save(
            self, f"Export {run.name} as {kind}", proposal, kinds, lambda target: self.export(run, target)
        )  # fmt: skip

    def export(self, run: Path, target: Path) -> None:
        """Export a run's frames to a file or folder."""

        def exported(_: Path) -> None:
            self._says.setText(f"{run.name} is exported to {target}.")

        self._work(f"the export of {run.name}", jobs.export, run, target, then=exported)

    def delete_selected(self) -> None:
        """Move the selected run to the trash; asked twice."""
        selected = self.catalogue.selected
        if selected is None:
            return
        if self._sure != selected.path:
            self._sure = selected.path
            self._delete.setText("Press again")
            self._says.setText(f"{selected.path.name} will be moved to the trash, where it can be found again.")
            QTimer.singleShot(SURE_MS, self, self._ask_again)
            return
        self._sure = None
        self.delete(selected.path)

    def _ask_again(self) -> None:
        """A press long after is a first one."""
        self._sure = None
        self._delete.setText(DELETE)

    def delete(self, run: Path) -> None:
        """Move a run to the trash, and take everything of it off the screen."""
        if self._busy and self.on_screen.source.run == run:
            self.told.emit(f"{run.name} is being recorded; stop it first, then delete it")
        elif not _to_trash(run):
            self.told.emit(f"{run}: cannot be moved to the trash; move its folder by hand")
        else:
            self._says.setText(f"{run.name} is in the trash.")
            self.on_screen.forget(run)
            self.deleted.emit(run)
        self.refresh()

    def _keep_note(self) -> None:
        """Keep what was typed with the run whose note stood in the field."""
        run, text = self._noted, self._note.text().strip()
        known = self.catalogue.find(run) if run is not None else None
        if known is not None and text != known.note:
            self.note(known.path, text)

    def note(self, run: Path, text: str) -> None:
        """Note something of a run."""

        def noted(_: None) -> None:
            self._says.setText(f"The note is kept with {run.name}.")
            self.refresh()

        self.on_screen.reader.run(write_note, run, text, then=noted, failed=self.told.emit)

    def _refit(self, settings: Any) -> None:
        run = self.on_screen.source.recorded
        if run is not None:
            source = self.on_screen.refit(run, settings)
            self._says.setText(f"In work: {source.title}")

    def _show_refit(self, source: Any) -> None:
        if source is None:
            run = self.on_screen.source.recorded
            if run is not None:
                self.open_asked.emit(run)
        else:
            self.on_screen.show_refit(source)

    def _list_refits(self) -> None:
        run = self.on_screen.source.recorded
        found = self.on_screen.refits_of(run) if run is not None else []
        self.refits.list_refits(found, self.on_screen.source)
        if self._says.text() in [f"In work: {one.title}" for one in found]:
            self._says.clear()

    def _work(self, name: str, work: Any, *arguments: Any, then: Any) -> None:
        self._says.setText(f"In work: {name}")
        self._background.run(work, *arguments, then=then, failed=self._failed, name=name)

    def _failed(self, sentence: str) -> None:
        self._says.clear()
        self.told.emit(sentence)

    def _show_report(self, run: Path, path: Path) -> None:
        self._says.setText(f"report: {path}")
        opened = QDesktopServices.openUrl(QUrl.fromLocalFile(str(path.absolute())))
        unseen = "" if opened else " No browser here opens it: open that file with one of your own."
        self.report_told.emit(run, f"The report of {run.name} is written: {path}.{unseen}", "good" if opened else "")

    # -- what is shown -------------------------------------------------------------------------------------------------

    def _list(self) -> None:
        """The runs that are visible, with the selected one marked."""
        runs, table = self.catalogue.visible, self._table
        table.blockSignals(True)
        table.setSortingEnabled(False)
        table.setRowCount(len(runs))
        for row, one in enumerate(runs):
            cells = (one.path.name, one.began_local, one.ending, one.doses, one.frames, one.note, one.name)
            for column, value in enumerate(cells):
                item = QTableWidgetItem()
                item.setData(Qt.ItemDataRole.DisplayRole, value)  # a number is sorted as one
                item.setToolTip(one.note if column == NOTE and one.note else one.message or str(one.path))
                item.setData(PATH, str(one.path))
                table.setItem(row, column, item)
        table.setSortingEnabled(True)
        table.clearSelection()
        table.setCurrentCell(-1, -1)
        selected = self.catalogue.selected
        if selected is not None:
            items = (table.item(row, 0) for row in range(table.rowCount()))
            paths = [item.data(PATH) for item in items if item is not None]
            table.selectRow(paths.index(str(selected.path)))
        table.blockSignals(False)
        self._empty.setVisible(not self.catalogue.runs)
        self._able()

    def _select(self) -> None:
        row = self._table.currentRow()
        marked = self._table.item(row, 0) if self._table.selectedItems() else None
        self.catalogue.select(Path(marked.data(PATH)) if marked is not None else None)

    def _able(self) -> None:
        """What can be done with the selected run, and which it is."""
        selected = self.catalogue.selected
        for button in self._buttons:
            button.setEnabled(selected is not None)
        self._note.setEnabled(selected is not None)
        if not self._note.hasFocus() or self._noted != (selected.path if selected is not None else None):
            self._noted = selected.path if selected is not None else None
            self._note.setText(selected.note if selected is not None else "")
        self._resume_button.setEnabled(selected is not None and selected.resumable and not self._busy)
        if selected is None or self._sure != selected.path:
            self._sure = None
            self._delete.setText(DELETE)
        if selected is None:
            self._selected.setText("No run is selected." if self.catalogue.runs else "")
        else:
            why = f" ({selected.message})" if selected.message else ""
            self._selected.setText(f"Selected: {selected.path.name}, {selected.ending}{why}")

    def _lay_out(self) -> None:
        self._table = QTableWidget(0, len(COLUMNS))
        self._table.setHorizontalHeaderLabels(list(COLUMNS))
        began = self._table.horizontalHeaderItem(BEGAN)
        assert began is not None
        began.setToolTip("by the clock on the wall here")
        self._table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self._table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setTabKeyNavigation(False)
        self._table.setAccessibleName("runs")
        self._table.verticalHeader().hide()
        self._table.verticalHeader().setDefaultSectionSize(34)
        self._table.setShowGrid(False)
        self._table.setWordWrap(False)
        self._table.setAlternatingRowColors(True)
        header = self._table.horizontalHeader()
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(NOTE, QHeaderView.ResizeMode.Stretch)
        header.setSectionResizeMode(RUN, QHeaderView.ResizeMode.Interactive)
        header.resizeSection(RUN, RUN_PX)
        self._table.setTextElideMode(Qt.TextElideMode.ElideMiddle)  # names that are times differ at both ends
        header.setSortIndicator(BEGAN, Qt.SortOrder.DescendingOrder)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        self._table.itemSelectionChanged.connect(self._select)
        self._table.itemActivated.connect(lambda _: self.open_selected())
        self._filter = QLineEdit()
        self._filter.setPlaceholderText("only runs with these words")
        self._filter.setClearButtonEnabled(True)
        self._filter.textChanged.connect(self.catalogue.sift)
        again = QPushButton("Refresh")
        again.clicked.connect(self.refresh)
        head = QHBoxLayout()
        head.addWidget(self._filter, 1)
        head.addWidget(again)
        self._empty = QLabel(
            f"No runs in {self.catalogue.folder} yet. Run a sequence, and when it has ended it will be here."
        )
        self._empty.setProperty("role", "faint")
        self._note = QLineEdit()
        self._note.setMaxLength(MOST_LETTERS)
        self._note.setPlaceholderText("a note on the selected run, kept with it")
        self._note.setAccessibleName("note on the selected run")
        self._note.editingFinished.connect(self._keep_note)
        self._selected, self._says = QLabel(), QLabel()
        for label in (self._empty, self._selected, self._says):
            label.setWordWrap(True)
        inside, on_screen = QWidget(), QVBoxLayout()
        on_screen.setContentsMargins(8, 4, 8, 4)
        on_screen.addWidget(self.bar)
        on_screen.addWidget(self.refits)
        inside.setLayout(on_screen)
        self.frame = SourceFrame(inside)
        column = QVBoxLayout(self)
        column.setContentsMargins(14, 10, 14, 10)
        column.addLayout(head)
        column.addWidget(self._empty)
        take_rest(self._table, 120)
        column.addWidget(self._table, 1)
        column.addWidget(self._selected)
        column.addWidget(self._note)
        column.addLayout(self._actions())
        column.addWidget(self._says)
        column.addWidget(self.frame)

    def _actions(self) -> Flow:
        row = Flow()
        actions = (
            ("Open", self.open_selected, "show it in the live view and on all pages"),
            ("Report", self.report_selected, "write the run as one HTML page and open it"),
            ("NetCDF", lambda: self.export_selected("NetCDF"), "export all frames with their coordinates"),
            ("TIFF", lambda: self.export_selected("TIFF"), "export a folder of 16-bit pictures"),
            ("Resume", self.resume_selected, "go on with a run that was interrupted"),
            (DELETE, self.delete_selected, "move the run's folder to the trash"),
        )
        self._buttons = []
        for name, do, tip in actions:
            button = QPushButton(name)
            button.setToolTip(tip)
            button.clicked.connect(do)
            row.addWidget(button)
            self._buttons.append(button)
        self._resume_button, self._delete = self._buttons[-2], self._buttons[-1]
        return row


def _to_trash(run: Path) -> bool:
    moved = QFile.moveToTrash(str(run.absolute()))
    return bool(moved[0] if isinstance(moved, tuple) else moved)

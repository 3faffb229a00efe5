"""What is calibrated, when and how well; and the rig file that holds it."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QFileSystemWatcher, Qt, QTimer, Signal
from PySide6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from tankrig.errors import TankrigError
from ui.window.calibration_known import known_of, set_aside
from ui.window.calibration_wizard import USE, CalibrationWizard
from ui.window.flow import take_rest
from ui.window.marked_text import MarkedText
from ui.window.rig_file import RigSource
from ui.window.sequence_text import line_of
from ui.window.status import RigState, RigStatus

if TYPE_CHECKING:
    from drivers.rig import RigFile


SETTLED_MS = 100
"""A file is read once whoever writes it has had so long to finish."""
OWN_FILE = "the simulated rig's own file"


class CalibrationPage(QWidget):
    """Lists the rig's calibration, and shows its file with the line marked that is wrong."""

    reopen_asked = Signal()
    wrong_line = Signal()
    """The rig file cannot be opened, and the line that is to blame is marked."""
    told = Signal(str)

    def __init__(self, source: RigSource) -> None:
        super().__init__()
        self._source = source
        self._table = QWidget()
        self._grid = QGridLayout(self._table)
        self._grid.setColumnStretch(1, 1)
        self._grid.setVerticalSpacing(10)
        self._grid.setHorizontalSpacing(18)
        self._grid.setAlignment(Qt.AlignmentFlag.AlignTop)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setFrameShape(QScrollArea.Shape.NoFrame)
        area.setWidget(self._table)
        self._text, self._as_read, self._sure = MarkedText(), "", False
        self._watcher = QFileSystemWatcher(self)
        self._watcher.fileChanged.connect(lambda _: QTimer.singleShot(SETTLED_MS, self._look_at_file))
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.addTab(area, "What is known")
        self.wizard = CalibrationWizard(source)
        self.wizard.told.connect(self.told)
        self.wizard.used.connect(self.reopen_asked)
        self.tabs.addTab(self.wizard, "Measure")
        self.tabs.addTab(self._file_tab(), "Rig file")
        column = QVBoxLayout(self)
        column.setContentsMargins(14, 10, 14, 10)
        take_rest(self.tabs, 300)
        column.addWidget(self.tabs)
        self._say_empty()

    def use_rig(self, source: RigSource) -> None:
        """Another rig, whose file stands on its tab."""
        self._source = source
        self.wizard.use_rig(source)
        self._name.setText(str(source.file or OWN_FILE))
        self._text.setReadOnly(source.file is None)
        self._keep.setEnabled(source.file is not None)
        self._read_file()

    def set_rig(self, rig: "RigFile") -> None:
        """Show this rig's calibration."""
        from drivers.calibration_health import calibration_checks
        from ui.calibration_way import calibration_steps

        self._clear()
        folder = self._source.file.parent if self._source.file is not None else self._source.folder
        for row, known in enumerate(known_of(rig, self._path(), folder)):
            name, words, note = QLabel(known.what), QLabel(known.value), QLabel(known.note)
            name.setProperty("role", "heading")
            note.setProperty("role", "faint")
            for label in (words, note):
                label.setWordWrap(True)
            self._grid.addWidget(name, 2 * row, 0, 2, 1, Qt.AlignmentFlag.AlignTop)
            self._grid.addWidget(words, 2 * row, 1)
            self._grid.addWidget(note, 2 * row + 1, 1)
            if known.aside is not None:
                use = QPushButton(USE)
                use.setAccessibleName(f"{USE}: {known.what}")
                use.clicked.connect(partial(self.wizard.use_aside, known.aside))
                self._grid.addWidget(use, 2 * row, 2, Qt.AlignmentFlag.AlignTop)
        self.wizard.show_aside(set_aside(rig))
        self.wizard.allow_doses(rig.limits.dose_ul)
        self.wizard.show_way(calibration_steps(rig, calibration_checks(rig, {})))
        self._read_file()

    def follow(self, status: RigStatus) -> None:
        """Mark the line of the rig file that is to blame, once it has failed."""
        self.wizard.follow(status)
        failed = status.state is RigState.FAILED
        self._again.setEnabled(failed or (self._source.file is not None and status.state is RigState.IDLE))
        if failed and status.trouble and self._source.file is not None and not self._text.marked:
            self._read_file()
            line = line_of(self._text.toPlainText(), status.trouble.partition(": ")[2])
            self._text.mark(line)
            if line:
                self._text.go_to(line)
                self.tabs.setCurrentIndex(2)
                self.wrong_line.emit()
        if not failed and self._text.marked:
            self._text.mark(0)

    def _path(self) -> Path:
        import drivers.simulated

        own = Path(str(drivers.simulated.__file__)).with_name("rig.toml")
        return self._source.file or own

    def _read_file(self) -> None:
        self._sure = False
        try:
            self._as_read = self._path().read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            self._as_read = f"# {self._path()}: cannot be read ({error})"
        self._text.replace_text(self._as_read)
        watched = [str(self._source.file)] if self._source.file is not None else []
        now = self._watcher.files()
        for file in set(now) - set(watched):
            self._watcher.removePath(file)
        for file in set(watched) - set(now):  # one that was replaced as a whole is no longer watched
            self._watcher.addPath(file)

    @property
    def _changed_outside(self) -> bool:
        """Whether the file is no longer what was read of it, or written to it, here."""
        try:
            return self._path().read_text(encoding="utf-8-sig") != self._as_read
        except (OSError, UnicodeDecodeError):
            return True

    def _look_at_file(self) -> None:
        """Somebody has written the rig file, or taken it away."""
        file = self._source.file
        if file is None or not self._changed_outside:
            return
        edited = self._text.toPlainText() != self._as_read
        if not file.exists():
            self.told.emit(f"{file} is gone; the rig stays as it was opened, and saving here writes the file anew")
        elif edited:
            self.told.emit(f"{file} was changed by another program, and here, too: saving here writes over that")
        else:
            self._read_file()
            self.told.emit(f"{file} was changed by another program; it counts once the rig is opened again")
        self._again.setEnabled(True)

    def _save(self) -> None:
        from tankrig.files import whole_file

        if self._source.file is None:
            self.told.emit("the simulated rig's file comes with tankrig; copy it and start with --rig to change it")
            return
        if self._changed_outside and not self._sure:
            self._sure = True
            self.told.emit(
                f"{self._source.file} was changed by another program meanwhile; press again to write over it"
            )
            return
        try:
            with whole_file(self._source.file) as unfinished:
                unfinished.write_text(self._text.toPlainText(), encoding="utf-8")
        except (OSError, TankrigError) as error:
            self.told.emit(str(error))
            return
        self._sure, self._as_read = False, self._text.toPlainText()
        self._text.mark(0)
        self.reopen_asked.emit()

    def _file_tab(self) -> QWidget:
        tab = QWidget()
        column, row = QVBoxLayout(tab), QHBoxLayout()
        self._name = name = QLabel(str(self._source.file or OWN_FILE))
        name.setProperty("role", "faint")
        name.setMinimumWidth(60)  # a long path is cut, and the page not widened
        name.setToolTip(name.text())
        self._text.setReadOnly(self._source.file is None)
        self._again, self._keep = QPushButton("Open the rig again"), QPushButton("Save and open again")
        save = self._keep
        save.setEnabled(self._source.file is not None)
        self._again.clicked.connect(self.reopen_asked)
        save.clicked.connect(self._save)
        row.addWidget(name, 1)
        row.addWidget(self._again)
        row.addWidget(save)
        column.setContentsMargins(0, 6, 0, 0)
        column.addWidget(self._text, 1)
        column.addLayout(row)
        return tab

    def _clear(self) -> None:
        while (item := self._grid.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.deleteLater()

    def _say_empty(self) -> None:
        empty = QLabel("The rig has not been opened yet, so nothing is known of it.")
        empty.setProperty("role", "faint")
        self._grid.addWidget(empty, 0, 0, 1, 2)

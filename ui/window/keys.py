"""The window's keys, and the card that lists them."""

from dataclasses import dataclass

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QGridLayout, QLabel, QPushButton, QVBoxLayout, QWidget


@dataclass(frozen=True)
class Key:
    """What keys do."""

    name: str
    keys: tuple[str, ...]
    what: str


KEYS = (
    Key("stop", ("F12", "Esc"), "STOP: doser and run stop at once (Esc only while one of them goes on)"),
    Key("run", ("F5",), "run the sequence"),
    Key("pause", ("F6",), "pause at the end of the step, or go on"),
    Key("dry-run", ("F7",), "dry run: time, ink and disk; nothing moves"),
    Key("open", ("Ctrl+O",), "open a sequence file"),
    Key("save", ("Ctrl+S",), "save the sequence"),
    Key("undo", ("Ctrl+Z",), "undo the last edit of the sequence"),
    Key("redo", ("Ctrl+Shift+Z",), "do it again"),
    Key("page-1", ("Ctrl+1",), "Sequence page"),
    Key("page-2", ("Ctrl+2",), "Fit page"),
    Key("page-3", ("Ctrl+3",), "Doser page"),
    Key("page-4", ("Ctrl+4",), "Projector page"),
    Key("page-5", ("Ctrl+5",), "Runs page"),
    Key("page-6", ("Ctrl+6",), "Calibration page"),
    Key("page-7", ("Ctrl+7",), "log"),
    Key("page-8", ("Ctrl+8",), "Compare page"),
    Key("page-9", ("Ctrl+9",), "Regions page"),
    Key("page-10", ("Ctrl+Shift+O",), "Waves page: light sorted by orders of scattering"),
    Key("palette", ("Ctrl+Shift+P",), "all actions by their names"),
    Key("screenshot", ("Ctrl+Shift+S",), "save a picture of the window"),
    Key("layout-align", ("Ctrl+F1",), "pages for aligning: a large picture, and the projector"),
    Key("layout-calibrate", ("Ctrl+F2",), "pages for calibrating"),
    Key("layout-run", ("Ctrl+F3",), "pages for a run"),
    Key("layout-look", ("Ctrl+F4",), "pages for looking at results"),
    Key("layout", ("Ctrl+0",), "all pages where they were at first"),
    Key("theme", ("Ctrl+T",), "dark or light"),
    Key("full-screen", ("F11",), "full screen"),
    Key("help", ("F1",), "these keys"),
    Key("quit", ("Ctrl+Q",), "close the window; in a run it is asked whether to end that first"),
)
BY_NAME = {key.name: key for key in KEYS}


class KeyCard(QDialog):
    """Lists the keys; does not block the window."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keys")
        self.setModal(False)
        grid = QGridLayout()
        grid.setHorizontalSpacing(24)
        for row, key in enumerate(KEYS):
            name = QLabel(" or ".join(key.keys))
            name.setProperty("role", "heading")
            grid.addWidget(name, row, 0, Qt.AlignmentFlag.AlignRight)
            grid.addWidget(QLabel(key.what), row, 1)
        close = QPushButton("Close")
        close.clicked.connect(self.close)
        column = QVBoxLayout(self)
        column.addLayout(grid)
        column.addWidget(close)

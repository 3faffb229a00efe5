"""What has happened, line by line, with a filter."""

import logging
from datetime import datetime

from PySide6.QtCore import QEvent, QObject, Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QVBoxLayout,
    QWidget,
)

from ui.window import theme
from ui.window.kept_log import PARTS

MOST_LINES = 5000
EMPTY = "What happens to the rig and to runs will be listed here, with its time, and is kept on disk."
LEVELS = {"everything": logging.INFO, "warnings and errors": logging.WARNING, "errors": logging.ERROR}


class _Handler(QObject, logging.Handler):
    """Hands log records to the window's thread."""

    logged = Signal(int, str)

    def __init__(self) -> None:
        QObject.__init__(self)
        logging.Handler.__init__(self, logging.INFO)

    def emit(self, record: logging.LogRecord) -> None:  # type: ignore[override]
        """Take a record in, from any thread."""
        at = datetime.fromtimestamp(record.created).strftime("%H:%M:%S")
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            text += f" ({type(record.exc_info[1]).__name__}: {record.exc_info[1]})"
        self.logged.emit(record.levelno, f"{at}  {text}")


class LogPanel(QWidget):
    """Lists what tankrig's parts log, newest last; `KeptLog` keeps it on disk."""

    def __init__(self) -> None:
        super().__init__()
        self._lines = QListWidget()
        self._lines.setWordWrap(True)
        self._lines.setAlternatingRowColors(True)
        self._lines.setAccessibleName("log")
        self._level = QComboBox()
        self._level.addItems(list(LEVELS))
        self._level.setToolTip("how grave a line must be to be listed")
        self._filter = QLineEdit()
        self._filter.setPlaceholderText("only lines with these words")
        self._filter.setClearButtonEnabled(True)
        self._level.currentTextChanged.connect(self._sift)
        self._filter.textChanged.connect(self._sift)
        head = QHBoxLayout()
        head.addWidget(self._filter, 1)
        head.addWidget(self._level)
        column = QVBoxLayout(self)
        column.setContentsMargins(6, 4, 6, 4)
        column.addLayout(head)
        self._empty = QLabel(EMPTY)
        self._empty.setWordWrap(True)
        self._empty.setProperty("role", "faint")
        column.addWidget(self._empty)
        column.addWidget(self._lines, 1)
        self._handler = _Handler()
        self._handler.logged.connect(self._add, Qt.ConnectionType.QueuedConnection)
        for name in PARTS:
            logging.getLogger(name).addHandler(self._handler)
            logging.getLogger(name).setLevel(logging.INFO)

    def lines(self) -> list[str]:
        """Those that the filter lets through."""
        items = (self._lines.item(row) for row in range(self._lines.count()))
        return [item.text() for item in items if not item.isHidden()]

    def close_log(self) -> None:
        """Listen no more."""
        for name in PARTS:
            logging.getLogger(name).removeHandler(self._handler)
        self._handler.close()

    def _add(self, level: int, text: str) -> None:
        item = QListWidgetItem(text)
        item.setData(Qt.ItemDataRole.UserRole, level)
        _colour(item)
        self._lines.addItem(item)
        self._empty.hide()
        item.setHidden(not self._passes(item))
        if self._lines.count() > MOST_LINES:
            self._lines.takeItem(0)
        self._lines.scrollToBottom()

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802 - Qt's name
        """Another theme has other colours."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            for row in range(self._lines.count()):
                _colour(self._lines.item(row))

    def _sift(self) -> None:
        for row in range(self._lines.count()):
            item = self._lines.item(row)
            item.setHidden(not self._passes(item))

    def _passes(self, item: QListWidgetItem) -> bool:
        grave = int(item.data(Qt.ItemDataRole.UserRole)) >= LEVELS[self._level.currentText()]
        words = self._filter.text().lower().split()
        return grave and all(word in item.text().lower() for word in words)


def _colour(item: QListWidgetItem) -> None:
    """By how grave it is."""
    level, now = int(item.data(Qt.ItemDataRole.UserRole)), theme.current()
    if level >= logging.WARNING:
        item.setForeground(QColor(now.bad if level >= logging.ERROR else now.warning))

"""The steps of the run under way: done, going on, to come, and what it waits for."""

from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QProgressBar, QVBoxLayout, QWidget

from tankrig.run.journal import Event
from tankrig.sequence.sequence import Sequence
from ui.window import theme
from ui.window.status import RigStatus
from ui.window.words import duration


class RunList(QWidget):
    """Follows a run by its status and its journal."""

    def __init__(self) -> None:
        super().__init__()
        self._what, self._left = QLabel("No run yet. Press Run (F5) to carry the sequence out."), QLabel()
        self._what.setProperty("role", "heading")
        self._what.setWordWrap(True)
        self._left.setProperty("role", "faint")
        self._left.setWordWrap(True)
        self._bar = QProgressBar()
        self._bar.setFormat("%v of %m steps")
        self._bar.setMaximum(1)
        self._steps = QListWidget()
        self._steps.setAccessibleName("steps of the run")
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 6, 0, 0)
        for widget in (self._what, self._left, self._bar):
            column.addWidget(widget)
        column.addWidget(self._steps, 1)
        self._labels: list[str] = []

    def begin(self, sequence: Sequence) -> None:
        """A run of this sequence begins."""
        self._labels = [task.label for task in sequence.tasks]
        self._steps.clear()
        for label in self._labels:
            self._steps.addItem(QListWidgetItem(f"      {label}"))
        self._bar.setMaximum(len(self._labels))
        self._bar.setValue(0)

    def list_plan(self, lines: list[str], words: str) -> None:
        """List what a run would do."""
        self._what.setText(words)
        self._left.clear()
        self._labels = []
        self._steps.clear()
        self._steps.addItems([f"      {line}" for line in lines])
        self._bar.setMaximum(max(1, len(lines)))
        self._bar.setValue(0)

    def see(self, event: Event) -> None:
        """Take in what the run has recorded."""
        if event.kind == "step" and event["step"] < len(self._labels):
            self._mark(event["step"], "✓" if event["state"] == "done" else "▶")

    def follow(self, status: RigStatus) -> None:
        """Show how far the run is."""
        if status.progress is None:
            return
        self._what.setText(status.words[:1].upper() + status.words[1:])
        self._left.setText(f"about {duration(status.progress.remaining_s)} left")
        self._bar.setValue(status.progress.step)

    def end(self, words: str) -> None:
        """The run is over."""
        self._what.setText(words)
        self._left.clear()

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802 - Qt's name
        """Another theme has other colours."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            for step in range(self._steps.count()):
                self._colour(step)

    def _mark(self, step: int, sign: str) -> None:
        item = self._steps.item(step)
        item.setText(f"{sign}  {self._labels[step]}")
        self._colour(step)
        self._steps.scrollToItem(item)
        item.setTextAlignment(Qt.AlignmentFlag.AlignLeft)

    def _colour(self, step: int) -> None:
        item = self._steps.item(step)
        colour = {"✓": theme.current().good, "▶": theme.current().accent}.get(item.text()[:1])
        if colour is not None:
            item.setForeground(QColor(colour))

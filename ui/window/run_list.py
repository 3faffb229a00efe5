"""The steps of a run: done, going on, to come, and what it waits for."""

from PySide6.QtCore import QEvent
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QProgressBar, QVBoxLayout, QWidget

from ui.window import theme
from ui.window.shown import Shown, StepState
from ui.window.source import Kind
from ui.window.status import RigStatus
from ui.window.words import capitalised, duration

NO_RUN = "No run yet. Press Run (F5) to carry the sequence out; its steps will be ticked off here."


class RunList(QWidget):
    """Draws the steps of the source that is on screen, and of a run that goes on how far it is."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: Shown | None = None
        self._status = RigStatus()
        self._what, self._left = QLabel(NO_RUN), QLabel()
        self._what.setProperty("role", "heading")
        self._left.setProperty("role", "faint")
        for label in (self._what, self._left):
            label.setWordWrap(True)
        self._bar = QProgressBar()
        self._bar.setFormat("%v of %m steps")
        self._bar.setMaximum(1)
        self._steps = QListWidget()
        self._steps.setAccessibleName("steps of the run")
        column = QVBoxLayout(self)
        column.setContentsMargins(6, 6, 6, 0)
        for widget in (self._what, self._left, self._bar):
            column.addWidget(widget)
        column.addWidget(self._steps, 1)

    def show_source(self, shown: Shown) -> None:
        """Draw this source from now on."""
        if self._shown is not None:
            self._shown.steps_changed.disconnect(self._list)
            self._shown.step_changed.disconnect(self._mark)
            self._shown.fits_changed.disconnect(self._say)
        self._shown = shown
        shown.steps_changed.connect(self._list)
        shown.step_changed.connect(self._mark)
        shown.fits_changed.connect(self._say)
        self._list()

    def follow(self, status: RigStatus) -> None:
        """Show how far a run is that goes on."""
        self._status = status
        self._say()

    @property
    def empty(self) -> bool:
        """Whether there is no run to show."""
        return self._shown is None or self._shown.source.run is None

    def lines(self) -> list[str]:
        """The steps as they are listed, each with its sign."""
        return [self._steps.item(row).text() for row in range(self._steps.count())]

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802 - Qt's name
        """Another theme has other colours."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and self._shown is not None:
            for step in range(self._steps.count()):
                self._colour(step)

    def _list(self) -> None:
        shown = self._shown
        self._steps.clear()
        for step in range(len(shown.labels) if shown is not None else 0):
            self._steps.addItem(QListWidgetItem())
            self._write(step)
        self._say()

    def _mark(self, step: int) -> None:
        self._write(step)
        self._steps.scrollToItem(self._steps.item(step))
        self._say()

    def _write(self, step: int) -> None:
        if self._shown is not None:
            self._steps.item(step).setText(f"{self._shown.steps[step].value}  {self._shown.labels[step]}")
            self._colour(step)

    def _say(self) -> None:
        """What goes on, or how it ended."""
        shown = self._shown
        if shown is None or shown.source.run is None:
            self._what.setText(NO_RUN)
            self._left.clear()
            self._bar.setValue(0)
            return
        done, now = shown.steps.count(StepState.DONE), self._status.progress
        self._bar.setMaximum(max(1, len(shown.steps)))
        self._bar.setValue(done)
        if shown.source.kind is Kind.LIVE and self._status.running and now is not None:
            words = self._status.words
            self._left.setText("" if self._status.finishing else f"about {duration(now.remaining_s)} left")
        else:
            words = f"{shown.source.run.name}: {shown.ending}" if shown.ending else f"{shown.source.run.name}"
            self._left.setText(f"{done} of {len(shown.steps)} steps are done")
        self._what.setText(capitalised(words))

    def _colour(self, step: int) -> None:
        assert self._shown is not None
        now = theme.current()
        colours = {StepState.DONE: now.good, StepState.BEGUN: now.accent, StepState.TO_COME: now.text}
        self._steps.item(step).setForeground(QColor(colours[self._shown.steps[step]]))

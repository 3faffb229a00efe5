"""What a sequence would take, step by step: a dry run."""

from PySide6.QtWidgets import QLabel, QListWidget, QVBoxLayout, QWidget

from tankrig.sequence.dry_run import DryRun
from ui.window.words import capitalised, duration, volume

EMPTY = "Press Dry run (F7): what each step takes will be listed here; nothing moves."


class PlanList(QWidget):
    """Lists the steps of a dry run."""

    def __init__(self) -> None:
        super().__init__()
        self._what, self._steps = QLabel(EMPTY), QListWidget()
        self.waiting = False
        """Whether a dry run was asked for that could not be made yet."""
        self._what.setProperty("role", "heading")
        self._what.setWordWrap(True)
        self._steps.setAccessibleName("steps of the dry run")
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 6, 0, 0)
        column.addWidget(self._what)
        column.addWidget(self._steps, 1)

    def show_plan(self, plan: DryRun, words: str) -> None:
        """List what a run would do."""
        self.waiting = False
        self._what.setText(words)
        self._steps.clear()
        for step in plan.steps:
            ink = f", {volume(step.ink_ul)} of ink" if step.ink_ul else ""
            frames = f", {step.frames} frames" if step.frames else ""
            self._steps.addItem(f"{step.label}: {takes(step.seconds)}{ink}{frames}")

    def wait(self, why: str) -> None:
        """Say why nothing can be listed yet; it is listed as soon as it can."""
        self.waiting = True
        self._what.setText(capitalised(why))
        self._steps.clear()

    def clear(self) -> None:
        """The sequence has changed: the list is no longer true of it."""
        self._what.setText(EMPTY)
        self._steps.clear()

    @property
    def says(self) -> str:
        """What stands above the list."""
        return self._what.text()


def takes(seconds: float) -> str:
    """What a step takes, in words.

    >>> takes(0.0), takes(0.12), takes(4.2)
    ('no time', 'less than 1 s', '4 s')
    """
    return "no time" if seconds <= 0.0 else "less than 1 s" if seconds < 1.0 else duration(seconds)

"""What the background is at, how long it will take, what waits behind it, and a way to call it off."""

from functools import partial

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QHBoxLayout, QLabel, QMenu, QPushButton, QWidget

from ui.window.background import Background, Task
from ui.window.words import duration

EVERY_MS = 500
LONGEST = 46
"""Letters of a task's name in the strip; the menu has all of them."""


def in_words(task: Task) -> str:
    """A task and how far it is.

    >>> in_words(Task("the report of a", print, (), print, None))
    'the report of a: waits'
    """
    if task.began_s is None:
        return f"{task.name}: waits"
    share = "" if task.share is None else f" {100.0 * task.share:.0f} %"
    left = "" if task.left_s is None else f", about {duration(task.left_s)} left"
    return f"{task.name}: in work{share}{left}"


class WorkStrip(QWidget):
    """One line, hidden while nothing with a name is in work."""

    def __init__(self, background: Background) -> None:
        super().__init__()
        self._background = background
        self._words, self._cancel = QLabel(), QPushButton("Cancel")
        self._cancel.setToolTip("call off what is in work; with more in the queue, choose what")
        self._cancel.clicked.connect(self._choose)
        room = self._cancel.sizePolicy()
        room.setRetainSizeWhenHidden(True)  # or each beginning and end of work would lay the whole window out anew
        self._cancel.setSizePolicy(room)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self._words)
        row.addWidget(self._cancel)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._draw)
        background.changed.connect(self._draw)
        self._draw()

    def tasks(self) -> list[Task]:
        """Those that a person has asked for."""
        return [task for task in self._background.tasks if task.name]

    def _draw(self) -> None:
        tasks = self.tasks()
        self._cancel.setVisible(bool(tasks))
        if not tasks:
            self._words.clear()
            self.setToolTip("")
            self._timer.stop()
            return
        first = tasks[0]
        name = first.name if len(first.name) <= LONGEST else first.name[: LONGEST - 1] + "…"
        words = in_words(first).replace(first.name, name, 1)
        self._words.setText(words + (f" (and {len(tasks) - 1} more)" if len(tasks) > 1 else ""))
        self.setToolTip("\n".join(in_words(task) for task in tasks))
        if not self._timer.isActive():
            self._timer.start(EVERY_MS)

    def _choose(self) -> None:
        """Call off the one there is, or ask which."""
        tasks = self.tasks()
        if len(tasks) == 1:
            self._background.cancel(tasks[0])
            return
        menu = QMenu(self)
        for task in tasks:
            menu.addAction(f"Cancel {in_words(task)}", partial(self._background.cancel, task))
        menu.popup(self._cancel.mapToGlobal(self._cancel.rect().topLeft()))

"""Every action by its name: type some of it, press Enter."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QDialog, QLineEdit, QListWidget, QListWidgetItem, QVBoxLayout, QWidget


@dataclass(frozen=True)
class Action:
    """Something that a person can have done.

    Parameters
    ----------
    words
        What it does.
    keys
        That do it, for people; empty where there are none.
    do
        Does it.
    """

    words: str
    keys: str
    do: Callable[[], object]


def matching(actions: Iterable[Action], typed: str) -> list[Action]:
    """Actions whose words hold all words that were typed, in their order.

    >>> one, other = Action("dark or light", "Ctrl+T", print), Action("dry run", "F7", print)
    >>> [action.keys for action in matching([one, other], "DR")]
    ['F7']
    """
    words = typed.lower().split()
    return [action for action in actions if all(word in action.words.lower() for word in words)]


class Palette(QDialog):
    """A field and a list; it does not block the window, and goes when an action was chosen."""

    def __init__(self, parent: QWidget, actions: list[Action]) -> None:
        super().__init__(parent)
        self.setWindowTitle("All actions")
        self.setModal(False)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._actions, self._listed = actions, actions
        self.field, self.list = QLineEdit(), QListWidget()
        self.field.setPlaceholderText("what to do")
        self.field.textChanged.connect(self._sift)
        self.field.returnPressed.connect(self._act)
        self.field.installEventFilter(self)
        self.list.itemActivated.connect(lambda _: self._act())
        column = QVBoxLayout(self)
        column.addWidget(self.field)
        column.addWidget(self.list)
        self.list.setWordWrap(True)
        self.resize(640, 460)
        self._sift("")

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 - Qt's name
        """Up and down move in the list while the field is typed in."""
        if event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent):
            by = {Qt.Key.Key_Down: 1, Qt.Key.Key_Up: -1}.get(Qt.Key(event.key()), 0)
            if by:
                self.list.setCurrentRow(min(max(self.list.currentRow() + by, 0), self.list.count() - 1))
                return True
        return super().eventFilter(watched, event)

    def _sift(self, typed: str) -> None:
        self._listed = matching(self._actions, typed)
        self.list.clear()
        for action in self._listed:
            words = action.words[:1].upper() + action.words[1:]
            self.list.addItem(QListWidgetItem(words + (f"    {action.keys}" if action.keys else "")))
        self.list.setCurrentRow(0)

    def _act(self) -> None:
        row = self.list.currentRow()
        if 0 <= row < len(self._listed):
            do = self._listed[row].do
            self.close()
            do()

"""The line across the window that says what has happened and what to do; never a dialog that blocks."""

from collections.abc import Callable

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QWidget


class Banner(QFrame):
    """One sentence, perhaps a button for what to do, and one to put it away."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("banner")
        self._text = QLabel()
        self._text.setWordWrap(True)
        self._text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._action = QPushButton()
        self._action.clicked.connect(self._act)
        away = QPushButton("Put away")
        away.clicked.connect(self.hide)
        row = QHBoxLayout(self)
        row.setContentsMargins(12, 6, 8, 6)
        row.addWidget(self._text, 1)
        row.addWidget(self._action)
        row.addWidget(away)
        self._do: Callable[[], object] | None = None
        self.hide()

    @property
    def text(self) -> str:
        """What it says; empty when it is put away."""
        return "" if self.isHidden() else self._text.text()

    def say(self, sentence: str, level: str = "", action: str = "", do: Callable[[], object] | None = None) -> None:
        """Show a sentence; `level` is "", "good" or "bad"."""
        self._text.setText(sentence)
        self._action.setText(action)
        self._action.setVisible(bool(action))
        self._do = do
        self.setProperty("level", level)
        self.style().unpolish(self)
        self.style().polish(self)
        self.show()

    def _act(self) -> None:
        self.hide()
        if self._do is not None:
            self._do()

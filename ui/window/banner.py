"""The strip across the window that says what has happened and what to do; never a dialog that blocks.

It has its place whether it says something or not, so that nothing is pushed about. A notice stays until it is put away
or no longer true; all of them can be read again.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QFrame, QHBoxLayout, QListWidget, QPushButton, QVBoxLayout, QWidget

from ui.window.elided import Elided
from ui.window.theme import set_role

LINES = 2
MOST_SHOWN, MOST_KEPT = 20, 500
"""Notices that wait to be put away, and that can be read again."""
NOTHING = "Nothing to tell."


@dataclass(frozen=True)
class Notice:
    """Something that a person has to know.

    Parameters
    ----------
    sentence, level
        What is said; `level` is "", "good" or "bad".
    action, do
        Words on a button, and what it does; empty and None where there is nothing to do.
    key
        What it is about: another notice about the same takes its place, and `withdraw` ends it.
    at
        When it was said, by the clock on the wall.
    about
        Folder of the run that it is about, which `withdraw` ends, too.
    """

    sentence: str
    level: str
    action: str
    do: Callable[[], object] | None
    key: str
    at: str
    about: str = ""


class Banner(QFrame):
    """One notice at a time, the newest first."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("banner")
        self._notices: list[Notice] = []
        self.history: list[Notice] = []
        self._text = Elided(LINES)
        self._action, self._away, self._past = QPushButton(), QPushButton("Put away"), QPushButton("Earlier")
        self._action.clicked.connect(self._act)
        self._away.clicked.connect(self.put_away)
        self._past.setToolTip("all that was told since the window was opened, with its time")
        self._past.clicked.connect(self.show_history)
        row = QHBoxLayout(self)
        row.setContentsMargins(12, 2, 6, 2)
        row.addWidget(self._text, 1)
        for button in (self._action, self._away, self._past):
            row.addWidget(button)
        for button in (self._action, self._away):  # their room stays when they are not there
            policy = button.sizePolicy()
            policy.setRetainSizeWhenHidden(True)
            button.setSizePolicy(policy)
        self._draw()

    @property
    def text(self) -> str:
        """What it says now; empty where there is nothing to tell."""
        return self._notices[-1].sentence if self._notices else ""

    @property
    def action(self) -> str:
        """What its button offers; empty where there is none."""
        return self._notices[-1].action if self._notices else ""

    def say(
        self, sentence: str, level: str = "", action: str = "", do: Callable[[], object] | None = None, key: str = "",
        about: str = "",
    ) -> None:  # fmt: skip
        """Show a sentence; see `Notice`."""
        notice = Notice(sentence, level, action, do, key or sentence, time.strftime("%H:%M:%S"), about)
        others = [one for one in self._notices if one.key != notice.key]
        self._notices = [*others[-MOST_SHOWN + 1 :], notice]
        self.history = [*self.history[-MOST_KEPT + 1 :], notice]
        self._draw()

    def withdraw(self, *keys: str) -> None:
        """What was said about these is no longer true."""
        left = [one for one in self._notices if one.key not in keys and one.about not in keys]
        if left != self._notices:
            self._notices = left
            self._draw()

    def put_away(self) -> None:
        """The notice that is shown has been read; the one before it comes back."""
        self._notices = self._notices[:-1]
        self._draw()

    def press(self) -> None:
        """Do what the button offers."""
        self._action.click()

    def show_history(self) -> None:
        """List all that was told, the newest first."""
        self._card = QDialog(self.window())
        self._card.setWindowTitle("What was told")
        self._card.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        lines, close = QListWidget(), QPushButton("Close")
        lines.setWordWrap(True)
        lines.addItems([f"{one.at}  {one.sentence}" for one in reversed(self.history)] or [NOTHING])
        close.clicked.connect(self._card.close)
        column = QVBoxLayout(self._card)
        column.addWidget(lines)
        column.addWidget(close)
        self._card.resize(640, 360)
        self._card.show()

    def _act(self) -> None:
        if self._notices and self._notices[-1].do is not None:
            do = self._notices[-1].do
            self.put_away()
            do()

    def _draw(self) -> None:
        notice = self._notices[-1] if self._notices else None
        more = f"  (and {len(self._notices) - 1} more)" if len(self._notices) > 1 else ""
        self._text.say(f"{notice.at}  {notice.sentence}{more}" if notice is not None else NOTHING)
        self._action.setText(notice.action if notice is not None else "")
        self._action.setVisible(notice is not None and bool(notice.action))
        self._away.setVisible(notice is not None)
        level = "none" if notice is None else notice.level
        set_role(self, level, "level")
        set_role(self._text, "faint" if notice is None else "")

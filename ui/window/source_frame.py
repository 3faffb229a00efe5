"""A frame in the colour of a source, with its title: whatever stands inside belongs to it."""

from PySide6.QtWidgets import QFrame, QLabel, QVBoxLayout, QWidget

from ui.window.source import LIVE, Source
from ui.window.theme import set_role


class SourceFrame(QFrame):
    """Frames a widget.

    Parameters
    ----------
    inside
        The widget.
    about
        Where it is about the rig itself, whatever is looked at: what it is, for a title such as "LIVE: bench 2".
    """

    def __init__(self, inside: QWidget, about: str = "") -> None:
        super().__init__()
        self.setObjectName("source")
        self._about, self._source, self._trouble = about, LIVE, ""
        self.title = QLabel()
        self.title.setObjectName("sourceTitle")
        self.title.setMinimumWidth(60)
        column = QVBoxLayout(self)
        column.setContentsMargins(2, 2, 2, 2)
        column.setSpacing(0)
        column.addWidget(self.title)
        column.addWidget(inside, 1)
        self.show_source(LIVE)
        self.name_rig("the rig")

    def show_source(self, source: Source) -> None:
        """Say whose it is from now on."""
        self._source = source
        if self._about:
            return
        if self._trouble and source.recorded is None:
            self._say(self._trouble, "rig")
        else:
            self._say(source.title, source.kind.value)

    def say_trouble(self, words: str) -> None:
        """Why nothing comes from the camera, in place of its title; empty where nothing is wrong."""
        if words != self._trouble:
            self._trouble = words
            self.show_source(self._source)

    def name_rig(self, name: str) -> None:
        """Which rig it is about."""
        if self._about:
            self._say(f"{self._about} {name}", "live" if self._about == "LIVE:" else "rig")

    def _say(self, title: str, kind: str) -> None:
        self.title.setText(title)
        self.title.setToolTip(title)
        for widget in (self, self.title):
            set_role(widget, kind, "source")

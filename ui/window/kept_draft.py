"""The sequence that is being edited, kept in the window's settings: what is typed survives whatever happens to it."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, QSettings, QTimer

if TYPE_CHECKING:
    from ui.window.sequence_document import SequenceDocument

DRAFT_MS = 700
"""From the last letter typed to the draft on disk."""


class KeptDraft(QObject):
    """Writes what is typed into the settings, and knows what was kept when the window was closed last.

    Parameters
    ----------
    settings
        That outlive the window.
    document
        The sequence that is edited.
    tell
        Says a sentence to the person.
    """

    def __init__(self, settings: QSettings, document: "SequenceDocument", tell: Callable[[str], object]) -> None:
        super().__init__(document)
        self._settings, self._document, self._tell = settings, document, tell
        self._lost = False
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.timeout.connect(self.keep)

    @property
    def file(self) -> Path | None:
        """The file that was edited last, where it is still there."""
        last = self._settings.value("sequence")
        return Path(str(last)) if last and Path(str(last)).is_file() else None

    @property
    def text(self) -> str:
        """What was typed and not saved when the window was closed; empty where all was."""
        return str(self._settings.value("draft") or "")

    def follow(self) -> None:
        """Keep what is typed from now on."""
        self._document.changed.connect(lambda: self._timer.start(DRAFT_MS))

    def keep(self) -> None:
        """Write it now; where that fails it is told, once."""
        self._settings.setValue("sequence", str(self._document.path or ""))
        self._settings.setValue("draft", self._document.text if self._document.unsaved else "")
        self._settings.sync()
        if self._settings.status() is not QSettings.Status.NoError and not self._lost:
            self._lost = True
            self._tell(f"{self._settings.fileName()}: cannot be written, so that what is typed is not kept; save it")

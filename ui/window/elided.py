"""A label for a text of unknown length: what does not fit is cut, and can be seen when it is asked for."""

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel

BESIDE_PX = 8
"""Qt lays text that can be selected out as a document, which has 4 pixels to either side."""
MOST_PX = 16_777_215
"""As Qt has it where there is no limit."""


class Elided(QLabel):
    """So many lines of text; what does not fit is in the tooltip, or shown when it is asked for.

    Parameters
    ----------
    lines
        How many there is room for.
    """

    cut = Signal(bool)
    """Whether some of the text does not fit."""

    def __init__(self, lines: int) -> None:
        super().__init__()
        self._lines, self._whole, self._all = lines, "", False
        self.too_long = False
        """Whether some of the text does not fit."""
        self.setWordWrap(True)
        self.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.setMinimumWidth(120)
        self.setTextFormat(Qt.TextFormat.PlainText)
        self._limit()

    def say(self, text: str) -> None:
        """Say this."""
        self._whole = text
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 - Qt's name
        """Another width holds another part of it."""
        super().resizeEvent(event)
        self._fit()

    def show_all(self, all_lines: bool) -> None:
        """Take as many lines as the text needs, or no more than there is room for."""
        self._all = all_lines
        self._limit()
        self._fit()

    @property
    def whole(self) -> str:
        """All that it has to say."""
        return self._whole

    def _limit(self) -> None:
        height = self._lines * self.fontMetrics().lineSpacing() + 8
        self.setMinimumHeight(height)
        self.setMaximumHeight(MOST_PX if self._all else height)

    def _fit(self) -> None:
        text = self._whole
        fits = self._holds(text)
        if not (fits or self._all):
            low, high = 0, len(text)
            while high - low > 1:
                middle = (low + high) // 2
                low, high = (middle, high) if self._holds(text[:middle] + "…") else (low, middle)
            text = text[:low].rstrip() + "…"
        self.setText(text)
        self.setToolTip(self._whole if text != self._whole else "")
        self.too_long = not fits
        self.cut.emit(not fits)

    def _holds(self, text: str) -> bool:
        metrics, wrap = self.fontMetrics(), int(Qt.TextFlag.TextWordWrap.value)
        box = metrics.boundingRect(0, 0, max(1, self.contentsRect().width() - BESIDE_PX), 10_000, wrap, text)
        return box.height() <= self._lines * metrics.lineSpacing() + 2

"""A text editor that marks the line that is wrong."""

from PySide6.QtCore import QEvent, QMimeData, QRect, QSize, Qt
from PySide6.QtGui import QColor, QFontDatabase, QPainter, QPaintEvent, QResizeEvent, QTextCursor, QTextFormat
from PySide6.QtWidgets import QPlainTextEdit, QTextEdit, QWidget

from ui.window import theme


class _Numbers(QWidget):
    """Line numbers beside the text."""

    def __init__(self, editor: "MarkedText") -> None:
        super().__init__(editor)
        self._editor = editor

    def sizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """As wide as the longest number."""
        return QSize(self._editor.numbers_width(), 0)

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802 - Qt's name
        """Draw those in view."""
        self._editor.paint_numbers(self, event)


class MarkedText(QPlainTextEdit):
    """Plain text in a fixed font, with line numbers, one of which can be marked."""

    def __init__(self) -> None:
        super().__init__()
        self.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.setTabChangesFocus(True)
        self.setUndoRedoEnabled(False)  # the document's own stack does it
        self.marked = 0
        self._numbers = _Numbers(self)
        self.blockCountChanged.connect(lambda _: self._make_room())
        self.updateRequest.connect(self._scrolled)
        self._make_room()

    def canInsertFromMimeData(self, source: QMimeData) -> bool:  # noqa: N802 - Qt's name
        """Files that are dropped are opened by the window, and not written into the text by their names."""
        return not source.hasUrls() and super().canInsertFromMimeData(source)

    def mark(self, line: int) -> None:
        """Mark a line, from 1; 0 for none."""
        self.marked = line
        selections = []
        block = self.document().findBlockByNumber(line - 1)
        if line and block.isValid():
            selection = QTextEdit.ExtraSelection()  # type: ignore[attr-defined,unused-ignore]
            colour = QColor(theme.current().bad)
            colour.setAlpha(70)
            selection.format.setBackground(colour)
            selection.format.setProperty(QTextFormat.Property.FullWidthSelection, True)
            selection.cursor = QTextCursor(block)
            selections = [selection]
        self.setExtraSelections(selections)
        self._numbers.update()

    def go_to(self, line: int) -> None:
        """Bring a line into view."""
        block = self.document().findBlockByNumber(max(0, line - 1))
        self.setTextCursor(QTextCursor(block))
        self.centerCursor()

    def replace_text(self, text: str) -> None:
        """Show another text; cursor and view stay where they were."""
        if text == self.toPlainText():
            return
        position, scrolled = self.textCursor().position(), self.verticalScrollBar().value()
        self.blockSignals(True)
        self.setPlainText(text)
        self.blockSignals(False)
        cursor = self.textCursor()
        cursor.setPosition(min(position, len(text)))
        self.setTextCursor(cursor)
        self.verticalScrollBar().setValue(scrolled)
        self._make_room()

    def numbers_width(self) -> int:
        """Pixels that the numbers take."""
        return 14 + self.fontMetrics().horizontalAdvance("9") * len(str(max(99, self.blockCount())))

    def paint_numbers(self, onto: QWidget, event: QPaintEvent) -> None:
        """Draw the numbers of the lines in view."""
        now, painter = theme.current(), QPainter(onto)
        painter.fillRect(event.rect(), QColor(now.window))
        painter.setFont(self.font())
        block = self.firstVisibleBlock()
        top = self.blockBoundingGeometry(block).translated(self.contentOffset()).top()
        while block.isValid() and top <= event.rect().bottom():
            number, height = block.blockNumber() + 1, self.blockBoundingRect(block).height()
            painter.setPen(QColor(now.bad if number == self.marked else now.faint))
            text = f"▶{number}" if number == self.marked else str(number)
            painter.drawText(0, int(top), onto.width() - 6, int(height), Qt.AlignmentFlag.AlignRight, text)
            block, top = block.next(), top + height
        painter.end()

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802 - Qt's name
        """Another theme has other colours."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and hasattr(self, "_numbers"):
            self.mark(self.marked)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 - Qt's name
        """Keep the numbers beside the text."""
        super().resizeEvent(event)
        inside = self.contentsRect()
        self._numbers.setGeometry(QRect(inside.left(), inside.top(), self.numbers_width(), inside.height()))

    def _make_room(self) -> None:
        self.setViewportMargins(self.numbers_width(), 0, 0, 0)

    def _scrolled(self, area: QRect, by: int) -> None:
        if by:
            self._numbers.scroll(0, by)
        else:
            self._numbers.update(0, area.y(), self._numbers.width(), area.height())

"""What of a window's pixels can be read and seen, as WCAG 2.2 measures it: text, outlines, the keyboard's place."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtGui import QColor, QImage
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QCheckBox,
    QComboBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QListView,
    QPlainTextEdit,
    QProgressBar,
    QPushButton,
    QTabBar,
    QTreeView,
    QWidget,
)

from tests.window_rig import wait_ms
from ui.window import theme

Picture = NDArray[np.uint8]

LEAST_PX = 9
"""Height of what can be seen of a text, below which it is cut off."""


def picture_of(window: QWidget) -> Picture:
    """(rows, columns, 3) what a window shows."""
    image = window.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def luminance(colours: NDArray[np.integer]) -> NDArray[np.float64]:
    """(…) relative luminance of (…, 3) colours 0 … 255."""
    parts = colours / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return np.asarray(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of two luminances."""
    return np.asarray((np.maximum(one, other) + 0.05) / (np.minimum(one, other) + 0.05))


def best_contrast(part: Picture) -> float:
    """Between the most frequent colour and the one that is furthest from it."""
    colours, often = np.unique(part.reshape(-1, 3), axis=0, return_counts=True)
    lights = luminance(colours)
    return float(contrast(lights[often.argmax()], lights).max())


def texts(window: QWidget) -> Iterator[tuple[str, QRect]]:
    """Whatever is written in a window and can be used now, and where."""
    for widget in window.findChildren(QWidget):
        if not widget.isVisible() or not widget.isEnabled() or widget.visibleRegion().isEmpty():
            continue
        if isinstance(widget, QLabel) and widget.text() and not widget.pixmap().width():
            if not widget.visibleRegion().contains(widget.rect().center()):
                continue  # scrolled out by half: its words may be in the other one
            yield widget.text(), _seen(window, widget, widget.rect())
        elif isinstance(widget, QCheckBox) and widget.text():
            yield widget.text(), _seen(window, widget, widget.rect().adjusted(26, 2, 0, -2))
        elif isinstance(widget, QAbstractButton) and widget.text():
            yield widget.text(), _seen(window, widget, widget.rect().adjusted(8, 5, -8, -5))
        elif isinstance(widget, QLineEdit) and (widget.text() or widget.placeholderText()):
            yield widget.text() or widget.placeholderText(), _seen(window, widget, widget.rect().adjusted(4, 4, -4, -4))
        elif isinstance(widget, QComboBox) and widget.currentText():
            yield widget.currentText(), _seen(window, widget, widget.rect().adjusted(4, 4, -24, -4))
        elif isinstance(widget, QProgressBar) and widget.isTextVisible() and widget.text():
            yield widget.text(), _seen(window, widget, widget.rect().adjusted(3, 1, -3, -1))
        elif isinstance(widget, QTabBar):
            for number in range(widget.count()):
                yield widget.tabText(number), _seen(window, widget, widget.tabRect(number).adjusted(2, 2, -2, -5))
        elif isinstance(widget, QHeaderView) and widget.orientation() is Qt.Orientation.Horizontal:
            for number in range(widget.count()):
                left, wide = widget.sectionViewportPosition(number), widget.sectionSize(number)
                words = str(widget.model().headerData(number, Qt.Orientation.Horizontal) or "")
                if words:
                    yield words, _seen(window, widget.viewport(), QRect(left, 0, wide, widget.height()))
        elif isinstance(widget, QPlainTextEdit) and widget.toPlainText():
            yield "text", _seen(window, widget.viewport(), widget.viewport().rect())
        elif isinstance(widget, QAbstractItemView) and not isinstance(widget, QHeaderView):
            yield from _entries(window, widget)
        elif isinstance(widget, pg.PlotWidget):
            for name in ("left", "bottom"):
                axis = widget.getPlotItem().getAxis(name)
                if axis.isVisible():
                    rect = widget.mapFromScene(axis.sceneBoundingRect()).boundingRect()
                    yield f"axis {name}", _seen(window, widget, rect)


def _entries(window: QWidget, view: QAbstractItemView) -> Iterator[tuple[str, QRect]]:
    model = view.model()
    if isinstance(view, QTreeView):
        index = model.index(0, 0)
        while index.isValid():
            for column in range(model.columnCount()):
                beside = index.siblingAtColumn(column)
                words, rect = str(beside.data() or "").strip(), view.visualRect(beside)
                if words and rect.isValid():
                    yield words, _seen(window, view.viewport(), rect.adjusted(1, 1, -1, -1))
            index = view.indexBelow(index)
        return
    columns = 1 if isinstance(view, QListView) else model.columnCount()
    for row in range(model.rowCount()):
        for column in range(columns):
            index = model.index(row, column)
            words, rect = str(index.data() or "").strip(), view.visualRect(index)
            if words and rect.isValid():
                yield words, _seen(window, view.viewport(), rect.adjusted(1, 1, -1, -1))


def _seen(window: QWidget, widget: QWidget, rect: QRect) -> QRect:
    """The part of a widget's rectangle that can be seen, in the window."""
    inside = rect.intersected(widget.visibleRegion().boundingRect())
    return QRect(widget.mapTo(window, inside.topLeft()), inside.size())


def faint_texts(window: QWidget, picture: Picture, least: float = 4.5) -> tuple[int, list[tuple[str, float]]]:
    """How many texts there are, and those that stand out too little."""
    looked, found = 0, []
    for words, rect in texts(window):
        if rect.width() < LEAST_PX or rect.height() < LEAST_PX:
            continue
        looked += 1
        part = picture[rect.top() : rect.bottom() + 1, rect.left() : rect.right() + 1]
        if part.size and (seen := best_contrast(part)) < least:
            found.append((words[:40], round(seen, 2)))
    return looked, found


def thin_outlines(window: QWidget, picture: Picture, least: float = 3.0) -> tuple[int, list[tuple[str, float]]]:
    """How many things can be pressed or filled in, and those whose outline stands out too little from what is beside.

    Looked at is the middle of the left side, and of a box the left side of its square.
    """
    looked, found = 0, []
    for widget in window.findChildren(QWidget):
        kinds = QPushButton | QLineEdit | QComboBox | QCheckBox
        if not isinstance(widget, kinds) or not widget.isVisible() or not widget.isEnabled() or widget.hasFocus():
            continue
        middle = widget.mapTo(window, QPoint(0, widget.height() // 2))
        if not widget.visibleRegion().contains(QPoint(1, widget.height() // 2)) or middle.x() < 3:
            continue
        looked += 1
        lights = luminance(picture[middle.y(), middle.x() - 3 : middle.x() + 9])
        if (seen := float(contrast(lights[0], lights[1:6]).max())) < least:
            found.append(
                (f"{type(widget).__name__} {widget.accessibleName() or widget.toolTip()[:40]}", round(seen, 2))
            )
    return looked, found


def _name(widget: QWidget) -> str:
    return f"{type(widget).__name__} {widget.accessibleName() or widget.toolTip()[:40]}"


def faint_rings(window: Any, page: QWidget, least: float = 3.0) -> tuple[int, list[tuple[str, float]]]:
    """How many places of a page the keyboard can be at, and those whose ring stands out too little."""
    looked, found = 0, []
    wanted = QColor(theme.current().focus)
    colour = np.array([wanted.red(), wanted.green(), wanted.blue()], np.uint8)
    for widget in page.findChildren(QWidget):
        if not widget.isVisible() or not widget.isEnabled() or widget.visibleRegion().isEmpty():
            continue
        if not widget.focusPolicy() & Qt.FocusPolicy.TabFocus or widget.focusProxy() is not None:
            continue
        widget.setFocus(Qt.FocusReason.TabFocusReason)
        wait_ms(3)
        name = _name(widget)
        looked += 1
        ring = window.ring.geometry() if window.ring.isVisible() else QRect()
        picture = picture_of(window)
        part = picture[ring.top() : ring.bottom() + 1, ring.left() : ring.right() + 1]
        drawn = (part == colour).all(axis=-1).sum() if part.size else 0
        if drawn < ring.width():  # less than one side of it
            found.append((f"{name}: no ring", 0.0))
            continue
        around = picture[max(0, ring.top() - 2) : ring.bottom() + 3, max(0, ring.left() - 2) : ring.right() + 3]
        edges = np.concatenate([around[0], around[-1], around[:, 0], around[:, -1]])
        beside = edges[(edges != colour).any(axis=-1)]
        ground, often = np.unique(beside, axis=0, return_counts=True)
        seen = float(contrast(luminance(colour), luminance(ground[often.argmax()])))
        if seen < least:
            found.append((name, round(seen, 2)))
    return looked, found

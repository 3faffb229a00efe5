"""What a person finds on a page of the window: by the words on it, beside it, or that a screen reader says of it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QCoreApplication, QEvent, QPointF, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QComboBox,
    QLabel,
    QLineEdit,
    QProgressBar,
    QTabBar,
    QTableWidget,
    QWidget,
)

from tests.window_rig import until
from ui.window.elided import Elided
from ui.window.fields import CheckedField
from ui.window.palette import Palette
from ui.window.staggered_painter import StaggeredPainter
from ui.window.tank_plot import IndexedImage


def button(page: QWidget, words: str) -> QAbstractButton:
    """The button or box that says this, whatever key stands behind it ("Run  F5") and whether or not it asks more."""
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)  # what a page has just replaced nobody sees
    return _only([one for one in page.findChildren(QAbstractButton) if _says(one) == words], words)


def field(page: QWidget, name: str) -> CheckedField:
    """The checked field behind this name; where it has none, the one whose hint begins with these words."""
    named = [one for one in _behind(page, name) if isinstance(one, CheckedField)]
    hinted = [one for one in page.findChildren(CheckedField) if one.edit.accessibleName().startswith(name)]
    return _only(named or hinted, name)


def line(page: QWidget, name: str) -> QLineEdit:
    """The line of text that a screen reader calls so, or that asks for this while it is empty."""
    lines = page.findChildren(QLineEdit)
    return _only([one for one in lines if name in (one.accessibleName(), one.placeholderText())], name)


def choice(page: QWidget, name: str) -> QComboBox:
    """The list behind this name; where it has none, the one whose hint begins with these words."""
    lists = page.findChildren(QComboBox)
    named = [one for one in _behind(page, name) if isinstance(one, QComboBox)]
    return _only(named or [one for one in lists if one.toolTip().startswith(name)], name)


def rows_of(page: QWidget, name: str) -> Any:
    """The list, table or tree that a screen reader calls so."""
    return _only([one for one in page.findChildren(QAbstractItemView) if one.accessibleName() == name], name)


def bar(page: QWidget, name: str) -> QProgressBar:
    """The bar behind this name."""
    return _only([one for one in _behind(page, name) if isinstance(one, QProgressBar)], name)


def words_on(page: QWidget) -> str:
    """All that labels say that can be seen when the page is looked at, a line each; also what had to be cut."""
    seen = (one for one in page.findChildren(QLabel) if one.isVisibleTo(page))
    return "\n".join(one.whole if isinstance(one, Elided) else one.text() for one in seen)


def wrongs_on(page: QWidget) -> list[str]:
    """What is said to be wrong, by labels that can be seen."""
    labels = (one for one in page.findChildren(QLabel) if one.property("role") == "wrong" and one.isVisibleTo(page))
    return [one.text() for one in labels if one.text()]


def fill(typed_in: CheckedField, text: str) -> None:
    """Type this in place of what stands there."""
    typed_in.edit.selectAll()
    QTest.keyClick(typed_in.edit, Qt.Key.Key_Delete)
    QTest.keyClicks(typed_in.edit, text)


def cells(table: QTableWidget) -> list[list[str]]:
    """What a table says, row by row."""
    columns = range(table.columnCount())
    return [[table.item(row, column).text() for column in columns] for row in range(table.rowCount())]


def pictures(page: QWidget) -> dict[str, IndexedImage]:
    """The pictures of the tank that are shown, by what stands above them."""
    return {
        title: item
        for title, plot in _plots(page)
        if plot.getViewWidget().isVisibleTo(page)
        for item in plot.items
        if isinstance(item, IndexedImage) and item.isVisible()
    }


def dots(page: QWidget, title: str) -> list[tuple[float, float]]:
    """Place and value of each dot in the plot whose title begins with this; none where the plot is hidden."""
    return [dot for cloud in _drawn(page, title, pg.ScatterPlotItem) for dot in cloud]


def point_at(page: QWidget, x_mm: float, y_mm: float) -> None:
    """Move the mouse to a place of the tank in the only picture that is shown."""
    (widget,) = (item.getViewWidget() for item in pictures(page).values())
    scene = widget.getPlotItem().getViewBox().mapViewToScene(QPointF(x_mm, y_mm))
    QTest.mouseMove(widget.viewport(), widget.mapFromScene(scene))


def curves(page: QWidget, title: str) -> list[list[tuple[float, float]]]:
    """The points of each curve in the plot whose title begins with this; none where the plot is hidden."""
    return _drawn(page, title, pg.PlotDataItem)


def titles(page: QWidget) -> list[str]:
    """What stands above the plots."""
    return [title for title, _ in _plots(page)]


def painted(page: QWidget) -> None:
    """Let the window work until all that waits for its turn to be painted on a page has been."""
    until(lambda: not any(one.busy for one in page.findChildren(StaggeredPainter)))


def _drawn(page: QWidget, title: str, kind: type[Any]) -> list[list[tuple[float, float]]]:
    plot = _only([one for name, one in _plots(page) if name.startswith(title)], title)
    if not plot.getViewWidget().isVisibleTo(page):
        return []
    drawn = [item.getData() for item in plot.items if isinstance(item, kind)]
    return [list(zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True)) for x, y in drawn if x is not None]


def _plots(page: QWidget) -> Iterator[tuple[str, Any]]:
    for widget in page.findChildren(pg.PlotWidget):
        yield widget.getPlotItem().titleLabel.text, widget.getPlotItem()


def _says(one: QAbstractButton) -> str:
    words = one.text().partition("  ")[0].strip().rstrip("…")
    return "" if isinstance(one.parent(), QTabBar) else words


def _behind(page: QWidget, name: str) -> Iterator[QWidget]:
    for label in page.findChildren(QLabel):
        if label.text().strip().rstrip(":") == name and label.buddy() is not None:
            yield label.buddy()


def palette_of(window: Any) -> Palette:
    """The list of all actions, opened by its keys or by `show_palette`."""
    if not any(one.isVisible() for one in window.findChildren(Palette)):
        window.show_palette()
    return _only([one for one in window.findChildren(Palette) if one.isVisible()], "All actions")


def _only(found: list[Any], name: str) -> Any:
    assert len(found) == 1, f"{len(found)} on the page are called {name!r}"
    return found[0]

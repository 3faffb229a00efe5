"""Fields that check what is typed, and say what is allowed, with its unit."""

import math
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QLineEdit, QVBoxLayout, QWidget

from tankrig.ranges import Within
from ui.window.theme import set_role


def number(text: str) -> float | None:
    """What a person may have meant by a number; None where it is none.

    >>> number(" 1,5 "), number("2e3"), number("much"), number("")
    (1.5, 2000.0, None, None)
    """
    try:
        value = float(text.strip().replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def numbers(
    text: str, unit: str, count: int | None = None, optional: bool = False
) -> tuple[list[float] | None, str]:  # fmt: skip
    """Several numbers with commas or blanks between them, or what is wrong with the text.

    >>> numbers("30 60, 90", "mm"), numbers("", "mm", optional=True)
    (([30.0, 60.0, 90.0], ''), (None, ''))
    >>> numbers("high", "mm")
    (None, 'give numbers in mm, with blanks between them')
    """
    if optional and not text.strip():
        return None, ""
    values = [number(word) for word in text.replace(",", " ").replace(";", " ").split()]
    if not values or None in values or (count and len(values) != count):
        return None, f"give {f'{count} numbers' if count else 'numbers'} in {unit}, with blanks between them"
    return [value for value in values if value is not None], ""


SURE_MS = 15_000
"""A second press of a button that asks twice counts so long after the first."""


class CheckedField(QWidget):
    """A line of text that is read as typed; `value` is None while it makes no sense.

    Parameters
    ----------
    read
        From text to (value, "") or (None, what is wrong).
    unit
        Behind the field.
    hint
        What is allowed, as a tooltip.
    """

    changed = Signal()
    committed = Signal()
    """Enter was pressed, or the field left, with a value that makes sense."""

    def __init__(self, read: Callable[[str], tuple[Any, str]], unit: str, hint: str) -> None:
        super().__init__()
        self._read, self._hint = read, hint
        self.edit = QLineEdit()
        self.edit.setAcceptDrops(False)  # a file that is dropped is opened by the window
        self.edit.setToolTip(hint)
        self.edit.setAccessibleName(hint)
        self.setFocusProxy(self.edit)
        self.says = QLabel()
        self.says.setProperty("role", "wrong")
        self.says.setWordWrap(True)
        self.says.hide()
        column, row = QVBoxLayout(self), QHBoxLayout()
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        column.addLayout(row)
        column.addWidget(self.says)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(4)
        row.addWidget(self.edit, 100)
        if unit:
            label = QLabel(unit)
            label.setProperty("role", "faint")
            row.addWidget(label)
        row.addStretch(0)
        self._row = row
        self.edit.textEdited.connect(self._typed)
        self.edit.editingFinished.connect(self._finished)
        self._committed = ""

    @property
    def value(self) -> Any:
        """What it holds; None while that makes no sense."""
        return self._read(self.edit.text())[0]

    @property
    def wrong(self) -> str:
        """What is wrong with it, or nothing."""
        return self._read(self.edit.text())[1]

    def set_text(self, text: str) -> None:
        """Fill it without telling anybody."""
        self._committed = text
        if text != self.edit.text():
            self.edit.setText(text)
        self._mark()

    def look_again(self) -> None:
        """What is allowed has changed: check what stands there once more; an empty field is not blamed."""
        if self.edit.text():
            self._mark()

    def say_wrong(self) -> None:
        """Say what is wrong with it although nobody has typed: a button was pressed that needs its value."""
        self._mark()
        self.setFocus()

    def add(self, widget: QWidget) -> None:
        """Put a widget behind the field."""
        self._row.addWidget(widget)

    def hasFocus(self) -> bool:  # noqa: N802 - Qt's name
        """Whether a person types there."""
        return self.edit.hasFocus()

    def _typed(self) -> None:
        self._mark()
        self.changed.emit()

    def _finished(self) -> None:
        if not self.wrong and self.edit.text() != self._committed:
            self._committed = self.edit.text()
            self.committed.emit()

    def _mark(self) -> None:
        wrong = self.wrong
        self.edit.setToolTip(wrong or self._hint)
        self.says.setText(wrong)
        self.says.setVisible(bool(wrong))
        set_role(self.edit, "true" if wrong else "", "wrong")


class NumberField(CheckedField):
    """A number with a unit and a range."""

    def __init__(
        self,
        unit: str,
        low: float,
        high: float,
        what: str = "",
        optional: bool = False,
        whole: bool = False,
        above: bool = False,
        below: bool = False,
    ) -> None:
        def read(text: str) -> tuple[float | int | None, str]:
            if optional and not text.strip():
                return None, ""
            value = number(text)
            if value is None or (whole and value != int(value)):
                return None, f"{text or 'nothing'} is no {'whole ' if whole else ''}number; give {span}"
            if not within.holds(value):
                return None, f"{value:.10g} is outside of {span}"
            return (int(value) if whole else value), ""

        within = Within(low, high, "", above, below)
        span = f"{'more than ' if above else ''}{low:g} to {'less than ' if below else ''}{high:g} {unit}".strip()
        super().__init__(read, unit, f"{what}: {span}" if what else span)
        self.edit.setMinimumWidth(64)
        self.edit.setMaximumWidth(110)

    def set_value(self, value: float | None) -> None:
        """Fill it without telling anybody."""
        self.set_text("" if value is None else f"{value:.10g}")


def with_name(name: str | QLabel, field: QWidget) -> QWidget:
    """A field behind its name, as one widget that no line break parts."""
    whole = QWidget()
    row = QHBoxLayout(whole)
    row.setContentsMargins(0, 0, 0, 0)
    row.setSpacing(6)
    label = QLabel(name) if isinstance(name, str) else name
    label.setBuddy(field)
    row.addWidget(label)
    row.addWidget(field)
    return whole

"""A field for something small made of several parts, each of which may be left out."""

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QGridLayout, QLabel, QWidget

from tankrig.errors import TankrigError
from ui.window.fields import CheckedField, number

SYMBOLS = {"sigma_a": "σa", "sigma_s": "σs"}


class PartsField(QWidget):
    """One line of text for each field of a dataclass, such as how well each coefficient is to be known.

    Parameters
    ----------
    kind
        The dataclass; all its fields are numbers or texts such as "1 %", and may be left out.
    values
        Those that are set.
    hint
        As a tooltip.
    """

    changed = Signal(object)
    """A dictionary of the parts that are set, or None where none is; only while all make sense."""
    typed = Signal()
    """Whatever was typed, right or wrong."""

    def __init__(self, kind: type[Any], values: Mapping[str, Any], hint: str) -> None:
        super().__init__()
        self._kind = kind
        self.fields: dict[str, CheckedField] = {}
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        for row, part in enumerate(dataclasses.fields(kind)):
            field = CheckedField(partial(self._read, part.name), "", f"{part.name}: {hint}")
            value = values.get(part.name)
            field.set_text("" if value is None else str(value))
            field.edit.setPlaceholderText("any")
            field.changed.connect(self._tell)
            grid.addWidget(QLabel(SYMBOLS.get(part.name, part.name)), row, 0)
            grid.addWidget(field, row, 1)
            self.fields[part.name] = field

    def _read(self, name: str, text: str) -> tuple[Any, str]:
        if not text.strip():
            return None, ""
        value = number(text)
        part = text.strip() if value is None else value
        try:
            self._kind(**{name: part})
        except TankrigError as error:
            return None, str(error)
        return part, ""

    @property
    def wrong(self) -> str:
        """What is wrong with one of its parts, or nothing."""
        return next((field.wrong for field in self.fields.values() if field.wrong), "")

    def _tell(self) -> None:
        self.typed.emit()
        if not any(field.wrong for field in self.fields.values()):
            parts = {name: field.value for name, field in self.fields.items() if field.value is not None}
            self.changed.emit(parts or None)

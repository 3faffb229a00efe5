"""Forms for frozen dataclasses: a checked field for each of their fields, made from its type and its name's unit."""

import dataclasses
import types
import typing
from functools import partial
from pathlib import Path
from typing import Any, Literal

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QFormLayout, QLabel, QLineEdit, QPushButton, QWidget

from tankrig.ranges import Within, ranges_of
from ui.window.fields import CheckedField, NumberField, numbers
from ui.window.files import ask_for_file
from ui.window.parts_field import PartsField

UNITS = {"_ul": "µl", "_mm": "mm", "_ms": "ms", "_s": "s", "_px": "px"}
RANGES: dict[str, tuple[float, float]] = {
    "bit": (0, 15), "step": (0, 64), "steps": (2, 64), "index": (0, 2**24), "size": (2, 4096),
}  # fmt: skip
"""Of fields that do not declare theirs, because the projector decides."""
WIDE = (-1e6, 1e6)
HINTS = {
    "until": "capture no more once the live fit knows it so well; a share such as 1 %, or a number in its unit",
    "periods_mm": "from crest to crest of each wave; the finest two tell order 1, the third what still follows it",
    "shifts": "in which each wave is shown: 4, 8, …; waves half a period apart add up to the sheet",
    "heights_mm": "middles of sheets as thick as z, one after the other; empty: the sheet at z alone",
}
"""What fields mean that do not say it by their names."""
PICTURES = "Pictures (*.png *.tif *.tiff *.bmp *.pgm)"


def unit_of(name: str) -> str:
    """The unit that a name ends in.

    >>> unit_of("total_ul"), unit_of("seconds"), unit_of("frames")
    ('µl', 's', '')
    """
    if name == "seconds":
        return "s"
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def label_of(name: str) -> str:
    """A field's name for people.

    >>> label_of("total_ul"), label_of("at_least_s"), label_of("pattern")
    ('total', 'at least', 'pattern')
    """
    end = next((end for end in UNITS if name.endswith(end)), "")
    return name.removesuffix(end).replace("_", " ")


class Form(QWidget):
    """One row for each field of a dataclass.

    Parameters
    ----------
    kind
        The dataclass.
    values
        Those that are set; the others show their defaults, faintly.
    choices
        For text fields, the words to choose among.
    skip
        Fields to leave out.
    unset
        What it means when a field without a default is left empty.
    """

    edited = Signal(str, object)
    """Name of a field, and its new value; None: as by default."""
    doubted = Signal(str, str)
    """Name of a field in which something was typed, and what is wrong with that; empty where nothing is."""

    def __init__(
        self,
        kind: type[Any],
        values: dict[str, Any],
        choices: dict[str, list[str]],
        skip: tuple[str, ...] = (),
        unset: str = "default",
    ) -> None:
        super().__init__()
        self.rows: dict[str, QWidget] = {}
        self._unset = unset
        layout = QFormLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.ExpandingFieldsGrow)
        hints = typing.get_type_hints(kind, include_extras=False)
        for field in dataclasses.fields(kind):
            if field.name in skip or not field.init:
                continue
            default = None if field.default is dataclasses.MISSING else field.default
            within = ranges_of(kind).get(field.name) or Within(*RANGES.get(field.name, WIDE), "")
            widget = self._widget(field.name, hints[field.name], values.get(field.name), default, choices, within)
            self.rows[field.name] = widget
            label = QLabel(label_of(field.name))
            label.setToolTip(HINTS.get(field.name, ""))
            label.setBuddy(widget)
            layout.addRow(label, widget)

    def _widget(
        self, name: str, hint: Any, value: Any, default: Any, choices: dict[str, list[str]], within: Within
    ) -> QWidget:
        optional = default is not None or type(None) in typing.get_args(hint)
        hint = _without_none(hint)
        if typing.get_origin(hint) is Literal or name in choices:
            words = choices.get(name) or [str(word) for word in typing.get_args(hint)]
            return self._choice(name, words, value if value is not None else default)
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            parts = PartsField(hint, value if isinstance(value, dict) else {}, HINTS.get(name, ""))
            parts.typed.connect(lambda: self.doubted.emit(name, parts.wrong))
            parts.changed.connect(lambda found: self.edited.emit(name, found))
            return parts
        if hint is bool:
            return self._box(name, bool(default if value is None else value))
        if hint in (float, int):
            field: CheckedField = NumberField(
                unit_of(name),
                within.low,
                within.high,
                _hinted(name, label_of(name)),
                optional,
                hint is int,
                within.above,
                within.below,
            )
        elif name == "path":
            field = _file_field(name)
        elif typing.get_origin(hint) is tuple and str in typing.get_args(hint):
            field = CheckedField(_read_words, "", f"{label_of(name)}: names with blanks between them")
        elif typing.get_origin(hint) is tuple:
            field = _numbers_field(name, hint, optional)
        else:
            field = CheckedField(lambda text: (text or None, ""), "", label_of(name))
        field.set_text(_shown(value))
        field.edit.setPlaceholderText(_shown(default) or (self._unset if optional else ""))
        field.changed.connect(lambda: self._take(name, field))
        return field

    def _take(self, name: str, field: CheckedField) -> None:
        self.doubted.emit(name, field.wrong)
        if not field.wrong:
            self.edited.emit(name, field.value)

    def _choice(self, name: str, words: list[str], value: Any) -> QWidget:
        combo = QComboBox()
        combo.setAccessibleName(name)
        if value is not None and str(value) not in words:
            words = [str(value), *words]
        combo.addItems(words)
        combo.setCurrentText(str(value if value is not None else words[0]))
        combo.currentTextChanged.connect(lambda word: self.edited.emit(name, word))
        return combo

    def _box(self, name: str, value: bool) -> QWidget:
        box = QCheckBox("yes")
        box.setChecked(value)
        box.toggled.connect(lambda on: self.edited.emit(name, on))
        return box


def _file_field(name: str) -> CheckedField:
    """For the name of a picture, with a button to choose one."""
    field = CheckedField(lambda text: (text or None, "" if text else "choose a picture"), "", label_of(name))
    choose = QPushButton("Choose…")

    def take(path: Path) -> None:
        field.set_text(str(path))
        field.changed.emit()

    choose.clicked.connect(lambda: ask_for_file(field, "Choose a picture", Path.cwd(), PICTURES, take))
    field.add(choose)
    return field


def _read_words(text: str) -> tuple[list[str] | None, str]:
    """Several words with commas or blanks between them."""
    words = text.replace(",", " ").split()
    return (words, "") if words else (None, "give one name or more, with blanks between them")


def _numbers_field(name: str, hint: Any, optional: bool) -> CheckedField:
    """For several numbers with commas or blanks between them."""
    arguments = typing.get_args(hint)
    count = None if Ellipsis in arguments else len(arguments)
    wanted = f"{count} numbers" if count else "numbers"
    read = partial(numbers, unit=unit_of(name), count=count, optional=optional)
    return CheckedField(read, unit_of(name), _hinted(name, f"{label_of(name)}: {wanted} with blanks between them"))


def _hinted(name: str, words: str) -> str:
    """Words about a field, and what it means where its name does not say that."""
    return f"{words} ({HINTS[name]})" if name in HINTS else words


def _without_none(hint: Any) -> Any:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return next(part for part in typing.get_args(hint) if part is not type(None))
    return hint


def _shown(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return "  ".join(_shown(one) for one in value)
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def line_edits(widget: QWidget) -> list[QLineEdit]:
    """All lines of text in a form."""
    return widget.findChildren(QLineEdit)

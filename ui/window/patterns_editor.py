"""The sequence's patterns: a list, a form for the one that is chosen, and what it looks like."""

from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QLabel,
    QLineEdit,
    QListWidget,
    QPushButton,
    QScrollArea,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from tankrig.errors import SequenceError
from tankrig.pattern.cut_off import cut_off
from tankrig.pattern.kinds import KINDS, Cells, draw
from ui.window.flow import Flow
from ui.window.forms import Form, label_of
from ui.window.pattern_preview import PatternPreview
from ui.window.sequence_document import SequenceDocument
from ui.window.sequence_tables import pattern_table, patterns_in
from ui.window.sequence_text import patterns_of

if TYPE_CHECKING:
    from tankrig.bench import Bench

BY_KIND: dict[str, type[Any]] = {str(kind.kind): kind for kind in KINDS}
NEW: dict[str, dict[str, Any]] = {
    "sheet": {"y_mm": [-60.0, 60.0], "z_mm": [58.0, 62.0]},
    "rays": {"y_mm": [-40.0, 0.0, 40.0], "z_mm": [58.0, 62.0], "width_mm": 4.0},
    "stripes": {"period_mm": 16.0, "duty": 0.5},
    "gray-code": {"bit": 3},
    "phase-shift": {"period_px": 64.0, "step": 0},
    "checker": {"cell_px": 16},
    "hadamard": {"index": 5, "size": 16},
    "image": {"path": "picture.png"},
    "full": {"level": 255},
    "dark": {},
}
"""A beginning for each kind."""
NOT_TYPED = ("kind", "light")
"""Of patterns: `tankrig advise` designs cells' light, in rows, which a form has no field for."""
DOUBTED = "pattern, "


class PatternsEditor(QWidget):
    """Shows and edits the patterns of a document."""

    refused = Signal(str)
    shown = Signal(object)
    """A pattern (its kind) that a person wants on the projector."""

    def __init__(self, document: SequenceDocument) -> None:
        super().__init__()
        self._document, self._own = document, False
        self._bench: Bench | None = None
        self.names = QListWidget()
        self.names.setAccessibleName("patterns")
        self.names.currentTextChanged.connect(lambda _: self._show_form())
        self._kind = QComboBox()
        self._kind.addItems(list(NEW))
        self._kind.setToolTip("which kind of pattern to add")
        self._name = QLineEdit()
        self._name.setPlaceholderText("name of the new pattern")
        self._name.returnPressed.connect(self.add)
        add, remove = QPushButton("Add"), QPushButton("Remove")
        add.clicked.connect(self.add)
        remove.clicked.connect(self.remove)
        head = Flow(self._kind, self._name, add, remove)
        self._form_area = QScrollArea()
        self._form_area.setWidgetResizable(True)
        self._form_area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._form_area.setFrameShape(QScrollArea.Shape.NoFrame)
        self._preview = PatternPreview()
        self._wrong, self._note = QLabel(), QLabel()
        self._wrong.setProperty("role", "wrong")
        for label in (self._wrong, self._note):
            label.setWordWrap(True)
        right = QWidget()
        column = QVBoxLayout(right)
        column.setContentsMargins(8, 0, 0, 0)
        column.addWidget(self._form_area, 1)
        column.addWidget(self._wrong)
        column.addWidget(self._note)
        column.addWidget(self._preview.widget, 1)
        split = QSplitter(Qt.Orientation.Horizontal)
        split.addWidget(self.names)
        split.addWidget(right)
        split.setSizes([180, 400])
        split.setChildrenCollapsible(False)
        whole = QVBoxLayout(self)
        whole.setContentsMargins(0, 6, 0, 0)
        whole.addLayout(head)
        whole.addWidget(split, 1)
        document.changed.connect(self._refresh)
        self._refresh()

    def set_bench(self, bench: "Bench") -> None:
        """Say where the projector's pixels fall, and where the tank's wall ends."""
        self._bench = bench
        self._draw()

    def _tables(self) -> dict[str, Any]:
        return patterns_of(self._document.reading.table)

    def _refresh(self) -> None:
        current, names = self.names.currentItem(), list(self._tables())
        chosen = current.text() if current else ""
        self.names.blockSignals(True)
        self.names.clear()
        self.names.addItems(names)
        self.names.setCurrentRow(names.index(chosen) if chosen in names else 0)
        self.names.blockSignals(False)
        if not self._own:
            self._show_form()
        self._draw()

    def _chosen(self) -> tuple[str, dict[str, Any]] | None:
        item = self.names.currentItem()
        table = self._tables().get(item.text()) if item else None
        return (item.text(), table) if item and isinstance(table, dict) else None

    def _show_form(self) -> None:
        for sentence in self._document.forget_doubts(DOUBTED):
            self.refused.emit(sentence)
        chosen = self._chosen()
        kind = BY_KIND.get(str(chosen[1].get("kind"))) if chosen else None
        if chosen is None or kind is None:
            empty = QLabel("“dark” and “full” are always there.\nAdd a pattern above to name others.")
            empty.setProperty("role", "faint")
            empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
            self._form_area.setWidget(empty)
            return
        form = Form(
            kind, chosen[1], {}, skip=(*NOT_TYPED, *(["z_mm"] if kind is Cells else [])), unset="the whole wall"
        )
        form.edited.connect(self._edit)
        form.doubted.connect(lambda name, why: self._document.doubt(f"{DOUBTED}{label_of(name)}", why))
        self._form_area.setWidget(form)
        self._draw()

    def _draw(self) -> None:
        chosen = self._chosen()
        self._wrong.clear()
        self._note.clear()
        if self._bench is None:
            return
        pattern, wall = None, self._bench.wall
        if chosen is not None and (kind := BY_KIND.get(str(chosen[1].get("kind")))):
            try:
                values = {key: tuple(v) if isinstance(v, list) else v for key, v in chosen[1].items()}
                if "path" in values:
                    values["path"] = str(self._document.folder / str(values["path"]))
                described = kind(**values)
                pattern = draw(described, wall, chosen[0])
                self._note.setText("\n".join(cut_off(described, wall, self._bench.tank)))
            except (SequenceError, TypeError, ValueError) as error:
                self._wrong.setText(str(error))
        self._preview.show(pattern, wall)

    def _edit(self, name: str, value: Any) -> None:
        chosen = self._chosen()
        if chosen is None:
            return

        def change(document: Any) -> None:
            table = document["patterns"][chosen[0]]
            if value is None:
                table.pop(name, None)
            else:
                table[name] = value

        self._own = True
        self._change(f"{name} of a pattern", change, typing=True)
        self._own = False

    def add(self) -> None:
        """Add a pattern of the chosen kind under the name that was typed, or under the kind's."""
        kind = self._kind.currentText()
        name, number = self._name.text().strip() or kind, 2
        while name in self._tables() or name in ("dark", "full"):
            name, number = f"{self._name.text().strip() or kind} {number}", number + 1
        table = {"kind": kind, **NEW[kind]}
        self._change(f"add {name}", lambda document: patterns_in(document).__setitem__(name, pattern_table(table)))
        self._name.clear()
        self.names.setCurrentRow(list(self._tables()).index(name) if name in self._tables() else 0)

    def remove(self) -> None:
        """Take the chosen pattern out."""
        chosen = self._chosen()
        if chosen is not None:
            self._change(f"remove {chosen[0]}", lambda document: document["patterns"].pop(chosen[0]))

    def _change(self, what: str, change: Any, typing: bool = False) -> None:
        try:
            self._document.edit(what, change, typing)
        except SequenceError as error:
            self.refused.emit(str(error))

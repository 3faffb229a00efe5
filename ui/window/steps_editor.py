"""The sequence's steps as a tree, and a form for the one that is chosen."""

import math
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QEvent, Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QLabel,
    QPushButton,
    QScrollArea,
    QSplitter,
    QTreeWidget,
    QTreeWidgetItem,
    QVBoxLayout,
    QWidget,
)

from tankrig.errors import SequenceError
from tankrig.pattern.kinds import LEAST_PIXELS
from tankrig.sequence.steps import Burst, Capture, Dose, Mix, Note, Repeat, Separate, Series, Wait
from ui.window import theme
from ui.window.flow import Flow
from ui.window.forms import Form, label_of
from ui.window.sequence_document import SequenceDocument
from ui.window.sequence_tables import inline, on_one_line, step_table, steps_in
from ui.window.sequence_text import Path_, at, line_of, patterns_of

if TYPE_CHECKING:
    from tankrig.pattern.wall import Wall

STEPS: dict[str, type[Any]] = {
    "capture": Capture, "dose": Dose, "mix": Mix, "series": Series, "repeat": Repeat, "wait": Wait, "note": Note,
    "burst": Burst, "separate": Separate,
}  # fmt: skip
NEW: dict[str, dict[str, Any]] = {
    "capture": {"do": "capture", "pattern": "full", "frames": 4},
    "dose": {"do": "dose", "total_ul": 100.0},
    "mix": {"do": "mix", "pattern": "full"},
    "series": {"do": "series", "total_ul": [100.0, 200.0], "steps": [{"do": "capture", "pattern": "full"}]},
    "repeat": {"do": "repeat", "times": 2, "steps": [{"do": "capture", "pattern": "full"}]},
    "wait": {"do": "wait", "seconds": 10.0},
    "note": {"do": "note", "text": "what was seen"},
    "burst": {"do": "burst", "patterns": ["full"]},
    "separate": {"do": "separate", "z_mm": [58.0, 62.0]},
}
FINEST_MM, SHEET_MM = 4.0, 4.0
"""Period of the finest wave and thickness of its sheet, where the projector is fine enough."""
ALWAYS = ("dark", "full")
DOUBTED = "step, "
PLACE = Qt.ItemDataRole.UserRole


def words_of(step: Any) -> str:
    """A step of a file, right or wrong, in words.

    >>> words_of({"do": "capture", "pattern": "sheet", "frames": 4}), words_of({"do": "dance"})
    ('capture sheet × 4', 'dance')
    """
    if not isinstance(step, dict):
        return "not a step"
    match step.get("do"):
        case "dose":
            return f"dose to {step.get('total_ul', '?')} µl"
        case "mix":
            return f"wait until mixed, looking at {step.get('pattern', 'full')}"
        case "capture":
            most = " at most, until it is known" if "until" in step else ""
            return f"capture {step.get('pattern', '?')} × {step.get('frames', 1)}{most}"
        case "burst":
            patterns = step.get("patterns", [])
            return f"burst of {len(patterns) if isinstance(patterns, list) else '?'} patterns × {step.get('times', 1)}"
        case "separate":
            periods = step.get("periods_mm", Separate.periods_mm)
            named = ", ".join(_short(one) for one in periods) if isinstance(periods, list | tuple) else periods
            return f"separate by waves of {named} mm"
        case "wait":
            return f"wait {step.get('seconds', '?')} s"
        case "note":
            return f"note: {step.get('text', '')}"
        case "repeat":
            return f"{step.get('times', '?')} times"
        case "series":
            totals = step.get("total_ul", [])
            return f"series of doses to {', '.join(map(str, totals)) if isinstance(totals, list) else totals} µl"
        case other:
            return str(other or "a step of no kind")


def separation_for(wall: "Wall") -> dict[str, Any]:
    """A step that separates orders of scattering, as this projector can show it: half-way up, by three waves.

    >>> from tankrig.pattern.wall import Wall
    >>> separation_for(Wall((120, 160), (-80.0, 80.0), (0.0, 120.0)))
    {'do': 'separate', 'z_mm': [58.0, 62.0], 'periods_mm': [4.0, 8.0, 16.0]}
    >>> separation_for(Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)))
    {'do': 'separate', 'z_mm': [56.0, 64.0], 'periods_mm': [16.0, 32.0, 64.0]}
    """
    row_mm, column_mm = wall.pixel_mm
    half = 0.5 * max(SHEET_MM, 2.0 * math.ceil(row_mm))
    middle = float(round(0.5 * sum(wall.z_mm)))
    finest = FINEST_MM * 2.0 ** max(0, math.ceil(math.log2(LEAST_PIXELS * column_mm / FINEST_MM)))
    return {"do": "separate", "z_mm": [middle - half, middle + half], "periods_mm": [finest, 2 * finest, 4 * finest]}


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


class StepsEditor(QWidget):
    """Shows and edits the steps of a document."""

    refused = Signal(str)
    """Why an edit was not made."""

    def __init__(self, document: SequenceDocument) -> None:
        super().__init__()
        self._document, self._own = document, False
        self._wall: Wall | None = None
        self.tree = QTreeWidget()
        self.tree.setHeaderHidden(True)
        self.tree.setAccessibleName("steps")
        self.tree.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.tree.currentItemChanged.connect(lambda *_: self._show_form())
        self._form_area = QScrollArea()
        self._form_area.setWidgetResizable(True)
        self._form_area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._form_area.setFrameShape(QScrollArea.Shape.NoFrame)
        self._kind = QComboBox()
        self._kind.addItems(list(STEPS))
        self._kind.setToolTip("what to add behind the chosen step")
        buttons = {
            "Add": self.add, "Remove": self.remove, "Up": lambda: self.move_step(-1), "Down": lambda: self.move_step(1)
        }  # fmt: skip
        head = Flow(self._kind)
        for name, do in buttons.items():
            button = QPushButton(name)
            button.setToolTip(f"{name.lower()} a step" if name == "Add" else f"{name.lower()}: the chosen step")
            button.clicked.connect(do)
            head.addWidget(button)
        self.separate = QPushButton("Separate")
        self.separate.setToolTip(
            "add a step that tells light scattered once from the rest: waves of light in a thin sheet, shifted step by "
            "step; the Waves page shows what they tell"
        )
        self.separate.clicked.connect(self.add_separation)
        head.addWidget(self.separate)
        split = QSplitter(Qt.Orientation.Horizontal)
        split.addWidget(self.tree)
        split.addWidget(self._form_area)
        split.setSizes([280, 300])
        split.setChildrenCollapsible(False)
        column_layout = QVBoxLayout(self)
        column_layout.setContentsMargins(0, 6, 0, 0)
        column_layout.addLayout(head)
        column_layout.addWidget(split, 1)
        document.changed.connect(self._refresh)
        self._refresh()

    # -- what is shown -------------------------------------------------------------------------------------------------

    def place(self) -> Path_ | None:
        """Where in the document the chosen step stands."""
        item = self.tree.currentItem()
        return None if item is None else tuple(item.data(0, PLACE))

    def choose(self, place: Path_) -> None:
        """Choose the step at a place."""
        for item in self._items():
            if tuple(item.data(0, PLACE)) == place:
                self.tree.setCurrentItem(item)

    def _refresh(self) -> None:
        place = self.place()
        self.tree.blockSignals(True)
        self.tree.clear()
        self._fill(self.tree.invisibleRootItem(), self._document.reading.table.get("steps", []), ())
        self.tree.expandAll()
        if place is not None:
            self.choose(place)
        self.tree.blockSignals(False)
        self._mark()
        if not self._own:
            self._show_form()

    def _fill(self, parent: QTreeWidgetItem, steps: Any, above: Path_) -> None:
        for number, step in enumerate(steps if isinstance(steps, list) else []):
            item = QTreeWidgetItem(parent, [words_of(step)])
            here: Path_ = (*above, "steps", number)
            item.setData(0, PLACE, list(here))
            item.setToolTip(0, words_of(step))
            if isinstance(step, dict):
                self._fill(item, step.get("steps", []), here)

    def _mark(self) -> None:
        """Mark the step that the problem's line is in."""
        problem = self._document.problem
        if problem is None or not problem.line:
            return
        lines = [(line_of(self._document.text, _spelt(item.data(0, PLACE))), item) for item in self._items()]
        before = [entry for entry in lines if 0 < entry[0] <= problem.line]
        if before and not self._in_patterns(problem.line):
            _, item = before[-1]
            item.setForeground(0, QColor(theme.current().bad))
            item.setText(0, f"⚠ {item.text(0).removeprefix('⚠ ')}")
            item.setToolTip(0, problem.sentence)

    def _in_patterns(self, line: int) -> bool:
        heads = [row for row in self._document.text.splitlines()[:line] if row.lstrip().startswith("[")]
        return bool(heads) and heads[-1].lstrip().startswith("[patterns")

    def _items(self) -> list[QTreeWidgetItem]:
        found = self.tree.findItems("", Qt.MatchFlag.MatchContains | Qt.MatchFlag.MatchRecursive)
        return list(found)

    def _show_form(self) -> None:
        for sentence in self._document.forget_doubts(DOUBTED):
            self.refused.emit(sentence)
        place = self.place()
        table = None
        if place is not None:
            try:
                table = at(self._document.reading.table, place)
            except (LookupError, TypeError):
                table = None
        kind = STEPS.get(str(table.get("do"))) if isinstance(table, dict) else None
        if table is None or kind is None:
            empty = QLabel("Choose a step to edit it,\nor add one." if self.tree.topLevelItemCount() else
                           "No steps yet: choose what\nto do above, and add it.")  # fmt: skip
            empty.setProperty("role", "faint")
            empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
            self._form_area.setWidget(empty)
            return
        patterns = [*ALWAYS, *patterns_of(self._document.reading.table)]
        choices = {"pattern": patterns} if kind in (Capture, Mix) else {}
        form = Form(kind, table, choices, skip=("do", "steps"))
        form.edited.connect(self._edit)
        form.doubted.connect(lambda name, why: self._document.doubt(f"{DOUBTED}{label_of(name)}", why))
        form.setContentsMargins(10, 4, 10, 4)
        self._form_area.setWidget(form)

    def changeEvent(self, event: QEvent) -> None:  # noqa: N802 - Qt's name
        """Another theme has other colours."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            self._mark()

    # -- edits ---------------------------------------------------------------------------------------------------------

    def _edit(self, name: str, value: Any) -> None:
        place = self.place()
        if place is None:
            return

        def change(document: Any) -> None:
            step = at(document, place)
            if value is None:
                step.pop(name, None)
            else:
                step[name] = inline(value)

        self._own = True
        try:
            self._document.edit(f"{name} of a step", change, typing=True)
        except SequenceError as error:
            self.refused.emit(str(error))
        finally:
            self._own = False

    def set_wall(self, wall: "Wall") -> None:
        """Which projector new steps are for."""
        self._wall = wall

    def add_separation(self) -> None:
        """Add a step that separates orders of scattering behind the chosen one."""
        self._kind.setCurrentText("separate")
        self.add()

    def add(self) -> None:
        """Add a step of the chosen kind behind the chosen one."""
        place: Path_ = self.place() or ("steps", self.tree.topLevelItemCount() - 1)
        kind, number = self._kind.currentText(), int(place[-1]) + 1
        new = separation_for(self._wall) if kind == "separate" and self._wall is not None else NEW[kind]
        self._change(f"add {kind}", lambda steps: steps.insert(number, step_table(new, on_one_line(steps))), place)
        self.choose((*place[:-1], number))

    def remove(self) -> None:
        """Take the chosen step out."""
        place = self.place()
        if place is not None:
            self._change("remove a step", lambda steps: steps.pop(place[-1]), place)

    def move_step(self, by: int) -> None:
        """Move the chosen step up (−1) or down (1) among its neighbours."""
        place = self.place()
        if place is None:
            return
        number = int(place[-1])
        if 0 <= number + by < len(at(self._document.reading.table, place[:-1])):
            self._change("move a step", lambda steps: steps.insert(number + by, steps.pop(number)), place)
            self.choose((*place[:-1], number + by))

    def _change(self, what: str, change: Any, place: Path_) -> None:
        """Change the list of steps that `place` is in."""
        try:
            self._document.edit(what, lambda document: change(steps_in(at(document, place[:-2]), len(place) > 2)))
        except SequenceError as error:
            self.refused.emit(str(error))


def _spelt(place: list[str | int]) -> str:
    """A place as messages spell it, down to the step's kind."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)[1:] + ".do ="

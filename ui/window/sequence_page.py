"""The sequence: build it, check it, run it."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QApplication,
    QLabel,
    QMenu,
    QPushButton,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from tankrig.errors import TankrigError
from ui.window.fields import NumberField, with_name
from ui.window.files import ask_for_file, ask_where_to_save
from ui.window.first_start import EXAMPLE, FirstStart
from ui.window.flow import Flow, take_rest
from ui.window.fresh_water import BUTTON, WAY, asks_for_it
from ui.window.marked_text import MarkedText
from ui.window.patterns_editor import PatternsEditor
from ui.window.plan_list import PlanList
from ui.window.run_list import RunList
from ui.window.sequence_document import SequenceDocument
from ui.window.sequence_tables import free_name, inline, on_one_line, pattern_table, patterns_in, step_table, steps_in
from ui.window.sequence_text import patterns_of
from ui.window.shown import Shown
from ui.window.source_frame import SourceFrame
from ui.window.status import RigStatus
from ui.window.steps_editor import StepsEditor
from ui.window.theme import set_role
from ui.window.words import capitalised, duration, size, volume

if TYPE_CHECKING:
    from ui.window.jobs import Suggestion

WAITING = "The rig is being opened; what each step takes will be listed here then."
KINDS = "Sequences (*.toml)"


class SequencePage(QWidget):
    """Edits one sequence document, and follows the run of it."""

    told = Signal(str)
    """What a person has to know."""
    run_asked = Signal()
    rig_asked = Signal()
    runs_asked = Signal()
    """Before there is a sequence: a rig file, or the runs that there are."""
    opened = Signal(object)
    """Path of a sequence that was opened."""
    recent_asked = Signal(object)
    """Path of something that was open lately and is wanted again."""
    wrong = Signal(str)
    """What a person has to know of the sequence, for as long as its problem is the same."""
    water_asked = Signal()
    """Fresh water in the tank would mend what is wrong."""
    dropped = Signal(str)
    """A text that was edited and not saved before another was opened."""

    def __init__(self, simulated: bool = False) -> None:
        super().__init__()
        self.first, self._building, self._anew = FirstStart(simulated), False, False
        self.first.try_asked.connect(self.try_example)
        self.first.build_asked.connect(self._build)
        self.first.rig_asked.connect(self.rig_asked)
        self.first.run_asked.connect(self.runs_asked)
        self.document = SequenceDocument()
        self.steps = StepsEditor(self.document)
        self.patterns = PatternsEditor(self.document)
        self.text = MarkedText()
        self.plan_list, self.run_list = PlanList(), RunList()
        self.run_frame = SourceFrame(self.run_list)
        self.steps.refused.connect(self.wrong)
        self.patterns.refused.connect(self.wrong)
        self.text.textChanged.connect(lambda: self.document.edit_text(self.text.toPlainText()))
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        for title, widget in (
            ("Steps", self.steps), ("Patterns", self.patterns), ("Text", self.text), ("Dry run", self.plan_list),
            ("Run", self.run_frame),
        ):  # fmt: skip
            self.tabs.addTab(widget, title)
        self._title, self._says, self._notes = QLabel(), QLabel(), QLabel()
        self._title.setProperty("role", "heading")
        self._says.setWordWrap(True)
        self._notes.setWordWrap(True)
        self._water = QPushButton(WAY)
        self._water.setToolTip(f"where “{BUTTON}” begins a new ledger for the tank")
        self._water.clicked.connect(self.water_asked)
        self._water.hide()
        self._exposure = NumberField("ms", 1e-3, 1e5, "exposure of frames whose step says nothing else")
        self._exposure.changed.connect(self._set_exposure)
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 8, 10, 8)
        column.addLayout(self._head())
        column.addWidget(self.first, 1)
        take_rest(self.tabs, 230)
        column.addWidget(self.tabs, 1)
        column.addWidget(self._says)
        column.addWidget(self._notes)
        column.addLayout(self._foot())
        self.document.changed.connect(self._refresh)
        self.document.undo.canUndoChanged.connect(self._undone)
        self.document.checked.connect(self._tell)
        self.document.changed.connect(self._list_plan_that_waits)
        self._busy = False
        self._refresh()

    # -- asked by keys and buttons -------------------------------------------------------------------------------------

    def open_file(self) -> None:
        """Ask for a file and open it."""
        folder = self.document.path.parent if self.document.path else Path.cwd()
        ask_for_file(self, "Open a sequence", folder, KINDS, self.load)

    def load(self, path: Path) -> None:
        """Open a file, right or wrong; a wrong one with its line marked."""
        unsaved = self.document.text if self.document.unsaved else ""
        try:
            self.document.load(path)
        except TankrigError as error:
            self.told.emit(str(error))
            return
        if path != EXAMPLE:
            self.opened.emit(path)
        problem = self.document.problem
        if problem is not None:
            self.tabs.setCurrentWidget(self.text)
            self.text.go_to(problem.line)
            self.wrong.emit(f"{path.name}: {problem.sentence}")
        if unsaved:
            self.dropped.emit(unsaved)  # last, for it can be put right now only

    def list_recent(self, paths: list[Path]) -> None:
        """What was open lately stands in the menu of the button “Recent”."""
        menu = self._recent.menu()
        assert menu is not None
        menu.clear()
        for path in paths:
            menu.addAction(f"{path.name}    {path.parent}", partial(self.recent_asked.emit, path))
        self._recent.setEnabled(bool(paths))

    def try_example(self) -> None:
        """Open the example and show what it would take; the next press of Run carries it out."""
        self.load(EXAMPLE)
        self.document.detach()
        self.dry_run()

    def append(self, suggestion: "Suggestion") -> None:
        """Append what is to be photographed next: the dose and its mixing where ink is needed, and the capture."""

        def change(document: Any) -> None:
            pattern = suggestion.pattern
            if suggestion.table is not None:
                known = patterns_of(document)
                pattern = free_name(pattern, suggestion.table, known)
                if pattern not in known:
                    patterns_in(document)[pattern] = pattern_table(suggestion.table)
            more = {name: inline(value) for name, value in suggestion.more.items()}
            new = [{"do": "capture", "pattern": pattern, "frames": suggestion.frames} | more]
            if suggestion.total_ul is not None:
                dose = {"do": "dose", "total_ul": suggestion.total_ul}
                new = [dose, {"do": "mix", "pattern": pattern}, *new]
            steps = steps_in(document, nested=False)
            for step in new:
                steps.append(step_table(step, on_one_line(steps)))

        try:
            self.document.edit("append what was advised", change)
        except TankrigError as error:
            self.told.emit(str(error))
        else:
            self.tabs.setCurrentWidget(self.steps)
            self.told.emit(f"{suggestion.pattern} × {suggestion.frames} is appended to the sequence; Ctrl+Z undoes it")

    def append_separation(self) -> None:
        """Append a step that separates orders of scattering, and show its form."""
        self._building = True
        self._refresh()
        self.tabs.setCurrentWidget(self.steps)
        self.steps.add_separation()

    def begin_anew(self) -> None:
        """An empty sequence, and the ways to begin; what was edited and is in no file is offered back."""
        unsaved = self.document.text if self.document.unsaved else ""
        self._building, self._anew = False, True
        self.tabs.setCurrentWidget(self.steps)
        self.document.begin_anew()
        if unsaved:
            self.dropped.emit(unsaved)

    def _build(self) -> None:
        self._building = True
        self._refresh()

    @property
    def beginning(self) -> bool:
        """Whether there is no sequence yet, and nobody has begun to build one."""
        return self.document.empty and not self._building

    @property
    def hindrance(self) -> str:
        """What keeps the sequence from being run; empty where nothing does."""
        if self.document.plan is not None:
            return ""
        problem = self.document.problem
        return "nothing to carry out yet: write or open a sequence" if problem is None else problem.sentence

    def edit_unsaved(self, text: str) -> None:
        """Edit a text that no file has."""
        self.document.edit_unsaved(text)

    def save(self) -> None:
        """Save to the file that was opened, or to one that is asked for."""
        if self.document.path is None:
            self.save_as()
        else:
            self._save(self.document.path)

    def save_as(self) -> None:
        """Ask for a file and save."""
        proposal = self.document.path or Path.cwd() / "sequence.toml"
        ask_where_to_save(self, "Save the sequence", proposal, KINDS, self._save)

    def _save(self, path: Path) -> None:
        try:
            self.document.save(path)
        except TankrigError as error:
            self.told.emit(str(error))

    def dry_run(self) -> None:
        """List what each step takes."""
        plan, problem = self.document.plan, self.document.problem
        if plan is None:
            self.plan_list.wait(problem.sentence if problem else WAITING)
            self.tabs.setCurrentWidget(self.plan_list)
            return
        self.plan_list.show_plan(plan, f"Dry run: {self._totals()}; nothing has moved")
        self.tabs.setCurrentWidget(self.plan_list)

    def _list_plan_that_waits(self) -> None:
        """A dry run that was asked for before the rig was known."""
        if self.plan_list.waiting and self.document.plan is not None:
            self.dry_run()

    # -- what goes on --------------------------------------------------------------------------------------------------

    def show_source(self, shown: Shown) -> None:
        """The steps of this source stand on the tab "Run", before the ways to begin unless these are asked for."""
        self._anew = False
        self.run_frame.show_source(shown.source)
        self.run_list.show_source(shown)
        self._refresh()

    def show_run(self) -> None:
        """Bring the steps of the run to the front."""
        self.tabs.setCurrentWidget(self.run_frame)

    def follow(self, status: RigStatus) -> None:
        """Where the rig stands."""
        self.run_list.follow(status)
        if status.tank is not None and not status.running:
            self.document.set_tank(status.tank)
        self._busy = status.busy
        self._run.setEnabled(self.document.plan is not None and not self._busy)

    def _undone(self, more: bool) -> None:
        """Once all that was built has been undone, the ways to begin stand there again."""
        if not more and self.document.empty and self.document.undo.canRedo():
            self._building = False
            self._refresh()

    def _refresh(self) -> None:
        if not self.plan_list.waiting:
            self.plan_list.clear()
        beginning = self.beginning and (self._anew or self.run_list.empty)
        focus = QApplication.focusWidget()
        if not beginning and focus is not None and self.first.isAncestorOf(focus):
            self.window().setFocus()  # Qt would hand the keyboard to any button that comes next
        self.first.setVisible(beginning)
        for widget in (self.tabs, *self._of_sequence):  # of no sequence there is nothing to set or to run
            widget.setVisible(not beginning)
        problem = self.document.problem
        self._title.setText(self.document.title)
        self.text.replace_text(self.document.text)
        self.text.mark(problem.line if problem else 0)
        set_role(self.text, "true" if problem else "", "wrong")
        if not self._exposure.hasFocus():
            exposure_ms = self.document.reading.table.get("exposure_ms", 20.0)
            self._exposure.set_text(f"{exposure_ms:.10g}" if isinstance(exposure_ms, float) else str(exposure_ms))
        self._tell()

    def _tell(self) -> None:
        """What the sequence takes, or what is wrong with it."""
        problem, plan = self.document.problem, self.document.plan
        set_role(self._says, "wrong" if problem and not self.beginning else "good")
        if self.beginning:
            self._says.clear()
        elif problem is not None:
            self._says.setText((f"Line {problem.line}: " if problem.line else "") + problem.sentence)
        else:
            self._says.setText(
                f"Takes {self._totals()}." if plan else "Waiting for the rig, to check against its limits."
            )
        notes = () if self.beginning else self.document.notes
        self._notes.setText("\n".join(f"{capitalised(note)}." for note in notes))
        self._notes.setVisible(bool(notes))
        self._water.setVisible(problem is not None and asks_for_it(problem.sentence))
        self._run.setEnabled(plan is not None and not self._busy)

    def _totals(self) -> str:
        plan = self.document.plan
        if plan is None:
            return ""
        ink = f"{volume(plan.ink_ul)} of ink" if plan.ink_ul else "no ink"
        return f"about {duration(plan.seconds)}, {ink}, {plan.frames} frames, up to {size(plan.disk_bytes)} of disk"

    def _set_exposure(self) -> None:
        value = self._exposure.value
        self.document.doubt("exposure", self._exposure.wrong)
        if value is not None:
            self.document.edit("exposure", lambda document: document.__setitem__("exposure_ms", value), typing=True)

    def _head(self) -> Flow:
        row = Flow(self._title)
        for name, do, tip in (
            ("New", self.begin_anew, "begin an empty sequence; the file that is open stays as it is"),
            ("Open", self.open_file, "open a sequence file (Ctrl+O)"), ("Save", self.save, "save it (Ctrl+S)"),
            ("Save as", self.save_as, "save it to another file"),
        ):  # fmt: skip
            button = QPushButton(name)
            button.setToolTip(tip)
            button.clicked.connect(do)
            row.addWidget(button)
        self._recent = QPushButton("Recent")
        self._recent.setToolTip("sequences, runs, rig files and scenes that were open lately")
        self._recent.setMenu(QMenu(self._recent))
        self._recent.setEnabled(False)
        row.addWidget(self._recent)
        stack = self.document.undo
        undo, redo = QPushButton("Undo"), QPushButton("Redo")
        for button, do, able, key in (
            (undo, stack.undo, stack.canUndoChanged, "Ctrl+Z"),
            (redo, stack.redo, stack.canRedoChanged, "Ctrl+Shift+Z"),
        ):
            button.setToolTip(f"{button.text().lower()} the last edit ({key})")
            button.setEnabled(False)
            button.clicked.connect(do)
            able.connect(button.setEnabled)
            row.addWidget(button)
        return row

    def _foot(self) -> Flow:
        dry, self._run = QPushButton("Dry run  F7"), QPushButton("Run  F5")
        dry.setToolTip("what each step takes; nothing moves")
        dry.clicked.connect(self.dry_run)
        self._run.setObjectName("primary")
        self._run.setToolTip("carry the sequence out")
        self._run.clicked.connect(self.run_asked)
        self._of_sequence = (with_name("exposure", self._exposure), dry, self._run)
        return Flow(*self._of_sequence, self._water)

"""The sequence that is being edited: one text, its undo stack, and what rig and budgets say to it."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import QObject, Signal
from PySide6.QtGui import QUndoCommand, QUndoStack

from tankrig.devices import Delivered
from tankrig.errors import SequenceError, StoreError
from tankrig.sequence.dry_run import DryRun, dry_run
from tankrig.sequence.sequence import Sequence
from ui.window import sequence_text
from ui.window.fresh_water import said_here
from ui.window.sequence_text import EMPTY, Problem, Reading

if TYPE_CHECKING:
    from drivers.rig import RigFile

FRAME_BYTES = np.dtype(np.uint16).itemsize


class _Edit(QUndoCommand):
    """From one text to another; letters typed one after the other are undone together."""

    def __init__(self, document: "SequenceDocument", text: str, what: str, typing: bool) -> None:
        super().__init__(what)
        self._document, self._before, self.after, self._typing = document, document.text, text, typing

    def id(self) -> int:
        """Edits of the same id may be merged."""
        return 1 if self._typing else -1

    def mergeWith(self, other: QUndoCommand) -> bool:  # noqa: N802 - Qt's name
        """Take a following edit in."""
        if not isinstance(other, _Edit) or other.text() != self.text():
            return False
        self.after = other.after
        return True

    def undo(self) -> None:
        """Have the text from before the edit again."""
        self._document.take(self._before)

    def redo(self) -> None:
        """Have the text from after the edit."""
        self._document.take(self.after)


class SequenceDocument(QObject):
    """Text, its meaning, and the way back.

    Attributes
    ----------
    reading
        What the text says.
    """

    changed = Signal()
    checked = Signal()
    """What the plan takes has changed, and nothing else."""

    def __init__(self) -> None:
        super().__init__()
        self.undo = QUndoStack(self)
        self.path: Path | None = None
        self.text = EMPTY
        self._rig: RigFile | None = None
        self._tank = Delivered(0.0, 0.0, 0.0)
        self._text_sequence: Sequence | None = None
        self.reading = Reading({})
        self._plan: DryRun | None = None
        self._saved = EMPTY
        self._doubts: dict[str, str] = {}
        self.take(EMPTY)

    @property
    def problem(self) -> Problem | None:
        """The first thing that is wrong: in a field that is being typed in, or in the text."""
        doubt = next(iter(self._doubts.items()), None)
        return self.reading.problem if doubt is None else Problem(f"{doubt[0]}: {doubt[1]}", 0)

    @property
    def plan(self) -> DryRun | None:
        """The dry run, when the sequence can be run on this rig and no field holds what makes no sense."""
        return None if self._doubts else self._plan

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know of a sequence that can be run: which of its light misses the tank."""
        sequence = self.reading.sequence
        if sequence is None or self._rig is None or self.plan is None:
            return ()
        return sequence.cut_off(self._rig.bench.wall, self._rig.bench.tank)

    @property
    def empty(self) -> bool:
        """Whether nobody has begun to write a sequence."""
        return self.path is None and self.text == EMPTY and not self.undo.canUndo()

    @property
    def unsaved(self) -> bool:
        """Whether the text is another one than its file has."""
        return self.text != self._saved

    @property
    def folder(self) -> Path:
        """Which the paths of pictures are relative to."""
        return self.path.parent if self.path else Path.cwd()

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.path.name if self.path else 'new sequence'}{' (edited)' if self.unsaved else ''}"

    # -- the text ------------------------------------------------------------------------------------------------------

    def load(self, path: Path) -> None:
        """Open a file, right or wrong.

        Raises
        ------
        SequenceError
            When it cannot be read as text.
        """
        try:
            text = path.read_text(encoding="utf-8-sig")
        except OSError as error:
            raise SequenceError(f"{path}: cannot be read ({error.strerror}); choose another file") from error
        except UnicodeDecodeError as error:
            raise SequenceError(f"{path}: is not text, so no sequence; choose a TOML file") from error
        self.path, self._saved = path, text
        self.undo.clear()
        self.take(text)

    def save(self, path: Path) -> None:
        """Write the text to a file.

        Raises
        ------
        StoreError
            When that cannot be done; the old file is then as it was.
        """
        from tankrig.files import whole_file

        try:
            with whole_file(path) as unfinished:
                unfinished.write_text(self.text, encoding="utf-8")
        except OSError as error:
            raise StoreError(f"{path}: cannot be written ({error.strerror or error}); save elsewhere") from error
        self.path, self._saved = path, self.text
        self.undo.setClean()
        self.changed.emit()

    def edit_text(self, text: str) -> None:
        """What a person types into the text."""
        if text != self.text:
            self.undo.push(_Edit(self, text, "typing", typing=True))

    def edit(self, what: str, change: Any, typing: bool = False) -> None:
        """Change the parsed document by `change(document)`; `what` names that for the undo menu.

        Raises
        ------
        SequenceError
            When the text is no TOML.
        """
        text = sequence_text.edited(self.text, change)
        if text != self.text:
            self.undo.push(_Edit(self, text, what, typing))

    def begin_anew(self) -> None:
        """Nobody has begun to write a sequence."""
        self.path, self._saved, self._doubts = None, EMPTY, {}
        self.undo.clear()
        self.take(EMPTY)

    def detach(self) -> None:
        """The text is nobody's file any more: saving asks where to."""
        self.path = None
        self.changed.emit()

    def edit_unsaved(self, text: str) -> None:
        """Edit a text that no file has."""
        self.path, self._saved = None, EMPTY
        self.edit_text(text)

    def doubt(self, field: str, sentence: str) -> None:
        """A field holds what makes no sense, so that it is not in the text: nothing is run before it is mended."""
        before = dict(self._doubts)
        self._doubts.pop(field, None)
        if sentence:
            self._doubts[field] = sentence
        if self._doubts != before:
            self.checked.emit()

    def forget_doubts(self, about: str) -> list[str]:
        """Fields whose names begin so are gone, with what was typed in them: what was wrong with it, in sentences."""
        gone = {field: why for field, why in self._doubts.items() if field.startswith(about)}
        for field in gone:
            self.doubt(field, "")
        return [
            f"{field}: {why}; what was typed is not taken, and the value before it stands"
            for field, why in gone.items()
        ]

    def take(self, text: str) -> None:
        """Have this text from now on; for the undo stack."""
        self.text = text
        self._read()
        self.changed.emit()

    # -- what rig and budgets say --------------------------------------------------------------------------------------

    def set_rig(self, rig: "RigFile") -> None:
        """Check against this rig."""
        self._rig = rig
        self.take(self.text)

    def set_tank(self, tank: Delivered) -> None:
        """Check against what the tank holds now."""
        if tank == self._tank:
            return
        before, self._tank = self.problem, tank
        if self._text_sequence is not None:
            self._check(self._text_sequence)
        (self.checked if self.problem == before else self.changed).emit()

    def _read(self) -> None:
        self.reading, self._plan = sequence_text.read(self.text, self.folder), None
        self._text_sequence = self.reading.sequence
        if self.reading.sequence is None or self._rig is None:
            return
        try:
            self.reading.sequence.drawn(self._rig.bench.wall)
        except SequenceError as error:
            self._text_sequence = None
            self._refuse(str(error).removeprefix(f"{self.reading.sequence.called}: "))
        else:
            self._check(self.reading.sequence)

    def _check(self, sequence: Sequence) -> None:
        """What the budgets say to it, with what the tank holds."""
        if self._rig is None:
            return
        rows, columns = self._rig.bench.camera.shape
        rig, frame_bytes = self._rig, rows * columns * FRAME_BYTES
        try:
            rule = rig.exposure_rule
            self._plan = dry_run(sequence, rig.limits, rig.pace, frame_bytes, self._tank, exposure=rule)
            self.reading = replace(self.reading, sequence=sequence, problem=None)
        except SequenceError as error:
            self._refuse(str(error).removeprefix(f"{sequence.called}: "))

    def _refuse(self, sentence: str) -> None:
        problem = Problem(said_here(sentence), sequence_text.line_of(self.text, sentence))
        self._plan, self.reading = None, replace(self.reading, sequence=None, problem=problem)

"""The wizard for all calibrations: what to do now, what the camera sees meanwhile, and what came out."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QImage, QPixmap
from PySide6.QtWidgets import (
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QPlainTextEdit,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from ui.window.calibration_process import CalibrationProcess
from ui.window.fields import number
from ui.window.rig_file import RigSource
from ui.window.status import RigState, RigStatus
from ui.window.theme import set_role

if TYPE_CHECKING:
    from ui.calibration_way import Step


@dataclass(frozen=True)
class Choice:
    """Something that can be chosen before a calibration.

    Parameters
    ----------
    name, flag
        For people, and as the command has it.
    default
        As text.
    hint
        What it means.
    """

    name: str
    flag: str
    default: str
    hint: str


@dataclass(frozen=True)
class Wizard:
    """A calibration that a person can be led through.

    Parameters
    ----------
    kind
        Of `tankrig calibrate`.
    title, wants
        What it finds, and what has to be at hand.
    choices
        That a person has.
    """

    kind: str
    title: str
    wants: str
    choices: tuple[Choice, ...]


WIZARDS = (
    Wizard("radiometry", "Radiometry: camera and projector in numbers of light",
           "a lens cap, and a diffuser that the projector lights; about 6 minutes",
           (Choice("camera gains", "--gains", "1", "those that runs will use, with commas between them"),)),
    Wizard("stray", "Stray light of the camera's lens: halo and veil",
           "the radiometry; a white card on a light trap, and a lamp; about 2 minutes",
           (Choice("places of the card", "--cards", "4", "3 or more"),)),
    Wizard("camera", "Camera: its lens", "a ChArUco board, held in air; about 3 minutes",
           (Choice("views of the board", "--views", "15", "at different slants and places"),)),
    Wizard("tank", "Tank and water before the camera",
           "the camera calibrated; the board on the floor, then in the water; about 6 minutes",
           (Choice("views of the board", "--views", "4", "in each position"),)),
    Wizard("projector", "Projector: its lens and place",
           "camera and tank calibrated; the board at a slant in the tank; about 4 minutes",
           (Choice("views of the board", "--views", "8", "at different slants"),)),
    Wizard("latency", "Latency of the projector's light",
           "the projector's light before the camera; about 10 seconds",
           (Choice("changes of light", "--flips", "100", "how often it goes from dark to bright; 20 or more"),)),
    Wizard("pump", "Pump: doses weighed on a balance",
           "a balance to 0.1 mg and a vessel on it, for the tube when it is asked for; about 20 minutes",
           (Choice("volumes (µl)", "--volumes", "50,250,500", "with commas between them"),
            Choice("doses of each", "--repeats", "10", "how often each volume is weighed"),
            Choice("water's temperature (°C)", "--temperature", "20", "its density follows from it"))),
)  # fmt: skip
"""In the order in which they rest on each other."""
_SEEN = (320, 200)
ROW_PX = 28


class CalibrationWizard(QWidget):
    """Leads through one calibration at a time; the rig is lent to it meanwhile.

    Parameters
    ----------
    source
        Which rig.
    """

    lend_asked = Signal(object)
    """What stops the calibration, to lend the rig to it; None: it has ended."""
    told = Signal(str)
    used = Signal()
    """A result that had been set aside is in force now."""

    def __init__(self, source: RigSource) -> None:
        super().__init__()
        self._source = source
        self._process: CalibrationProcess | None = None
        self._words: list[str] | None = None
        self._picture: Path | None = None
        self._aside: Path | None = None
        self._wants_number = False
        self.choice, self.options = QListWidget(), dict[str, QLineEdit]()
        self._chosen_by_person = False
        self.use = QPushButton("Use it all the same")
        self.begin, self.cancel, self.done = QPushButton("Begin"), QPushButton("Cancel"), QPushButton("Done")
        self.request, self.answer, self.bar = QLabel(), QLineEdit(), QProgressBar()
        self.light, self.seen, self.result = QLabel(), QLabel(), QLabel()
        self.said = QPlainTextEdit()
        self._lay_out()
        self.choice.currentRowChanged.connect(lambda _: self._chosen())
        self.choice.itemPressed.connect(self._choose_by_hand)
        self.begin.clicked.connect(self._begin)
        self.cancel.clicked.connect(self._cancel)
        self.done.clicked.connect(self._answer)
        self.answer.returnPressed.connect(self._answer)
        self._chosen()

    @property
    def at_work(self) -> bool:
        """Whether a calibration goes on."""
        return self._words is not None or self._process is not None

    def use_rig(self, source: RigSource) -> None:
        """Measure another rig."""
        self._source = source

    def show_way(self, steps: "Mapping[str, Step]") -> None:
        """What is measured and what is missing; the first that is missing is chosen, until a person chooses."""
        missing = [kind for kind, step in steps.items() if not step.done]
        for row, wizard in enumerate(WIZARDS):
            step, item = steps.get(wizard.kind), self.choice.item(row)
            if step is None:
                continue
            sign = "✓" if step.done else "→" if missing[:1] == [wizard.kind] else " "
            item.setText(f"{row + 1}  {sign}  {wizard.kind.capitalize()}: {step.finding}")
            item.setToolTip(f"{wizard.title}: {step.finding}")
        if missing and not self._chosen_by_person and not self.at_work:
            self.choose(missing[0])

    def choose(self, kind: str) -> None:
        """Lead through this one next."""
        self.choice.setCurrentRow([wizard.kind for wizard in WIZARDS].index(kind))

    def _choose_by_hand(self) -> None:
        self._chosen_by_person = True

    def follow(self, status: RigStatus) -> None:
        """Begin once the rig has been let go of; nothing can begin while it is in use."""
        if self._words is not None and status.state is RigState.LENT:
            self._start()
        self.begin.setEnabled(not self.at_work and not status.busy and status.state is not RigState.OPENING)

    def _begin(self) -> None:
        wizard = WIZARDS[max(0, self.choice.currentRow())]
        rig = ["--rig", str(self._source.file)] if self._source.file is not None else []
        chosen = [word for flag, field in self.options.items() if field.text().strip()
                  for word in (flag, "".join(field.text().split()))]  # fmt: skip
        self._words = ["calibrate", wizard.kind, *rig, *chosen]
        self._picture = self._aside = None
        self.use.hide()
        self.said.clear()
        self.result.clear()
        self._ask("The rig is being let go of.", False, answered=False)
        self.cancel.setEnabled(True)
        self.begin.setEnabled(False)
        self.lend_asked.emit(self._stop)

    def _stop(self) -> None:
        """STOP was pressed; from any thread."""
        self._words = None
        if self._process is not None:
            self._process.stop()

    def _start(self) -> None:
        words, self._words = self._words, None
        assert words is not None
        self._process = process = CalibrationProcess(words, self._source.folder)
        process.asked.connect(lambda request, wants_number: self._ask(request, wants_number, answered=True))
        process.said.connect(self._say)
        process.looked.connect(self._look)
        process.kept.connect(self._keep)
        process.ended.connect(self._end)
        self._ask("The devices are being opened.", False, answered=False)

    def _cancel(self) -> None:
        if self._process is not None:
            self._process.cancel()
        elif self._words is not None:
            self._words = None
            self._end(1, "cancelled before it began")

    def _ask(self, request: str, wants_number: bool, answered: bool) -> None:
        self.request.setText(request)
        set_role(self.request, "heading" if answered else "faint")
        self._wants_number = wants_number
        self.answer.setVisible(wants_number)
        self.answer.clear()
        self.done.setVisible(answered)
        self.done.setText("Enter" if wants_number else "Done")
        if answered:
            (self.answer if wants_number else self.done).setFocus()

    def _answer(self) -> None:
        text = self.answer.text() if self._wants_number else ""
        if self._process is None or (self._wants_number and number(text) is None):
            set_role(self.answer, "true" if text else "false", "wrong")
            return
        value = number(text)
        self._ask("", False, answered=False)
        self._process.answer("" if value is None else repr(value))

    def _say(self, line: str, moment: bool) -> None:
        if moment:
            self.light.setText(line)
        else:
            self.said.appendPlainText(line)

    def _look(self, look: Mapping[str, Any]) -> None:
        if self.done.isHidden():
            self.request.setText(f"Measuring: {look['doing']}")
        if look["done"] is not None:
            self.bar.setValue(round(1000 * look["done"]))
        pixels = look["pixels"]
        if pixels is None:
            return
        rows, columns = pixels["shape"]
        data = base64.b64decode(pixels["base64"])
        image = QImage(data, columns, rows, columns, QImage.Format.Format_Grayscale8).copy()
        self._show(QPixmap.fromImage(image))
        light = f"brightest {look['filled']:.0%} of the range"
        saturated = look["saturated"] > 1e-3
        self.light.setText(light + (f", {look['saturated']:.1%} of the pixels saturated" if saturated else ""))
        set_role(self.light, "wrong" if look["filled"] > 0.98 else "faint")

    def _keep(self, kept: Mapping[str, Any]) -> None:
        lines = [f"{name}: {value}" for name, value in kept["rows"].items()]
        lines += [f"Doubt: {doubt}" for doubt in kept["doubts"]]
        lines.append(f"Kept in {kept['path']}" + ("." if kept["in_use"] else "; not used yet."))
        self.result.setText("\n".join(lines))
        set_role(self.result, "wrong" if kept["doubts"] else "")
        self._aside = Path(kept["path"]) if kept["doubts"] and not kept["in_use"] else None
        picture = Path(kept["path"]).with_suffix(".png")
        self._picture = picture if picture.exists() else None

    def _end(self, status: int, sentence: str) -> None:
        if self._process is not None:
            self._process.deleteLater()
        self._process = None
        self._ask(sentence if sentence else "Finished.", False, answered=False)
        set_role(self.request, "wrong" if sentence else "heading")
        if sentence:
            self.told.emit(sentence)
        if self._picture is not None:
            self._show(QPixmap(str(self._picture)))
        self.use.setVisible(self._aside is not None)
        self.bar.setValue(1000 if status == 0 else 0)
        self.light.clear()
        self.cancel.setEnabled(False)
        self.lend_asked.emit(None)

    def _use(self) -> None:
        """Have a doubtful result in force: out of the folder in which it was set aside."""
        aside, self._aside = self._aside, None
        self.use.hide()
        if aside is None:
            return
        try:
            for file in aside.parent.glob(f"{aside.stem}.*"):
                file.rename(aside.parent.parent / file.name)
        except OSError as error:
            self.told.emit(f"{aside}: cannot be moved to where it is used ({error.strerror}); move it by hand")
            return
        self.result.setText(self.result.text().replace("; not used yet.", "; used from now on, doubts and all."))
        self.used.emit()

    def _show(self, picture: QPixmap) -> None:
        """As large as there is room, not blown up."""
        width = max(_SEEN[0], self.width() - 40) if self._picture is not None else _SEEN[0]
        smooth = Qt.TransformationMode.SmoothTransformation
        self.seen.setPixmap(picture.scaledToWidth(min(width, max(picture.width(), _SEEN[0])), smooth))

    def _chosen(self) -> None:
        wizard = WIZARDS[max(0, self.choice.currentRow())]
        while self._choices.rowCount():
            self._choices.removeRow(0)
        self.options = {}
        for one in wizard.choices:
            field = QLineEdit(one.default)
            field.setToolTip(one.hint)
            field.setAccessibleName(f"{one.name}: {one.hint}")
            field.setMaximumWidth(180)
            self._choices.addRow(one.name, field)
            self.options[one.flag] = field
        if not self.at_work:
            self._ask(f"{wizard.title}. Wants {wizard.wants}.", False, answered=False)

    def _lay_out(self) -> None:
        self.choice.addItems([f"{number}     {wizard.title}" for number, wizard in enumerate(WIZARDS, 1)])
        self.choice.setCurrentRow(0)
        self.choice.setAccessibleName("the way of calibration, in its order")
        self.choice.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.choice.setFixedHeight(len(WIZARDS) * ROW_PX + 8)
        self._choices = QFormLayout()
        self.use.setToolTip("a doubtful result, or one much worse than the last, is kept aside until somebody says so")
        self.use.clicked.connect(self._use)
        self.use.hide()
        self.begin.setObjectName("primary")
        self.done.setObjectName("primary")
        self.begin.setEnabled(False)
        self.cancel.setEnabled(False)
        self.answer.setMaximumWidth(160)
        self.bar.setRange(0, 1000)
        self.bar.setTextVisible(False)
        for label in (self.request, self.light, self.result):
            label.setWordWrap(True)
        self.light.setProperty("role", "faint")
        self.result.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.said.setReadOnly(True)
        self.said.setMaximumHeight(110)
        self.said.setPlaceholderText("what is said on the way")
        inside = QWidget()
        column = QVBoxLayout(inside)
        column.setContentsMargins(0, 8, 0, 0)
        column.setSpacing(8)
        column.addWidget(self.choice)
        column.addLayout(self._choices)
        column.addLayout(_row(self.begin, self.cancel, None))
        column.addWidget(self.request)
        column.addLayout(_row(self.answer, self.done, None))
        column.addWidget(self.bar)
        column.addWidget(self.light)
        column.addWidget(self.result)
        column.addLayout(_row(self.use, None))
        column.addWidget(self.seen)
        column.addWidget(self.said)
        column.addStretch(1)
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        area.setFrameShape(QScrollArea.Shape.NoFrame)
        area.setWidget(inside)
        outside = QVBoxLayout(self)
        outside.setContentsMargins(0, 0, 0, 0)
        outside.addWidget(area)


def _row(*widgets: QWidget | None) -> QHBoxLayout:
    """Beside each other; None: room."""
    row = QHBoxLayout()
    for widget in widgets:
        if widget is None:
            row.addStretch(1)
        else:
            row.addWidget(widget, 1 if isinstance(widget, QLineEdit) else 0)
    return row

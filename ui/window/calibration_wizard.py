"""The wizard for all calibrations: what to do now, what the camera sees meanwhile, and what came out."""

import base64
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

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

from tankrig.errors import CalibrationError, StoreError
from tankrig.ranges import Within
from ui.window.calibration_process import CalibrationProcess
from ui.window.fields import CheckedField, NumberField, number, numbers
from ui.window.rig_file import RigSource
from ui.window.status import RigState, RigStatus
from ui.window.theme import set_role
from ui.window.words import calibrated

if TYPE_CHECKING:
    from tankrig.calibration.file import Calibration
    from ui.calibration_way import Step


@dataclass(frozen=True)
class Choice:
    """Something that can be chosen before a calibration: a number, or several.

    Parameters
    ----------
    name, flag
        For people, and as the command has it.
    default
        As text; empty: the command's own.
    hint
        What it means.
    unit
        Of the numbers.
    low, high
        Least and most that the command takes.
    kind
        "whole", "number", or "list" of numbers with commas between them.
    above
        Whether the least itself is too little.
    """

    name: str
    flag: str
    default: str
    hint: str
    unit: str = ""
    low: float = 1.0
    high: float = 100.0
    kind: Literal["whole", "number", "list"] = "whole"
    above: bool = False

    def field(self, most: float) -> CheckedField:
        """Checked as it is typed; `most` is what the rig allows."""
        if self.kind == "list":
            high = min(self.high, most)
            to = f" to {high:g}" if math.isfinite(high) else ""
            span = f"{'more than ' if self.above else ''}{self.low:g}{to} {self.unit}".strip()

            def read(text: str) -> tuple[list[float] | None, str]:
                values, wrong = numbers(text, self.unit, optional=True)
                if wrong:
                    return None, f"give numbers with commas between them, {span}"
                within = Within(self.low, high, "", self.above)
                outside = [value for value in values or () if not within.holds(value)]
                return (None, f"{outside[0]:g} is outside of {span}") if outside else (values, "")

            made = CheckedField(read, self.unit, f"{self.hint}: {span}")
            made.edit.setMaximumWidth(180)
        else:
            whole = self.kind == "whole"
            made = NumberField(self.unit, self.low, self.high, self.hint, True, whole, self.above)
        made.edit.setAccessibleName(f"{self.name}: {self.hint}")
        made.set_text(self.default)
        return made


def _no_sweep(values: Mapping[str, Any]) -> str:
    """What is wrong with exposures and gains together; empty where they make a sweep."""
    given = {flag.removeprefix("--").replace("-", "_"): value for flag, value in values.items() if value is not None}
    if not given.keys() - {"gains"}:
        return ""
    from tankrig.calibration.radiometry_plan import RadiometryPlan  # takes time to load

    try:
        RadiometryPlan(**given)
    except CalibrationError as error:
        return str(error)
    return ""


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
    together
        What is wrong with the values that were chosen, by their flags, although each can be by itself.
    """

    kind: str
    title: str
    wants: str
    choices: tuple[Choice, ...]
    together: Callable[[Mapping[str, Any]], str] = lambda _: ""


LONGEST_MS = 1e6
WIZARDS = (
    Wizard("radiometry", "Radiometry: camera and projector in numbers of light",
           "a lens cap, and a diffuser that the projector lights; about 6 minutes",
           (Choice("camera gains", "--gains", "1", "those that runs will use, with commas between them",
                   low=0.0, high=1e6, kind="list", above=True),
            Choice("shortest exposure", "--shortest-ms", "", "of the sweep; empty: 1/60 s",
                   "ms", 0.0, LONGEST_MS, "number", above=True),
            Choice("longest exposure", "--longest-ms", "", "of the sweep; empty: 2 s",
                   "ms", 0.0, LONGEST_MS, "number", above=True),
            Choice("projector's period", "--period-ms", "", "exposures are whole ones of it; empty: 1/60 s, 0: any",
                   "ms", 0.0, LONGEST_MS, "number")),
           _no_sweep),
    Wizard("stray", "Stray light of the camera's lens: halo and veil",
           "the radiometry; a white card on a light trap, and a lamp; about 2 minutes",
           (Choice("places of the card", "--cards", "4", "at which it is photographed", low=3, high=50),)),
    Wizard("camera", "Camera: its lens", "a ChArUco board, held in air; about 3 minutes",
           (Choice("views of the board", "--views", "15", "at different slants and places", low=6),)),
    Wizard("tank", "Tank and water before the camera",
           "the camera calibrated; the board on the floor, then in the water; about 6 minutes",
           (Choice("views of the board", "--views", "4", "in each position", low=0, high=50),)),
    Wizard("projector", "Projector: its lens and place",
           "camera and tank calibrated; the board at a slant in the tank; about 4 minutes",
           (Choice("views of the board", "--views", "8", "at different slants", low=4, high=50),)),
    Wizard("latency", "Latency of the projector's light",
           "the projector's light before the camera; about 10 seconds",
           (Choice("changes of light", "--flips", "100", "how often it goes from dark to bright", low=20, high=1e4),)),
    Wizard("pump", "Pump: doses weighed on a balance",
           "a balance to 0.1 mg and a vessel on it, for the tube when it is asked for; about 20 minutes",
           (Choice("volumes", "--volumes", "", "with commas between them; empty: 10, 50 and 100 % of the largest dose",
                   "µl", 0.0, math.inf, "list", above=True),
            Choice("doses of each", "--repeats", "10", "how often each volume is weighed"),
            Choice("water's temperature", "--temperature", "20", "its density follows from it",
                   "°C", 0.0, 50.0, "number"))),
)  # fmt: skip
"""In the order in which they rest on each other."""
UNUSED = "; not used yet."
USE = "Use it all the same"
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
        self._most_ul, self._free, self._moving = math.inf, False, False
        self.choice, self.options = QListWidget(), dict[str, CheckedField]()
        self.wrong = QLabel()
        self._chosen_by_person = False
        self._asides: Mapping[str, Calibration] = {}
        self.use = QPushButton(USE)
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
            item.setText(f"{row + 1}  {sign}  {calibrated(wizard.kind).capitalize()}: {step.finding}")
            item.setToolTip(f"{wizard.title}: {step.finding}")
        if missing and not self._chosen_by_person and not self.at_work and self._aside is None:
            self.choose(missing[0])

    def show_aside(self, asides: "Mapping[str, Calibration]") -> None:
        """Doubtful results that lie aside, by kind: each is offered with its kind for as long as it can be used."""
        self._asides = asides
        if self._aside is None and not self.at_work:
            self._offer()

    def choose(self, kind: str) -> None:
        """Lead through this one next."""
        self.choice.setCurrentRow([wizard.kind for wizard in WIZARDS].index(kind))

    def _choose_by_hand(self) -> None:
        self._chosen_by_person = True

    def follow(self, status: RigStatus) -> None:
        """Begin once the rig has been let go of; nothing can begin while it is in use."""
        if self._words is not None and status.state is RigState.LENT:
            self._start()
        self._moving = status.state is RigState.RUNNING or status.dosing
        self._free = not status.busy and status.state is not RigState.OPENING
        self._able()

    def allow_doses(self, most_ul: float) -> None:
        """Of the rig: the largest dose that the pump is weighed with."""
        if most_ul != self._most_ul:
            self._most_ul = most_ul
            if self._wizard.kind == "pump" and not self.at_work:
                self._chosen()

    @property
    def _wizard(self) -> Wizard:
        return WIZARDS[max(0, self.choice.currentRow())]

    def _able(self) -> None:
        """Nothing begins with what makes no sense: the rig would be let go of for nothing."""
        names = {one.flag: one.name for one in self._wizard.choices}
        wrong = [f"{names[flag]}: {field.wrong}" for flag, field in self.options.items() if field.wrong]
        together = "" if wrong else self._wizard.together({flag: field.value for flag, field in self.options.items()})
        self.wrong.setText(together)
        self.wrong.setVisible(bool(together))
        self.begin.setEnabled(self._free and not self.at_work and not wrong and not together)
        self.begin.setToolTip("; ".join(wrong) or together)

    def _begin(self) -> None:
        self._able()
        if not self.begin.isEnabled():
            return
        wizard = self._wizard
        rig = ["--rig", str(self._source.file)] if self._source.file is not None else []
        chosen = [word for flag, field in self.options.items() if field.value is not None
                  for word in (flag, _typed(field.value))]  # fmt: skip
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
        lines.append(f"Kept in {kept['path']}" + ("." if kept["in_use"] else UNUSED))
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

    def _offer(self) -> None:
        """What lies aside of the chosen kind, in place of what was told of another."""
        one = self._asides.get(self._wizard.kind)
        if one is None or one.path is None:
            if self._aside is not None:
                self.result.clear()
            self._aside = None
        else:
            self._aside = one.path
            told = [f"Measured {one.date[:16].replace('T', ' ')} UTC, and set aside."]
            told += [f"Doubt: {doubt}" for doubt in one.doubts]
            self.result.setText("\n".join([*told, f"Kept in {one.path}{UNUSED}"]))
            set_role(self.result, "wrong")
        self.use.setVisible(self._aside is not None)

    def _use(self) -> None:
        if self._aside is not None:
            self.use_aside(self._aside)

    def use_aside(self, aside: Path) -> None:
        """Have a doubtful result in force: out of the folder in which it was set aside."""
        from tankrig.calibration.file import use_all_the_same

        if self.at_work or self._moving:
            self.told.emit("the rig is at work; wait for its end before you use another calibration")
            return
        self._aside = None
        self.use.hide()
        try:
            use_all_the_same(aside)
        except StoreError as error:
            self.told.emit(str(error))
            return
        self._asides = {kind: one for kind, one in self._asides.items() if one.path != aside}
        if str(aside) in self.result.text():
            self.result.setText(self.result.text().replace(UNUSED, "; used from now on, doubts and all."))
        self.used.emit()

    def _show(self, picture: QPixmap) -> None:
        """As large as there is room, not blown up."""
        width = max(_SEEN[0], self.width() - 40) if self._picture is not None else _SEEN[0]
        smooth = Qt.TransformationMode.SmoothTransformation
        self.seen.setPixmap(picture.scaledToWidth(min(width, max(picture.width(), _SEEN[0])), smooth))

    def _chosen(self) -> None:
        wizard = self._wizard
        while self._choices.rowCount():
            self._choices.removeRow(0)
        self.options = {}
        for one in wizard.choices:
            field = one.field(self._most_ul if one.unit == "µl" else math.inf)
            field.edit.textChanged.connect(self._able)
            self._choices.addRow(one.name, field)
            self.options[one.flag] = field
        self._able()
        if not self.at_work:
            self._offer()
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
        self.wrong.setProperty("role", "wrong")
        self.wrong.hide()
        for label in (self.wrong, self.request, self.light, self.result):
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
        column.addWidget(self.wrong)
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


def _typed(value: Any) -> str:
    """Numbers as a command takes them."""
    return ",".join(f"{one:.10g}" for one in (value if isinstance(value, list) else [value]))


def _row(*widgets: QWidget | None) -> QHBoxLayout:
    """Beside each other; None: room."""
    row = QHBoxLayout()
    for widget in widgets:
        if widget is None:
            row.addStretch(1)
        else:
            row.addWidget(widget, 1 if isinstance(widget, QLineEdit) else 0)
    return row

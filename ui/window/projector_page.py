"""The projector: what is on the output, and what a person puts there."""

from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QGuiApplication, QScreen
from PySide6.QtWidgets import (
    QComboBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from tankrig.errors import SequenceError
from tankrig.pattern import Pattern
from tankrig.pattern.cut_off import cut_off
from tankrig.pattern.kinds import draw
from ui.window.forms import Form
from ui.window.pattern_preview import PatternPreview
from ui.window.patterns_editor import BY_KIND, NEW
from ui.window.status import RigState, RigStatus

if TYPE_CHECKING:
    from drivers.rig import RigFile

IDENTIFY_MS = 3000


class ProjectorPage(QWidget):
    """Shows the output, and edits one pattern to put on it between runs."""

    show_asked = Signal(object)
    """Pattern."""
    screen_asked = Signal(object)
    """Identity of the screen that the projector is, as rig files have it."""

    def __init__(self) -> None:
        super().__init__()
        self._rig: RigFile | None = None
        self._values: dict[str, dict[str, Any]] = {kind: dict(values) for kind, values in NEW.items()}
        self._cards: list[QLabel] = []
        self._output, self._draft = PatternPreview(150), PatternPreview(150)
        self._now = QLabel("nothing has been shown yet")
        self._wrong, self._note = QLabel(), QLabel()
        self._wrong.setProperty("role", "wrong")
        for label in (self._now, self._wrong, self._note):
            label.setWordWrap(True)
        self._kind = QComboBox()
        self._kind.addItems(list(NEW))
        self._kind.currentTextChanged.connect(lambda _: self._show_form())
        self._brightness = QSlider(Qt.Orientation.Horizontal)
        self._brightness.setRange(1, 100)
        self._brightness.setValue(100)
        self._brightness.setToolTip("brightness of the whole pattern, in percent of its levels")
        self._free = False
        self._doubts: set[str] = set()
        """Names of fields that hold what makes no sense."""
        self._percent = QLabel("100 %")
        self._brightness.valueChanged.connect(self._brighten)
        self._show, self._dark = QPushButton("Show it"), QPushButton("Go dark")
        self._show.setObjectName("primary")
        self._show.clicked.connect(self._ask)
        self._dark.clicked.connect(self._ask_dark)
        self._form_area = QScrollArea()
        self._form_area.setWidgetResizable(True)
        self._form_area.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._form_area.setFrameShape(QScrollArea.Shape.NoFrame)
        self._lay_out()
        self._show_form()

    def set_rig(self, rig: "RigFile") -> None:
        """Whose projector."""
        self._rig = rig
        by_screen = rig.projector["driver"] == "hdmi-projector"
        self._driver.setText(f"driver: {rig.projector['driver']}" + ("" if by_screen else ", which needs no screen"))
        self._use.setEnabled(by_screen)
        self._preview()

    def shown(self, pattern: Pattern) -> None:
        """This is on the output now."""
        lit = float((pattern.pixels > 0).mean())
        self._now.setText(f"on the output now: <b>{pattern.name}</b>, {lit:.0%} of its pixels lit")
        if self._rig is not None:
            self._output.show(pattern, self._rig.bench.wall)

    def follow(self, status: RigStatus) -> None:
        """A person may change the output only while no run does."""
        free = status.state is RigState.IDLE
        self._free = free
        self._allow()
        self._dark.setEnabled(free)

    def _allow(self) -> None:
        """Show only what the form says: a field that makes no sense has left its old value behind."""
        self._show.setEnabled(self._free and not self._wrong.text() and not self._doubts)

    def _doubt(self, name: str, why: str) -> None:
        if why:
            self._doubts.add(name)
            self._wrong.clear()  # it is about what stood there before
        elif name in self._doubts:
            self._doubts.discard(name)
            self._preview()
        self._allow()

    def _pattern(self) -> Pattern | None:
        """What the form describes, dimmed; None, and the reason on the page, where that cannot be drawn."""
        kind = self._kind.currentText()
        self._wrong.clear()
        self._note.clear()
        if self._rig is None:
            return None
        try:
            values = {name: tuple(v) if isinstance(v, list) else v for name, v in self._values[kind].items()}
            described, bench = BY_KIND[kind](**values), self._rig.bench
            drawn = draw(described, bench.wall)
            self._note.setText("\n".join(cut_off(described, bench.wall, bench.tank)))
        except (SequenceError, TypeError, ValueError) as error:
            self._wrong.setText(str(error))
            return None
        percent = self._brightness.value()
        if percent == 100:
            return drawn
        return Pattern(f"{kind} at {percent} %", np.round(drawn.pixels * (percent / 100.0)).astype(np.uint8))

    def _preview(self) -> None:
        if self._rig is not None:
            self._draft.show(self._pattern(), self._rig.bench.wall)

    def _show_form(self) -> None:
        kind = self._kind.currentText()
        form = Form(BY_KIND[kind], self._values[kind], {}, skip=("kind",), unset="the whole wall")
        form.edited.connect(self._edit)
        form.doubted.connect(self._doubt)
        self._doubts.clear()
        self._allow()
        self._form_area.setWidget(form)
        self._preview()

    def _edit(self, name: str, value: Any) -> None:
        values = self._values[self._kind.currentText()]
        if value is None:
            values.pop(name, None)
        else:
            values[name] = value
        self._preview()

    def _brighten(self, percent: int) -> None:
        self._percent.setText(f"{percent} %")
        self._preview()

    def _ask(self) -> None:
        pattern = self._pattern()
        if pattern is not None:
            self.show_asked.emit(pattern)

    def _ask_dark(self) -> None:
        if self._rig is not None:
            self.show_asked.emit(Pattern("dark", np.zeros(self._rig.bench.wall.shape, np.uint8)))

    # -- screens -------------------------------------------------------------------------------------------------------

    def identify(self) -> None:
        """Show on each screen, for three seconds, which one it is."""
        for card in self._cards:
            card.close()
        self._cards = [_screen_card(number, screen) for number, screen in enumerate(QGuiApplication.screens(), 1)]
        QTimer.singleShot(IDENTIFY_MS, self._put_away)

    def _put_away(self) -> None:
        for card in self._cards:
            card.close()
        self._cards = []

    def _list_screens(self) -> None:
        self._screens.clear()
        for number, screen in enumerate(QGuiApplication.screens(), 1):
            self._screens.addItem(_words(number, screen), _identity(screen))

    def _use_screen(self) -> None:
        self.screen_asked.emit(self._screens.currentData())

    def _lay_out(self) -> None:
        identify = QPushButton("Identify screens")
        identify.setToolTip("a number on each screen for three seconds")
        identify.clicked.connect(self.identify)
        self._screens, self._driver = QComboBox(), QLabel()
        self._screens.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self._driver.setProperty("role", "faint")
        self._driver.setWordWrap(True)
        self._use = QPushButton("Use this screen")
        self._use.setToolTip("write into the rig file that the projector is this screen, and open the rig again")
        self._use.clicked.connect(self._use_screen)
        self._use.setEnabled(False)
        app = QGuiApplication.instance()
        assert isinstance(app, QGuiApplication)
        app.screenAdded.connect(lambda _: self._list_screens())
        app.screenRemoved.connect(lambda _: self._list_screens())
        self._list_screens()
        bright = QHBoxLayout()
        for widget in (QLabel("brightness"), self._brightness, self._percent):
            bright.addWidget(widget)
        buttons = QHBoxLayout()
        buttons.addWidget(self._dark)
        buttons.addWidget(self._show)
        head = QLabel("A pattern to show between runs")
        head.setProperty("role", "heading")
        head.setBuddy(self._kind)
        left, right = QVBoxLayout(), QVBoxLayout()
        left.addWidget(head)
        left.addWidget(self._kind)
        left.addWidget(self._form_area, 1)
        left.addLayout(bright)
        left.addWidget(self._wrong)
        left.addWidget(self._note)
        left.addLayout(buttons)
        right.addWidget(self._now)
        right.addWidget(self._output.widget, 1)
        right.addWidget(QLabel("as it would be"))
        right.addWidget(self._draft.widget, 1)
        grid = QGridLayout(self)
        grid.setContentsMargins(14, 10, 14, 10)
        grid.setHorizontalSpacing(16)
        grid.addLayout(left, 0, 0)
        grid.addLayout(right, 0, 1)
        foot = QHBoxLayout()
        words = QVBoxLayout()
        words.addWidget(self._driver)
        words.addWidget(self._screens)
        foot.addLayout(words, 1)
        foot.addWidget(self._use)
        foot.addWidget(identify)
        grid.addLayout(foot, 1, 0, 1, 2)
        grid.setColumnStretch(0, 1)
        grid.setColumnStretch(1, 1)
        grid.setRowStretch(0, 1)


def _words(number: int, screen: QScreen) -> str:
    size = screen.geometry()
    made = " ".join(word for word in (screen.manufacturer(), screen.model(), screen.serialNumber()) if word)
    return f"screen {number}: {screen.name()} {made} {size.width()} × {size.height()}, {screen.refreshRate():.0f} Hz"


def _identity(screen: QScreen) -> dict[str, str]:
    """What tells this screen from others wherever it is plugged in; its output where it says nothing of itself."""
    if screen.serialNumber():
        return (
            {"serial": screen.serialNumber(), "model": screen.model()}
            if screen.model()
            else {"serial": screen.serialNumber()}
        )
    return {"output": screen.name()}


def _screen_card(number: int, screen: QScreen) -> QLabel:
    card = QLabel(f"{number}\n{_words(number, screen)}")
    card.setWindowFlags(Qt.WindowType.ToolTip | Qt.WindowType.WindowStaysOnTopHint)
    card.setAlignment(Qt.AlignmentFlag.AlignCenter)
    card.setStyleSheet("background: #0b62b4; color: white; font-size: 28pt; padding: 30px;")
    card.adjustSize()
    card.move(screen.geometry().center() - card.rect().center())
    card.show()
    return card

"""Of the source on screen: which model of the light holds, and which dose or pattern would tell most next."""

from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QGridLayout,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from ui.window.fields import CheckedField, numbers, with_name
from ui.window.flow import Flow
from ui.window.on_screen import OnScreen
from ui.window.result import CONFIDENCE
from ui.window.shown import Shown
from ui.window.source import Kind

if TYPE_CHECKING:
    from tankrig.advice.design import Wanted
    from ui.window.jobs import Suggestion

HEADINGS = ("model", "left, % of peak", "σs (1/mm)", "g", "σa (1/mm)", "above the best (BIC)")
NO_ADVICE = "Press “What next?”: the doses and patterns that would tell most will stand here, each with a button."
NO_ADVICE_OF_REFITS = "What next is told by the fits that a run keeps: open the run itself to ask."
WANTED: "dict[str, Wanted]" = {"σs, g and σa": "all", "σs": "sigma_s", "g": "g", "σa": "sigma_a"}
"""What a designed picture is to tell most about."""
NO_MODELS = "Press “Compare models”: what each model of the light leaves of the photograph on the Fit page."


class NextSteps(QWidget):
    """Asks for advice and for a comparison of models, and keeps neither: both belong to the source on screen."""

    step_asked = Signal(object)
    """Suggestion that a person wants in the sequence."""

    def __init__(self, on_screen: OnScreen) -> None:
        super().__init__()
        self._on_screen = on_screen
        self._shown: Shown | None = None
        self.buttons: list[QPushButton] = []
        self._lay_out()

    def show_source(self, shown: Shown) -> None:
        """Whose advice."""
        if self._shown is not None:
            for signal in (self._shown.advised, self._shown.fits_changed, self._shown.compared):
                signal.disconnect(self._draw)
        self._shown = shown
        for signal in (shown.advised, shown.fits_changed, shown.compared):
            signal.connect(self._draw)
        self._draw()

    def _draw(self) -> None:
        shown = self._shown
        if shown is None:
            return
        refit = shown.source.kind is Kind.REFIT
        self.ask.setEnabled(shown.source.run is not None and bool(shown.fits) and not refit)
        self.compare.setEnabled(shown.chosen is not None)
        self._follow_heights()
        self._draw_advice(shown)
        models = shown.models
        self._of.setText(NO_MODELS if models is None else shown.models_of)
        rows = models or ()
        self._table.setVisible(bool(rows))
        self._table.setRowCount(len(rows))
        for row, cells in enumerate(rows):
            for column, text in enumerate(cells):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                self._table.setItem(row, column, item)

    def _draw_advice(self, shown: Shown) -> None:
        while (item := self._advice.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.deleteLater()
        self.buttons = []
        says = [shown.design_says, "" if shown.advice else shown.advice_says]
        if not (shown.advice or shown.designed or any(says)):
            says = [NO_ADVICE_OF_REFITS if shown.source.kind is Kind.REFIT else NO_ADVICE]
        sentences = [*filter(None, says)]
        for row, sentence in enumerate(sentences):
            label = QLabel(sentence)
            label.setWordWrap(True)
            label.setProperty("role", "faint")
            self._advice.addWidget(label, row, 0, 1, 2)
        for row, one in enumerate((*filter(None, [shown.designed]), *shown.advice), len(sentences)):
            button, words = QPushButton("Append"), QLabel(one.words)
            button.setToolTip("append these steps to the sequence; nothing moves before it is run")
            button.clicked.connect(partial(self._append, one))
            words.setWordWrap(True)
            self._advice.addWidget(button, row, 0)
            self._advice.addWidget(words, row, 1)
            self.buttons.append(button)

    def _follow_heights(self) -> None:
        """Nothing is designed from what cannot be, or for heights that are none."""
        possible = self._shown is not None and self._shown.source.run is not None and self._shown.designable is not None
        self.design.setEnabled(possible and not self._heights.wrong)

    def _design(self) -> None:
        self._on_screen.design(WANTED[self._wanted.currentText()], tuple(self._heights.value or ()))

    def _append(self, one: "Suggestion") -> None:
        self.step_asked.emit(one)

    def _lay_out(self) -> None:
        self.ask, self.compare = QPushButton("What next?"), QPushButton("Compare models")
        self.ask.setToolTip("rank doses and patterns by the information expected per minute, from what this run found")
        self.compare.setToolTip("fit the photograph that the Fit page shows by several models of the light")
        self.ask.clicked.connect(lambda: self._on_screen.advise())
        self.compare.clicked.connect(lambda: self._on_screen.compare_models())
        self.design, self._wanted = QPushButton("Design a picture"), QComboBox()
        self.design.setToolTip(
            "invent the picture of cells from which most would be learned, beside what this run has photographed"
        )
        self.design.clicked.connect(lambda: self._design())
        self._wanted.addItems(list(WANTED))
        self._wanted.setAccessibleName("what the design is to tell most about")
        self._heights = CheckedField(
            partial(numbers, unit="mm", optional=True), "mm", "middles of one to three thin sheets of light"
        )
        self._heights.edit.setPlaceholderText("half-way up")
        self._heights.edit.setMaximumWidth(130)
        self._heights.changed.connect(self._follow_heights)
        inside = QWidget()
        self._advice = QGridLayout(inside)
        self._advice.setContentsMargins(0, 0, 0, 0)
        self._advice.setColumnStretch(1, 1)
        self._of = QLabel(NO_MODELS)
        self._of.setWordWrap(True)
        self._table = QTableWidget(0, len(HEADINGS))
        self._table.setHorizontalHeaderLabels(
            [f"{one} ± {CONFIDENCE}" if "σ" in one or one == "g" else one for one in HEADINGS]
        )
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setTabKeyNavigation(False)
        self._table.verticalHeader().hide()
        self._table.horizontalHeader().setStretchLastSection(True)
        column = QVBoxLayout(self)
        column.setContentsMargins(8, 8, 8, 8)
        column.addLayout(Flow(self.ask, self.compare))
        column.addLayout(Flow(self.design, with_name("about", self._wanted), with_name("sheets at", self._heights)))
        column.addWidget(inside)
        column.addWidget(self._of)
        column.addWidget(self._table, 1)
        column.addStretch(0)

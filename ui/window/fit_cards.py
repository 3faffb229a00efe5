"""The result in large figures, and which orders of scattering it needs."""

from collections.abc import Mapping

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from ui.window.elided import Elided
from ui.window.result import CONFIDENCE, NAMES, Result
from ui.window.words import capitalised

ORDERS = {
    "1": "order 1 only", "1–3": "orders 1–3", "1–20": "orders 1–20", "all": "all orders",
    "single": "single scattering's best",
}  # fmt: skip
BAR_ROWS = 3
"""Two columns of bars leave room for the curves on a screen 800 high."""
VERDICT_LINES = 2
SCATTERING_LINES = 2
EMPTY_LINE = "\u00a0"
"""Keeps a note's second line, so that a card is as high whatever it says."""
NOTHING = f"not fitted yet\n{EMPTY_LINE}"
LONGEST_LINE = f"± 0.00000000 ({CONFIDENCE})"
"""What a card has room for."""
BESIDE_PX = 12
"""Room to either side of a card's text."""


class ResultCard(QWidget):
    """One result: σs, σa, g with their 95 % intervals, whose they are, and what the verdict says.

    Where g does not say all of how the liquid scatters, a line below them says the rest.
    """

    copy_asked = Signal(str)
    """"text", "table" or "figure"."""

    def __init__(self) -> None:
        super().__init__()
        self.belongs, self.scattering, self.verdict = Elided(1), Elided(SCATTERING_LINES), Elided(VERDICT_LINES)
        self.scattering.hide()
        self.belongs.setProperty("role", "faint")
        self._whole = QPushButton("All of it")
        self._whole.setCheckable(True)
        self._whole.setToolTip("all that the verdict says and whose it is, or the first lines")
        for line in (self.belongs, self.verdict):
            self._whole.toggled.connect(line.show_all)
            line.cut.connect(self._follow_cut)
        row = QHBoxLayout()
        self._copies = []
        for words, what, tip in (
            ("Copy", "text", "copy this result as text"),
            ("Table", "table", "copy the fits of all doses as a table, for a spreadsheet"),
            ("Figure", "figure", "copy what this page shows as a picture"),
        ):
            button = QPushButton(words)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, what=what: self.copy_asked.emit(what))
            self._copies.append(button)
        self.buttons = (self._whole, *self._copies)
        """What can be done with the result, for whoever lays out the page."""
        self.values: dict[str, tuple[QLabel, QLabel, QLabel]] = {}
        for name in NAMES:
            card = QFrame()
            card.setObjectName("card")
            title, value, note = QLabel(), QLabel(), QLabel()
            value.setProperty("role", "big")
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            for label in (note, title):
                label.setProperty("role", "faint")
            column = QVBoxLayout(card)
            column.setContentsMargins(BESIDE_PX, 6, BESIDE_PX, 6)
            column.setSpacing(0)
            for label in (title, value, note):
                label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
                column.addWidget(label)
            # Whatever a fit says, nothing moves: laying the page out anew costs a picture of the live view.
            card.setMinimumWidth(self.fontMetrics().horizontalAdvance(LONGEST_LINE) + 2 * BESIDE_PX)
            row.addWidget(card, 1)
            self.values[name] = title, value, note
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        column.addWidget(self.belongs)
        column.addLayout(row)
        column.addWidget(self.scattering)
        column.addWidget(self.verdict)
        self.show_result(None, "")

    def _follow_cut(self) -> None:
        """There is more to be seen of what does not fit."""
        self._whole.setEnabled(self.belongs.too_long or self.verdict.too_long)

    def show_result(self, result: Result | None, says: str) -> None:
        """Show a result, or that there is none; `says` is what goes on besides."""
        found = {one.name: one for one in result.coefficients} if result is not None else {}
        for name, (title, value, note) in self.values.items():
            one = found.get(name)
            if one is None:
                title.setText(NAMES[name])
                value.setText("–")
                note.setText(NOTHING)
                continue
            number, _, half = one.text.partition(" ± ")
            title.setText(f"{one.symbol} {one.unit}".strip())
            value.setText(number)
            note.setText(f"± {half} ({CONFIDENCE})\n" + (EMPTY_LINE if one.determined else "not determined"))
        self.belongs.say(result.belongs if result is not None else "")
        further = result.scattering if result is not None else ()
        self.scattering.say("; ".join(f"{one.symbol} {one.text} {one.unit}".rstrip() for one in further)
                            + (f" ({CONFIDENCE})" if further else ""))  # fmt: skip
        # All fits of a run search the same phase functions, so it comes and goes with the run.
        self.scattering.setVisible(bool(further))
        verdict = result.verdict if result is not None else ""
        stop = "." if says and says[-1] not in ".…" else ""
        self.verdict.say(f"{capitalised(says)}{stop} {verdict}".strip())
        for button in self._copies:
            button.setEnabled(result is not None)


class OrderBars(QWidget):
    """What each sum of orders leaves of the picture: the paper's argument at a glance."""

    def __init__(self) -> None:
        super().__init__()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setVerticalSpacing(2)
        self._bars: dict[str, QProgressBar] = {}
        for number, (key, words) in enumerate(ORDERS.items()):
            row, column = number % BAR_ROWS, 2 * (number // BAR_ROWS)
            bar = QProgressBar()
            bar.setRange(0, 1000)
            bar.setFormat("–")
            bar.setFixedHeight(16)
            bar.setAlignment(Qt.AlignmentFlag.AlignCenter)
            label = QLabel(words)
            label.setToolTip("root mean square of what is left over, in percent of the brightest pixel")
            label.setBuddy(bar)
            grid.addWidget(label, row, column)
            grid.addWidget(bar, row, column + 1)
            grid.setColumnStretch(column + 1, 1)
            self._bars[key] = bar

    def show_rmse(self, rmse: Mapping[str, float]) -> None:
        """Show RMSE as parts of the peak; the longest bar is the worst."""
        worst = max(rmse.values(), default=0.0) or 1.0
        for key, bar in self._bars.items():
            value = rmse.get(key)
            bar.setValue(0 if value is None else round(1000.0 * value / worst))
            bar.setFormat("–" if value is None else f"{100.0 * value:.2g} % left")

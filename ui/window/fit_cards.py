"""The fitted coefficients in large figures, and which orders of scattering they need."""

from collections.abc import Mapping

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QGridLayout, QHBoxLayout, QLabel, QProgressBar, QVBoxLayout, QWidget

from tankrig.live.formatting import with_error
from tankrig.live.results import DoseFit

COEFFICIENTS = {"sigma_s": ("σs", 1, "per mm"), "sigma_a": ("σa", 0, "per mm"), "g": ("g", 2, "")}
"""Symbol, place in the covariance, unit."""
ORDERS = {
    "1": "order 1 only", "1–3": "orders 1–3", "1–20": "orders 1–20", "all": "all orders",
    "single": "single scattering's best",
}  # fmt: skip


class Coefficients(QWidget):
    """Three cards: σs, σa, g with their standard deviations."""

    def __init__(self) -> None:
        super().__init__()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        self._values: dict[str, tuple[QLabel, QLabel]] = {}
        for name, (symbol, _, unit) in COEFFICIENTS.items():
            card = QFrame()
            card.setObjectName("card")
            value, note, title = QLabel("–"), QLabel("not fitted yet"), QLabel(f"{symbol} {unit}".strip())
            value.setProperty("role", "big")
            value.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            for label in (note, title):
                label.setProperty("role", "faint")
            column = QVBoxLayout(card)
            column.setContentsMargins(12, 6, 12, 6)
            column.setSpacing(0)
            for label in (title, value, note):
                column.addWidget(label)
            row.addWidget(card, 1)
            self._values[name] = value, note

    def show_fit(self, fit: DoseFit) -> None:
        """Show a dose's fit."""
        for name, (_, place, _) in COEFFICIENTS.items():
            best, sd, known = getattr(fit.medium, name), fit.sd[place], fit.identifiable[name]
            value, note = self._values[name]
            number, _, error = with_error(best, sd).partition(" ± ")
            value.setText(number)
            note.setText(f"± {error}{'' if known else ', not determined'}")
            value.setToolTip(f"95 %: {best - 1.96 * sd:.4g} to {best + 1.96 * sd:.4g}")


class OrderBars(QWidget):
    """What each sum of orders leaves of the picture: the paper's argument at a glance."""

    def __init__(self) -> None:
        super().__init__()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setVerticalSpacing(2)
        self._bars: dict[str, QProgressBar] = {}
        for row, (key, words) in enumerate(ORDERS.items()):
            bar = QProgressBar()
            bar.setRange(0, 1000)
            bar.setFormat("–")
            bar.setFixedHeight(20)
            bar.setAlignment(Qt.AlignmentFlag.AlignCenter)
            label = QLabel(words)
            label.setToolTip("root mean square of what is left over, in percent of the brightest pixel")
            grid.addWidget(label, row, 0)
            grid.addWidget(bar, row, 1)
            self._bars[key] = bar
        grid.setColumnStretch(1, 1)

    def show_rmse(self, rmse: Mapping[str, float]) -> None:
        """Show RMSE as parts of the peak; the longest bar is the worst."""
        worst = max(rmse.values(), default=0.0) or 1.0
        for key, bar in self._bars.items():
            value = rmse.get(key)
            bar.setValue(0 if value is None else round(1000.0 * value / worst))
            bar.setFormat("–" if value is None else f"{100.0 * value:.2g} % left")

"""The fit as it stands: the result, coefficients against dose and time, and what the model leaves of the picture."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QCheckBox, QComboBox, QGridLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from ui.window.fields import with_name
from ui.window.figure import pixmap_of
from ui.window.fit_cards import OrderBars, ResultCard
from ui.window.fit_curves import FitCurves
from ui.window.flow import Flow
from ui.window.result import result_of, table
from ui.window.shown import Shown
from ui.window.staggered_painter import StaggeredPainter
from ui.window.tank_plot import TankPlot
from ui.window.tone import Tone, residual_palette

if TYPE_CHECKING:
    from ui.window.jobs import Comparison

Image = NDArray[np.floating]
Indices = NDArray[np.uint8]

TOP = 60_000.0
"""Where the brightest pixel observed lies on the scale of tones."""
AGAINST = {"against dose": "dose_ml", "against time": "time_s"}
NEWEST = "newest dose"
EMPTY = "A photograph, the model's picture of it and what is left will stand here, once ink has been fitted."


class FitPage(QWidget):
    """Draws the fits of the source that is on screen, and keeps nothing of its own."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: Shown | None = None
        self._painter = StaggeredPainter(self)
        self._lay_out()

    def show_source(self, shown: Shown) -> None:
        """Draw this source from now on, and nothing of the one before."""
        if self._shown is not None:
            self._shown.fits_changed.disconnect(self._draw_fits)
            self._shown.compared.disconnect(self._draw_comparison)
        self._shown = shown
        shown.fits_changed.connect(self._draw_fits)
        shown.compared.connect(self._draw_comparison)
        self._curves.clear()
        self._clear_pictures()
        self._draw_fits()
        self._draw_comparison()

    @property
    def says(self) -> str:
        """What stands below the pictures."""
        return self._says.text()

    # -- what is shown -------------------------------------------------------------------------------------------------

    def _draw_fits(self) -> None:
        shown = self._shown
        if shown is None:
            return
        self.card.show_result(result_of(shown), shown.says)
        self._draw_curves()
        self._list_photographs(shown)

    def _draw_curves(self) -> None:
        shown, against = self._shown, AGAINST[self._against.currentText()]
        if shown is None:
            return
        if against == "dose_ml":
            fits = [(fit.dose_ml, fit) for fit in shown.by_dose]
        else:
            fits = [(one.time_s, one.fit) for one in shown.fits]
        self._curves.show_fits(fits, against, shown.series)

    def _list_photographs(self, shown: Shown) -> None:
        """Patterns and doses to choose from; nothing is chosen by listing them."""
        doses = [NEWEST, *(f"{dose:.4g} ml" for dose in sorted({key.dose_ml for key in shown.photographs}))]
        patterns = list(dict.fromkeys(key.pattern for key in shown.photographs))
        chosen = shown.chosen
        dose = NEWEST if shown.follows_newest or chosen is None else f"{chosen.dose_ml:.4g} ml"
        for box, words, now in (
            (self._pattern, patterns, chosen.pattern if chosen is not None else ""), (self._dose, doses, dose)
        ):  # fmt: skip
            if [box.itemText(row) for row in range(box.count())] != words:
                box.clear()
                box.addItems(words)
            box.setCurrentText(now)
            box.setEnabled(bool(patterns))

    def _choose(self) -> None:
        """A person looks at another photograph."""
        shown = self._shown
        if shown is None:
            return
        pattern, dose = self._pattern.currentText(), self._dose.currentText()
        newest = shown.newest
        if dose == NEWEST:
            at_ml = newest.dose_ml if newest is not None else None
            shown.chosen = next((k for k in shown.photographs if (k.pattern, k.dose_ml) == (pattern, at_ml)), None)
            shown.choose(None)
        else:
            here = [key for key in shown.photographs if f"{key.dose_ml:.4g} ml" == dose]
            shown.choose(next((key for key in here if key.pattern == pattern), here[0] if here else None))

    def _draw_comparison(self) -> None:
        shown = self._shown
        if shown is None:
            return
        self._list_photographs(shown)
        one = shown.comparison
        if one is not None:
            self._draw(one)
            return
        self._clear_pictures()
        if shown.wants_comparison is not None:
            self._says.setText("The model's picture is being computed…")

    def _clear_pictures(self) -> None:
        self._painter.take([])
        for plot in (self._observed, self._model, self._residual):
            plot.clear()
        self._bars.show_rmse({})
        self._says.setText(EMPTY)

    def _copy(self, what: str) -> None:
        if what == "figure":
            QGuiApplication.clipboard().setPixmap(pixmap_of(self))
        elif self._shown is not None:
            result = result_of(self._shown)
            text = table(self._shown) if what == "table" else result.text if result is not None else ""
            QGuiApplication.clipboard().setText(text)

    def _draw(self, one: "Comparison") -> None:
        peak = float(one.observed.max()) or 1.0
        tone = Tone(0.0, TOP, gamma=0.5)
        table, palette = tone.table(), tone.palette()

        def toned(image: Image) -> Indices:
            indices: Indices = table[np.clip(image * (TOP / peak), 0.0, 65_535.0).astype(np.uint16)]
            return indices

        residual = np.nan_to_num(one.residual)  # nothing where a pixel was left out
        reach = float(np.percentile(np.abs(residual), 99.5)) / peak or 1e-6
        if self._same.isChecked():
            left, colours, same = toned(np.abs(residual)), palette, "|residual|, same scale"
        else:
            part = np.clip(residual / (peak * reach), -1.0, 1.0)
            left, colours = (127.5 * (1.0 + part)).astype(np.uint8), residual_palette()
            same = f"residual, ±{100.0 * reach:.2g} %"

        def show(plot: TankPlot, name: str, indices: Indices, colours: Indices) -> None:
            plot.show_indices(indices, colours)
            plot.place(one.tank, one.camera)
            plot.name(name)

        self._painter.take((
            partial(show, self._observed, "observed, 0–100 %", toned(one.observed), palette),
            partial(show, self._model, "model, same scale", toned(one.model), palette),
            partial(show, self._residual, same, left, colours),
            partial(self._sum_up, one),
        ))  # fmt: skip

    def _sum_up(self, one: "Comparison") -> None:
        self._bars.show_rmse(one.rmse)
        head, single, whole = f"{one.pattern} at {one.dose_ml:.4g} ml", one.rmse.get("single"), one.rmse["all"]
        by = single / whole if single is not None and whole > 0.0 else 1.0
        rest = "" if single is None else f": single scattering leaves {by:.1f} times as much as all orders"
        self._says.setText(f"{head}{rest}.")

    def _lay_out(self) -> None:
        self.card, self._bars, self._curves = ResultCard(), OrderBars(), FitCurves()
        self.card.copy_asked.connect(self._copy)
        self._says = QLabel(EMPTY)
        self._says.setProperty("role", "faint")
        self._says.setWordWrap(True)
        self._says.setToolTip("percentages on this page are of the brightest pixel observed")
        self._observed, self._model, self._residual = (
            TankPlot(title, axes=False) for title in ("observed", "model", "residual")
        )
        pictures = QHBoxLayout()
        for plot in (self._observed, self._model, self._residual):
            plot.widget.setMinimumHeight(104)
            pictures.addWidget(plot.widget, 1)
        self._pattern, self._dose, self._against = QComboBox(), QComboBox(), QComboBox()
        self._same = QCheckBox("residual on the same scale")
        self._pattern.setMinimumWidth(110)
        self._pattern.setToolTip("which pattern's picture to compare")
        self._dose.setMinimumWidth(110)
        self._dose.setToolTip("of which dose; the newest follows the fits as they come")
        for box in (self._pattern, self._dose):
            box.setMinimumContentsLength(len(NEWEST))
            box.activated.connect(lambda _: self._choose())  # by a person only
        self._against.setToolTip("what the curves stand against: the ink in the tank, or the time of the run")
        self._against.addItems(list(AGAINST))
        self._against.currentTextChanged.connect(lambda _: self._draw_curves())
        self._same.toggled.connect(lambda _: self._draw_comparison())
        choices = Flow(
            *self.card.buttons, with_name("picture of", self._pattern), with_name("at", self._dose), self._same,
            self._against,
        )  # fmt: skip
        middle = QGridLayout()
        middle.addWidget(self._bars, 0, 0)
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 8, 10, 8)
        column.setSpacing(4)
        column.addWidget(self.card)
        column.addLayout(choices)
        column.addLayout(pictures, 4)
        column.addWidget(self._says)
        column.addLayout(middle)
        column.addWidget(self._curves, 3)
        column.addStretch(0)

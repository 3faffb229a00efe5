"""The fit as it stands: coefficients now, against dose and time, and what the model leaves of the picture."""

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QGridLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from tankrig.live.results import DoseFit, FailedFit, Fit, SeriesFit
from ui.window import jobs
from ui.window.background import Background
from ui.window.fit_cards import Coefficients, OrderBars
from ui.window.fit_curves import FitCurves
from ui.window.tank_plot import TankPlot
from ui.window.tone import Tone, residual_palette
from ui.window.turns import Turns

if TYPE_CHECKING:
    from tankrig.live.exposures import Photograph

Image = NDArray[np.floating]
Indices = NDArray[np.uint8]

SYMBOLS = {"sigma_s": "σs", "g": "g", "sigma_a": "σa"}
TOP = 60_000.0
"""Where the brightest pixel observed lies on the scale of tones."""
AGAINST = {"against dose": "dose_ml", "against time": "time_s"}


class FitPage(QWidget):
    """Shows the fits of one run, live or recorded."""

    gain_found = Signal(float)
    """Counts per ms and W/mm²/sr, by the newest fit."""

    def __init__(self, background: Background) -> None:
        super().__init__()
        self._background = background
        self._fits: list[tuple[float, DoseFit]] = []
        self._series: SeriesFit | None = None
        self._photographs: dict[str, tuple[Photograph, DoseFit]] = {}
        self._compared: jobs.Comparison | None = None
        self._asked = self._again = False
        self._turns = Turns(self)
        self._began_s = time.monotonic()
        self._lay_out()

    # -- what comes in -------------------------------------------------------------------------------------------------

    def begin(self, words: str) -> None:
        """Another run: forget the last one's fits."""
        self._fits, self._series, self._compared = [], None, None
        self._photographs.clear()
        self._began_s = time.monotonic()
        self._pattern.clear()
        self._verdict.setText(words)
        self._curves.show_fits([], "dose_ml", None)

    def add(self, fit: Fit, photographs: "Sequence[Photograph]", time_s: float | None = None) -> None:
        """Take in a fit, and the photographs that it fitted, where they are at hand."""
        if isinstance(fit, FailedFit):
            self._verdict.setText(f"This fit could not be made: {fit.error}")
            return
        if isinstance(fit, SeriesFit):
            self._series = fit
            self._verdict.setText(fit.verdict)
            self._draw_curves()
            return
        self._fits.append((time.monotonic() - self._began_s if time_s is None else time_s, fit))
        self._coefficients.show_fit(fit)
        self._verdict.setText(in_words(fit))
        self.gain_found.emit(fit.gain)
        self._draw_curves()
        for photograph in photographs:
            self._photographs[photograph.pattern] = photograph, fit
            if self._pattern.findText(photograph.pattern) < 0:
                self._pattern.addItem(photograph.pattern)
        self._compare()

    def show_run(self, path: Path) -> None:
        """Show the fits of a recorded run; those that it lacks are made."""
        self.begin(f"Reading the fits of {path.name}; those that it lacks are being made…")
        self._background.run(jobs.fits_of, path, then=self._take_run, failed=self._verdict.setText)

    def show_fits(self, doses: Sequence[DoseFit], series: SeriesFit | None) -> None:
        """Show other fits of the same photographs."""
        photographs = [photograph for photograph, _ in self._photographs.values()]
        self._fits, self._series = [], None
        self._take_run((doses, series, photographs))

    def _take_run(self, found: "tuple[Sequence[DoseFit], SeriesFit | None, Sequence[Photograph]]") -> None:
        doses, series, photographs = found
        for fit in doses:
            self.add(fit, [one for one in photographs if one.dose_ml == fit.dose_ml])
        if series is not None:
            self.add(series, [])

    # -- what is shown -------------------------------------------------------------------------------------------------

    def _draw_curves(self) -> None:
        against = AGAINST[self._against.currentText()]
        fits = self._fits
        if against == "dose_ml":
            fits = list({fit.dose_ml: (fit.dose_ml, fit) for _, fit in fits}.values())
        self._curves.show_fits(fits, against, self._series)

    def _compare(self) -> None:
        """Have the model's picture made; of requests that come meanwhile, only the last is answered."""
        chosen = self._photographs.get(self._pattern.currentText())
        if chosen is None:
            return
        if self._asked:
            self._again = True
            return
        self._asked, self._again = True, False
        self._says.setText("computing the model's picture…")
        self._background.run(jobs.compare, *chosen, then=self._take, failed=self._failed)

    def _take(self, compared: jobs.Comparison) -> None:
        self._compared, self._asked = compared, False
        self._draw()
        if self._again:
            self._compare()

    def _failed(self, sentence: str) -> None:
        self._asked = False
        self._says.setText(sentence)

    def _draw(self) -> None:
        one = self._compared
        if one is None:
            return
        peak = float(one.observed.max()) or 1.0
        tone = Tone(0.0, TOP, root=True)
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
            same = f"residual, ±{100.0 * reach:.2g} % of peak"

        def show(plot: TankPlot, name: str, indices: Indices, colours: Indices) -> None:
            plot.show_indices(indices, colours)
            plot.place(one.tank, one.camera)
            plot.name(name)

        self._turns.take((
            partial(show, self._observed, "observed, 0–100 %", toned(one.observed), palette),
            partial(show, self._model, "model, same scale", toned(one.model), palette),
            partial(show, self._residual, same, left, colours),
            partial(self._sum_up, one),
        ))  # fmt: skip

    def _sum_up(self, one: jobs.Comparison) -> None:
        self._bars.show_rmse(one.rmse)
        head, single, whole = f"{one.pattern} at {one.dose_ml:.4g} ml", one.rmse.get("single"), one.rmse["all"]
        by = single / whole if single is not None and whole > 0.0 else 1.0
        rest = "" if single is None else f": single scattering leaves {by:.1f} times as much as all orders"
        self._says.setText(f"{head}{rest}.")

    def _lay_out(self) -> None:
        self._coefficients, self._bars, self._curves = Coefficients(), OrderBars(), FitCurves()
        self._verdict, self._says = QLabel(), QLabel()
        self._verdict.setText("No fit yet. Fits come by themselves while a run goes on, from the first dose of ink.")
        self._verdict.setWordWrap(True)
        self._verdict.setMinimumHeight(42)
        self._says.setProperty("role", "faint")
        self._says.setWordWrap(True)
        self._observed, self._model, self._residual = (
            TankPlot(title, axes=False) for title in ("observed", "model", "residual")
        )
        pictures = QHBoxLayout()
        for plot in (self._observed, self._model, self._residual):
            plot.widget.setMinimumHeight(104)
            pictures.addWidget(plot.widget, 1)
        self._pattern, self._against, self._same = QComboBox(), QComboBox(), QCheckBox("residual on the same scale")
        self._pattern.setMinimumWidth(140)
        self._pattern.setToolTip("which pattern's picture to compare")
        self._pattern.currentTextChanged.connect(lambda _: self._compare())
        self._against.addItems(list(AGAINST))
        self._against.currentTextChanged.connect(lambda _: self._draw_curves())
        self._same.toggled.connect(lambda _: self._draw())
        choices = QHBoxLayout()
        for widget in (QLabel("picture of"), self._pattern, self._same):
            choices.addWidget(widget)
        choices.addStretch(1)
        choices.addWidget(self._against)
        middle = QGridLayout()
        middle.addWidget(self._bars, 0, 0)
        column = QVBoxLayout(self)
        column.setContentsMargins(10, 8, 10, 8)
        column.addWidget(self._coefficients)
        column.addWidget(self._verdict)
        column.addLayout(choices)
        column.addLayout(pictures, 4)
        column.addWidget(self._says)
        column.addLayout(middle)
        column.addWidget(self._curves, 3)


def in_words(fit: DoseFit) -> str:
    """Which coefficients a dose's fit determines.

    >>> from tankrig.scene import Medium
    >>> known = {"sigma_a": False, "sigma_s": True, "g": True}
    >>> in_words(DoseFit(0.4, Medium(1e-4, 0.01, 0.7), identifiable=known, frames=12, patterns=("sheet",)))
    'With 0.4 ml, from 12 frames of sheet: σs and g are determined, σa is not yet; more dose or patterns tell more.'
    """
    known = [symbol for name, symbol in SYMBOLS.items() if fit.identifiable[name]]
    unknown = [symbol for name, symbol in SYMBOLS.items() if not fit.identifiable[name]]
    head = f"With {fit.dose_ml:.4g} ml, from {fit.frames} frames of {', '.join(fit.patterns)}: "
    if not unknown:
        return f"{head}σs, g and σa are all determined."
    are = " and ".join(known) + (" are" if len(known) > 1 else " is") + " determined, " if known else ""
    rest = " and ".join(unknown) + (" are" if len(unknown) > 1 else " is") + " not yet"
    return f"{head}{are}{rest}; more dose or patterns tell more."

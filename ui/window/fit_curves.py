"""σs, σa and g against dose or time, with 95 % error bars."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtWidgets import QGraphicsItem, QHBoxLayout, QSizePolicy, QWidget

from tankrig.live.results import DoseFit, SeriesFit
from ui.window.result import CONFIDENCE, Z
from ui.window.staggered_painter import StaggeredPainter
from ui.window.tank_plot import pen
from ui.window.theme import CURVES

COEFFICIENTS = {"sigma_s": ("σs", 1, "per mm"), "sigma_a": ("σa", 0, "per mm"), "g": ("g", 2, "")}
"""Symbol, place in the standard deviations, unit."""
GREY = "#888888"
BAND_POINTS = 25
TIP = (
    "grey: the liquid by the fit of all doses; dashed where that does not determine the coefficient, between the edges "
    f"of its interval ({CONFIDENCE})"
)
LEAST_OF_G = 0.05
"""Half of what the axis of g shows at least."""
ROOM = 1.5
"""Times what is shown: an axis that is at most so long stays as it is."""
AXIS_PX = 50
"""Width of the axis at the left: one that follows its numbers has the plot laid out and painted twice."""


class FitCurves(QWidget):
    """Three small plots side by side."""

    def __init__(self) -> None:
        super().__init__()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        self._plots: dict[str, tuple[Any, Any, Any, Any]] = {}
        self._bands: dict[str, Any] = {}
        self._widgets: list[QWidget] = []
        for (name, (symbol, _, unit)), colour in zip(COEFFICIENTS.items(), CURVES, strict=False):
            widget = pg.PlotWidget(enableMenu=False)
            plot = widget.getPlotItem()
            plot.setTitle(f"{symbol} {unit}".strip() + f", ± {CONFIDENCE}", size="9pt")
            plot.hideButtons()
            for side in ("left", "bottom"):
                axis = plot.getAxis(side)
                axis.enableAutoSIPrefix(False)
                axis.setCacheMode(QGraphicsItem.CacheMode.DeviceCoordinateCache)
                axis.setTickDensity(0.6)  # side by side, numbers have little room
            plot.getAxis("left").setTickDensity(0.3)  # nor one above the other, on a screen 800 high
            plot.getAxis("left").setWidth(AXIS_PX)
            plot.setLabel("bottom", "ink (ml)")
            plot.showGrid(x=True, y=True, alpha=0.2)
            line, band = plot.plot(), plot.plot(pen=pen(GREY, 1.0, dashed=True), connect="finite")
            widget.setToolTip(TIP)
            bars = pg.ErrorBarItem(pen=pg.mkPen(colour, width=2), beam=0.0)
            points = pg.ScatterPlotItem(size=9, brush=colour, pen=None)
            plot.addItem(bars)
            plot.addItem(points)
            row.addWidget(widget, 1)
            self._widgets.append(widget)
            self._plots[name] = plot, line, bars, points
            self._bands[name] = band
            widget.setMinimumHeight(104)
            policy = QSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
            policy.setRetainSizeWhenHidden(True)  # each is laid out in its own turn, and none of the others with it
            widget.setSizePolicy(policy)
            widget.hide()
        self._fits: Sequence[tuple[float, DoseFit]] = []
        self._series: SeriesFit | None = None
        self._against, self._painter = "dose_ml", StaggeredPainter(self)

    def clear(self) -> None:
        """Show nothing, at once."""
        self._fits, self._series = [], None
        self._painter.take([])
        for widget in self._widgets:
            widget.hide()
        for name, (_, line, bars, points) in self._plots.items():
            line.setData([], [])
            self._bands[name].setData([], [])
            points.setData([], [])
            bars.setData(x=np.empty(0), y=np.empty(0), height=np.empty(0))

    def points(self, name: str) -> list[tuple[float, float]]:
        """What a plot shows: place and value of each point."""
        at, values = self._plots[name][3].getData()
        return list(zip(np.asarray(at).tolist(), np.asarray(values).tolist(), strict=True))

    def show_fits(self, fits: Sequence[tuple[float, DoseFit]], against: str, series: SeriesFit | None) -> None:
        """Show fits of doses, each with its ml or seconds; `against` is "dose_ml" or "time_s"."""
        self._fits, self._series = fits, series
        if against != self._against:
            self._against = against
            for plot, *_ in self._plots.values():
                plot.setLabel("bottom", "ink (ml)" if against == "dose_ml" else "time (s)")
        self._painter.take(partial(self._show, name) for name in self._plots)

    def _show(self, name: str) -> None:
        plot, line, bars, points = self._plots[name]
        at = np.array([place for place, _ in self._fits])
        values = np.array([getattr(fit.medium, name) for _, fit in self._fits])
        errors = Z * np.array([fit.sd[COEFFICIENTS[name][1]] for _, fit in self._fits])
        points.setData(at, values)
        bars.setData(x=at, y=values, height=2.0 * errors)
        if len(at):
            self._frame(plot, at, values, errors, name)
        series = self._series if self._against == "dose_ml" and len(at) else None
        sure = series is None or series.identifiable.get(name, True)
        line.setPen(pen(GREY, 1.5, dashed=not sure))
        line.setData(*self._line(name, at, series))
        self._bands[name].setData(*([], []) if sure or series is None or not series.sd else _band(name, at, series))
        plot.getViewWidget().setVisible(bool(len(at)))  # axes of nothing would measure nothing

    def _frame(self, plot: Any, at: Any, values: Any, errors: Any, name: str) -> None:
        """A view in which a few very long error bars do not hide the rest."""
        reach = np.minimum(errors, np.maximum(np.abs(values), 1e-12))
        low, high = float(np.min(values - reach)), float(np.max(values + reach))
        if name == "g":
            # Over its whole range every error bar would be a line; over no more than they are, noise a catastrophe.
            half = max(0.5 * (high - low), LEAST_OF_G)
            low, high = (0.5 * (low + high) + by for by in (-half, half))
        margin = 0.1 * (high - low or 1.0)  # a point is as wide as a tenth of a low plot
        if name != "g":
            low = min(low, 0.0) - margin
        (left, right), (bottom, top) = plot.viewRange()
        furthest = float(at.max()) * 1.05 or 1.0
        # Axes that stay as they are need not be drawn again.
        if not (abs(left) < 1e-6 * right and furthest <= right <= ROOM * furthest):
            plot.setXRange(0.0, 1.05 * furthest, padding=0)
        if not (bottom <= low and high + margin <= top and top - bottom <= ROOM * (high + margin - low)):
            plot.setYRange(low - 0.5 * margin, high + 1.5 * margin, padding=0)
            plot.getAxis("left").setTickSpacing(levels=[(_step(high - low + 2.0 * margin), 0)])

    def _line(self, name: str, at: Any, series: SeriesFit | None) -> tuple[Any, Any]:
        if series is None:
            return [], []
        x = np.array([0.0, float(at.max()) * 1.1])
        return x, np.array([getattr(series.at(dose_ml), name) for dose_ml in x.tolist()])


def _band(name: str, at: Any, series: SeriesFit) -> tuple[Any, Any]:
    """The lower and then the upper edge of where a series has a coefficient, with a gap between."""
    x = np.linspace(0.0, float(at.max()) * 1.1, BAND_POINTS)
    middle = np.array([getattr(series.at(dose_ml), name) for dose_ml in x.tolist()])
    half = Z * deviation(name, x, series)
    lowest = -1.0 if name == "g" else 0.0
    low, high = np.maximum(middle - half, lowest), np.minimum(middle + half, 1.0 if name == "g" else np.inf)
    return np.r_[x, np.nan, x], np.r_[low, np.nan, high]


def deviation(name: str, dose_ml: Any, series: SeriesFit) -> Any:
    """Standard deviation of a coefficient of the liquid at each dose, as the series has it."""
    if name != "sigma_a":
        return np.full_like(dose_ml, series.sd[COEFFICIENTS[name][1]]) * (1.0 if name == "g" else dose_ml)
    if len(series.covariance) < 4:
        return np.hypot(series.sd[0] * dose_ml, series.sd[3])
    spread = np.array(series.covariance)
    return np.sqrt(np.maximum(spread[0, 0] * dose_ml**2 + 2.0 * spread[0, 3] * dose_ml + spread[3, 3], 0.0))


def _step(length: float) -> float:
    """Between the numbers of an axis, so that there are two to five of them however low the plot is.

    >>> _step(1.05), _step(0.0021), _step(9.9), _step(4.0)
    (0.5, 0.001, 2.0, 2.0)
    """
    ten = 10.0 ** math.floor(math.log10(max(length, 1e-300)))
    return next(part * ten for part in (5.0, 2.0, 1.0, 0.5, 0.2) if length / (part * ten) >= 2.0)

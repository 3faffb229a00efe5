"""The report's curves: coefficients against the dose, and where the time went."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.live.results import DoseFit, SeriesFit
from tankrig.report.timing import Span

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TANK, SERIES, SINGLE = "#0072b2", "#222222", "#d55e00"
"""Colours that colour-blind readers tell apart."""
KINDS = {"dose": "#009e73", "wait": "#bbbbbb", "capture": "#0072b2", "note": "#999999", "fit": "#cc79a7"}
LABELS = {"sigma_s": "$\\sigma_s$ (1/mm)", "sigma_a": "$\\sigma_a$ (1/mm)", "g": "$g$"}


def coefficients(doses: Sequence[DoseFit], series: SeriesFit | None) -> "Figure":
    """σs, σa and g against the dose with 95 % error bars, the series' straight lines, single scattering beside them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.7), layout="constrained")
    at = np.array([one.dose_ml for one in doses])
    along = np.linspace(0.0, 1.06 * at.max(), 60)
    for axes, name in zip(figure.subplots(1, 3), LABELS, strict=True):
        order = ("sigma_a", "sigma_s", "g").index(name)
        values = np.array([getattr(one.medium, name) for one in doses])
        errors = 1.96 * np.array([one.sd[order] for one in doses])
        if series is not None:
            axes.plot(along, _line(series, name, along), color=SERIES, linewidth=1.2, label="series fit", zorder=1)
        if name == "sigma_s":
            single = [one.single.sigma_t if one.single else np.nan for one in doses]
            label = "single scattering's $\\sigma_t$"
            axes.plot(at, single, "s", color=SINGLE, markersize=5, markerfacecolor="none", label=label)
        axes.errorbar(
            at, values, errors, fmt="o", color=TANK, markersize=5, capsize=3, linewidth=1.2, label="tank model, 95 %"
        )
        axes.set(xlabel="ink (ml)", title=LABELS[name], xlim=(0.0, along[-1]))
        if name == "g":
            low, high = float(np.min(values - errors)), float(np.max(values + errors))
            axes.set_ylim(max(-1.0, low - 0.1), min(1.0, high + 0.1))
        else:
            axes.set_ylim(0.0, 1.25 * float(np.max(values + np.minimum(errors, values))))
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, linewidth=0.6)
    figure.axes[0].legend(loc="upper left")
    return figure


def _line(series: SeriesFit, name: str, dose_ml: Any) -> Any:
    return [getattr(series.at(float(one)), name) for one in dose_ml]


def timeline(spans: Sequence[Span]) -> "Figure":
    """Every step of the run as a bar, the fits beneath."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(12.5, 1.9), layout="constrained")
    axes = figure.subplots()
    for span in spans:
        row = 0 if span.kind == "fit" else 1
        axes.barh(
            row, max(span.seconds, 0.05), left=span.begin_s, height=0.7, color=KINDS.get(span.kind, "#999999"),
            edgecolor="white", linewidth=0.3,
        )  # fmt: skip
    axes.set_yticks([0, 1], ["fits", "steps"])
    axes.set_xlabel("s since the run began")
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(left=False)
    used = [kind for kind in KINDS if any(span.kind == kind for span in spans)]
    handles = [Patch(color=KINDS[kind], label=kind) for kind in used]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(used))
    return figure

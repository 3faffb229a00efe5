"""The archive's curves: coefficients over months, rigs side by side, drift, and where refits disagree."""

from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.archive.table import DISAGREES, Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")
"""That colour-blind readers tell apart."""
LABELS = {"sigma_s": "$\\sigma_s$", "g": "$g$", "sigma_a": "$\\sigma_a$"}
MOST_LEGEND = 8
"""Groups that get a colour and a name of their own; the others share the last."""


def over_time(records: Sequence[Record]) -> "Figure":
    """σs, g and σa of every fit against the day, a colour for each material."""
    figure, axes = _three()
    groups = _groups(records, "material")
    for one, name in zip(axes, LABELS, strict=True):
        for colour, (label, rows) in zip(_colours(len(groups)), groups, strict=True):
            days = [_day(row) for row in rows]
            one.errorbar(
                days, [row[name] for row in rows], [row[f"sd_{name}"] or 0.0 for row in rows], fmt=".", color=colour,
                markersize=3, linewidth=0.5, alpha=0.6, label=label or "no material named",
            )  # fmt: skip
        one.set_title(f"{LABELS[name]} ({_unit(records, name)})")
        _dates(one)
    _legend(axes[0], len(groups))
    return figure


def side_by_side(records: Sequence[Record]) -> "Figure":
    """Each coefficient by rig, relative to the median of its material and dose: what differs is the rig."""
    figure, axes = _three()
    rigs = sorted({str(one["rig"]) for one in records})
    for one, name in zip(axes, LABELS, strict=True):
        relative = _relative(records, name)
        values = [[by for row, by in zip(records, relative, strict=True) if row["rig"] == rig] for rig in rigs]
        one.boxplot(
            [100.0 * np.asarray(part) for part in values], tick_labels=[rig or "no rig" for rig in rigs], sym="."
        )
        one.axhline(0.0, color="#999999", linewidth=0.6)
        one.set_title(f"{LABELS[name]}: beside the median of material and dose (%)")
    return figure


def drift(records: Sequence[Record], changes: Sequence[tuple[str, str, str]]) -> "Figure":
    """The fitted gain of each rig over time: what light and lenses make of one radiance; and calibrations.

    Parameters
    ----------
    records
        Rows with fits.
    changes
        Day, rig and kind of each calibration that came into force.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.4), layout="constrained")
    axes = figure.subplots()
    groups = _groups([one for one in records if one["gain"]], "rig")
    for colour, (label, rows) in zip(_colours(len(groups)), groups, strict=True):
        gains = np.array([row["gain"] for row in rows], float)
        days = [_day(row) for row in rows]
        axes.plot(
            days, 100.0 * (gains / np.median(gains) - 1.0), ".", color=colour, markersize=3, label=label or "no rig"
        )
        for day, rig, kind in changes:
            if rig == label:
                axes.axvline(_at(day), color=colour, linewidth=0.8, linestyle=":")
                axes.annotate(kind, (_at(day), 1.0), xycoords=("data", "axes fraction"), fontsize=7)
    axes.set_title("fitted gain beside the rig's median (%); dotted: a calibration came into force")
    _dates(axes)
    _legend(axes, len(groups))
    return figure


def disagreements(records: Sequence[Record]) -> "Figure":
    """How far refits are from what was found before, in standard deviations, against the day."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.0), layout="constrained")
    axes = figure.subplots()
    rows = [one for one in records if one["disagreement"] is not None]
    far = [row["disagreement"] > DISAGREES for row in rows]
    for kind, colour, label in ((False, COLOURS[0], "agrees"), (True, COLOURS[1], f"beyond {DISAGREES:g}")):
        chosen = [row for row, beyond in zip(rows, far, strict=True) if beyond is kind]
        axes.plot(
            [_day(row) for row in chosen], [row["disagreement"] for row in chosen], ".", color=colour, label=label
        )
    axes.axhline(DISAGREES, color="#999999", linewidth=0.8)
    axes.set_title("new fit beside the old one (standard deviations)")
    _dates(axes)
    _legend(axes, 2)
    return figure


def _three() -> "tuple[Figure, Any]":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.7), layout="constrained")
    return figure, figure.subplots(1, 3)


def _groups(records: Sequence[Record], by: str) -> list[tuple[str, list[Record]]]:
    """By name; the smallest together where there are more than can be told apart."""
    groups: dict[str, list[Record]] = {}
    for one in records:
        groups.setdefault(str(one[by]), []).append(one)
    if len(groups) > MOST_LEGEND:
        largest = sorted(groups, key=lambda name: -len(groups[name]))[: MOST_LEGEND - 1]
        rest = [one for name, rows in groups.items() if name not in largest for one in rows]
        groups = {name: groups[name] for name in sorted(largest)} | {f"{len(groups) - len(largest)} others": rest}
    return list(groups.items())


def _relative(records: Sequence[Record], name: str) -> list[float]:
    groups: dict[tuple[Any, ...], list[float]] = {}
    for one in records:
        groups.setdefault((one["material"], one["fit"], one["dose_ml"]), []).append(one[name])
    medians = {key: float(np.median(values)) for key, values in groups.items()}
    middles = [medians[one["material"], one["fit"], one["dose_ml"]] for one in records]
    return [one[name] / middle - 1.0 if middle else 0.0 for one, middle in zip(records, middles, strict=True)]


def _unit(records: Sequence[Record], name: str) -> str:
    if name == "g":
        return "mean cosine"
    return "1/mm per ml" if all(one["fit"] == "series" for one in records) else "1/mm"


def _day(record: Record) -> float:
    return _at(record["utc"])


def _at(utc: str) -> float:
    """A moment as matplotlib counts days."""
    from matplotlib.dates import date2num

    return float(date2num(datetime.fromisoformat(utc)))  # type: ignore[no-untyped-call]


def _dates(axes: "Axes") -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    locator: Any = AutoDateLocator()  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


def _colours(count: int) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(count)]


def _legend(axes: "Axes", count: int) -> None:
    if count > 1:
        axes.legend(fontsize=7, ncols=2)

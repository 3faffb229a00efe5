"""A separated sheet as pictures: light that follows the wave, light that has forgotten it, and order 1 beside both."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tankrig.figures.tank_image import FALSE_COLOUR, brightness, draw, label_outer
from tankrig.scene.description import Medium
from tankrig.separation.expected import sheet_scene
from tankrig.separation.recorded import Separation
from tankrig.separation.waves import Mask, Waves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ORDERS = {"order 1": (1,), "order 2": (2,), "orders ≥ 3": (3, "4-20", ">20")}
COLOURS = ("#0072b2", "#e69f00", "#999999")


def separation_figure(one: Separation, expected: Mapping[float, Mapping[int | str, Waves]] | None = None) -> "Figure":
    """Sheet, what follows the finest wave, what has forgotten it, and order 1, in one brightness.

    Parameters
    ----------
    one
        What was measured.
    expected
        By period, what a model says, order by order (`expected_separation`): drawn as bars of what follows each wave.
    """
    from matplotlib.figure import Figure

    finest = next(iter(one.waves.values()))
    images = {
        "Whole sheet": one.sheet,
        f"Follows the wave of {next(iter(one.waves)):g} mm": finest.modulated,
        "Has forgotten it": finest.even,
    }
    if one.order_one is not None:
        images["Order 1, no model of the liquid"] = one.order_one.image
    columns = len(images) + (expected is not None)
    figure = Figure(figsize=(4.1 * columns, 3.1), layout="constrained")
    grid = figure.subplots(1, columns, squeeze=False)
    scene = sheet_scene(one.transfers[0].wave, one.bench, one.camera, Medium(0.0, 0.01, 0.0))
    scale = brightness(one.sheet)
    for axes, (title, image) in zip(grid[0], images.items(), strict=False):
        draw(axes, np.maximum(np.nan_to_num(image), 0.0), scene, FALSE_COLOUR, scale, title)
    label_outer([list(grid[0][: len(images)])])
    if expected is not None:
        _bars(grid[0, -1], one, expected)
    middle = 0.5 * (one.z_mm[0] + one.z_mm[1])
    figure.suptitle(f"{one.dose_ml:.4g} ml, sheet at z = {middle:g} mm", x=0.01, ha="left", weight="bold", size=10)
    return figure


def shares(waves: Mapping[int | str, Waves], lit: Mask) -> dict[str, float]:
    """Parts of the sheet's light that follow the wave, by orders of scattering: each along the wave of all of them."""
    along = waves["all"].wave[lit]
    turn = np.conj(along) / np.maximum(np.abs(along), 1e-300)
    whole = float(waves["all"].sheet[lit].sum())
    return {
        name: sum(float(np.real(waves[order].wave[lit] * turn).sum()) for order in orders if order in waves) / whole
        for name, orders in ORDERS.items()
    }


def _bars(axes: "object", one: Separation, expected: Mapping[float, Mapping[int | str, Waves]]) -> None:
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    lit = one.transfers[0].seen
    names = [f"{period_mm:g} mm" for period_mm in expected]
    base = np.zeros(len(names))
    told = [shares(waves, lit) for waves in expected.values()]
    for name, colour in zip(ORDERS, COLOURS, strict=True):
        height = np.array([100.0 * of[name] for of in told])
        axes.bar(names, height, bottom=base, color=colour, label=f"{name}, by the model", width=0.6)
        base = base + height
    measured = [100.0 * float(one.waves[p].modulated[lit].sum() / one.sheet[lit].sum()) for p in expected]
    axes.plot(names, measured, "kD", markersize=5, label="measured")
    axes.set(title="Part that follows the wave, %", xlabel="period", ylim=(0.0, 1.35 * max(*measured, *base)))
    axes.legend(loc="upper left", fontsize=7)
    axes.spines[["top", "right"]].set_visible(False)

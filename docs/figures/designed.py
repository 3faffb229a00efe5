"""The picture of docs/advise.md: a pair of pictures designed for thin and for thick ink, beside the usual ones.

Run it in the folder of the checkout: python docs/figures/designed.py
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[2]))

from tankrig.advice.cells import CellLight, cell_light, even_cells
from tankrig.advice.design import designed
from tankrig.advice.next_pictures import usual_pictures
from tankrig.figures.tank_image import FALSE_COLOUR, STYLE, brightness, draw, label_outer
from tankrig.scene import Medium
from tests.designed_pictures import BENCH, prospect

INKS = {"thin": Medium(2e-4, 0.004, 0.8), "thick": Medium(5e-4, 0.04, 0.8)}
CELLS = even_cells((-60.0, 60.0), [(58.0, 62.0)], 15)
FRAMES, ERROR = 8.0, 0.001


def pair_for(light: CellLight) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The designed pair, and the usual pictures."""
    usual = usual_pictures(CELLS)
    now = prospect(light, ERROR, float(light.images.sum(axis=0).max()))
    starts = [np.stack([usual[one], usual[other]]) for one in usual for other in usual if one < other]
    return designed([now], starts, FRAMES / 2, limit_s=60.0).light, usual


def show(axes: Axes, light: CellLight, parts: np.ndarray, title: str) -> None:
    """The camera's image, and before its edge the light of each cell, white for all of it."""
    draw(axes, light.picture(parts)[0], light.scene, FALSE_COLOUR, brightness(light.images.sum(axis=0)), title)
    axes.imshow(
        parts[:, None], cmap="gray", vmin=0.0, vmax=1.0, extent=(-26.0, -8.0, *CELLS.y_mm), origin="lower",
        interpolation="nearest",
    )  # fmt: skip
    axes.add_patch(mpl.patches.Rectangle((-26.0, CELLS.y_mm[0]), 18.0, np.ptp(CELLS.y_mm), fill=False, lw=0.6))
    axes.set_xlim(-30.0, 240.0)
    axes.set_ylim(-80.0, 80.0)
    axes.set_xticks([0, 100, 200])


with mpl.rc_context(STYLE):
    figure = Figure(figsize=(12.5, 3.5), layout="constrained")
    grid = figure.subplots(len(INKS), 6)
    for row, (ink, medium) in zip(grid, INKS.items(), strict=True):
        light = cell_light(CELLS, BENCH, BENCH.camera, medium)
        pair, usual = pair_for(light)
        pictures = {"designed, 1": pair[0], "designed, 2": pair[1], **usual}
        for axes, (name, parts) in zip(row, pictures.items(), strict=True):
            show(axes, light, parts, name if ink == "thin" else "")
        row[0].annotate(
            f"{ink}: $\\sigma_s$ {medium.sigma_s:g} /mm", (-0.36, 0.5), xycoords="axes fraction", rotation=90,
            va="center", weight="bold",
        )  # fmt: skip
    label_outer(grid.tolist())
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=90)

"""The picture of docs/separation.md: thin, medium and thick ink of an independent program, separated.

Run it in the folder of the checkout: python docs/figures/separation.py
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[2]))

from tankrig.figures.tank_image import FALSE_COLOUR, STYLE, brightness, draw, label_outer
from tests.test_separation import measured, truth_of

INKS = ("o-thin", "o-medium", "o-thick")

with mpl.rc_context(STYLE):
    figure = Figure(figsize=(12.5, 5.0), layout="constrained")
    grid = figure.subplots(len(INKS), 4)
    for row, ink in zip(grid, INKS, strict=True):
        waves, medium = truth_of(ink)
        order_1, scene = measured(ink)
        fine = waves[min(waves)]
        images = {
            "Whole sheet": fine.sheet,
            f"Follows a wave of {min(waves):g} mm": fine.modulated,
            "Has forgotten it": fine.even,
            "Order 1, measured": np.nan_to_num(order_1.image),
        }
        for axes, (title, image) in zip(row, images.items(), strict=True):
            shown = title if ink == INKS[0] else ""
            draw(axes, np.maximum(image, 0.0), scene, FALSE_COLOUR, brightness(fine.sheet), shown)
        name = f"{ink[2:]}: $\\sigma_t$ {medium.sigma_t:g} /mm"
        row[0].annotate(name, (-0.24, 0.5), xycoords="axes fraction", rotation=90, va="center", weight="bold")
    label_outer(grid.tolist())
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=80)

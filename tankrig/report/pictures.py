"""The report's pictures of the tank: observations of all doses, and reconstructions by order beside one of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tankrig.estimation.found_optics import described_with
from tankrig.estimation.result import Reconstruction
from tankrig.figures.fit_figure import draw_reconstructions
from tankrig.figures.tank_image import FALSE_COLOUR, GREY, brightness, draw, label_outer
from tankrig.live.exposures import Photograph
from tankrig.live.results import DoseFit
from tankrig.prediction import ORDER_CLASSES, Prediction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"grey": GREY, "false colour": FALSE_COLOUR}
SUMS = {"1": 1, "1–3": 3, "1–20": 4, "all": 5}
"""Classes of orders that each reconstruction adds up."""


def observations(photographs: Sequence[Photograph]) -> "Figure":
    """Every photograph in grey and in false colour: a row for each dose, a pair of columns for each pattern."""
    from matplotlib.figure import Figure

    doses = sorted({one.dose_ml for one in photographs})
    patterns = list(dict.fromkeys(one.pattern for one in photographs))
    camera = photographs[0].scene.camera
    rows_mm, columns_mm = np.multiply(camera.shape, camera.sides_mm)  # bins of a calibrated camera are not square
    height = 2.5 * rows_mm / columns_mm
    figure = Figure(figsize=(5.0 * len(patterns), height * len(doses) + 0.6), layout="constrained")
    grid = figure.subplots(len(doses), 2 * len(patterns), squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    for one in photographs:
        row, column = doses.index(one.dose_ml), 2 * patterns.index(one.pattern)
        for axes, (name, colours) in zip(grid[row, column : column + 2], COLOURS.items(), strict=True):
            axes.set_axis_on()
            title = f"{one.pattern}, {name}" if row == 0 else ""
            draw(axes, one.image, one.scene, colours, brightness(one.image), title)
        if column == 0:
            grid[row, 0].annotate(
                f"{one.dose_ml:.3g} ml", (-0.32, 0.5), xycoords="axes fraction", rotation=90, va="center", weight="bold"
            )
    label_outer(grid.tolist())
    return figure


def predicted(photograph: Photograph, fit: DoseFit) -> Prediction:
    """The tank model's image of a photograph as a dose's fit has it, with its orders."""
    from tankrig.image.predict import predict

    scene = described_with(photograph.scene, {name: value for name, (value, _) in fit.astray.items()})
    return predict(replace(scene, medium=fit.medium), "tank")


def by_order(photograph: Photograph, prediction: Prediction, gain: float, offset: float) -> list[Reconstruction]:
    """The photograph rebuilt from the first orders and from all, at one gain and offset (the paper's Figs. 6, 7)."""
    rebuilt = []
    for name, count in SUMS.items():
        image = gain * np.sum([prediction.orders[order] for order in ORDER_CLASSES[:count]], axis=0) + offset
        residual = np.where(photograph.used, photograph.image - image, np.nan)
        rebuilt.append(Reconstruction(name, image, residual, float(np.sqrt(np.nanmean(residual**2)))))
    return rebuilt


def reconstructions(photograph: Photograph, rebuilt: Sequence[Reconstruction]) -> "Figure":
    """The photograph, its reconstructions by order, and what each leaves."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15.0, 4.6), layout="constrained")
    axes = figure.subplots(2, 5, squeeze=False)
    percent = 100.0 / float(photograph.image.max())
    scale = brightness(percent * photograph.image)
    draw(axes[0, 0], percent * photograph.image, photograph.scene, FALSE_COLOUR, scale, "Observed")
    draw(axes[1, 0], percent * photograph.image, photograph.scene, GREY, scale, "Observed, in grey")
    label_outer([[axes[0, 0]], [axes[1, 0]]])
    noise = float(np.sqrt(np.mean(photograph.noise**2)))
    draw_reconstructions(axes[:, 1:].tolist(), photograph.scene, rebuilt, photograph.image, noise)
    return figure

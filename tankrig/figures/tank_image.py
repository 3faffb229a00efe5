"""One image of the tank on one pair of axes: in mm, in grey, in false colour, or as a residual."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.image import AxesImage

Image = NDArray[np.floating]

FALSE_COLOUR = "inferno"
"""Perceptually even, so that equal steps of brightness look equal; the paper's rainbow invents edges."""
RESIDUAL_COLOUR = "RdBu_r"
GREY = "gray"

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.6,
    "axes.grid": False,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.frameon": False,
    "figure.constrained_layout.h_pad": 0.06,
    "figure.constrained_layout.w_pad": 0.05,
}
"""Of every figure."""


def brightness(image: Image) -> "Normalize":
    """Square-root scale from the darkest to the brightest pixel, on which faint scattered light shows beside beams."""
    from matplotlib.colors import PowerNorm

    low, high = (float(value) for value in np.nanpercentile(image, (0.5, 100.0)))
    return PowerNorm(0.5, vmin=low, vmax=high, clip=True)


def signed(largest: Image, noise: float) -> "Normalize":
    """Scale for residuals, even about zero: linear up to twice the noise, logarithmic up to the largest residual.

    On it one sees both where a model fails by half the peak and that a good one leaves nothing but noise.
    """
    from matplotlib.colors import SymLogNorm

    reach = float(np.nanpercentile(np.abs(largest), 99.5)) or 1.0
    linear = min(max(2.0 * noise, 1e-3 * reach), 0.5 * reach)
    return SymLogNorm(linthresh=linear, vmin=-reach, vmax=reach, base=10)


def pixel_centres(scene: Scene, shape: tuple[int, int]) -> tuple[Image, Image]:
    """x (columns) and y (rows) of the pixels' centres on the plane z = Lz, mm."""
    rows, columns = shape
    tall, wide = scene.camera.sides_mm
    return (np.arange(columns) + 0.5) * wide, (np.arange(rows) + 0.5) * tall - scene.tank.size_mm[1] / 2


def draw(axes: "Axes", image: Image, scene: Scene, colours: str, scale: "Normalize", title: str = "") -> "AxesImage":
    """Show an image on the plane z = Lz in mm: x to the right, away from the projector, y up.

    Parameters
    ----------
    axes
        Where to draw.
    image
        (rows, columns) of the scene's camera.
    scene
        Gives the size of a pixel and of the tank.
    colours
        Name of a colour map.
    scale
        From values to colours.
    title
        Above the image.
    """
    rows, columns = image.shape
    (tall, wide), low = scene.camera.sides_mm, -scene.tank.size_mm[1] / 2
    extent = (0.0, columns * wide, low, low + rows * tall)
    shown = axes.imshow(image, cmap=colours, norm=scale, origin="lower", extent=extent, interpolation="nearest")
    axes.set_title(title)
    return shown


def label_outer(axes: Sequence[Sequence["Axes"]]) -> None:
    """Name x and y in mm on the left and lower edges of a block of images, and leave the rest bare."""
    for row in axes:
        for column, one in enumerate(row):
            if column == 0:
                one.set_ylabel("y (mm)")
            one.tick_params(labelleft=column == 0, labelbottom=row is axes[-1])
    for one in axes[-1]:
        one.set_xlabel("x (mm)")


def add_bar(axes: Sequence["Axes"], shown: "AxesImage", residual: bool = False) -> None:
    """One colour bar for a row of images, in percent of the observed peak."""
    figure = axes[0].get_figure()
    assert figure is not None
    bar = figure.colorbar(shown, ax=list(axes), pad=0.008, aspect=22, extend="both" if residual else "neither")
    bar.set_label("% of peak")
    low, high = (float(edge or 0.0) for edge in shown.get_clim())
    if residual:
        sizes = [
            size for size in (0.01, 0.1, 1.0, 10.0, 100.0) if getattr(shown.norm, "linthresh", 0.0) <= size <= high
        ]
        sizes = sizes or [float(f"{0.5 * high:.1g}")]  # a faint residual lies between two of them
        ticks = [-size for size in reversed(sizes)] + [0.0, *sizes]
    else:
        ticks = [tick for tick in (0.0, 1.0, 5.0, 10.0, 25.0, 50.0, 75.0, 100.0) if low <= tick <= high]
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.ax.minorticks_off()

"""The picture that shows whether to believe a geometric calibration: where corners were, and how far off."""

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from tankrig.figures.tank_image import STYLE
from tankrig.files import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tankrig.calibration.blur_in_depth import BlurInDepth

FOUND, ALLOWED, FITTED = "#0072b2", "#999999", "#d55e00"


class Found(Protocol):
    """What the procedures for camera, tank and projector give."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the picture that corners are in."""

    @property
    def corners_px(self) -> NDArray[np.float64]:
        """(n, 2) places."""

    @property
    def residuals_px(self) -> NDArray[np.float64]:
        """(n, 2) how far each lies from where it should."""

    @property
    def view_rms_px(self) -> tuple[float, ...]:
        """Of each view."""

    @property
    def rms_px(self) -> float:
        """Of all."""


def write_geometry_figure(
    path: Path, title: str, found: Found, allowed_px: float, blur: "BlurInDepth | None" = None
) -> None:
    """Draw corners with their residuals in the picture, the residuals about zero, and each view's error.

    Parameters
    ----------
    path
        Of the picture (.png, .pdf or .svg).
    title
        Over it.
    found
        What to judge.
    allowed_px
        Above which it should not be believed.
    blur
        Of a projector over depth, to be drawn as well.

    Raises
    ------
    StoreError
        When the picture cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        wide = (1.8, 1.0, 1.0) if blur is None else (1.8, 1.0, 1.0, 1.2)
        figure = Figure(figsize=(3.2 * sum(wide), 4.2), layout="constrained")
        axes = figure.subplots(1, len(wide), width_ratios=wide).ravel().tolist()
        _where(axes[0], found)
        _about_zero(axes[1], found)
        _by_view(axes[2], found, allowed_px)
        if blur is not None:
            _over_depth(axes[3], blur)
        figure.suptitle(title, fontsize=10)
        with whole_file(path) as unfinished:
            figure.savefig(unfinished, dpi=130)


def _where(axes: "Axes", found: Found) -> None:
    rows, columns = found.shape
    enlarged = 0.03 * columns / max(found.rms_px, 1e-6)
    (x, y), (u, v) = found.corners_px.T, found.residuals_px.T
    axes.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=1.0 / enlarged, width=0.0015, color=FOUND)
    axes.plot(x, y, ".", markersize=2, color="black")
    axes.set(xlim=(0, columns), ylim=(rows, 0), aspect="equal", xlabel="column", ylabel="row")
    axes.set_title(f"corners; errors enlarged {enlarged:.0f} times. Want: all over, no pattern", fontsize=8)


def _about_zero(axes: "Axes", found: Found) -> None:
    axes.plot(*found.residuals_px.T, ".", markersize=2, color=FOUND)
    reach = 1.1 * max(float(np.abs(found.residuals_px).max()), 1e-6)
    axes.axhline(0.0, color=ALLOWED, linewidth=0.6)
    axes.axvline(0.0, color=ALLOWED, linewidth=0.6)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="px along rows", ylabel="px down")
    axes.set_title(f"errors, rms {found.rms_px:.3f} px. Want: one round cloud", fontsize=8)


def _by_view(axes: "Axes", found: Found, allowed_px: float) -> None:
    axes.bar(np.arange(1, len(found.view_rms_px) + 1), found.view_rms_px, color=FOUND)
    axes.axhline(allowed_px, color=ALLOWED, linestyle="--")
    axes.set(xlabel="view", ylabel="rms, px")
    axes.set_title("error of each view. Want: far below the line", fontsize=8)


def _over_depth(axes: "Axes", blur: "BlurInDepth") -> None:
    x_mm, seen, fitted = blur.parts[np.argsort(blur.parts[:, 0])].T
    axes.plot(x_mm, seen, ".", markersize=3, color=FOUND)
    axes.plot(x_mm, fitted, color=FITTED)
    if blur.lens_mm > 0.0:
        axes.axvline(blur.focus_mm, color=ALLOWED, linestyle="--")
    axes.set(xlim=(0.0, blur.length_mm), ylim=(0.0, None), xlabel="x, mm", ylabel="variance of the blur, px²")
    axes.set_title("blur over depth. Want: points on the line, all along", fontsize=8)

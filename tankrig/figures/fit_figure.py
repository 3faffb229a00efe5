"""The picture of a fit: observation, reconstruction by scattering order, residuals, and single scattering beside it."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tankrig.estimation.estimate import Estimate
from tankrig.estimation.result import ALL_ORDERS, Reconstruction, light_of, told_apart
from tankrig.figures.tank_image import (
    FALSE_COLOUR,
    GREY,
    RESIDUAL_COLOUR,
    STYLE,
    Image,
    add_bar,
    brightness,
    draw,
    label_outer,
    pixel_centres,
    signed,
)
from tankrig.files import whole_file
from tankrig.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

OBSERVED, FULL, SINGLE = "#222222", "#0072b2", "#d55e00"
"""Colours of curves, which colour-blind readers tell apart too."""
PROFILE_X_MM = 40.0
"""Where the profile across the light is taken."""
NOISE_REACHES = 4.0
"""Standard deviations that noise alone hardly exceeds anywhere: the least range of colours of a structure map."""


def write_fit_figure(
    path: Path,
    scene: Scene,
    estimate: Estimate,
    rebuilt: Sequence[Reconstruction],
    single: Estimate | None,
    max_order: int | None = None,
) -> None:
    """Draw a fit and write it as a picture; the file is there whole or not at all.

    Every image is in percent of the observation's peak, all but the residuals on one square-root colour scale.

    Parameters
    ----------
    path
        Of the picture (.png, .pdf or .svg).
    scene
        Of the observation.
    estimate
        The fit.
    rebuilt
        Its reconstructions by order, see `by_order`.
    single
        Fit of the single-scattering model to the same image; None where that is what `estimate` is.
    max_order
        The highest order that was fitted; None for all that the model has.

    Raises
    ------
    StoreError
        When the file cannot be written.
    """
    import matplotlib
    from matplotlib.figure import Figure

    observed = estimate.image + estimate.residual
    percent = 100.0 / float(np.nanmax(observed))
    beside = "grey" if estimate.structure is None else "structure"
    rebuilt = told_apart(rebuilt, max_order)
    alone, whole = len(rebuilt) == 1, light_of(estimate.model, max_order)
    names = [["colour", beside, "text", "text"], *_rows(alone, single is not None)]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(15.0, 2.95 * len(names)), layout="constrained")
        axes: dict[str, Axes] = figure.subplot_mosaic(names)  # type: ignore[arg-type]
        scale = brightness(percent * observed)
        draw(axes["colour"], percent * observed, scene, FALSE_COLOUR, scale, "Observed, in false colour")
        if estimate.structure is None:
            draw(axes[beside], percent * observed, scene, GREY, scale, "Observed")
        else:
            _draw_structure(axes[beside], scene, estimate.structure)
        label_outer([[axes["colour"], axes[beside]]])
        _write_text(axes["text"], estimate)
        grid = [[axes[f"{kind}{index}"] for index in range(1 if alone else 4)] for kind in ("image", "residual")]
        reach = draw_reconstructions(grid, scene, rebuilt, observed, estimate.noise, whole)
        if alone:
            label_outer([[grid[0][0], grid[1][0]]])
        if single is not None:
            _draw_single((axes["single"], axes["single residual"]), scene, observed, estimate, single, reach)
        if "along" in axes:
            _draw_profiles((axes["along"], axes["across"]), scene, observed, estimate, single, whole)
        with whole_file(path) as unfinished:
            figure.savefig(unfinished, dpi=120)


def _rows(alone: bool, compared: bool) -> list[list[str]]:
    """What stands below the observation: of a model that tells no orders apart one image, which leaves room beside."""
    if alone and compared:
        return [["image0", "residual0", "single", "single residual"], ["along", "along", "across", "across"]]
    if alone:
        return [["image0", "residual0", "along", "across"]]
    orders = [[f"{kind}{index}" for index in range(4)] for kind in ("image", "residual")]
    return [*orders, ["single", "single residual", "along", "across"]] if compared else orders


def draw_reconstructions(
    grid: Sequence[Sequence["Axes"]],
    scene: Scene,
    rebuilt: Sequence[Reconstruction],
    observed: Image,
    noise: float,
    whole: str = ALL_ORDERS,
) -> "Normalize":
    """Reconstructions on the observation's colour scale above their residuals on one scale (the paper's Figs. 6, 7).

    Parameters
    ----------
    grid
        Two rows of axes, at least as many columns as reconstructions.
    scene
        Of the observation.
    rebuilt
        See `by_order`.
    observed, noise
        The observation and the standard deviation of its noise, image units.
    whole
        What the model's whole image holds, see `light_of`.

    Returns
    -------
    The residuals' scale, percent of the observed peak.
    """
    percent = 100.0 / float(np.nanmax(observed))
    scale = brightness(percent * observed)
    reach = signed(percent * rebuilt[0].residual, percent * noise)
    for column, one in enumerate(rebuilt):
        which = {"1": "order 1", "all": whole}.get(one.orders, f"orders {one.orders}")
        title = f"{which[:1].upper()}{which[1:]}: RMSE {percent * one.rmse:.3g} %"
        top = draw(grid[0][column], percent * one.image, scene, FALSE_COLOUR, scale, title)
        bottom = draw(grid[1][column], percent * one.residual, scene, RESIDUAL_COLOUR, reach, f"Observed − {which}")
    shown = [row[: len(rebuilt)] for row in grid]
    for unused in [one for row in grid for one in row[len(rebuilt) :]]:
        unused.axis("off")
    label_outer(shown)
    add_bar(grid[0], top)
    add_bar(grid[1], bottom, residual=True)
    return reach


def _write_text(axes: "Axes", estimate: Estimate) -> None:
    axes.axis("off")
    medium, sd = estimate.medium, np.sqrt(np.diag(estimate.covariance))
    lines = [
        f"$\\sigma_a$ = {medium.sigma_a:.4g} ± {sd[0]:.1g} /mm",
        f"$\\sigma_s$ = {medium.sigma_s:.4g} ± {sd[1]:.1g} /mm",
        f"$g$  = {medium.g:.4g} ± {sd[2]:.1g}",
    ]
    axes.text(0.02, 1.02, "\n".join(lines), va="top", fontsize=14, linespacing=1.5, transform=axes.transAxes)
    about = (
        f"{estimate.model} model\ngain {estimate.gain:.4g}\noffset {estimate.offset:.3g}\nnoise {estimate.noise:.3g}"
    )
    axes.text(0.6, 1.0, about, va="top", fontsize=10, linespacing=1.6, color="#444444", transform=axes.transAxes)
    verdict = "\n".join(textwrap.wrap(estimate.verdict, 92))
    axes.text(0.02, 0.5, verdict, va="top", fontsize=10, linespacing=1.4, color="#444444", transform=axes.transAxes)


def _draw_structure(axes: "Axes", scene: Scene, structure: Image) -> None:
    """Where neighbouring pixels leave something in common that noise does not."""
    from matplotlib.colors import Normalize

    reach = max(NOISE_REACHES, float(np.nanpercentile(np.abs(structure), 99.5)))
    shown = draw(axes, structure, scene, RESIDUAL_COLOUR, Normalize(-reach, reach), "Structure of the residual, in sd")
    figure = axes.get_figure()
    assert figure is not None
    figure.colorbar(shown, ax=axes, pad=0.008, aspect=22)


def _draw_single(
    axes: Sequence["Axes"], scene: Scene, observed: Image, estimate: Estimate, single: Estimate, reach: "Normalize"
) -> None:
    """Best fit of single scattering alone, and what it leaves."""
    image, residual = axes
    percent = 100.0 / float(np.nanmax(observed))
    ratio = single.medium.sigma_t / estimate.medium.sigma_t
    title = f"Single scattering alone: RMSE {percent * single.rmse:.3g} %"
    draw(image, percent * single.image, scene, FALSE_COLOUR, brightness(percent * observed), title)
    title = f"Observed − it; its $\\sigma_t$ is {ratio:.3g} × the fit's"
    draw(residual, percent * single.residual, scene, RESIDUAL_COLOUR, reach, title)
    label_outer([[image, residual]])


def _draw_profiles(
    axes: Sequence["Axes"], scene: Scene, observed: Image, estimate: Estimate, single: Estimate | None, whole: str
) -> None:
    """The observation and the fit along the light and across it, with single scattering where that was fitted too."""
    along, across = axes
    percent = 100.0 / float(np.nanmax(observed))
    x, y = pixel_centres(scene, (observed.shape[0], observed.shape[1]))
    row = int(np.nanargmax(np.nansum(observed, axis=1)))
    column = int(np.argmin(np.abs(x - PROFILE_X_MM)))
    fitted = "full fit" if whole == ALL_ORDERS else f"fit: {whole}"
    curves = {"observed": percent * observed, fitted: percent * estimate.image}
    if single is not None:
        curves["single-scattering fit"] = percent * single.image
    _draw_curves(along, x, {name: one[row] for name, one in curves.items()})
    along.set(xlabel="x (mm)", title=f"% of peak along the light, y = {y[row]:g} mm")
    _draw_curves(across, y, {name: one[:, column] for name, one in curves.items()})
    across.set(xlabel="y (mm)", title=f"% of peak across it, x = {x[column]:g} mm")
    along.legend()


def _draw_curves(axes: "Axes", at: Image, curves: Mapping[str, Image]) -> None:
    """The observation first, then the fit, then single scattering's."""
    (name, observed), (fitted, full), *rest = curves.items()
    axes.plot(at, observed, ".", color=OBSERVED, markersize=3.5, label=name)
    axes.plot(at, full, color=FULL, linewidth=1.4, label=fitted)
    for name, single in rest:
        axes.plot(at, single, color=SINGLE, linewidth=1.2, linestyle="--", label=name)
    axes.set_yscale("log")
    bright = np.concatenate([observed, full])
    positive = bright[bright > 0.0]
    axes.set_ylim(max(0.4 * float(np.percentile(positive, 1)), 0.001), 1.6 * float(np.nanmax(bright)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.spines[["top", "right"]].set_visible(False)

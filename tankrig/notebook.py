"""How results show themselves in a notebook: a table, and a figure beneath it.

Everything here takes plain words, numbers and arrays, so that scenes, predictions, estimates and runs can all lean on
it; matplotlib is imported when a figure is drawn.
"""

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FALSE_COLOUR = "inferno"
RESIDUAL_COLOUR = "RdBu_r"
MOST_SHOWN = 8
"""Pictures of one figure."""
_INCHES = 3.2
_DPI = 80


def page(heading: str, rows: Sequence[tuple[str, str]], figure: "Figure | None" = None) -> str:
    """HTML of a heading, a table of names and values, and a figure; what `_repr_html_` gives.

    Parameters
    ----------
    heading
        What is shown.
    rows
        Names and values as plain text.
    figure
        Drawn beneath; none where left out.

    Examples
    --------
    >>> print(page("a medium", [("g", "0.5 < 1")]))
    <p><b>a medium</b></p><table><tr><td>g</td><td>0.5 &lt; 1</td></tr></table>
    """
    cells = "".join(f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>" for name, value in rows)
    picture = "" if figure is None else f'<img alt="{html.escape(heading)}" src="{_embedded(figure)}">'
    return f"<p><b>{html.escape(heading)}</b></p><table>{cells}</table>{picture}"


def _embedded(figure: "Figure") -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=_DPI)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode("ascii")


def pictures(images: Mapping[str, ArrayLike], residuals: Sequence[str] = (), unit: str = "") -> "Figure":
    """Images side by side in false colour, on a square-root scale; residuals on one that is even about zero.

    Parameters
    ----------
    images
        (rows, columns) each, by title; the first `MOST_SHOWN` are drawn.
    residuals
        Titles of those that may be negative.
    unit
        Of all, beside the colours.

    Returns
    -------
    matplotlib's Figure, on no screen; a notebook shows it, `savefig` writes it.
    """
    from matplotlib.colors import Normalize, PowerNorm
    from matplotlib.figure import Figure

    shown = list(images.items())[:MOST_SHOWN]
    columns = min(4, max(1, len(shown)))
    rows = -(-max(1, len(shown)) // columns)
    figure = Figure(figsize=(_INCHES * columns, 0.85 * _INCHES * rows), layout="constrained")
    for number, (title, image) in enumerate(shown, 1):
        values = np.asarray(image, float)
        finite = values[np.isfinite(values)]
        axes = figure.add_subplot(rows, columns, number)
        axes.set_title(title, loc="left", fontsize=9)
        axes.set_xlabel("column")
        axes.set_ylabel("row")
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        scale: Normalize
        if title in residuals:
            reach = max(abs(low), abs(high)) or 1.0
            scale, colours = Normalize(-reach, reach), RESIDUAL_COLOUR
        else:
            scale, colours = PowerNorm(0.5, low, high if high > low else low + 1.0, clip=True), FALSE_COLOUR
        drawn = axes.imshow(values, cmap=colours, norm=scale, origin="lower", interpolation="nearest")
        figure.colorbar(drawn, ax=axes, shrink=0.8, label=unit)
    return figure


def rectangles(
    extents: Mapping[str, tuple[tuple[float, float], tuple[float, float]]], across: str, up: str
) -> "Figure":
    """Rectangles in mm, one in another.

    Parameters
    ----------
    extents
        ((low, high) across, (low, high) up) by label; the first is drawn as a frame, the others filled.
    across, up
        Names of the axes.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    figure = Figure(figsize=(1.6 * _INCHES, _INCHES), layout="constrained")
    axes = figure.add_subplot()
    for number, (label, ((left, right), (bottom, top))) in enumerate(extents.items()):
        colour = f"C{number % 10}"
        axes.add_patch(
            Rectangle((left, bottom), right - left, top - bottom, fill=number > 0, alpha=0.5, color=colour, label=label)
        )
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel(f"{across} / mm")
    axes.set_ylabel(f"{up} / mm")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return figure

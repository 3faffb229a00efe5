"""The picture that shows whether to believe a camera's halo and veil: light beside the card, seen and fitted."""

from pathlib import Path

import numpy as np

from tankrig.calibration.stray_light import StrayFound
from tankrig.figures.tank_image import STYLE
from tankrig.files import whole_file

SEEN, FITTED = "#0072b2", "#d55e00"


def write_stray_figure(path: Path, camera: str, found: StrayFound) -> None:
    """Draw the light beside the card over its distance, with what halo and veil explain, and what is left.

    Parameters
    ----------
    path
        Of the picture (.png, .pdf or .svg).
    camera
        Its name.
    found
        What was measured.

    Raises
    ------
    StoreError
        When the picture cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    away, seen, fitted = found.beside.T
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        beside, left = figure.subplots(1, 2).ravel().tolist()
        beside.semilogy(away, np.maximum(100.0 * seen, 1e-4), ".", color=SEEN, label="seen")
        beside.semilogy(away, np.maximum(100.0 * fitted, 1e-4), color=FITTED, label="halo and veil")
        beside.set(xlabel="px from the card", ylabel="% of the card's light")
        beside.set_title("light beside the card. Want: points on the line", fontsize=8)
        beside.legend(frameon=False, fontsize=8)
        left.plot(away, 100.0 * (seen - fitted), ".-", color=SEEN)
        left.axhline(0.0, color=FITTED, linewidth=0.8)
        left.set(xlabel="px from the card", ylabel="% of the card's light")
        left.set_title("seen less fitted. Want: about zero", fontsize=8)
        figure.suptitle(
            f"{camera}: halo {100 * found.share:.2f} ± {100 * found.sd[0]:.2g} %, veil {100 * found.veil:.2f} ± "
            f"{100 * found.sd[2]:.2g} %",
            fontsize=10,
        )
        with whole_file(path) as unfinished:
            figure.savefig(unfinished, dpi=130)

"""What unpolarised light of one wavelength leaves out, for polystyrene beads: the figure and tables of scalar_light.md.

python docs/figures/scalar_light.py [--out docs/figures]
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.console import Console

from tankrig.figures.tank_image import STYLE
from tankrig.materials.library import material
from tankrig.materials.scalar_light import SEEN_DEG, band_change, left_out, second_order
from tankrig.scene.mie import Mie

DIAMETERS_UM = (0.2, 0.5, 1.0, 2.0)
WAVELENGTHS_NM = (450.0, 532.0, 633.0)
BANDS_NM = (5.0, 20.0, 60.0)
COLOURS = ("#0072b2", "#009e73", "#d55e00", "#cc79a7")


def bead(diameter_um: float, wavelength_nm: float) -> Mie:
    """Beads of the library."""
    beads = material(f"polystyrene-{diameter_um:g}").beads
    assert beads is not None
    return beads.mie(wavelength_nm)


def figure() -> Figure:
    """P(θ); the error of order 2 by diameter; what a band changes."""
    drawn = Figure(figsize=(12.5, 3.7), layout="constrained")
    left, middle, right = drawn.subplots(1, 3)
    angle = np.linspace(0.0, 180.0, 361)
    bands = np.array([1.0, 5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    for diameter_um, colour in zip(DIAMETERS_UM, COLOURS, strict=True):
        mie = bead(diameter_um, 532.0)
        label = f"{diameter_um:g} µm"
        left.plot(angle, mie.polarisation(np.cos(np.radians(angle))), color=colour, linewidth=1.2, label=label)
        wide = [100.0 * band_change(mie, float(band_nm)) for band_nm in bands]
        right.plot(bands, wide, color=colour, linewidth=1.2, label=label)
    sizes = np.geomspace(0.05, 3.0, 30)
    for wavelength_nm, colour in zip(WAVELENGTHS_NM, COLOURS, strict=False):
        off = [100.0 * second_order(replace(bead(float(size), wavelength_nm), spread=0.0)) for size in sizes]
        middle.semilogx(sizes, off, color=colour, linewidth=1.2, label=f"{wavelength_nm:g} nm")
    left.axvspan(*SEEN_DEG, color="#e69f00", alpha=0.12, linewidth=0.0)
    left.set(title="P(θ) of beads at 532 nm", xlabel="θ (°)", xlim=(0.0, 180.0), ylim=(-1.0, 1.0))
    middle.set(title="order 2, changed by its own polarisation (%)", xlabel="diameter (µm)")
    middle.set_xticks((0.05, 0.1, 0.2, 0.5, 1.0, 2.0), ("0.05", "0.1", "0.2", "0.5", "1", "2"))
    right.set(title="σs p(80 … 100°), changed by a band (%)", xlabel="full width of the band (nm)", xlim=(0.0, 60.0))
    for axes in (left, middle, right):
        axes.legend(loc="best")
        axes.grid(alpha=0.25, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


def table() -> None:
    """Rows of the page's table."""
    console = Console()
    for diameter_um in DIAMETERS_UM:
        for wavelength_nm in WAVELENGTHS_NM:
            mie = bead(diameter_um, wavelength_nm)
            least, most = left_out(mie).polarisation
            bands = " / ".join(f"{100.0 * band_change(mie, band_nm):.1f}" for band_nm in BANDS_NM)
            console.print(
                f"| {diameter_um:g} | {wavelength_nm:g} | {least:+.2f} … {most:+.2f} | "
                f"{100.0 * second_order(mie):+.1f} | {bands} |"
            )


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--out", type=Path, default=Path("docs/figures"))
    out = asked.parse_args().out
    table()
    with rc_context(STYLE):
        figure().savefig(out / "scalar_light.png", dpi=110)

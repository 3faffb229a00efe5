"""The picture of a radiometric calibration, by which a person sees whether to believe it."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tankrig.calibration.radiometry_procedure import RadiometryMeasured, Sweep
from tankrig.figures.tank_image import GREY, STYLE
from tankrig.files import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RAW, CORRECTED, ALLOWED = "#d55e00", "#0072b2", "#999999"
"""Colours that colour-blind readers tell apart, too."""


def write_radiometry_figure(path: Path, measured: RadiometryMeasured) -> None:
    """Draw linearity, photon transfer, darks, flat, response and the response's error; the file is there whole or not.

    Parameters
    ----------
    path
        Of the picture (.png, .pdf or .svg).
    measured
        What was found.

    Raises
    ------
    StoreError
        When the picture cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(12.0, 7.0), layout="constrained")
        axes = figure.subplots(2, 3).ravel().tolist()
        first = measured.sweeps[0]
        _linearity(axes[0], first)
        _transfer(axes[1], first)
        _darks(axes[2], first)
        _flat(axes[3], measured)
        _response(axes[4], measured)
        _response_error(axes[5], measured)
        figure.suptitle(f"{measured.camera}: radiometry at gain {first.gain:g}", fontsize=10)
        with whole_file(path) as unfinished:
            figure.savefig(unfinished, dpi=130)


def _linearity(axes: "Axes", sweep: Sweep) -> None:
    good = ~sweep.dark.hot
    used = [one for one in sweep.exposures if one.mean[good].mean() <= sweep.linearity.full]
    times = np.array([one.exposure_ms for one in used])
    counts = np.array([one.mean[good].mean() for one in used])
    linear = np.array([sweep.linearity.linear(one.mean[good]).mean() for one in used])
    for values, colour, name in ((counts, RAW, "as read"), (linear, CORRECTED, "corrected")):
        off = 100.0 * (values / times / np.median(values / times) - 1.0)
        axes.semilogx(counts, off, "o-", ms=3, lw=1, color=colour, label=name)
    axes.axhspan(-0.5, 0.5, color=ALLOWED, alpha=0.2, lw=0)
    axes.set(title="Linearity", xlabel="counts above the dark", ylabel="off a straight line, %")
    axes.legend(frameon=False)


def _transfer(axes: "Axes", sweep: Sweep) -> None:
    good, transfer = ~sweep.dark.hot, sweep.transfer
    mean = np.array([sweep.linearity.linear(one.mean[good]).mean() for one in sweep.exposures])
    stretched = [(one.variance[good] * sweep.linearity.slope(one.mean[good]) ** 2).mean() for one in sweep.exposures]
    axes.loglog(mean, stretched, "o", ms=3, color=CORRECTED)
    line = np.geomspace(mean.min(), mean.max(), 50)
    axes.loglog(line, transfer.dn_per_e * line + sweep.dark.read_variance, lw=1, color="k")
    told = (
        f"{transfer.dn_per_e:.4g} ± {transfer.dn_per_e_sd:.2g} counts per electron\n"
        f"read noise {transfer.read_noise_e:.3g} ± {transfer.read_noise_e_sd:.2g} electrons"
    )
    axes.text(0.04, 0.95, told, transform=axes.transAxes, va="top")
    axes.set(title="Photon transfer", xlabel="linear counts above the dark", ylabel="variance, counts²")


def _darks(axes: "Axes", sweep: Sweep) -> None:
    rate = sweep.dark.rate
    low, high = np.quantile(rate, (0.0005, 0.998))
    axes.hist(rate.ravel(), bins=np.linspace(low, high, 60).tolist(), color=CORRECTED, log=True)
    hot = int(sweep.dark.hot.sum())
    axes.locator_params(axis="x", nbins=4)
    axes.set(title=f"Dark current; {hot} hot pixels", xlabel="counts per ms", ylabel="pixels")


def _flat(axes: "Axes", measured: RadiometryMeasured) -> None:
    flat = measured.flat
    shown = axes.imshow(flat.response, cmap=GREY, vmin=float(np.quantile(flat.response, 0.001)))
    axes.figure.colorbar(shown, ax=axes, shrink=0.8)
    axes.set(title=f"Flat: corners −{100 * flat.vignetting:.1f} %, pixels ± {100 * flat.uneven:.2f} %")
    axes.set_xticks([])
    axes.set_yticks([])


def _response(axes: "Axes", measured: RadiometryMeasured) -> None:
    level, light, _ = measured.measured.T
    axes.plot(level, 100.0 * light, "o", ms=3, color=CORRECTED, label="measured")
    axes.plot(100.0 * measured.response.curve, lw=1, color="k", label="fit")
    axes.set(title=f"Projector, γ ≈ {measured.response.gamma():.2f}", xlabel="level", ylabel="light, % of level 255")
    axes.text(0.04, 0.75, f"level 0 has {100 * measured.response.leak:.2g} %", transform=axes.transAxes)
    axes.legend(frameon=False, loc="upper left")


def _response_error(axes: "Axes", measured: RadiometryMeasured) -> None:
    from tankrig.calibration.radiometry_plan import CHECKED_LEVELS

    levels = [level for level in measured.measured[:, 0] if level in CHECKED_LEVELS]
    axes.axhspan(-1.0, 1.0, color=ALLOWED, alpha=0.2, lw=0)
    axes.plot(levels, 100.0 * measured.checked, "o", ms=4, color=RAW)
    axes.set(title="Levels that were left out of the fit", xlabel="level", ylabel="fit off by, %", xlim=(0, 255))

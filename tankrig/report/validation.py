"""`write_validation`: a run beside a reference liquid, as one page that needs nothing but itself."""

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.bench import Bench
from tankrig.checked_toml import checked
from tankrig.errors import ImageError, StoreError
from tankrig.figures.tank_image import STYLE
from tankrig.files import require_writable, whole_file
from tankrig.live.formatting import with_error
from tankrig.materials.coefficients import Optics
from tankrig.materials.dosing import tank_volume_ml
from tankrig.materials.scalar_light import left_out
from tankrig.report.beside_reference import AGREES, TANK_SD, WIDEST, Row, Validation, budget, validated
from tankrig.report.inlined import inlined, rendered
from tankrig.report.results import recorded
from tankrig.run.reading import Run, open_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOUND, KNOWN = "#0072b2", "#222222"


def validation_of(
    run: Run,
    optics: Optics,
    tank_ml: float | None = None,
    tank_relative_sd: float = TANK_SD,
    stock: float = 1.0,
    polarisation: float | None = None,
) -> Validation:
    """A run's recorded fits beside a reference; see `tankrig.report.beside_reference.validated`.

    Where nobody says how far the light is polarised, what the run's bench says counts.

    Raises
    ------
    ImageError
        When the run has no fit of its series, of which the reference could be asked.
    """
    doses, series = recorded(run)
    if series is None:
        raise ImageError(f"{run.path}: its series is not fitted, which takes two doses; run tankrig refit {run.path}")
    bench = checked(Bench, dict(run.settings["bench"]), f"{run.path}: its bench", StoreError)
    polarisation = bench.polarisation if polarisation is None else polarisation
    fitted = [one for one in doses if one.dose_ml in series.doses_ml]
    volume_ml = tank_ml or tank_volume_ml(bench.tank)
    return validated(optics, series, fitted, volume_ml, tank_relative_sd, stock, polarisation)


def fitted_as(run: Run, optics: Optics) -> bool:
    """Whether a run's series, where it has one, was fitted with the phase functions that a material may have."""
    _, series = recorded(run)
    wanted = optics.searched
    name = wanted if isinstance(wanted, str) else wanted.kind
    return series is None or (series.scattering is not None and name in series.scattering.families)


def write_validation(path: Path, found: Validation, out: Path | None = None) -> Path:
    """Write the page of a validation.

    Parameters
    ----------
    path
        Folder of the run.
    found
        What was compared.
    out
        The .html file, or a folder for validation.html; the run's own folder where None.

    Returns
    -------
    Path
        Of the file.
    """
    target = path / "validation.html" if out is None else out if out.suffix == ".html" else out / "validation.html"
    require_writable(target.parent)
    page = validation_page(open_run(path), found)
    with whole_file(target) as unfinished:
        unfinished.write_text(page, encoding="utf-8")
    return target


def validation_page(run: Run, found: Validation) -> str:
    """The page as HTML."""
    import matplotlib as mpl

    optics = found.optics
    with mpl.rc_context(STYLE):
        pictures = {"doses": inlined(_doses(found), "svg"), "phase": inlined(_phase(found), "svg")}
    parts = ", ".join(f"{cause} {100.0 * share:.1f} %" for cause, share in budget(found.rows[0]).items())
    diluted = "" if found.stock == 1.0 else f", 1 part in {found.stock:g}"
    return rendered(
        "validation.html",
        title=f"{optics.material.title} at {optics.wavelength_nm:g} nm",
        subtitle=f"{run.path.name} · {run.settings.get('rig', '')} · {found.tank_ml:.0f} ml of water{diluted}",
        passed=found.passed,
        verdict=found.verdict,
        rows=[_row(one) for one in found.rows],
        agrees=f"{AGREES:g} standard deviations",
        widest=f"{100.0 * WIDEST:.0f} %",
        budget=parts,
        linearity=_linearity(found),
        phase=_phase_words(found),
        pictures=pictures,
        left_out=_left_out(found),
        sources=list(optics.material.sources.items()),
        footer=f"made by tankrig {version('tankrig')}",
    )


def _row(one: Row) -> dict[str, Any]:
    by = 100.0 / one.known.value if one.known.value else 0.0
    return {
        "name": one.name,
        "unit": one.unit,
        "found": with_error(one.found, one.found_sd),
        "known": with_error(one.known.value, one.known.sd),
        "difference": f"{by * (one.found - one.known.value):+.1f} %",
        "deviations": f"{one.deviations:+.1f}",
        "says": one.says,
        "bad": one.says == "disagrees",
    }


def _linearity(found: Validation) -> str:
    bend = found.series.linearity
    if bend is None:
        return "Not tested: that takes three doses."
    said = "holds" if bend.holds else "does not hold"
    return (
        "In so thin a suspension particles scatter independently, so σs must grow in proportion to the dose: that "
        f"{said} ({100.0 * bend.bend:+.1f} ± {100.0 * bend.sd:.1f} % at the highest dose)."
    )


def _phase_words(found: Validation) -> str:
    said = "The reference's, with its uncertainty, beside the fit's."
    if found.series.ink.phase is not None:
        return said
    return f"{said} The fit was of Henyey–Greenstein, which no such liquid is: its σs and g explain most of the light."


def _left_out(found: Validation) -> list[str]:
    beads = found.optics.material.beads
    lines = [
        f"The tank's volume is that of its sides in the run, {found.tank_ml:.0f} ml; what was dosed adds less than a "
        f"permille to it ({1000.0 * max(found.series.doses_ml) / found.tank_ml:.2g} ‰)."
    ]
    if beads is not None:
        bounds = left_out(beads.mie(found.optics.wavelength_nm))
        lines += [
            f"Polarised light changes order 1 by up to ± {100.0 * bounds.first_order():.0f} %, in proportion to its "
            "degree; what was said of that is in the uncertainty of the reference.",
            "Light is computed as scalar: that of order 2, polarised by order 1, differs from it by "
            f"{100.0 * bounds.second_order:+.1f} %.",
            f"A band of {bounds.band_nm:g} nm changes σs·p by up to {100.0 * bounds.band:.1f} % where the camera "
            "looks.",
        ]
    structure = max((one.structure or 0.0 for one in found.doses), default=0.0)
    if structure:
        share = f"{100.0 * structure:.2g} %"
        lines.append(f"Up to {share} of a dose's light is not as the fit's model has it, and counted in its errors.")
    return lines


def _doses(found: Validation) -> "Figure":
    """σs against the dose, and over the reference."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    at = np.array([one.dose_ml for one in found.doses])
    sigma_s = np.array([one.medium.sigma_s for one in found.doses])
    errors = 1.96 * np.array([one.sd[1] if len(one.sd) > 1 else 0.0 for one in found.doses])
    along = np.linspace(0.0, 1.06 * max(found.series.doses_ml), 50)
    known = found.rows[0].known
    for axes, by in ((left, along), (right, np.full(along.size, 1.0 / known.value))):
        low, high = ((known.value + side * 1.96 * known.sd) * by for side in (-1.0, 1.0))
        axes.fill_between(along, low, high, color=KNOWN, alpha=0.15, linewidth=0.0)
        axes.plot(along, known.value * by, color=KNOWN, linewidth=1.2, label="reference, 95 %")
        axes.set(xlabel="dosed (ml)", xlim=(0.0, along[-1]))
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, linewidth=0.6)
    style: dict[str, Any] = {"fmt": "o", "color": FOUND, "markersize": 5, "capsize": 3, "label": "run, 95 %"}
    left.errorbar(at, sigma_s, errors, **style)
    expected = known.value * at
    right.errorbar(at, sigma_s / expected, errors / expected, **style)
    left.set_title("$\\sigma_s$ (1/mm)")
    right.set_title("$\\sigma_s$ over the reference")
    left.legend(loc="upper left")
    return figure


def _phase(found: Validation) -> "Figure":
    """p(θ) of both, on a logarithmic scale, and the fit's over the reference's."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 3.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    angle = np.linspace(0.0, 180.0, 361)
    cosine = np.cos(np.radians(angle))
    known, sd = found.optics.density(cosine)
    fitted, curve = found.series.ink.phase_function.at(cosine), found.series.scattering
    for axes, by in ((left, np.ones_like(known)), (right, 1.0 / known)):
        low, high = (np.maximum((known + side * 1.96 * sd) * by, 1e-9) for side in (-1.0, 1.0))
        axes.fill_between(angle, low, high, color=KNOWN, alpha=0.15, linewidth=0.0)
        axes.plot(angle, known * by, color=KNOWN, linewidth=1.2, label="reference, 95 %")
        axes.plot(angle, fitted * by, color=FOUND, linewidth=1.2, label="fit")
        if curve is not None:
            at, middle, sd_of_log = (np.array(one) for one in (curve.angle_deg, curve.value, curve.sd))
            scale = np.interp(at, angle, by)
            low, high = (middle * np.exp(side * 1.96 * sd_of_log) * scale for side in (-1.0, 1.0))
            axes.fill_between(at, low, high, color=FOUND, alpha=0.2, linewidth=0.0, label="fit, 95 %")
        axes.axvspan(80.0, 100.0, color="#e69f00", alpha=0.12, linewidth=0.0, label="seen of order 1")
        axes.set(xlabel="$\\theta$ (°)", xlim=(0.0, 180.0), xticks=range(0, 181, 30))
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, linewidth=0.6)
    left.set_yscale("log")
    left.set_title("$p(\\theta)$ (1/sr)")
    right.set_ylim(0.0, float(np.clip(1.3 * np.max(fitted / known), 1.5, 5.0)))
    right.set_title("over the reference's $p(\\theta)$")
    left.legend(loc="upper right")
    return figure

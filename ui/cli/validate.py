"""`tankrig validate`: a dilution series of a reference liquid beside what is published of it."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.materials import label_option, optics_of, stock_option
from ui.cli.options import FiniteRange, json_option, out_option
from ui.cli.refit import progress_shown
from ui.cli.tables import tell_table

if TYPE_CHECKING:
    from tankrig.report.beside_reference import Validation
    from tankrig.run.reading import Run


@click.command(epilog="Example: tankrig validate runs/2026-11-20T10-00-00 --material polystyrene-1.0 --wavelength 633")
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--material", "name", required=True, metavar="NAME", help="What was dosed; tankrig materials lists them.")
@click.option("--wavelength", "wavelength_nm", type=FiniteRange(min=0.0, min_open=True), metavar="NM",
              help="Of the projector's light, in vacuum; default: what the run's sequence says.")  # fmt: skip
@label_option
@stock_option
@click.option("--tank-ml", type=FiniteRange(min=0.0, min_open=True), help="Water in the tank; default: the run's.")
@click.option("--tank-sd", type=FiniteRange(min=0.0), default=0.005, show_default=True,
              help="Standard deviation of that volume, as a share of it.")  # fmt: skip
@click.option("--band-nm", type=FiniteRange(min=0.0), default=0.0, show_default=True,
              help="Full width at half maximum of the light's band.")  # fmt: skip
@click.option(
    "--polarisation",
    type=FiniteRange(0.0, 1.0),
    help="Largest degree of the light's linear polarisation, 0 for none; default: what the run's bench says, else all "
    "is possible.",
)
@click.option("--quick", is_flag=True, help="Compare what RUN has fitted, and fit nothing.")
@out_option(None, "The .html file, or a folder for it; default: validation.html in RUN.")
@json_option
def validate(
    run: Path, name: str, wavelength_nm: float | None, label: tuple[tuple[str, Any], ...], stock: float | None,
    tank_ml: float | None, tank_sd: float, band_nm: float, polarisation: float | None, quick: bool, out: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Compare RUN, a dilution series of a reference liquid, with what is known of it, and write one page.

    Coefficients per ml beside the reference with both uncertainties, proportion to the dose as a test that must come
    out null, and the phase function. It passes only where what was determined agrees, and could have disagreed. A run
    whose fits searched other phase functions than the material may have is fitted anew: beads by their label, other
    liquids by any smooth one.
    """
    from tankrig.live.refit import refit
    from tankrig.report import fitted_as, validation_of, write_validation
    from tankrig.run.reading import open_run

    wavelength_nm = wavelength_nm or wavelength_of(open_run(run))
    optics = optics_of(name, wavelength_nm, label, band_nm)
    if not quick:
        with progress_shown() as told:
            refit(run, not fitted_as(open_run(run), optics), progress=told, phase=optics.searched)
    found = validation_of(open_run(run), optics, tank_ml, tank_sd, stock or 1.0, polarisation)
    file = write_validation(run, found, out)
    if as_json:
        click.echo(json.dumps(fields_of(found) | {"report": str(file)}, ensure_ascii=False))
    else:
        tell(found)
        click.echo(f"written  {file}")
    warn_of_polarisation(found)


def wavelength_of(run: "Run") -> float | None:
    """What the sequence of a run says of its light, nm; None where it says nothing."""
    said = run.settings.get("sequence", {}).get("wavelength_nm")
    return float(said) if isinstance(said, int | float) else None


def warn_of_polarisation(found: "Validation") -> None:
    """Say on stderr that the light's polarisation was counted as anything, where that is so."""
    if found.polarisation is None:
        click.echo("nobody said how polarised the light is, so it may be anything; give --polarisation", err=True)


def fields_of(found: "Validation") -> dict[str, Any]:
    """For `--json`."""
    bend = found.series.linearity
    rows = {
        row.name: {"found": row.found, "found_sd": row.found_sd, "reference": row.known.value,
                   "reference_sd": row.known.sd, "deviations": row.deviations, "says": row.says}
        for row in found.rows
    }  # fmt: skip
    linearity = None if bend is None else {"bend": bend.bend, "sd": bend.sd, "holds": bend.holds}
    return {
        "material": found.optics.material.name, "wavelength_nm": found.optics.wavelength_nm, "passed": found.passed,
        "verdict": found.verdict, "rows": rows, "linearity": linearity,
    }  # fmt: skip


def tell(found: "Validation") -> None:
    """As a table, and in a sentence."""
    from tankrig.live.formatting import with_error

    rows = [
        (row.name, with_error(row.found, row.found_sd), with_error(row.known.value, row.known.sd), row.unit, row.says)
        for row in found.rows
    ]
    tell_table(("", "run", "reference", "", ""), rows, left=range(5), sentences=True)
    click.echo(f"each ± is one standard deviation\n\n{found.verdict}\n")

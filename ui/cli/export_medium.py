"""`tankrig export-medium`: a fitted liquid as a file of another program."""

import json
from pathlib import Path

import click

from ui.cli.options import FINITE, FiniteRange, json_option, out_option


@click.command("export-medium", epilog="Example: tankrig export-medium tank-fit.json --to mitsuba --out milk.xml")
@click.argument("given", metavar="FIT", type=click.Path(path_type=Path))
@click.option("--to", required=True, type=click.Choice(["mitsuba", "pbrt", "mcx", "csv"]),
              help="Mitsuba 3, pbrt-v4, MCX, or a table of angles.")  # fmt: skip
@click.option("--dose-ml", type=FINITE, help="Which dose of a run; default: the last that is fitted.")
@click.option("--unit-mm", type=FiniteRange(min=0.0, min_open=True), default=1.0, show_default=True,
              help="Length of one unit of the other scene, or of a voxel.")  # fmt: skip
@out_option(None, "The file; default: the name of FIT with the other program's suffix, in this folder.")
@json_option
def export_medium(given: Path, to: str, dose_ml: float | None, unit_mm: float, out: Path | None, as_json: bool) -> None:
    """Write the liquid of FIT in another program's units and phase functions.

    FIT is the .json that tankrig fit writes, the folder of a fitted run, or a scene file. What the other program
    cannot hold is said in the file.
    """
    from tankrig.estimation.verdict import SYMBOLS
    from tankrig.exchange.formats import SUFFIXES, exported
    from tankrig.exchange.liquid import liquid_of
    from tankrig.files import whole_file

    liquid = liquid_of(given, dose_ml)
    text = exported(liquid, to, unit_mm)
    file = out or Path(f"{given.resolve().stem}-{to}{SUFFIXES[to]}")
    with whole_file(file) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    if liquid.undetermined:
        names = " and ".join(SYMBOLS[name] for name in liquid.undetermined)
        are = "are" if len(liquid.undetermined) > 1 else "is"
        click.echo(f"{names} {are} not determined by the fit, which the file says beside the number", err=True)
    if as_json:
        click.echo(json.dumps({"file": str(file), "not_determined": list(liquid.undetermined)}))
    else:
        click.echo(f"written  {file}")

"""`tankrig separate`: what waves of light tell of a run's orders of scattering, without a model of the liquid."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from tankrig.live.results import DoseFit
    from tankrig.live.separated import Told
    from tankrig.separation import Separation


@click.command(epilog="Example: tankrig separate runs/2026-11-20T10-00-00 --orders")
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@out_option(None, "Folder for the pictures; default: derived in RUN.")
@click.option("--orders", is_flag=True, help="Draw what the fitted liquid says, order by order; takes seconds a dose.")
@json_option
def separate(run: Path, out: Path | None, orders: bool, as_json: bool) -> None:
    """Separate light that still follows the waves of RUN's `separate` steps from light that has forgotten them.

    For each dose and sheet: how much follows each wave, order 1 by carrying that on to a period of 0, and σt from its
    decay. None of it needs a model of the liquid. Where the dose is fitted, order 1 is compared with the fit's. The
    arrays are kept in RUN, in the folder derived.
    """
    import matplotlib as mpl
    from rich.console import Console

    from tankrig.figures.separation_figure import separation_figure
    from tankrig.figures.tank_image import STYLE
    from tankrig.files import require_writable
    from tankrig.live.recorded import fits_that_hold
    from tankrig.live.results import fits_in
    from tankrig.live.separated import told_of
    from tankrig.run.derived import FOLDER, write_derived
    from tankrig.run.reading import open_run
    from tankrig.separation import separations_of_run

    opened = open_run(run)
    folder = out or run / FOLDER
    require_writable(folder if folder.is_dir() else folder.parent)
    told: list[tuple[Told, Path | None]] = []
    with Console(stderr=True).status("reading the frames") as status, mpl.rc_context(STYLE):
        fits = {round(one.dose_ml, 6): one for one in fits_in([event.fields for event in fits_that_hold(opened)])[0]}
        for one in separations_of_run(opened):
            fit = fits.get(round(one.dose_ml, 6))
            name = f"separation-{one.dose_ml:g}ml-z{0.5 * sum(one.z_mm):g}mm"
            status.update(f"separating {one.dose_ml:g} ml")
            found = told_of(one, fit)
            write_derived(run, name, one.arrays(), one.frames, **found.row)
            expected = None
            if orders and fit is not None:
                status.update(f"predicting {one.dose_ml:g} ml order by order")
                expected = _expected(one, fit)
            picture = None
            if one.transfers:
                folder.mkdir(exist_ok=True)
                picture = folder / f"{name}.png"
                separation_figure(one, expected).savefig(picture, dpi=110)
            told.append((found, picture))
    if as_json:
        rows = [{**found.row, **({"picture": str(file)} if file else {})} for found, file in told]
        click.echo(json.dumps({"run": str(run), "sheets": rows}))
    else:
        _tell([found for found, _ in told])
        for _, file in told:
            click.echo(f"written  {file}") if file else None


def _expected(one: "Separation", fit: "DoseFit") -> dict[float, Any]:
    from tankrig.separation import expected_separation

    return {
        transfer.wave.period_mm: expected_separation(transfer.wave, one.bench, one.camera, fit.medium)
        for transfer in one.transfers
    }


def _tell(rows: "list[Told]") -> None:
    from rich.console import Console
    from rich.table import Table

    from tankrig.live.formatting import with_error

    table = Table(box=None, pad_edge=False)
    periods = sorted({period_mm for row in rows for period_mm in row.follow})
    follow = (f"{period_mm:g} mm, %" for period_mm in periods)
    for heading in ("ink, ml", "z, mm", *follow, "order 1, %", "σt, 1/mm", "order 1 / fit"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        order_1 = None if row.order_1 is None else (100.0 * row.order_1[0], 100.0 * row.order_1[1])
        beside = None if row.over_fit is None else (row.over_fit.ratio, row.over_fit.sd)
        table.add_row(
            f"{row.dose_ml:.4g}",
            f"{row.height_mm:g}",
            *(f"{100.0 * row.follow[one]:.1f}" if one in row.follow else "–" for one in periods),
            *(
                "–" if one is None else with_error(*one).replace(" ", "\u00a0")
                for one in (order_1, row.sigma_t, beside)
            ),
        )
    Console(highlight=False, width=110).print(table)
    click.echo("under each period: the part of the sheet's light that follows a wave of it")
    for row in rows:
        for doubt in row.doubts:
            click.echo(f"{row.dose_ml:.4g} ml, z = {row.height_mm:g} mm: {doubt}")

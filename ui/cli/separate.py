"""`tankrig separate`: what waves of light tell of a run's orders of scattering, without a model of the liquid."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from tankrig.live.results import DoseFit
    from tankrig.run.reading import Run
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
    from tankrig.live.exposures import fits_that_hold
    from tankrig.live.results import fits_in
    from tankrig.run.derived import FOLDER, write_derived
    from tankrig.run.reading import open_run
    from tankrig.separation import separations_of_run

    opened = open_run(run)
    folder = out or run / FOLDER
    require_writable(folder if folder.is_dir() else folder.parent)
    told: list[dict[str, Any]] = []
    with Console(stderr=True).status("reading the frames") as status, mpl.rc_context(STYLE):
        fits = {round(one.dose_ml, 6): one for one in fits_in([event.fields for event in fits_that_hold(opened)])[0]}
        for one in separations_of_run(opened):
            fit = fits.get(round(one.dose_ml, 6))
            middle_mm = 0.5 * (one.z_mm[0] + one.z_mm[1])
            name = f"separation-{one.dose_ml:g}ml-z{middle_mm:g}mm"
            status.update(f"separating {one.dose_ml:g} ml")
            row = _row(opened, one, fit)
            write_derived(run, name, one.arrays(), one.frames, **row)
            expected = None
            if orders and fit is not None:
                status.update(f"predicting {one.dose_ml:g} ml order by order")
                expected = _expected(one, fit)
            folder.mkdir(exist_ok=True)
            file = folder / f"{name}.png"
            if one.transfers:
                separation_figure(one, expected).savefig(file, dpi=110)
                row["picture"] = str(file)
            told.append(row)
    if as_json:
        click.echo(json.dumps({"run": str(run), "sheets": told}))
    else:
        _tell(told)


def _row(run: "Run", one: "Separation", fit: "DoseFit | None") -> dict[str, Any]:
    """What is told of a sheet, as numbers and sentences."""
    from tankrig.separation.expected import extinction, sheet_scene
    from tankrig.scene.description import Medium

    row: dict[str, Any] = {"dose_ml": one.dose_ml, "z_mm": list(one.z_mm), "doubts": list(one.doubts)}
    if not one.transfers:
        return row
    lit = one.transfers[0].seen
    whole = float(one.sheet[lit].sum())
    row["follow"] = {f"{p:g}": float(waves.modulated[lit].sum()) / whole for p, waves in one.waves.items()}
    first = one.order_one
    if first is None:
        return row
    known = first.known
    part = float(one.sheet[known].sum())
    by_noise = float((first.noise[known] ** 2).sum()) ** 0.5
    row["order_1"] = float(first.image[known].sum()) / part
    row["order_1_sd"] = (by_noise**2 + float(first.model[known].sum()) ** 2) ** 0.5 / part
    medium = fit.medium if fit is not None else Medium(0.0, 0.01, 0.0)
    scene = sheet_scene(one.transfers[0].wave, one.bench, one.camera, medium)
    if row["order_1"] > 3.0 * row["order_1_sd"]:
        row["sigma_t"], row["sigma_t_sd"] = extinction(first, scene)
    if fit is not None:
        from tankrig.light.single import single_scattering
        from tankrig.separation.expected import agreement

        beside = agreement(first, fit.gain * single_scattering(scene))
        row["over_fit"], row["over_fit_sd"] = beside.ratio, beside.sd
        row["doubts"] += [beside.doubt] if beside.doubt else []
    return row


def _expected(one: "Separation", fit: "DoseFit") -> dict[float, Any]:
    from tankrig.separation import expected_separation

    return {
        transfer.wave.period_mm: expected_separation(transfer.wave, one.bench, one.camera, fit.medium)
        for transfer in one.transfers
    }


def _tell(rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    from tankrig.live.formatting import with_error

    table = Table(box=None, pad_edge=False)
    periods = list(dict.fromkeys(p for row in rows for p in row.get("follow", {})))
    for heading in ("ink, ml", "z, mm", *(f"follow {p} mm, %" for p in periods), "order 1, %", "σt, 1/mm", "order 1 / fit"):
        table.add_column(heading, justify="right")
    for row in rows:
        follow = row.get("follow", {})
        table.add_row(
            f"{row['dose_ml']:.4g}",
            f"{sum(row['z_mm']) / 2:g}",
            *(f"{100.0 * follow[p]:.1f}" if p in follow else "–" for p in periods),
            *(
                with_error(scale * row[name], scale * row[f"{name}_sd"]) if name in row else "–"
                for name, scale in (("order_1", 100.0), ("sigma_t", 1.0), ("over_fit", 1.0))
            ),
        )
    Console(highlight=False).print(table)
    for row in rows:
        for doubt in row["doubts"]:
            click.echo(f"{row['dose_ml']:.4g} ml, z = {sum(row['z_mm']) / 2:g} mm: {doubt}")
    for row in rows:
        if "picture" in row:
            click.echo(f"written  {row['picture']}")

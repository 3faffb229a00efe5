"""`tankrig archive`: the runs of an archive as a table, as a file, or as a page."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import json_option
from ui.cli.tables import tell_table

if TYPE_CHECKING:
    from tankrig.archive.table import Record

SHOWN = 40
NAMES = ("sigma_s", "g", "sigma_a")


@click.command(epilog="Example: tankrig archive runs --results refitted --disagreeing --out archive.html")
@click.argument("archive_folder", metavar="ARCHIVE", type=click.Path(path_type=Path))
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    metavar="RESULTS",
    help="Of tankrig refit --out: its fits, not the old.",
)
@click.option(
    "--material", multiple=True, help="Only of this material; * and ? stand for anything; several may be given."
)
@click.option("--rig", multiple=True, help="Only of this rig.")
@click.option("--run", "name", multiple=True, help="Only runs of this name.")
@click.option("--since", default="", metavar="DATE", help="Only from this day on, such as 2026-03-01 (UTC).")
@click.option("--until", default="", metavar="DATE", help="Only up to this day.")
@click.option(
    "--between",
    nargs=3,
    type=(str, float, float),
    multiple=True,
    metavar="COLUMN FROM TO",
    help="Only where a number is in this range, such as dose_ml 0.4 0.6 or sigma_s 0.01 0.02.",
)
@click.option("--verdict", default="", metavar="WORDS", help="Only where the verdict says this.")
@click.option("--fit", type=click.Choice(["dose", "series"]), default=None, help="Only fits of doses, or of series.")
@click.option("--failed", is_flag=True, help="Only what could not be read or fitted.")
@click.option("--disagreeing", is_flag=True, help="Only where the new fit is more than 3 sd from the old one.")
@click.option("--by", metavar="COLUMN", help="Compare groups instead: means, scatter and stated errors by this column.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write a .csv, a .parquet, or a page with plots (.html).",
)
@json_option
def archive(
    archive_folder: Path,
    results: Path | None,
    material: tuple[str, ...],
    rig: tuple[str, ...],
    name: tuple[str, ...],
    since: str,
    until: str,
    between: tuple[tuple[str, float, float], ...],
    verdict: str,
    fit: str | None,
    failed: bool,
    disagreeing: bool,
    by: str | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """List, filter and compare the runs below the folder ARCHIVE by what their fits found.

    Without --results the fits are those that the runs' journals have. xarray opens all frames of an archive as one
    dataset: tankrig.archive.dataset.open_archive.
    """
    from tankrig.archive.page import write_page
    from tankrig.archive.table import Filter, compared, table_of, write_table
    from tankrig.files import require_writable

    wanted = Filter(
        material, rig, name, since, until, between, verdict, fit or "", failed, disagreeing
    )  # fmt: skip
    if out is not None:
        if out.suffix not in (".csv", ".parquet", ".html"):
            raise click.UsageError(f"{out} is neither .csv nor .parquet nor .html")
        require_writable(out.parent)
    with _reading() as told:
        records = [one for one in table_of(archive_folder, results, told) if wanted(one)]
    if out is not None and out.suffix == ".html":
        write_page(archive_folder, records, out)
    rows = records if by is None else compared(records, by)
    if out is not None and out.suffix != ".html":
        write_table(rows, out)
    if as_json:
        click.echo(json.dumps(rows, ensure_ascii=False))
        return
    if out is not None:
        click.echo(f"written  {out}")
        return
    _tell(rows, by)
    runs, fits = len({one["run"] for one in records}), sum(bool(one["fit"]) for one in records)
    without = sum(bool(one["failed"]) for one in records)
    counted = f"{runs} run{'' if runs == 1 else 's'}, {fits} fit{'' if fits == 1 else 's'}"
    click.echo(counted + f", {without} failed" * bool(without))


def _tell(rows: "Sequence[Record]", by: str | None) -> None:
    from rich.console import Console

    heads = ("run", "day", "rig", "material") if by is None else (by, "fits")
    headings = (*heads, "ml", "σs, 1/mm", "g", "σa, 1/mm", *(("old, sd",) if by is None else ()))
    cells: list[tuple[str, ...]] = []
    for row in rows[:SHOWN]:
        start = (
            (row["run"], row["utc"][:10], row["rig"], row["material"]) if by is None else (row[by], str(row["fits"]))
        )
        if by is None and row["failed"]:
            cells.append((*start, *[""] * (len(headings) - len(start))))
            continue
        dose = "–" if not row["fit"] else "per ml" if row["fit"] == "series" else f"{row['dose_ml']:.3g}"
        numbers = [_cell(row, name) for name in NAMES]
        moved = () if by is not None else ("" if row["disagreement"] is None else f"{row['disagreement']:.1f}",)
        cells.append((*start, dose, *numbers, *moved))
    styles = ["red" if row.get("failed") else None for row in rows[:SHOWN]]
    left = {headings[column] for column in range(len(heads) if by is None else 1)}
    # A column that says nothing of any run makes the others go on beneath each other on a narrow terminal.
    told = [column for column in range(len(headings)) if not column or not cells or any(row[column] for row in cells)]
    tell_table(
        [headings[column] for column in told],
        [[row[column] for column in told] for row in cells],
        left=[number for number, column in enumerate(told) if headings[column] in left],
        styles=styles,
    )
    console = Console()
    if any("±" in cell for row_cells in cells for cell in row_cells[len(heads) :]):
        console.print("each ± is one standard deviation", highlight=False)
    if any(cell.endswith("?") for row_cells in cells for cell in row_cells[len(heads) :]):
        console.print("? not determined by the photographs", highlight=False)
    for row in rows[:SHOWN]:
        if row.get("failed"):
            console.print(f"{row['run']}: {row['failed']}", highlight=False, markup=False, soft_wrap=True)
    if len(rows) > SHOWN:
        click.echo(f"… and {len(rows) - SHOWN} rows more; --out table.csv has them all")


def _cell(row: "Record", name: str) -> str:
    from tankrig.live.formatting import with_error

    value, sd = row[name], row[f"sd_{name}"]
    if value is None:
        return ""
    mark = "?" if row.get(f"determined_{name}") is False else ""
    return (f"{value:.4g}" if not sd else with_error(value, sd).replace(" ± ", "±")) + mark


def _reading() -> Any:
    """How many runs are read, where that takes longer than a moment."""
    from contextlib import contextmanager

    from rich.console import Console

    @contextmanager
    def shown() -> Any:
        with Console(stderr=True).status("reading") as status:
            yield lambda done, total: status.update(f"reading {done} of {total} runs") if done % 100 == 0 else None

    return shown()

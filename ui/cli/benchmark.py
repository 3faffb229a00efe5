"""`tankrig benchmark`: time against error of every model on this machine."""

import json
import os
import platform
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from tankrig.benchmark.race import Race


BUNDLED = Path(__file__).parents[2] / "tests" / "data" / "reference"
"""In a checkout; an installed program hasn't got it."""


@click.command(epilog="Example: tankrig benchmark --quick")
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of cases NAME.toml and NAME.npz; default: the checkout's, else three scenes by our own Monte Carlo.",
)
@click.option("--cases", metavar="NAMES", default="", help="Only these cases, separated by commas.")
@click.option(
    "--repeat", type=click.IntRange(min=1), default=3, show_default=True, help="Processes to take a median of."
)
@click.option("--quick", is_flag=True, help="One case, few models, no table of costs: less than a minute.")
@out_option("benchmark", "Folder for benchmark.json and benchmark.png.")
@json_option
def benchmark(reference: Path | None, cases: str, repeat: int, quick: bool, out: Path, as_json: bool) -> None:
    """Measure error against time of every model, side by side, each in a fresh process."""
    from rich.console import Console

    from tankrig.benchmark.contestant import contestants
    from tankrig.benchmark.plot import plot
    from tankrig.benchmark.race import race
    from tankrig.benchmark.truth import cases_of, own_cases
    from tankrig.files import require_writable, whole_file
    from tankrig.light.prepared.cache import cache_folder

    require_writable(out)
    names = tuple(name.strip() for name in cases.split(",") if name.strip())
    with Console(stderr=True).status("reading the reference") as status:
        folder = reference or (BUNDLED if BUNDLED.is_dir() else None)
        if folder is not None:
            chosen = cases_of(folder, names or (("pub02",) if quick and reference is None else ()))
        else:
            chosen = own_cases(cache_folder() / "benchmark", names or (("thin-beam",) if quick else ()))
        chosen = chosen[:1] if quick else chosen
        measured = race(chosen, contestants(quick), 1 if quick else repeat, not quick, status.update)
    machine = {"processor": platform.machine(), "processors": os.cpu_count(), "python": platform.python_version()}
    found = {"machine": machine, "load": os.getloadavg()[0], **measured.as_json()}
    with whole_file(out / "benchmark.json") as unfinished:
        unfinished.write_text(json.dumps(found, indent=1), encoding="utf-8")
    plot(measured, out / "benchmark.png")
    if as_json:
        click.echo(json.dumps(found))
        return
    _show(measured)
    click.echo(f"written  {out / 'benchmark.json'}\n         {out / 'benchmark.png'}")


def _show(measured: "Race") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Error and time, cold", box=None)
    for heading in ("case", "model", "error %", "noise %", "s", "CPU s", "MiB"):
        table.add_column(heading, justify="left" if heading in ("case", "model") else "right")
    for one in measured.results:
        figures = (f"{100 * one.error:.2f}", f"{100 * one.noise:.2f}", f"{one.seconds:.3f}", f"{one.cpu_seconds:.3f}")
        table.add_row(one.case, one.label, *figures, f"{one.peak_mib:.0f}")
    console = Console()
    console.print(table)
    if measured.costs:
        costs = Table(title="What a prediction of the first case to 1 % costs", box=None)
        for heading in ("changed", "to", "s", "CPU s", "MiB"):
            costs.add_column(heading, justify="left" if heading in ("changed", "to") else "right")
        for cost in measured.costs:
            costs.add_row(
                cost.what, cost.value, f"{cost.seconds:.3f}", f"{cost.cpu_seconds:.3f}", f"{cost.peak_mib:.0f}"
            )
        console.print(costs)
    for case, label, why in measured.refused:
        click.echo(f"refused  {case}, {label}: {why}")

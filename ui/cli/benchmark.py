"""`tankrig benchmark`: time against error of every model on this machine."""

import json
import os
import platform
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from tankrig.benchmark.race import Cost, Race
    from tankrig.benchmark.result import Result
    from tankrig.benchmark.truth import Case

BUNDLED = Path(__file__).parents[2] / "tests" / "data" / "reference"
"""In a checkout; an installed program hasn't got it."""


DEFAULT_CASES = ("pub01", "pub02", "pub07", "pub09")
"""Of those: thin, medium and dense, and two pinholes."""


@click.command(epilog="Example: tankrig benchmark --quick")
@click.option(
    "--reference",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of cases NAME.toml and NAME.npz; default: the checkout's, else three scenes by our own Monte Carlo.",
)
@click.option(
    "--cases",
    metavar="NAMES",
    default="",
    help=f'Only these, by commas, or "all"; default: {", ".join(DEFAULT_CASES)}.',
)
@click.option(
    "--repeat", type=click.IntRange(min=1), default=3, show_default=True, help="Processes to take a median of."
)
@click.option(
    "--limit", type=click.FloatRange(min=1.0), default=120.0, show_default=True, help="Longest time of a trial, s."
)
@click.option("--prepared", is_flag=True, help="Prepared models too: minutes for each case that isn't in the cache.")
@click.option("--quick", is_flag=True, help="One case, few models, no table of costs: less than a minute.")
@out_option("benchmark", "Folder for benchmark.json and benchmark.png.")
@json_option
def benchmark(
    reference: Path | None, cases: str, repeat: int, limit: float, prepared: bool, quick: bool, out: Path, as_json: bool
) -> None:
    """Measure error against time of every model, side by side, each in a fresh process.

    Plain Monte Carlo and, where it is installed (pip install tankrig[mitsuba]), Mitsuba 3 run beside the models, and
    a table tells what they take for the error that a prediction to 1 % has.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from tankrig.benchmark.contestant import contestants
    from tankrig.benchmark.plot import plot
    from tankrig.benchmark.race import race, variations
    from tankrig.files import require_writable, whole_file

    require_writable(out)
    console = Console(stderr=True, width=140, highlight=False)
    with console.status("reading the reference"):
        chosen = _cases(reference, tuple(name.strip() for name in cases.split(",") if name.strip()), quick)
    field = contestants(quick, prepared)
    if prepared:
        limit = max(limit, 900.0)
    total = len(chosen) * len(field) + (0 if quick else len(list(variations(chosen[0].scene))))
    columns = BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("", total=total)

        def tell(what: str, done: bool) -> None:
            bar.update(task, description=what, advance=int(done))
            if done:
                console.print(what)

        measured = race(chosen, field, 1 if quick else repeat, not quick, limit, tell)
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


def _cases(reference: Path | None, names: tuple[str, ...], quick: bool) -> "list[Case]":
    """The cases that are asked for; of a folder that is given all, of our own a few."""
    from tankrig.benchmark.truth import cases_of, own_cases
    from tankrig.light.prepared.cache import cache_folder

    everything = names == ("all",)
    if reference is not None or BUNDLED.is_dir():
        usual = () if everything or reference is not None else DEFAULT_CASES[1:2] if quick else DEFAULT_CASES
        chosen = cases_of(reference or BUNDLED, usual if everything else names or usual)
    else:
        usual = ("thin-beam",) if quick else ()
        chosen = own_cases(cache_folder() / "benchmark", () if everything else names or usual)
    return chosen[:1] if quick else chosen


def _show(measured: "Race") -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()

    def table(title: str, words: tuple[str, ...], figures: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
        shown = Table(title=title, box=None)
        for heading in (*words, *figures):
            shown.add_column(heading, justify="left" if heading in words else "right")
        for row in rows:
            shown.add_row(*row)
        if rows:
            console.print(shown)

    table(
        "Error and time, cold",
        ("case", "model"),
        ("error %", "noise %", "s", "CPU s", "MiB"),
        [
            (one.case, one.label, f"{100 * one.error:.2f}", f"{100 * one.noise:.2f}", *_times(one))
            for one in measured.results
        ],
    )
    table(
        "What simulators take for the error that the tank model has at 1 %",
        ("case", "model"),
        ("error %", "s", "CPU s", "times as long", "extrapolated"),
        [
            (
                one.case, one.model, f"{100 * one.error:.2f}", f"{one.seconds:.3g}", f"{one.cpu_seconds:.3g}",
                f"{one.slower:.3g}", f"×{one.extrapolated:.3g}" if one.extrapolated > 1.0 else "no",
            )
            for one in measured.equal
        ],
    )  # fmt: skip
    table(
        "What a prediction of the first case to 1 % costs",
        ("changed", "to"),
        ("s", "CPU s", "MiB"),
        [(cost.what, cost.value, *_times(cost)) for cost in measured.costs],
    )
    for one in measured.missing:
        click.echo(f"missing  {one.case}, {one.label}: {one.why}")


def _times(one: "Result | Cost") -> tuple[str, str, str]:
    return f"{one.seconds:.3f}", f"{one.cpu_seconds:.3f}", f"{one.peak_mib:.0f}"

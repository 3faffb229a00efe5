"""`tankrig benchmark`: time against error of every model on this machine."""

import json
import os
import platform
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.options import FiniteRange, json_option, out_option

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
    "--limit", type=FiniteRange(min=1.0), default=120.0, show_default=True, help="Longest time of a trial, s."
)
@click.option("--prepared", is_flag=True, help="Prepared models too: minutes for each case that isn't in the cache.")
@click.option("--quick", is_flag=True, help="One case, few models, no table of costs: less than a minute.")
@click.option(
    "--wide",
    type=click.IntRange(min=1),
    metavar="N",
    help="Instead: how well predictions keep their tolerance on N random scenes, or on N cases of --reference.",
)
@click.option(
    "--tolerances", metavar="LIST", default="0.01", show_default=True, help="Of --wide, by commas, such as 0.03,0.01."
)
@click.option(
    "--budget",
    "budget_s",
    type=FiniteRange(0.0, min_open=True),
    default=120.0,
    show_default=True,
    help="Seconds of each prediction of --wide.",
)
@out_option("benchmark", "Folder for benchmark.json and benchmark.png.")
@json_option
def benchmark(
    reference: Path | None,
    cases: str,
    repeat: int,
    limit: float,
    prepared: bool,
    quick: bool,
    wide: int | None,
    tolerances: str,
    budget_s: float,
    out: Path,
    as_json: bool,
) -> None:
    """Measure error against time of every model, side by side, each in a fresh process.

    Plain Monte Carlo and, where it is installed (pip install tankrig[mitsuba]), Mitsuba 3 run beside the models, and
    a table tells what they take for the error that a prediction to 1 % has. With --wide it is measured instead how well
    predictions keep the tolerance that they are asked for.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from tankrig.benchmark.contestant import contestants
    from tankrig.benchmark.plot import plot
    from tankrig.benchmark.race import race, variations
    from tankrig.files import require_writable, whole_file

    require_writable(out)
    if wide is not None:
        _wide(reference, wide, _numbers(tolerances), budget_s, out, as_json)
        return
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


def _numbers(tolerances: str) -> list[float]:
    """Tolerances of a list by commas."""
    try:
        found = [float(word) for word in tolerances.split(",")]
    except ValueError:
        found = []
    if not found or not all(0.0 < one <= 1.0 for one in found):
        raise click.BadParameter(
            f'"{tolerances}" is no list of relative errors; give such as 0.03,0.01', param_hint="'--tolerances'"
        )
    return found


def _wide(
    reference: Path | None, count: int, tolerances: list[float], budget_s: float, out: Path, as_json: bool
) -> None:
    """Tolerances on random scenes: write wide.json and show the figures."""
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from tankrig.benchmark.wide import Kept, measured, own_truths, summary, truths_of
    from tankrig.files import whole_file
    from tankrig.light.prepared.cache import cache_folder

    console = Console(stderr=True, width=140, highlight=False)

    def tell(one: Kept) -> None:
        said = ", said" if one.said else ""
        console.print(
            f"{one.name}: {100 * one.error:.2f} % asked for {100 * one.tolerance:g} %, stated {100 * one.stated:.2f} %"
            f"{said}; {one.cpu_seconds:.2f} CPU s"
        )

    truths = truths_of(reference, count) if reference else own_truths(count, min(tolerances), cache_folder())
    found = measured(truths, tolerances, budget_s, tell)
    figures = [summary(found, tolerance) for tolerance in tolerances]
    as_plain = {key: [_known(asdict(one)) for one in some] for key, some in (("summary", figures), ("scenes", found))}
    with whole_file(out / "wide.json") as unfinished:
        unfinished.write_text(json.dumps(as_plain, indent=1), encoding="utf-8")
    if as_json:
        click.echo(json.dumps(as_plain))
        return
    shown = Table(title="How tolerances are kept", box=None)
    for heading in (
        "asked %",
        "scenes",
        "kept %",
        "worst unsaid",
        "blocks",
        "CPU s median",
        "95 %",
        "worst",
        "classes %",
    ):
        shown.add_column(heading, justify="right")
    for one in figures:
        shown.add_row(
            f"{100 * one.tolerance:g}", str(one.scenes), f"{100 * one.kept:.0f}", f"× {one.worst_unsaid:.2f}",
            f"{one.blocks:.2f}", f"{one.cpu_median:.2f}", f"{one.cpu_95:.2f}", f"{one.cpu_worst:.2f}",
            f"{100 * one.classes:.0f}",
        )  # fmt: skip
    Console().print(shown)
    for one in figures:
        for kind, slower in one.slower.items():
            click.echo(
                f"at {100 * one.tolerance:g} % the truths' program takes {slower:.3g} times as long: {kind}, median"
            )
    click.echo(f"written  {out / 'wide.json'}")


def _known(figures: dict[str, object]) -> dict[str, object]:
    """Figures with None for what isn't known, since JSON knows no NaN."""
    return {name: None if isinstance(one, float) and one != one else one for name, one in figures.items()}


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

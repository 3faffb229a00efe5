"""`tankrig demo`: a whole dilution experiment on the simulated rig, fitted while it runs, with a report at its end."""

import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.scene import Medium
    from tankrig.sequence import Sequence

DOSES_UL = (100.0, 200.0, 400.0, 800.0, 1600.0)
WATER = {"sigma_a": 1.0e-4, "sigma_s": 1.9e-6, "g": 0.0}
INK = {"sigma_a": 4.0e-4, "sigma_s": 0.012, "g": 0.71}
"""What is in the demo's tank, the ink per mm and ml: thin at the first dose, five mean free paths long at the last."""
MIXING_S = 0.7
PATIENCE_S = 240.0
LIGHT_MM = (58.0, 62.0)


@click.command(epilog="Example: tankrig demo --out runs/demo")
@click.option("--doses", type=click.IntRange(2, len(DOSES_UL)), default=len(DOSES_UL), show_default=True,
              help="How many doses of ink, each twice the one before.")  # fmt: skip
@out_option(None, "Folder of the run, which must not exist; default: runs/ and the time.")
@json_option
def demo(doses: int, out: Path | None, as_json: bool) -> int:
    """Run a dilution series on the simulated rig, fit it while it runs, and write a report.

    At each dose the tank is photographed dark, under a sheet, stripes and three beams. Nothing here knows what the
    simulated ink is: its coefficients are found from the photographs, and shown beside the truth at the end.
    """
    from drivers.rig import open_rig
    from tankrig.live.attached import fitted_live
    from tankrig.live.exposures import Plan
    from tankrig.report import write_report
    from tankrig.run.start import new_run
    from ui.cli.run import carried_out

    began = time.perf_counter()
    path = out or Path("runs") / datetime.now(UTC).strftime("demo-%Y-%m-%dT%H-%M-%S")
    description = _rig(path)
    sequence = _sequence(doses)
    plan = Plan.of(description.bench, sequence, list(sequence.drawn(description.bench.wall).values()))
    runner = new_run(sequence, open_rig(description), path)
    click.echo("a dilution series on the simulated rig; nothing real moves", err=True)
    with fitted_live(runner, plan, PATIENCE_S):
        outcome = carried_out(runner)
    if outcome.error is not None:
        raise outcome.error
    if outcome.reason.value != "completed":
        return 1
    report = write_report(path)
    numbers = {**_numbers(path), "report": str(report), "seconds": round(time.perf_counter() - began, 1)}
    if as_json:
        click.echo(json.dumps(numbers, ensure_ascii=False))
    else:
        _tell(numbers)
    return 0


def _rig(path: Path) -> "RigFile":
    """The simulated rig with collimated light and the demo's ink, remembered beside the run."""
    from drivers.rig import simulated_rig

    rig = simulated_rig(path.with_name(f"{path.name}.rig"))
    bench = replace(rig.bench, light="collimated", light_position_mm=None)
    truth = {"bench": asdict(bench), "water": WATER, "ink": INK, "mixing_s": MIXING_S}
    return replace(rig, bench=bench, camera={**rig.camera, "truth": truth})


def _sequence(doses: int) -> "Sequence":
    from tankrig.pattern.kinds import AnyKind, Rays, Sheet, Stripes
    from tankrig.sequence import Capture, Mix, Sequence, Series
    from tankrig.sequence.steps import Step

    patterns: dict[str, AnyKind] = {
        "sheet": Sheet((-60.0, 60.0), LIGHT_MM),
        "stripes": Stripes(16.0, 0.5, (-60.0, 60.0), LIGHT_MM),
        "beams": Rays((-40.0, 0.0, 40.0), LIGHT_MM),
    }
    captures = [Capture(name, 4) for name in patterns]
    steps: tuple[Step, ...] = (
        Mix("sheet", tolerance=0.003, every_s=0.1, at_least_s=2.0),
        Capture("dark", 2),
        *captures,
    )
    return Sequence("demo", (Series(DOSES_UL[:doses], steps),), patterns, exposure_ms=20.0)


def _numbers(path: Path) -> dict[str, Any]:
    """Fits of the run, and the truth of the twin beside them."""
    from drivers.simulated.tank import mixture
    from tankrig.report.results import results_of
    from tankrig.run.reading import open_run
    from tankrig.scene import Medium

    results = results_of(open_run(path))
    ink, water = Medium(**INK), Medium(**WATER)
    rows = []
    for fit in results.doses:
        truth = mixture(water, ink, fit["dose_ml"])
        rows.append({
            "dose_ml": fit["dose_ml"],
            "fitted": {name: fit[name] for name in ("sigma_a", "sigma_s", "g")},
            "sd": dict(zip(("sigma_a", "sigma_s", "g"), fit["sd"], strict=True)),
            "truth": _named(truth),
            "single_sigma_t_ratio": fit["single"]["sigma_t"] / truth.sigma_t,
        })  # fmt: skip
    series = results.series or {}  # there are two doses at least
    return {
        "run": str(path),
        "doses": rows,
        "ink_per_ml": series["ink"],
        "ink_sd": series["sd"],
        "truth_per_ml": _named(ink),
        "verdict": series["verdict"],
    }


def _named(medium: "Medium") -> dict[str, float]:
    return {"sigma_a": medium.sigma_a, "sigma_s": medium.sigma_s, "g": medium.g}


def _tell(numbers: dict[str, Any]) -> None:
    """Coefficients beside the truth, in 1/m so that they are short, and how wrong single scattering is."""
    from rich.console import Console
    from rich.table import Table

    names = ("sigma_s", "g", "sigma_a")
    table = Table(box=None, pad_edge=False, collapse_padding=True, header_style="bold")
    for heading in ("ink", "σs, 1/m", "truth", "g", "truth", "σa, 1/m", "truth", "single\nscatt. σt"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in numbers["doses"]:
        cells = [f"{row['dose_ml']:.3g} ml", *_cells(names, row["fitted"], row["sd"], row["truth"])]
        table.add_row(*cells, f"{100.0 * (row['single_sigma_t_ratio'] - 1.0):+.0f} %")
    sd = dict(zip(("sigma_a", "sigma_s", "g"), numbers["ink_sd"], strict=False))
    table.add_row(*[""] * 8)
    table.add_row("per ml", *_cells(names, numbers["ink_per_ml"], sd, numbers["truth_per_ml"]), "", style="bold")
    console = Console()
    console.print(table)
    console.print(f"\n{numbers['verdict']}\n", highlight=False)
    click.echo(f"run      {numbers['run']}\nreport   {numbers['report']}\ntook     {numbers['seconds']:.0f} s")


def _cells(
    names: tuple[str, ...], found: dict[str, float], sd: dict[str, float], truth: dict[str, float]
) -> Iterator[str]:
    for name in names:
        by = 1.0 if name == "g" else 1000.0
        digits = max(0, 1 - math.floor(math.log10(by * sd[name]))) if sd[name] > 0.0 else 4
        yield f"{by * found[name]:.{digits}f}±{by * sd[name]:.{digits}f}"
        yield f"{by * truth[name]:.3f}"

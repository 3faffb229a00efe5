"""`tankrig demo`: a whole dilution experiment on the simulated rig, fitted while it runs, with a report at its end."""

import json
import time
from datetime import UTC, datetime
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING

import click

from ui.cli.options import json_option, out_option

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.sequence import Sequence

DOSES_UL = (100.0, 200.0, 400.0, 800.0, 1600.0)
TRUTH = """
[camera.truth]                  # an ink that is thin at the first dose and five mean free paths long at the last
water = { sigma_a = 1.0e-4, sigma_s = 1.9e-6, g = 0.0 }
ink = { sigma_a = 4.0e-4, sigma_s = 0.012, g = 0.71 }
mixing_s = 0.7
"""
"""What is in the demo's tank, and a stirrer in a hurry: what its rig file says beyond the one that ships."""
LIGHT_MM = (58.0, 62.0)
BENCH_DOSES = 3
"""Of the sequence that ships for the simulated bench."""


@click.command(epilog="Example: tankrig demo --bench --out bench")
@click.option("--doses", type=click.IntRange(2, len(DOSES_UL)),
              help=f"How many doses of ink; default: {len(DOSES_UL)}, and {BENCH_DOSES} with --bench.")  # fmt: skip
@click.option("--bench", is_flag=True, help="On a bench that has to be calibrated first, from lens cap to report.")
@click.option("--seed", type=click.IntRange(0), help="That the bench is drawn from; default: 0.")
@click.option("--by-hand", is_flag=True, help="Only make the bench's folder, and say what to type.")
@out_option(None, "Folder of the run, or of the bench; default: runs/ and the time.")
@json_option
def demo(doses: int | None, bench: bool, seed: int | None, by_hand: bool, out: Path | None, as_json: bool) -> int:
    """Run a dilution series on the simulated rig, fit it while it runs, and write a report.

    At each dose the tank is photographed dark, under a sheet, stripes and three beams. Nothing here knows what the
    simulated ink is: its coefficients are found from the photographs, and shown beside the truth at the end.

    With --bench it walks the whole way on a simulated bench with hidden lenses, glass, water and light: calibrate
    radiometry, camera, tank, projector and latency, doctor, prepare, dry run, run, report. Each command is told before
    it is carried out; all is kept in one folder, and what was stopped goes on when the same folder is given again.
    """
    if bench:
        return _bench(doses, seed, by_hand, out, as_json)
    if seed is not None or by_hand:
        raise click.UsageError("--seed and --by-hand are for the bench; give --bench too")
    return _series(doses or len(DOSES_UL), out, as_json)


def _bench(doses: int | None, seed: int | None, by_hand: bool, out: Path | None, as_json: bool) -> int:
    from ui.cli.demo_bench import is_there, make, walk, way_of

    folder = out or Path("runs") / datetime.now(UTC).strftime("bench-%Y-%m-%dT%H-%M-%S")
    if is_there(folder):
        if doses is not None or seed is not None or by_hand:
            raise click.UsageError(f"{folder} holds a bench already; give only --bench --out {folder} to go on with it")
    else:
        if doses is not None and doses > BENCH_DOSES:
            raise click.UsageError(f"the bench's sequence has {BENCH_DOSES} doses; give --doses 2 or {BENCH_DOSES}")
        make(folder, seed or 0, doses or BENCH_DOSES)
    if not by_hand:
        click.echo("a simulated bench, in a hurry; nothing real moves", err=True)
        return walk(folder, as_json)
    commands = [f"tankrig {join(words)}" for words in way_of(folder)]
    if as_json:
        click.echo(json.dumps({"folder": str(folder), "commands": commands}))
    else:
        click.echo("\n".join([f"{folder} holds a rig file and a sequence; the way to a fitted run:", *commands]))
    return 0


def _series(doses: int, out: Path | None, as_json: bool) -> int:
    """On the ideal rig."""
    from tankrig.run.start import require_place
    from ui.cli.run import carry_out, open_runner, tell

    began = time.perf_counter()
    path = out or Path("runs") / datetime.now(UTC).strftime("demo-%Y-%m-%dT%H-%M-%S")
    sequence = _sequence(doses)
    require_place(path, 0)
    description = _rig(path)
    runner = open_runner(sequence, path, description)
    click.echo("a dilution series on the simulated rig; nothing real moves", err=True)
    status = tell(carry_out(runner, fit=True), description, fit=True, as_json=as_json)
    click.echo(f"took {time.perf_counter() - began:.0f} s", err=True)
    return status


def _rig(path: Path) -> "RigFile":
    """The simulated rig with the demo's ink; its rig file lies beside the run, for when that is resumed."""
    from drivers.rig import SIMULATED, simulated_rig

    folder = path.with_name(f"{path.name}.rig")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(SIMULATED.read_text(encoding="utf-8") + TRUTH, encoding="utf-8")
    return simulated_rig(folder)


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

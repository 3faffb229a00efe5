"""`tankrig demo`: a whole dilution experiment on the simulated rig, fitted while it runs, with a report at its end."""

import time
from datetime import UTC, datetime
from pathlib import Path
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

"""`tankrig doctor`: is the rig fit to be used, and what is missing before a fitted run?"""

import json
import tempfile
from dataclasses import asdict
from pathlib import Path

import click

from drivers.check import typed
from ui.calibration_way import Step
from ui.cli.options import json_option
from ui.cli.way import next_step, rig_as_typed, way

_MARKS = {True: "✓", False: "✗", None: "?"}


@click.command(epilog="Example: tankrig doctor rig.toml --sequence dilution.toml")
@click.argument("rig", type=click.Path(path_type=Path), envvar="TANKRIG_RIG", required=False)
@click.option("--light/--no-light", default=True, help="Flash the projector to measure its latency.")
@click.option(
    "--sequence",
    "sequence_file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Sequence that is to be run, which is checked against the rig too.",
)
@json_option
def doctor(rig: Path | None, light: bool, sequence_file: Path | None, as_json: bool) -> int:
    """Check the devices of the rig file RIG step by step, and say what to do about each failure; moves no ink.

    Then the way to a fitted run is told: what is done, what is missing, in order, with the command of each step, and
    which comes next. Without RIG (or $TANKRIG_RIG) the simulated rig is checked.

    Exit status 1: something has to be done.
    """
    from drivers.health import examine
    from drivers.rig import load_rig_file, simulated_rig

    option = rig_as_typed(rig)
    with tempfile.TemporaryDirectory() as folder:
        description = load_rig_file(rig) if rig else simulated_rig(Path(folder))
        if not as_json:
            click.echo(f"{rig or 'no rig is configured; this is the simulated one'}: {description.name}")
        failed = 0
        done = []
        for check in examine(description, light):
            done.append(check)
            failed += check.passed is False
            if as_json:
                continue
            click.echo(f"{_MARKS[check.passed]} {check.what}: {check.finding}")
            if not check.passed and check.remedy:
                click.echo(f"    → {typed(check.remedy, option)}")
        steps = way(description, done, rig, sequence_file)
    if as_json:
        checks = [asdict(check) | {"remedy": typed(check.remedy, option)} for check in done]
        told = {"fit": not failed, "checks": checks, "way": [asdict(step) for step in steps]}
        following = next_step(steps)
        click.echo(json.dumps({**told, "next": following.command if following else ""}, ensure_ascii=False))
    else:
        _tell_way(steps)
    return 1 if failed or any(step.done is False for step in steps) else 0


def _tell_way(steps: list[Step]) -> None:
    click.echo("\nThe way to a fitted run:")
    for step in steps:
        click.echo(f"{_MARKS[step.done]} {step.what}" + ("" if step.done else f": {step.finding}"))
        if step.command:
            click.echo(f"    → {step.command}")
    following = next_step(steps)
    if following is not None:
        click.echo(f"\nnext: {following.command}")

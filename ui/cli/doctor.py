"""`tankrig doctor`: is the rig fit to be used?"""

import json
import tempfile
from dataclasses import asdict
from pathlib import Path

import click

from ui.cli.options import json_option

_MARKS = {True: "✓", False: "✗", None: "?"}


@click.command(epilog="Example: tankrig doctor rig.toml")
@click.argument("rig", type=click.Path(path_type=Path), envvar="TANKRIG_RIG", required=False)
@click.option("--light/--no-light", default=True, help="Flash the projector to measure its latency.")
@json_option
def doctor(rig: Path | None, light: bool, as_json: bool) -> int:
    """Check the devices of the rig file RIG step by step, and say what to do about each failure; moves no ink.

    Without RIG (or $TANKRIG_RIG) the simulated rig is checked. Exit status 1: something has to be done.
    """
    from drivers.health import examine
    from drivers.rig import load_rig_file, simulated_rig

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
                click.echo(f"    → {check.remedy}")
    if as_json:
        click.echo(json.dumps({"fit": not failed, "checks": [asdict(check) for check in done]}, ensure_ascii=False))
    return 1 if failed else 0

"""`tankrig recover`: check a run after a crash."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from ui.cli.options import json_option


@click.command(epilog="Example: tankrig recover runs/2026-11-20T10-00-00")
@click.argument("path", metavar="RUN", type=click.Path(path_type=Path))
@json_option
def recover(path: Path, as_json: bool) -> int:
    """Verify every recorded frame of RUN against its checksum and set a torn end of its journal aside."""
    from rich.console import Console

    from tankrig.run.recovery import recover as checked

    with Console(stderr=True).status("checking frames"):
        found = checked(path)
    if as_json:
        click.echo(json.dumps({**asdict(found), "path": str(found.path)}))
        return 1 if found.damaged else 0
    click.echo(f"{path}: {found.frames} frames are as they were recorded")
    if found.torn_bytes:
        click.echo(f"a torn end of {found.torn_bytes} bytes, never acknowledged, is set aside in journal.jsonl.torn")
    if found.damaged:
        numbers = ", ".join(str(index) for index in found.damaged[:20]) + (" …" if len(found.damaged) > 20 else "")
        click.echo(f"damaged frames: {numbers}; restore them from a copy of the run")
    if found.open_dose_ul is not None:
        click.echo(
            f"a dose to {found.open_dose_ul:g} µl was begun and not seen to end; "
            f"resume with: tankrig run --resume {path} --delivered-ul X"
        )
    elif not found.finished:
        click.echo(f"it has not come to its end; resume with: tankrig run --resume {path}")
    return 1 if found.damaged else 0

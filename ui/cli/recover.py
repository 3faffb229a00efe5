"""`tankrig recover`: check a run after a crash, or on a damaged disk."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.options import json_option

if TYPE_CHECKING:
    from tankrig.run.recovery import Recovery

_SHOWN = 20


@click.command(epilog="Example: tankrig recover runs/2026-11-20T10-00-00")
@click.argument("path", metavar="RUN", type=click.Path(path_type=Path))
@click.option("--leave-out", is_flag=True, help="Leave damaged frames out of all that reads the run from now on.")
@json_option
def recover(path: Path, leave_out: bool, as_json: bool) -> int:
    """Verify every recorded frame and every line of the journal of RUN, and say what is lost.

    A torn end of the journal is set aside; what was acknowledged is never changed.
    """
    from rich.console import Console

    from tankrig.run.recovery import recover as checked

    with Console(stderr=True).status("checking frames"):
        found = checked(path, leave_out)
    if as_json:
        click.echo(json.dumps({**asdict(found), "path": str(found.path)}))
    else:
        tell(found)
    return 0 if found.whole else 1


def tell(found: "Recovery") -> None:
    """What was found, a sentence a line; what to do comes last."""
    click.echo(f"{found.path}: {found.frames} frames are as they were recorded")
    if found.damaged:
        click.echo(
            f"damaged or missing frames: {_listed(found.damaged)}; restore them from a copy of the run, or leave them "
            f"out: tankrig recover {found.path} --leave-out"
        )
    if found.left_out:
        click.echo(f"left out, being damaged: frames {_listed(found.left_out)}")
    for lost in found.lost[:_SHOWN]:
        click.echo(str(lost))
    if len(found.lost) > _SHOWN:
        click.echo(f"… and {len(found.lost) - _SHOWN} more damaged places (--json lists them all)")
    if found.unsure_doses:
        click.echo(
            f"frames at a dose that is not known any more, and that are not fitted: {_listed(found.unsure_doses)}"
        )
    if found.unverified_lines:
        click.echo(f"{found.unverified_lines} lines of the journal are from before checksums: whole, but unverified")
    if found.unlisted_frames:
        click.echo(
            f"frames that the journal does not speak of, and that do not count: {_listed(found.unlisted_frames)}"
        )
    if found.torn_bytes:
        where = "stays where it is" if found.read_only else "is set aside in journal.jsonl.torn"
        click.echo(f"a torn end of {found.torn_bytes} bytes, never acknowledged, {where}")
    if found.damaged_derived:
        click.echo(
            f"damaged, and to be calculated anew from the frames: {', '.join(found.damaged_derived)} "
            f"(tankrig separate {found.path})"
        )
    for what in found.mended:
        click.echo(f"mended: {what}")
    if found.read_only:
        click.echo("the run cannot be written here, so nothing was put right; recover a copy of it to go on")
    if found.open_dose_ul is not None:
        click.echo(
            f"a dose to {found.open_dose_ul:g} µl was begun and not seen to end; "
            f"resume with: tankrig run --resume {found.path} --delivered-ul X"
        )
    elif found.dose_doubt and not found.finished:
        click.echo(
            "what the tank holds is not known from the journal; "
            f"resume with: tankrig run --resume {found.path} --delivered-ul X"
        )
    elif not found.finished:
        click.echo(f"it has not come to its end; resume with: tankrig run --resume {found.path}")


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers[:_SHOWN])) + (" …" if len(numbers) > _SHOWN else "")

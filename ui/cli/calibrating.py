"""What the calibration commands share: asking for what goes before the lens, live feedback, and keeping the result."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.calibration.file import Calibration
    from tankrig.calibration.lit_camera import Look
    from tankrig.devices import Camera

_REQUESTS = {
    "cap": "Cap the lens, so that no light gets in.",
    "diffuser": "Take the cap off, and put the diffuser before the lens where the projector's picture falls on it.",
    "diffuser turned": "Turn the diffuser by half a turn, in its own plane.",
    "nothing": "Take everything off the lens.",
}

accept_option = click.option(
    "--accept", is_flag=True, help="Use the result even if it is doubtful or much worse than the one before."
)


def described(rig: Path | None) -> "RigFile":
    """What the rig file says; without one the simulated rig, beside which its calibrations are kept."""
    from drivers.rig import load_rig_file, simulated_rig

    if rig is None:
        click.echo("no rig is configured, so this is the simulated rig", err=True)
    return load_rig_file(rig) if rig else simulated_rig(Path())


def asker(camera: "Camera", pause: Callable[[], object] = lambda: None) -> Callable[[str], None]:
    """Ask a person to put something before the lens; a simulated camera does it by itself.

    Raises
    ------
    click.UsageError
        When there is nobody to ask.
    """
    put = getattr(camera, "put", None)
    if put is None and not sys.stdin.isatty():
        raise click.UsageError("somebody has to handle the lens; run this on a terminal")

    def ask(what: str) -> None:
        if put is not None:
            put(what)
            return
        pause()
        click.prompt(f"{_REQUESTS[what]} Then Enter", "", show_default=False, err=True)

    return ask


class Feedback:
    """A line with how far the calibration is, and how bright the last frame was."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self.bar = Progress(
            TextColumn("{task.description:42s}"),
            BarColumn(),
            TextColumn("{task.fields[light]}"),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._task = self.bar.add_task("", total=1.0, light="")

    def look(self, look: "Look") -> None:
        """Show how it is getting on."""
        light = f"brightest {look.filled:4.0%}"
        if look.saturated > 1e-3:
            light += f", [red]{look.saturated:.1%} saturated[/red]"
        self.bar.update(self._task, description=look.doing, completed=look.done, light=light)

    def count(self, what: str, done: int, of: int) -> None:
        """Show how many are done."""
        self.bar.update(self._task, description=what, completed=done / of)

    def pause(self) -> None:
        """Leave the terminal to a question; `look` begins again."""
        self.bar.refresh()


@contextmanager
def feedback() -> Iterator[Feedback]:
    """Live feedback while a calibration goes on."""
    shown = Feedback()
    with shown.bar:
        yield shown


def keep(
    calibration: "Calibration", description: "RigFile", accept: bool, draw: Callable[[Path], object] | None
) -> "Calibration":
    """Save a calibration beside the rig file, and its picture beside it."""
    from tankrig.calibration.file import save

    kept = save(calibration, Path(description.calibration_folder), accept)
    if draw is not None and kept.path is not None:
        draw(kept.path.with_suffix(".png"))
    return kept


def tell(kept: "Calibration", rows: Mapping[str, str], as_json: bool) -> int:
    """Say what was found, how well, where it is kept and whether it is used.

    Returns
    -------
    int
        Exit status: 3 when a person has to decide about a result that was set aside.
    """
    path = kept.path
    assert path is not None
    if as_json:
        found: dict[str, Any] = {
            "path": str(path), "sha256": kept.hash, "in_use": kept.in_use, "doubts": list(kept.doubts),
            "how_well": dict(kept.how_well),
        }  # fmt: skip
        click.echo(json.dumps(found, ensure_ascii=False))
        return 0 if kept.in_use else 3
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=False)
    for name, value in rows.items():
        table.add_row(name, escape(value))
    Console().print(table)
    for doubt in kept.doubts:
        click.echo(f"doubt: {doubt}")
    picture = path.with_suffix(".png")
    click.echo(f"written to {path}" + (f"; look at {picture.name} before you believe it" if picture.exists() else ""))
    if not kept.in_use:
        click.echo(
            f"it was set aside and is not used; mend what the doubts say and calibrate again, or move {path.name} into "
            f"{path.parent.parent} to use it all the same"
        )
        return 3
    return 0

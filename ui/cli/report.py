"""`tankrig report`: a run as one self-contained page."""

import json
from pathlib import Path

import click

from ui.cli.options import json_option, out_option


@click.command(epilog="Example: tankrig report runs/2026-11-20T10-00-00 --out report.html")
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@out_option(None, "The .html file, or a folder for it; default: report.html in RUN.")
@json_option
def report(run: Path, out: Path | None, as_json: bool) -> None:
    """Write what RUN has shown as one HTML file: photographs, fits with error bars, reconstructions, timing.

    Fits that the run did not make while it went on are made now.
    """
    from rich.console import Console

    from tankrig.report import write_report

    with Console(stderr=True).status("reading") as status:
        file = write_report(run, out, status.update)
    click.echo(json.dumps({"report": str(file)}) if as_json else f"written  {file}")

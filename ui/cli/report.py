"""`tankrig report`: a run as one self-contained page."""

import json
from pathlib import Path

import click

from ui.cli.options import json_option, out_option
from ui.cli.refit import progress_shown


@click.command(epilog="Example: tankrig report runs/2026-11-20T10-00-00 --out report.html")
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@out_option(None, "The .html file, or a folder for it; default: report.html in RUN.")
@click.option("--quick", is_flag=True, help="Leave out what RUN has not fitted, and say so, instead of fitting it.")
@json_option
def report(run: Path, out: Path | None, quick: bool, as_json: bool) -> None:
    """Write what RUN has shown as one HTML file: photographs, fits with error bars, reconstructions, timing.

    What RUN has not fitted is fitted first and recorded in it, as tankrig refit does, but for an ink's own phase
    function, which takes ten minutes and more; Ctrl-C keeps what is made.
    """
    from rich.console import Console

    from tankrig.live.refit import refit
    from tankrig.report import write_report

    if not quick:
        with progress_shown() as told:
            refit(run, progress=told, further=False)
    with Console(stderr=True).status("reading") as status:
        file = write_report(run, out, status.update)
    click.echo(json.dumps({"report": str(file)}) if as_json else f"written  {file}")

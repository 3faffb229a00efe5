"""`tankrig import`: a run of somebody else's frames."""

import json
from pathlib import Path
from typing import Any

import click

from ui.cli.options import FiniteRange, json_option


class NamedScene(click.ParamType[Any]):
    """FILE, or NAME=FILE."""

    name = "[NAME=]FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ARG002
        """Text to (name, path); the name is the file's where none is given."""
        if isinstance(value, tuple):
            return value
        name, found, file = str(value).rpartition("=")
        return (name, Path(file)) if found else (Path(file).stem, Path(file))


@click.command("import", epilog="Example: tankrig import photographs --scene sheet.toml --dose-ml 0.4 --exposure-ms 20")
@click.argument("folder", metavar="FOLDER", type=click.Path(path_type=Path))
@click.option(
    "--scene",
    "scenes",
    type=NamedScene(),
    multiple=True,
    required=True,
    help="Scene file of what the pictures show; one for each pattern of the table, where there are several.",
)
@click.option(
    "--table", type=click.Path(path_type=Path), metavar="FILE", help="Default: table.csv in FOLDER, if there."
)
@click.option("--dose-ml", type=FiniteRange(min=0.0), help="Ink in the tank, where the table does not say.")
@click.option("--exposure-ms", type=FiniteRange(min=0.0, min_open=True), help="Where the table does not say.")
@click.option("--name", help="Of the experiment, for people.")
@click.option("--rig", default="", help="Where it was taken, for people.")
@click.option("--material", default="", help="What the ink is, for people.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="PATH", help="The run; default: runs/ and FOLDER's name."
)
@json_option
def import_(
    folder: Path,
    scenes: tuple[tuple[str, Path], ...],
    table: Path | None,
    dose_ml: float | None,
    exposure_ms: float | None,
    name: str | None,
    rig: str,
    material: str,
    out: Path | None,
    as_json: bool,
) -> None:
    """Make a run of the pictures in FOLDER, which tankrig refit, report and archive take like any other.

    The table is a CSV file with the columns file, dose_ml, exposure_ms and, where needed, pattern, gain, dose_sd_ml.
    A picture without light has the pattern dark: it is subtracted from the others of its dose.
    """
    from tankrig.archive.importing import import_run, pictures_in
    from tankrig.scene.loading import whole_scene

    known = {each: whole_scene(file) for each, file in scenes}
    pictures = pictures_in(folder, list(known), table, dose_ml, exposure_ms)
    run = out or Path("runs") / folder.resolve().name
    about = {"name": name or folder.resolve().name, "rig": rig, "material": material}
    import_run(run, pictures, known, about)
    doses = len({one.dose_ml for one in pictures if one.dose_ml > 0.0})
    if as_json:
        click.echo(json.dumps({"run": str(run), "frames": len(pictures), "doses": doses}))
        return
    click.echo(f"{len(pictures)} frames at {doses} doses of ink in {run}; next: tankrig report {run}")

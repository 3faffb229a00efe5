"""`tankrig prepare`: a model of a scene's geometry and pattern that answers at once, made and kept on disk."""

import json
import time
import warnings
from dataclasses import asdict
from pathlib import Path

import click

from ui.cli.options import json_option

Ends = tuple[float, float]
RANGE = (float, float)


@click.command(epilog="Example: tankrig prepare scene.toml")
@click.argument("scene_file", metavar="SCENE", type=click.Path(path_type=Path))
@click.option(
    "--tolerance",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=0.01,
    show_default=True,
    help="Relative L2 error to aim for; the time goes with its inverse square.",
)
@click.option("--sigma-t", type=RANGE, default=(0.0005, 0.12), show_default=True, help="Extinctions to hold, 1/mm.")
@click.option("--albedo", type=RANGE, default=(0.5, 0.9999), show_default=True, help="Albedos to hold.")
@click.option("--g", type=RANGE, default=(-0.4, 0.95), show_default=True, help="Asymmetries to hold.")
@json_option
def prepare(scene_file: Path, tolerance: float, sigma_t: Ends, albedo: Ends, g: Ends, as_json: bool) -> None:
    """Prepare a model of SCENE for every medium: it then predicts images in a millisecond, with derivatives.

    The model is kept in the folder that TANKRIG_CACHE names, else in the user's cache folder. When this is
    interrupted, the next call goes on where it stopped.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    import tankrig
    from tankrig.light.prepared.box import Box

    box = Box(sigma_t, albedo, g)
    scene = tankrig.load_scene(scene_file)
    started = time.perf_counter()
    columns = TextColumn("preparing"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with warnings.catch_warnings(record=True) as said, Progress(*columns, console=Console(stderr=True)) as bar:
        warnings.simplefilter("always", UserWarning)
        task = bar.add_task("preparing", total=1.0)
        live = tankrig.prepare(scene, tolerance, lambda share: bar.update(task, completed=share), box)
    seconds = round(time.perf_counter() - started, 3)
    if as_json:
        found = {"error": live.error, "largest_error": live.largest_error, "tolerance": tolerance, "box": asdict(box)}
        click.echo(json.dumps({**found, "seconds": seconds, "cache": str(live.path)}))
        return
    click.echo(f"ready    in {seconds:.1f} s; error {live.error:.2%} on average, {live.largest_error:.2%} at most")
    click.echo(f"kept     {live.path}")
    for one in said:
        click.echo(f"note     {one.message}")

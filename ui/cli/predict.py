"""`tankrig predict`: from a scene file to the image its camera would see."""

import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.options import FiniteRange, json_option, out_option

if TYPE_CHECKING:
    from tankrig.prediction import Prediction
    from tankrig.scene import Scene

MOST_FREE_PATHS = 100.0
"""Along the tank; experiments have a few, whole milk has some thousands."""


@click.command(epilog="Example: tankrig predict scene.toml --tolerance 0.005 --out predicted")
@click.argument("scene_file", metavar="SCENE", type=click.Path(path_type=Path))
@click.option("--model", metavar="NAME", help="tank, single, convolution, diffuse or montecarlo; default: tank.")
@click.option(
    "--tolerance",
    type=FiniteRange(0.0, 1.0, min_open=True),
    default=0.01,
    show_default=True,
    help="Relative L2 error to aim for.",
)
@click.option("--max-order", type=click.IntRange(min=1), help="Sum orders of scattering 1 … N only.")
@click.option(
    "--seed",
    type=click.IntRange(0, 2**63 - 1),
    default=0,
    show_default=True,
    help="Of the random numbers, where the model uses any.",
)
@click.option(
    "--budget",
    "budget_s",
    type=FiniteRange(0.0, min_open=True),
    default=120.0,
    show_default=True,
    help="Seconds that the tank's model may take to keep the tolerance.",
)
@out_option("out", "Folder for SCENE's .npz and .png, or the .npz itself.")
@json_option
def predict(
    scene_file: Path,
    model: str | None,
    tolerance: float,
    max_order: int | None,
    seed: int,
    budget_s: float,
    out: Path,
    as_json: bool,
) -> None:
    """Predict the image that the camera of SCENE sees; write it, and a picture of it in false colour.

    Where the tolerance cannot be kept, a line says so and why; the image is written, and the exit status is 0 all the
    same.
    """
    import warnings

    from rich.console import Console
    from rich.progress import Progress

    import tankrig
    from tankrig.files import require_writable
    from tankrig.image.prediction_file import write_prediction

    scene = tankrig.load_scene(scene_file)
    if doubt := _per_metre(scene):
        click.echo(f"note: {doubt}", err=True)
    arrays = out if out.suffix == ".npz" else out / f"{scene_file.stem}.npz"
    picture = arrays.with_suffix(".png")
    require_writable(arrays.parent)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # `missed` is told below
        task = bar.add_task("predicting", total=1.0)
        started = time.perf_counter()
        prediction = tankrig.predict(
            scene, model, tolerance, max_order, seed, budget_s, lambda share: bar.update(task, completed=share)
        )
        seconds = round(time.perf_counter() - started, 4)
    asked = {"tolerance": tolerance, "max_order": max_order, "seed": seed, "seconds": seconds}
    write_prediction(arrays, prediction, scene, asked)
    _write_picture(picture, prediction, scene)
    missed = _missed(prediction, tolerance, budget_s, seconds)
    if as_json:
        figures = {**_figures(prediction), "missed": missed}
        click.echo(json.dumps({**figures, **asked, "arrays": str(arrays), "picture": str(picture)}))
        return
    _tell(prediction, seconds)
    if _dark(prediction, scene):
        click.echo("dark     no pixel has any light, though the liquid is lit and scatters")
    if missed:
        click.echo(f"missed   {missed}")
    click.echo(f"written  {arrays}\n         {picture}")


def _per_metre(scene: "Scene") -> str:
    """A doubt about the unit of coefficients that make milk of the tank; empty where there is none."""
    medium, length_mm = scene.medium, scene.tank.size_mm[0]
    free_paths = medium.sigma_t * length_mm
    if free_paths <= MOST_FREE_PATHS:
        return ""
    return (
        f"σa + σs = {medium.sigma_t:g}/mm are {free_paths:.0f} free paths along the tank of {length_mm:g} mm, which "
        "may take minutes; coefficients are per mm, not per metre"
    )


def _dark(prediction: "Prediction", scene: "Scene") -> bool:
    """Whether there is no light where there should be some."""
    lit = scene.medium.sigma_s > 0.0 and any(beam.power > 0.0 for beam in scene.projector.beams)
    return lit and not prediction.image.any()


def _missed(prediction: "Prediction", tolerance: float, budget_s: float, seconds: float) -> str:
    """Why the tolerance was not kept, in the words of this command's options; empty where it was kept."""
    from tankrig.image.predict import why_missed

    if not prediction.missed:
        return ""
    spent = prediction.model == "tank" and seconds >= budget_s
    why = f"it took all of --budget {budget_s:g}" if spent else why_missed(prediction, tolerance)
    do = "a longer --budget" if spent else "another --model"
    return (
        f"the image may be wrong by {prediction.error:.2g} of its L2 norm, more than --tolerance {tolerance:g} "
        f"({why}); give {do} or a larger --tolerance"
    )


def _shares(prediction: "Prediction") -> dict[str, float]:
    """Of the image's light, by class of orders."""
    total = float(prediction.image.sum()) or 1.0
    return {str(order): float(image.sum()) / total for order, image in prediction.orders.items()}


def _figures(prediction: "Prediction") -> dict[str, object]:
    return {
        "model": prediction.model,
        "mean": float(prediction.image.mean()),
        "peak": float(prediction.image.max()),
        "shares": _shares(prediction),
        "error": prediction.error,
        "skipped": [
            {"what": part.what, "bound": part.bound if math.isfinite(part.bound) else None}  # JSON knows no infinity
            for part in prediction.skipped
        ],
    }


def _tell(prediction: "Prediction", seconds: float) -> None:
    click.echo(f"model    {prediction.model}, {seconds:.2f} s")
    click.echo(f"image    mean {prediction.image.mean():.4g}, peak {prediction.image.max():.4g} W/mm²/sr")
    if prediction.orders:
        click.echo("orders   " + ", ".join(f"{order}: {share:.1%}" for order, share in _shares(prediction).items()))
    noise = f"of which noise and smoothing {prediction.noise:.2g}"
    click.echo(f"error    {prediction.error:.2g} of the image's L2 norm stated, {noise}")
    for part in prediction.skipped:
        if part.bound == 0.0:  # it changes nothing, or the error above holds it
            continue
        effect = f"changes the image by at most {part.bound:.2g}" if math.isfinite(part.bound) else "effect unknown"
        click.echo(f"skipped  {part.what} ({effect})")


def _write_picture(path: Path, prediction: "Prediction", scene: "Scene") -> None:
    import matplotlib as mpl
    import numpy as np
    from matplotlib.figure import Figure

    from tankrig.figures.tank_image import FALSE_COLOUR, STYLE, brightness, draw
    from tankrig.files import whole_file

    rows, columns = prediction.image.shape
    with mpl.rc_context(STYLE), whole_file(path) as unfinished:
        figure = Figure(figsize=(7.0, min(5.6 * rows / columns, 20.0) + 0.8), layout="constrained")
        axes = figure.subplots()
        scale = brightness(prediction.image)
        shown = draw(axes, prediction.image, scene, FALSE_COLOUR, scale, f"{path.stem} ({prediction.model})")
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
        ticks = scale.inverse(np.linspace(0.0, 1.0, 6))
        figure.colorbar(shown, label="radiance (W/mm²/sr)", ticks=ticks, format="%.2g", shrink=0.85, pad=0.02)
        figure.savefig(unfinished, dpi=150)

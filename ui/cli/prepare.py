"""`tankrig prepare`: models that answer at once, made and kept on disk: of a scene, or for a run that is to come."""

import json
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.options import FINITE, FiniteRange, json_option, rig_option

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from tankrig.light.prepared.box import Box
    from tankrig.scene import Scene

Ends = tuple[float, float]
RANGE = (FINITE, FINITE)
BY_PATHS = "where light or sight slants, other phase functions than Henyey–Greenstein's are fitted by light paths"


@click.command(epilog="Example: tankrig prepare scene.toml")
@click.argument("scene_file", metavar="[SCENE]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--sequence",
    "sequence_file",
    metavar="SEQUENCE",
    type=click.Path(path_type=Path),
    help="Instead of a scene: prepare what the live fit of this sequence on --rig will ask for.",
)
@rig_option
@click.option(
    "--tolerance",
    type=FiniteRange(0.0, 1.0, min_open=True),
    default=0.01,
    show_default=True,
    help="Relative L2 error to aim for; the time goes with its inverse square.",
)
@click.option("--sigma-t", type=RANGE, default=(0.0005, 0.12), show_default=True, help="Extinctions to hold, 1/mm.")
@click.option("--albedo", type=RANGE, default=(0.5, 0.9999), show_default=True, help="Albedos to hold.")
@click.option("--g", type=RANGE, default=(-0.4, 0.95), show_default=True, help="Asymmetries to hold.")
@click.option(
    "--bench",
    "learned",
    is_flag=True,
    help="First learn what light becomes that enters at these patterns' heights, once for all patterns there.",
)
@json_option
def prepare(
    scene_file: Path | None,
    sequence_file: Path | None,
    rig: Path | None,
    tolerance: float,
    sigma_t: Ends,
    albedo: Ends,
    g: Ends,
    learned: bool,
    as_json: bool,
) -> None:
    """Prepare a model of SCENE for every medium: it then predicts images in a millisecond, with derivatives.

    The model is kept in the folder that TANKRIG_CACHE names, else in the user's cache folder. When this is
    interrupted, the next call goes on where it stopped.

    With --rig and --sequence it prepares what a run's live fit can use whatever the ink is, while a person sets up;
    with `ink` in the sequence, the models of its doses too.

    With --bench, and a calibrated bench or pinholes, what light becomes is learned as well, for the same liquids.
    Models of further patterns at these heights, on the same bench, then follow no light paths.
    """
    if (scene_file is None) == (sequence_file is None):
        raise click.UsageError("give a scene file, or --sequence with --rig")
    if sequence_file is not None:
        if rig is None:
            raise click.UsageError("--sequence needs the bench that it is for; give --rig")
        _for_a_run(sequence_file, rig, learned, as_json)
    elif scene_file is not None:
        from tankrig.light.prepared.box import Box

        _of_a_scene(scene_file, tolerance, Box(sigma_t, albedo, g), learned, as_json)


def _of_a_scene(scene_file: Path, tolerance: float, box: "Box", learned: bool, as_json: bool) -> None:
    import tankrig

    scene = tankrig.load_scene(scene_file)
    started = time.perf_counter()
    if learned:
        _learn([scene], box, tolerance)
    with warnings.catch_warnings(record=True) as said, _progress() as bar:
        warnings.simplefilter("always", UserWarning)
        task = bar.add_task("preparing", total=1.0)
        live = tankrig.prepare(scene, tolerance, lambda share: bar.update(task, completed=share), box)
    seconds = round(time.perf_counter() - started, 3)
    if as_json:
        found = {"error": live.error, "largest_error": live.largest_error, "tolerance": tolerance, "box": asdict(box)}
        notes = [str(one.message) for one in said]
        click.echo(json.dumps({**found, "seconds": seconds, "cache": str(live.path), "notes": notes}))
        return
    click.echo(f"ready    in {seconds:.1f} s; error {live.error:.2%} on average, {live.largest_error:.2%} at most")
    click.echo(f"kept     {live.path}")
    for one in said:
        click.echo(f"note     {one.message}")


def _learn(scenes: "Sequence[Scene]", box: "Box", tolerance: float) -> None:
    """What light becomes that enters at the heights of all these scenes of one bench."""
    from tankrig.light.prepared.entrance import learn

    beams = tuple(beam for scene in scenes for beam in scene.projector.beams)
    with _progress("learning") as bar:
        task = bar.add_task("learning", total=1.0)
        one = replace(scenes[0], projector=replace(scenes[0].projector, beams=beams))
        learn(one, box, tolerance, lambda share: bar.update(task, completed=share))


def _for_a_run(sequence_file: Path, rig: Path, learned: bool, as_json: bool) -> None:
    from drivers.rig import calibrated_bench, load_rig_file
    from tankrig.live.attached import require_fittable
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.live.preparing import (
        LOOK,
        foreseen,
        is_kept,
        model_for,
        phases_prepared,
        tolerance_for,
        unlike_learned,
    )
    from tankrig.sequence import load_sequence

    sequence, bench = load_sequence(sequence_file), calibrated_bench(load_rig_file(rig))
    require_fittable(sequence, bench)
    plan = PhotographPlan.of(bench, sequence, list(sequence.drawn(bench.wall).values()))
    phases = phases_prepared(plan)
    foreseeable = foreseen(list(plan.scenes.values()), plan.doses_ml, plan.ink) if phases else []
    wanted = [(scene, box) for scenes, box in foreseeable for scene in scenes]
    kept = sum(is_kept(*one, phases or "hg") for one in wanted)
    started = time.perf_counter()
    if learned:
        boxes = [box for _, box in foreseeable if box != LOOK]  # whose few paths are followed sooner than learned
        if not boxes:
            raise click.UsageError(f"--bench learns for liquids that are foreseen; {sequence.name} wants an `ink`")
        scenes = list(plan.scenes.values())
        for box in boxes:
            _learn(scenes, box, tolerance_for(scenes[0], box))
    notes = list(filter(None, dict.fromkeys(unlike_learned(*one, phases or "hg") for one in wanted)))
    notes += sequence.cut_off(bench.wall, bench.tank)
    with _progress() as bar:
        task = bar.add_task("preparing", total=float(len(wanted)))
        for done, (scene, box) in enumerate(wanted):
            told = partial(_told, bar, task, done)
            model_for(scene, box, told, phases or "hg")
    seconds = round(time.perf_counter() - started, 3)
    if as_json:
        click.echo(json.dumps({"models": len(wanted), "kept": kept, "seconds": seconds, "notes": notes}))
        return
    if phases is None:
        click.echo(f"{sequence.name}: {BY_PATHS}, so there is nothing to prepare")
        return
    what = "the first look" if plan.ink is None else "the first look and the doses of the ink expected"
    found = "was there" if kept == len(wanted) else f"is ready after {seconds:.1f} s"
    rest = "; the run prepares the rest, once a first look has told what ink it is" if plan.ink is None else ""
    click.echo(f"{sequence.name}: what can be prepared for {what} {found}{rest}")
    for note in notes:
        click.echo(f"note     {note}")


def _told(bar: "Progress", task: "TaskID", done: int, share: float) -> None:
    bar.update(task, completed=done + share)


@contextmanager
def _progress(what: str = "preparing") -> "Iterator[Progress]":
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = TextColumn(what), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True)) as bar:
        yield bar

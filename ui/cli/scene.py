"""`tankrig scene`: the scene of a pattern, by the calibrations in force, as a file for predict, fit and prepare."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.options import json_option, rig_option

if TYPE_CHECKING:
    from tankrig.bench import Bench
    from tankrig.calibration.file import Calibration
    from tankrig.pattern import Pattern
    from tankrig.scene import Medium

PLACEHOLDER = (0.0002, 0.01, 0.5)
"""σa and σs per mm and g of a medium that nobody has said anything about."""


class Coefficients(click.ParamType[Any]):
    """σa,σs,g: two per mm, and a number between −1 and 1."""

    name = "σa,σs,g"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to a medium."""
        from tankrig.scene import Medium

        if isinstance(value, Medium):
            return value
        try:
            sigma_a, sigma_s, g = (float(one) for one in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is not σa,σs,g, such as 0.0002,0.01,0.6", param, ctx)
        return Medium(sigma_a, sigma_s, g)


class Bins(click.ParamType[Any]):
    """A whole number from 1 up, or the word "auto"."""

    name = "N|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Text to "auto" or int."""
        if value == "auto" or isinstance(value, int):
            return value
        if not value.isdigit() or int(value) < 1:
            self.fail(f'{value!r} is neither "auto" nor a whole number of pixels from 1 up', param, ctx)
        return int(value)


@click.command(epilog="Example: tankrig scene --rig rig.toml --pattern sheet --sequence dilution.toml --bin auto")
@click.argument("run_folder", metavar="[RUN]", required=False, type=click.Path(path_type=Path))
@rig_option
@click.option("--pattern", "pattern_name", required=True, metavar="NAME", help="That the projector shows.")
@click.option(
    "--sequence",
    "sequence_file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help='Sequence (TOML) that has the pattern; "full" and "dark" are known without.',
)
@click.option("--medium", type=Coefficients(), metavar="σa,σs,g",
              help="In the tank, per mm; default: a placeholder, said to be one.")  # fmt: skip
@click.option(
    "--bin", "bins", type=Bins(), default="1", show_default=True, help="Camera pixels along a pixel of the scene."
)
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE", help="Default: NAME.toml in this folder.")
@json_option
def scene(
    run_folder: Path | None,
    rig: Path | None,
    pattern_name: str,
    sequence_file: Path | None,
    medium: "Medium | None",
    bins: Any,
    out: Path | None,
    as_json: bool,
) -> None:
    """Write the scene file of a pattern: tank, projector and camera as calibrated, for predict, fit and prepare.

    With the folder of a RUN, as they were when it was recorded; else as they are in force for the rig. What was not
    measured but believed is said, here and above the file. A picture of the projector goes into a PNG beside the file.
    """
    from tankrig.calibration.geometry_in_force import USED
    from tankrig.calibration.places import believed, measured_places

    if run_folder is not None:
        bench, pattern, found, source = _of_run(run_folder, pattern_name)
    else:
        bench, pattern, found, source = _of_rig(rig, pattern_name, sequence_file)
    path = out or Path(f"{pattern_name}.toml")
    unsure = believed(bench, found)
    if medium is None:
        unsure.append(
            "the medium is a placeholder; a fit takes it for no more than a start, a prediction for the truth"
        )
    by = _binning(bench, pattern) if bins == "auto" else bins
    known = measured_places(found)
    comments = [
        f'Pattern "{pattern.name}" of {source}; written by tankrig scene.',
        *[f"Rests on {line}." for line in _rests_on(found)],
        *[f"Measured: {one.what} {one.text}." for one in known],
        *(["Each ± above is a standard deviation."] if known else []),
        *[f"Not measured: {line}." for line in unsure],
    ]
    _write(path, bench, pattern, medium, by, comments)
    if as_json:
        told = {
            "path": str(path),
            "pattern": pattern.name,
            "binning": by,
            "rests_on": {kind: found[kind].hash for kind in USED if kind in found},
            "measured": [
                {"what": one.what, "values": one.values, "sds": one.sds, "unit": one.unit, "file": one.calibration}
                for one in known
            ],
            "believed": unsure,
        }
        click.echo(json.dumps(told, ensure_ascii=False))
        return
    for one in known:
        click.echo(
            f"{one.what:28s}{one.text}   {one.calibration}" + (f"; not in the ±: {one.note}" if one.note else "")
        )
    if known:
        click.echo("each ± is a standard deviation")
    for line in unsure:
        click.echo(f"not measured: {line}")
    click.echo(f"written to {path}; try tankrig predict {path}")


_Source = tuple["Bench", "Pattern", Mapping[str, "Calibration"], str]


def _of_rig(rig: Path | None, pattern_name: str, sequence_file: Path | None) -> _Source:
    from drivers.rig import SIMULATED, calibrated_bench, load_rig_file
    from tankrig.calibration.file import in_force
    from tankrig.errors import SequenceError
    from tankrig.sequence import Capture, Sequence, load_sequence

    if rig is None:
        click.echo("no rig is configured, so this is the simulated rig", err=True)
    description = load_rig_file(rig) if rig else load_rig_file(SIMULATED, beside=Path().absolute())
    bench = calibrated_bench(description)
    patterns = load_sequence(sequence_file).patterns if sequence_file else {}
    try:
        shown = Sequence("scene", (Capture(pattern_name),), patterns, source=str(sequence_file or ""))
    except SequenceError as error:
        said = str(error).removeprefix(f"capture {pattern_name}: ")  # a step that nobody has written
        raise SequenceError(f"{sequence_file}: {said}" if sequence_file else said) from error
    drawn = shown.drawn(bench.wall)
    for note in shown.cut_off(bench.wall, bench.tank):
        click.echo(f"note: {note}", err=True)
    found = in_force(Path(description.calibration_folder), description.calibration)
    return bench, drawn[pattern_name], found, f"rig {description.name}"


def _of_run(folder: Path, pattern_name: str) -> _Source:
    from tankrig.bench import Bench
    from tankrig.errors import SequenceError
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.run.calibrations import calibrations_of
    from tankrig.run.reading import open_run

    run = open_run(folder)
    by_name = {pattern.name: pattern for pattern in run.patterns.values()}
    if pattern_name not in by_name:
        raise SequenceError(f'{folder}: has no pattern "{pattern_name}"; it has {", ".join(by_name)}')
    bench = PhotographPlan.of_run(run).bench
    if not isinstance(bench, Bench):
        raise SequenceError(f"{folder}: was imported, with a scene for each pattern: it is in the run's settings")
    return bench, by_name[pattern_name], calibrations_of(run), f"run {run.path.name}"


def _binning(bench: "Bench", pattern: "Pattern") -> int:
    """As a fit of a run puts pixels together, and no coarser either way."""
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.sequence import Capture, Sequence

    bins = PhotographPlan.of(bench, Sequence("scene", (Capture("full"),)), [pattern]).bins
    return min(bins.by, bins.along)


def _rests_on(found: Mapping[str, "Calibration"]) -> list[str]:
    from tankrig.calibration.geometry_in_force import USED
    from tankrig.calibration.places import named

    return [f"the calibration of the {kind}, {named(found[kind])}" for kind in USED if kind in found]


def _write(
    path: Path, bench: "Bench", pattern: "Pattern", medium: "Medium | None", by: int, comments: list[str]
) -> None:
    """The file, and where the projector's pixels are known one by one, its picture."""
    import cv2
    import numpy as np

    from tankrig.errors import StoreError
    from tankrig.files import require_writable, whole_file
    from tankrig.scene import Medium
    from tankrig.scene.writing import scene_text

    seen = bench.scene(pattern, medium or Medium(*PLACEHOLDER))
    seen = replace(seen, camera=replace(seen.camera, bin=by if by > 1 else 0))
    require_writable(path.parent)
    image = None
    if bench.light == "calibrated":
        picture = path.with_suffix(".png")
        image = picture.name
        shares = bench.wall.fractions[pattern.pixels]  # linear in light, so the scene's gamma is 1
        encoded, data = cv2.imencode(".png", np.rint(shares * math.floor(2**16 - 1)).astype(np.uint16))
        if not encoded:
            raise StoreError(f"{picture}: the projector's picture could not be encoded; report this")
        with whole_file(picture) as unfinished:
            unfinished.write_bytes(data.tobytes())
        seen = replace(seen, projector=replace(seen.projector, gamma=1.0))
    with whole_file(path) as unfinished:
        unfinished.write_text(scene_text(seen, comments, image), encoding="utf-8")

"""`tankrig calibrate radiometry`: camera and projector in numbers of light."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.calibrating import accept_option, asker, described, keep, tell
from ui.cli.options import FINITE, bench_option, json_option
from ui.guide import feedback, guided

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tankrig.calibration.file import Calibration


@click.command(epilog="Example: tankrig calibrate radiometry --rig rig.toml --gains 1,4")
@bench_option
@click.option("--gains", default="1", show_default=True, metavar="G,G,…", help="Gains that will be used.")
@click.option("--shortest-ms", type=FINITE, help="Shortest exposure of the sweep; default: 1/60 s.")
@click.option("--longest-ms", type=FINITE, help="Longest exposure of the sweep; default: 2 s.")
@click.option("--period-ms", type=FINITE, help="Refresh period of the projector; exposures are whole ones of it.")
@accept_option
@json_option
def radiometry(rig: Path | None, gains: str, accept: bool, as_json: bool, **exposures: float | None) -> int:
    """Measure the camera's darks, linearity, noise and flat, and the projector's response.

    Wants a lens cap, and a diffuser (opal glass, or white paper) before the lens on which the projector's picture
    falls; no ink moves. The result is a dated file in the folder calibration/ beside the rig file, used from then on.
    """
    from drivers.rig import open_light
    from tankrig.calibration.radiometry_plan import ExposuresError, RadiometryPlan
    from tankrig.calibration.radiometry_procedure import measure_radiometry
    from tankrig.calibration.radiometry_result import calibration_of
    from tankrig.figures.radiometry_figure import write_radiometry_figure

    given: dict[str, Any] = {name: value for name, value in exposures.items() if value is not None}
    plan = RadiometryPlan(_gains(gains), **given)
    description = described(rig)
    click.echo(f"takes about {plan.seconds / 60.0:.0f} minutes on the bench, handling included", err=True)
    try:
        with open_light(description) as (projector, camera), feedback() as shown:
            measured = measure_radiometry(projector, camera, plan, asker(camera, shown), shown.look)
    except ExposuresError as error:
        if guided():  # a window has fields for them, by their names in words
            raise
        options = ", ".join(f"--{name.replace('_', '-')}" for name in error.settings)
        raise ExposuresError(f"{error} ({options})", *error.settings) from error
    kept = keep(calibration_of(measured), description, accept, lambda path: write_radiometry_figure(path, measured))
    return tell(kept, _rows(kept), as_json)


def _gains(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text} is not numbers with commas between them", param_hint="--gains") from None


def _rows(kept: "Calibration") -> "Mapping[str, str]":
    rows: dict[str, str] = {}
    for one, sd in zip(kept.result["amplified"], kept.sd["amplified"], strict=True):
        at = f"gain {one['gain']:g}: "
        rows[at + "counts per electron"] = _with(one, sd, "dn_per_e")
        rows[at + "read noise, electrons"] = _with(one, sd, "read_noise_e")
        rows[at + "black, counts"] = _with(one, sd, "black_dn")
        rows[at + "dark current, counts per s"] = f"{1000 * one['dark_dn_per_ms']:.4g}"
    flat, projector, well = kept.result["flat"], kept.result["projector"], kept.how_well
    rows["not linear by, after correction"] = f"{well['linearity_error_percent']:.2g} % (levels left out of the fit)"
    rows["corners darker by"] = f"{100 * flat['vignetting']:.1f} %"
    rows["pixels differ by"] = f"{100 * flat['uneven']:.2f} %, {flat['hot_pixels']} are hot"
    rows["projector's response"] = f"like gamma {projector['gamma']:.2f}; level 0 has {100 * projector['leak']:.2g} %"
    rows["response off by"] = f"{well['response_error_percent']:.2g} % (levels left out of the fit)"
    return rows


def _with(values: dict[str, Any], sd: dict[str, Any], name: str) -> str:
    return f"{values[name]:.5g} ± {sd[name]:.2g}"

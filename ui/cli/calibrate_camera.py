"""`tankrig calibrate camera`: its lens, by a ChArUco board held in air."""

from pathlib import Path
from typing import Any

import click

from ui.cli.boards import Holder, board_of, board_options, opened
from ui.cli.calibrating import accept_option, blurred, described, keep, tell
from ui.cli.options import bench_option, json_option

_SECONDS_A_VIEW = 12.0


@click.command(epilog="Example: tankrig calibrate camera --rig rig.toml --board 7x5 --square-mm 20.02")
@bench_option
@board_options
@click.option("--views", type=click.IntRange(6, 100), default=15, show_default=True, help="Good ones to take.")
@accept_option
@json_option
def camera(rig: Path | None, views: int, exposure_ms: float | None, accept: bool, as_json: bool, **board: Any) -> int:
    """Find the camera's lens with a ChArUco board that is held before it in air, all over the picture.

    The result is a dated file in the folder calibration/ beside the rig file, used from then on.
    """
    from tankrig.calibration.camera import INTRINSICS, MOST_RMS_PX, calibrate_camera
    from tankrig.calibration.pictures import Pictures
    from tankrig.figures.geometry_figure import write_geometry_figure

    held = board_of(**board)
    description = described(rig)
    click.echo(f"takes about {views * _SECONDS_A_VIEW / 60.0:.0f} minutes on the bench, handling included", err=True)
    with opened(description, "camera") as (device,):
        with Holder(device, Pictures(device, exposure_ms), held) as holder:
            seen = holder.good_views("air", views, lambda view: view)
        found = calibrate_camera(seen, held)
        name = device.name
    kept = keep(
        found.calibration(name),
        description,
        accept,
        lambda path: write_geometry_figure(path, f"{name}: lens", found, MOST_RMS_PX),
    )
    rows = {one: f"{getattr(found.lens, one):.6g} ± {found.sd[one]:.2g}" for one in INTRINSICS[:-1]}
    rows["corners off by"] = f"{found.rms_px:.3f} px rms, {len(found.view_rms_px)} views"
    rows["covered"] = f"{found.coverage:.0%} of the picture, views tilted by up to {found.tilt_deg:.0f}° to each other"
    rows |= blurred(kept, "px")
    if found.left_out:
        rows["left out"] = f"views {', '.join(str(number + 1) for number in found.left_out)}, unlike the others"
    return tell(kept, rows, as_json)

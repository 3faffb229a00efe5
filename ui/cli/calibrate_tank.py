"""`tankrig calibrate tank`: where it stands before the camera, and how high its water."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.boards import Holder, board_of, board_options, opened
from ui.cli.calibrating import (
    accept_option,
    clear_water_option,
    described,
    keep,
    left_out,
    require_clear_water,
    tell,
)
from ui.cli.options import bench_option, json_option

if TYPE_CHECKING:
    from tankrig.calibration.board import BoardView
    from tankrig.calibration.tank import Place

_MINUTES = 6


@click.command(epilog="Example: tankrig calibrate tank --rig rig.toml --views 6")
@bench_option
@board_options
@click.option("--views", type=click.IntRange(0, 50), default=4, show_default=True, help="Of the board in the water.")
@clear_water_option
@accept_option
@json_option
def tank(
    rig: Path | None,
    views: int,
    exposure_ms: float | None,
    clear_water: bool,
    accept: bool,
    as_json: bool,
    **board: Any,
) -> int:
    """Find the tank before the camera, and its water's level, with a board on its floor and then in the water.

    Wants the camera calibrated. The tank's inside and its water's refractive index are those of the rig file, whose
    table [tolerances] says by how much they, and the board's place on the floor, may be off. The result is a dated file
    in the folder calibration/ beside the rig file, used from then on.
    """
    from tankrig.calibration.file import in_force
    from tankrig.calibration.geometry_in_force import lens_of, require
    from tankrig.calibration.pictures import Pictures
    from tankrig.calibration.tank import MOST_RMS_PX, calibrate_tank
    from tankrig.calibration.uncertainty import Named
    from tankrig.figures.geometry_figure import write_geometry_figure

    held = board_of(**board)
    description = described(rig)
    require_clear_water(description, clear_water)
    known = require(in_force(Path(description.calibration_folder), description.calibration, ("camera",)), "camera")
    click.echo(f"takes about {_MINUTES} minutes on the bench, filling not included", err=True)
    with opened(description, "camera") as (device,):
        known.require_for(device.name, device.shape)
        seen: list[tuple[Place, BoardView]] = []
        places: tuple[tuple[Place, int], ...] = (("floor", 1), ("flooded", 1), ("water", views))
        with Holder(device, Pictures(device, exposure_ms), held) as holder:
            for place, count in places:
                seen += [(place, view) for view in holder.good_views(place, count, lambda view: view)]
        name = device.name
    believed = description.bench.tank
    lens = Named.of(known)
    found = calibrate_tank(
        seen,
        held,
        lens_of(known),
        believed.size_mm,
        believed.refractive_index,
        lens.covariance if lens else None,
        description.tolerances,
    )
    kept = keep(
        found.calibration(name, {"camera": known.hash}),
        description,
        accept,
        lambda path: write_geometry_figure(path, f"{name}: tank and water", found, MOST_RMS_PX),
    )
    where, sd = kept.result["camera_position_mm"], kept.sd["camera_position_mm"]
    rows = {
        f"camera's {axis}": f"{value:.2f} ± {error:.2g} mm" for axis, value, error in zip("xyz", where, sd, strict=True)
    }
    rows["water level"] = f"{found.level_mm:.2f} ± {kept.sd['level_mm']:.2g} mm"
    rows["surface leans by"] = f"{found.tilt_deg:.2f} ± {found.tilt_sd_deg:.2g}°"
    rows["corners off by"] = f"{found.rms_px:.3f} px rms, {len(found.view_rms_px)} views"
    return tell(kept, rows | left_out(kept), as_json)

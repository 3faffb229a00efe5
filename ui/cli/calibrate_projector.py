"""`tankrig calibrate projector`: its lens and where it stands, by patterns on a board that the camera sees."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ui.cli.boards import Holder, board_of, board_options, opened
from ui.cli.calibrating import (
    accept_option,
    blurred,
    clear_water_option,
    described,
    keep,
    left_out,
    require_clear_water,
    tell,
)
from ui.cli.options import bench_option, json_option

if TYPE_CHECKING:
    from tankrig.calibration.file import Calibration
    from tankrig.calibration.projector import ProjectorFound

_SECONDS_A_PICTURE, _SECONDS_A_VIEW = 0.12, 20.0


@click.command(epilog="Example: tankrig calibrate projector --rig rig.toml --views 10")
@bench_option
@board_options
@click.option("--views", type=click.IntRange(4, 50), default=8, show_default=True, help="Of the board.")
@click.option("--empty", is_flag=True, help="The tank is empty; default: filled as when the tank was calibrated.")
@clear_water_option
@accept_option
@json_option
def projector(
    rig: Path | None,
    views: int,
    empty: bool,
    exposure_ms: float | None,
    clear_water: bool,
    accept: bool,
    as_json: bool,
    **board: Any,
) -> int:
    """Find the projector's lens and place by Gray code and phase shift on a board held at a slant in the tank.

    Wants camera and tank calibrated, and the radiometry, without which the projector is taken to light its picture
    evenly; the wall's thickness and index are those of the rig file. The result is a dated file in the folder
    calibration/ beside the rig file, used from then on.
    """
    from tankrig.calibration.camera import blur_of
    from tankrig.calibration.file import in_force
    from tankrig.calibration.geometry_in_force import camera_pose, lens_of, require, surface_of
    from tankrig.calibration.gray_code import gray_code_patterns
    from tankrig.calibration.pictures import Pictures
    from tankrig.calibration.projector import MOST_RMS_PX, calibrate_projector
    from tankrig.calibration.projector_halo import CameraStray, half_patterns
    from tankrig.calibration.radiometry import Radiometry
    from tankrig.calibration.uncertainty import Named
    from tankrig.figures.geometry_figure import write_geometry_figure
    from tankrig.geometry.refraction import entry_wall
    from ui.cli.board_light import BoardLight

    held = board_of(**board)
    description = described(rig)
    require_clear_water(description, clear_water or empty)
    force = in_force(
        Path(description.calibration_folder), description.calibration, ("camera", "tank", "radiometry", "stray")
    )
    known = {kind: require(force, kind) for kind in ("camera", "tank")}
    radiometry = Radiometry.of(force["radiometry"]) if "radiometry" in force else None
    stray = CameraStray.of(force["stray"]) if "stray" in force else None
    with opened(description, "projector", "camera") as (device, camera):
        known["camera"].require_for(camera.name, camera.shape)
        if radiometry:
            force["radiometry"].require_for(camera.name, camera.shape)
        patterns = gray_code_patterns(device.shape)
        halves = half_patterns(device.shape) if radiometry and stray else ()
        seconds = views * ((len(patterns) + len(halves)) * _SECONDS_A_PICTURE + _SECONDS_A_VIEW)
        click.echo(f"takes about {seconds / 60.0:.0f} minutes on the bench, handling included", err=True)
        pictures = Pictures(camera, exposure_ms)
        holder = Holder(camera, pictures, held)
        light = BoardLight(device, camera, pictures, holder, held, patterns, halves, radiometry, stray)
        device.show(patterns[0])
        with holder:
            boards = holder.good_views("slant" if empty else "flooded slant", views, light.corners)
        name, shape = device.name, device.shape
    tank = description.bench.tank
    pane = (tank.wall_mm, tank.wall_index) if tank.entry == "glass" else (0.0, 1.52)
    surface = None if empty else surface_of(known["tank"])
    wall = entry_wall(surface.water_index if surface else 1.0, *pane)
    found = calibrate_projector(
        boards,
        held,
        lens_of(known["camera"]),
        camera_pose(known["tank"]),
        surface,
        wall,
        shape,
        tank.size_mm,
        Named.of(known["tank"]),
        description.tolerances,
        blur_of(known["camera"]),
    )
    kept = keep(
        found.calibration(name, {kind: one.hash for kind, one in known.items()}),
        description,
        accept,
        lambda path: write_geometry_figure(path, f"{name}: lens and place", found, MOST_RMS_PX, found.blur_in_depth),
    )
    return tell(kept, _rows(found, kept), as_json)


def _rows(found: "ProjectorFound", kept: "Calibration") -> dict[str, str]:
    """What was found, in words."""
    where, sd = kept.result["position_mm"], kept.sd["position_mm"]
    rows = {f"its {axis}": f"{value:.2f} ± {error:.2g} mm" for axis, value, error in zip("xyz", where, sd, strict=True)}
    rows |= {
        one: f"{getattr(found.lens, one):.6g} ± {kept.sd[one]:.2g}" for one in ("fx", "fy", "cx", "cy", "k1", "k2")
    }
    rows["corners off by"] = f"{found.rms_px:.3f} projector px rms, {len(found.view_rms_px)} views"
    rows["between corners"] = f"{found.coverage:.0%} of its picture"
    rows["light"] = _evenness(found)
    return rows | blurred(kept, "projector px") | _in_depth(found) | _halo(found) | left_out(kept)


def _evenness(found: "ProjectorFound") -> str:
    """In words."""
    from tankrig.geometry.shading import shading

    if found.evenness is None:
        return "taken to be even; calibrate the radiometry first, and its fall-off is measured"
    map_ = shading(found.evenness.coefficients, found.shape)
    return f"{map_.min() / map_.max():.0%} of its brightest pixel's in the darkest; points scatter by " + (
        f"{found.evenness.scatter:.1%}"
    )


def _in_depth(found: "ProjectorFound") -> dict[str, str]:
    """In words."""
    told = found.blur_in_depth
    if told is None:
        return {"over depth": "not measured; show more of the board's white, near the wall and far from it"}
    blur, lens, focus = told.sd
    if told.lens_mm == 0.0:
        return {"over depth": f"alike; its lens is a pinhole as far as boards tell, less than {2.0 * lens:.2g} mm wide"}
    return {
        "sharpest at": f"x = {told.focus_mm:.0f} ± {focus:.2g} mm, where it blurs by {told.blur_px:.2f} ± {blur:.2g} "
        f"projector px",
        "lens": f"{told.lens_mm:.1f} ± {lens:.2g} mm wide: it blurs the more the farther from there",
    }


def _halo(found: "ProjectorFound") -> dict[str, str]:
    """In words."""
    if found.halo is None:
        why = "calibrate radiometry and stray first" if not found.evenness else "calibrate stray first"
        return {"halo": f"not measured; {why}, and it is told from the camera's"}
    share, width = found.halo.sd
    return {
        "halo": f"{100 * found.halo.share:.2f} ± {100 * share:.2g} % of the light, standard deviation "
        f"{found.halo.sigma_px:.0f} ± {width:.2g} projector px"
    }

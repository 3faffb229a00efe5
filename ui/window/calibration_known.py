"""What is known of a rig, where from, since when, and how well: lines for people."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from tankrig.calibration.how_well import how_well
from tankrig.calibration.places import measured_places
from tankrig.errors import StoreError, TankrigError
from tankrig.live.formatting import with_error
from ui.calibration_way import EXACT_PUMP, WHY_EXACT
from ui.window.result import CONFIDENCE, Z
from ui.window.words import calibrated

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.calibration.file import Calibration

BELIEVED = "taken from the rig file; not measured by tankrig"

NOT_YET = "not yet", "the tab Measure leads through it"
MEASURED_INSTEAD = ("light", "projector to wall", "camera")
"""What the rig file says of these is not used once camera, tank and projector have been measured."""


class Known(NamedTuple):
    """One thing that is known; of a doubtful result that was set aside, its file."""

    what: str
    value: str
    note: str
    aside: Path | None = None


def set_aside(rig: "RigFile") -> "dict[str, Calibration]":
    """Doubtful results that a person may still use, by kind; none where it cannot be told what counts."""
    from tankrig.calibration.file import left_aside

    try:
        return left_aside(Path(rig.calibration_folder), rig.calibration)
    except TankrigError:
        return {}


def known_of(rig: "RigFile", file: Path, folder: Path) -> Iterator[Known]:
    """Measured things first, then what the rig file is believed in.

    Parameters
    ----------
    rig, file
        What the rig file says, and the file.
    folder
        Where pump calibrations lie.
    """
    found = _in_use(rig)
    places = measured_places(found)
    yield from _measured(rig)
    for one in places:
        sure = f" ({CONFIDENCE})" if any(sd > 0.0 for sd in one.sds) else ""
        yield Known(
            one.what, one.within(Z) + sure, one.calibration + (f"; not in the ±: {one.note}" if one.note else "")
        )
    yield from _weighed(rig, folder)
    note = f"{BELIEVED}; file of {datetime.fromtimestamp(file.stat().st_mtime):%Y-%m-%d %H:%M}"
    for what, value in _believed(rig):
        if places and what in MEASURED_INSTEAD:
            continue
        if what == "projector's brightness" and "radiometry" in found:
            value = value.partition(",")[0]  # its gamma was measured
        yield Known(what, value, note)


def _in_use(rig: "RigFile") -> "dict[str, Calibration]":
    """Calibrations that count; none where that cannot be told, which `_measured` says."""
    from tankrig.calibration.file import usable

    try:
        return usable(Path(rig.calibration_folder), rig.calibration)
    except TankrigError:
        return {}


def _measured(rig: "RigFile") -> Iterator[Known]:
    from drivers.calibration_health import KINDS, why_none
    from tankrig.calibration.file import all_in, passed_over, usable

    place = Path(rig.calibration_folder)
    for unusable in all_in(place):
        if isinstance(unusable, StoreError):
            yield Known("calibration file", "cannot be used", str(unusable))
    try:
        found = usable(place, rig.calibration)
        for over in passed_over(place, rig.calibration):
            yield Known(f"{calibrated(over.kind)}, measured", "no run before a person decides", str(over))
    except TankrigError as error:
        yield Known("calibration", "the one that the rig file names is not there", str(error))
        found = {}
    for kind, doubtful in set_aside(rig).items():
        when = f"{doubtful.date[:16].replace('T', ' ')} UTC ({_age(doubtful.age_days)})"
        note = f"{when}, {doubtful.path and doubtful.path.name}; not used"
        yield Known(f"{calibrated(kind)}, set aside", _well(doubtful), note, doubtful.path)
    for kind in KINDS:
        if kind not in found:
            why = why_none(kind, rig)
            missing = ("not needed", why) if why else NOT_YET
            yield Known(f"{calibrated(kind)}, measured", *missing)
            continue
        one = found[kind]
        when = f"{one.date[:16].replace('T', ' ')} UTC ({_age(one.age_days)}), {one.path and one.path.name}"
        yield Known(f"{calibrated(kind)}, measured", _well(one), f"{when}; of {one.device}")


def _well(one: "Calibration") -> str:
    return how_well(one.kind, one.how_well) + "".join(f"; doubt: {doubt}" for doubt in one.doubts)


def _age(days: float) -> str:
    return "today" if days < 1.0 else "yesterday" if days < 2.0 else f"{days:.0f} days ago"


def _weighed(rig: "RigFile", folder: Path) -> Iterator[Known]:
    """Pump calibrations, newest first; how to make one where there is none."""
    files = sorted(folder.glob("pump-*.toml"), reverse=True)
    for file in files:
        from tankrig.calibration.pump import load_pump_calibration  # spared where there is nothing to read

        try:
            one = load_pump_calibration(file)
        except TankrigError as error:
            yield Known("pump", "cannot be read", str(error))
            continue
        used = Path(str(rig.doser.get("calibration", ""))).name == file.name
        factor = with_error(one.correction, Z * one.correction_sd)
        yield Known(
            "pump, weighed",
            f"{factor} true µl per nominal µl ({CONFIDENCE}), doses scatter by {one.scatter_ul:.2g} µl (standard "
            "deviation)",
            f"{one.date[:16].replace('T', ' ')} UTC, {len(one.mass_mg)} doses, "
            + ("in use" if used else f'not in use: put calibration = "./{file.name}" into [doser]'),
        )
    if not files:
        exact = rig.doser["driver"] == EXACT_PUMP
        yield Known("pump, weighed", *(("not needed", WHY_EXACT) if exact else NOT_YET))


def _believed(rig: "RigFile") -> Iterator[tuple[str, str]]:
    tank, wall, camera, limits = rig.bench.tank, rig.bench.wall, rig.bench.camera, rig.limits
    size = " × ".join(f"{side:g}" for side in tank.size_mm)
    light, y, z = rig.bench.light_position_mm, wall.y_mm, wall.z_mm
    steps = f", {rig.doser['steps_per_ul']:g} steps per µl" if "steps_per_ul" in rig.doser else ""
    yield "tank", f"{size} mm, {tank.surface} surface"
    yield "light", f"{rig.bench.light}" + (f" from {_point(light)} mm" if light else "")
    yield (
        "projector to wall",
        f"{wall.shape[1]} × {wall.shape[0]} pixels on y = {y[0]:g} … {y[1]:g} mm, z = {z[0]:g} … {z[1]:g} mm",
    )
    yield "projector's brightness", f"{wall.irradiance:g} W/mm² at level 255, gamma {wall.gamma:g}"
    seen = f"{camera.kind}" + (f" from {_point(camera.position_mm)} mm" if camera.position_mm else "")
    yield "camera", f"{seen}, {camera.shape[1]} × {camera.shape[0]} pixels of {camera.pixel_mm:g} mm"
    yield "doser", f"driver {rig.doser['driver']}{steps}"
    yield "limits", f"{limits.dose_ul:g} µl a dose, {limits.run_ul:g} µl a run, {limits.tank_ul:g} µl a tank"


def _point(position: tuple[float, float, float]) -> str:
    return f"({', '.join(f'{value:g}' for value in position)})"

"""What a rig's calibration lacks, what in it is out of date, and what does not fit together."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.check import Check, failed
from drivers.rig import RigFile, is_as_described, require_of_bench
from tankrig.calibration.file import Calibration, all_in, left_aside, passed_over, usable
from tankrig.calibration.geometry_in_force import DEVICES
from tankrig.calibration.how_well import how_well
from tankrig.calibration.witness import bright_exposure_ms, mean_of
from tankrig.devices import CameraDevice, Projector
from tankrig.errors import StoreError, TankrigError
from tankrig.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.sequence import ExposureRule

KINDS = ("camera", "projector", "tank", "radiometry", "stray", "latency")
"""What can be calibrated, in the order of the checks."""
BY_BOARDS = ("camera", "projector", "tank", "stray")
"""What is found by a camera's perspective, so not by a telecentric lens."""
TELECENTRIC = "the camera's lens is telecentric, which no board measures; the rig file is believed"
AS_DESCRIBED = "the simulated rig is what its file says; to practise, calibrate the simulated bench"
STALE_DAYS = 90.0
_CLOSE = 2.0
"""mm, ms; by which measured and believed may differ, whatever the uncertainty."""
_LEVEL = 128
_OFF = 0.05
_DIM = 0.01
_ANY = ExposureRule()


def calibration_checks(rig: RigFile, devices: Mapping[str, Any]) -> Iterator[Check]:
    """Look at the calibration files of a rig.

    Parameters
    ----------
    rig
        What its file says.
    devices
        Those that could be opened, by "camera", "projector".
    """
    folder = Path(rig.calibration_folder)
    for unusable in all_in(folder):
        if isinstance(unusable, StoreError):
            yield replace(failed("calibration file can be used", unusable), part="calibration")
    try:
        found = usable(folder, rig.calibration)
    except StoreError as error:
        yield replace(failed("calibration that the rig file names is there", error), part="calibration")
        return
    for over in passed_over(folder, rig.calibration):
        what = f"newest calibration of the {over.kind} can be used"
        yield Check(what, False, f"runs are refused: {over.question}", over.remedy, over.kind)
    yield from _of_one_bench(rig, found)
    aside = left_aside(folder, rig.calibration)
    for kind in KINDS:
        if kind in found:
            yield replace(_fits(found[kind], devices.get(DEVICES[kind]), found, folder), part=kind)
        elif why := why_none(kind, rig):
            yield Check(f"{kind} is calibrated", None, f"not needed: {why}", part=kind)
        elif kind in aside:
            yield Check(
                f"{kind} is calibrated", None,
                f"was measured {aside[kind].age_days:.0f} days ago and set aside; the rig file is believed",
                f"look at what was set aside, {aside[kind].path}, or tankrig calibrate {kind} --rig FILE", kind,
            )  # fmt: skip
        else:
            yield Check(
                f"{kind} is calibrated", None, "has not been measured; the rig file is believed",
                f"tankrig calibrate {kind} --rig FILE", kind,
            )  # fmt: skip
    yield from _blur_in_depth(found)
    yield from _as_believed(rig, found)


def why_none(kind: str, rig: RigFile) -> str:
    """Why nothing of this kind is to be measured on the rig, so that nothing is missing; empty where it is."""
    if is_as_described(rig):
        return AS_DESCRIBED
    return TELECENTRIC if kind in BY_BOARDS and rig.bench.camera.kind == "orthographic" else ""


def _blur_in_depth(found: Mapping[str, Calibration]) -> Iterator[Check]:
    """Whether it is known how a projector's blur grows with depth, since when, and how well."""
    if "projector" not in found:
        return
    one, what = found["projector"], "projector's blur over depth is measured"
    if "lens_mm" not in one.result:
        why = "its calibration is older, or the stripes told too little; models take its blur to be alike at any depth"
        yield Check(what, None, why, "tankrig calibrate projector --rig FILE", "projector")
        return
    told, sd = one.result, one.sd
    sharp = f"blurs by {told['blur_focus_px']:.2f} ± {sd['blur_focus_px']:.2g} px"
    if "focus_mm" in told:
        sharp += f" at x = {told['focus_mm']:.0f} ± {sd['focus_mm']:.2g} mm, its lens is {told['lens_mm']:.1f} ± "
        sharp += f"{sd['lens_mm']:.2g} mm wide"
    else:
        sharp += f" at any depth, its lens is less than {2.0 * sd['lens_mm']:.2g} mm wide"
    yield Check(what, one.age_days <= STALE_DAYS, f"{sharp}; {one.age_days:.0f} days old",
                "tankrig calibrate projector --rig FILE", "projector")  # fmt: skip


def _of_one_bench(rig: RigFile, found: Mapping[str, Calibration]) -> Iterator[Check]:
    """What a run would be refused for, before any device is opened."""
    try:
        require_of_bench(rig, found)
    except StoreError as error:
        yield replace(failed("calibrations are of this rig and belong together", error), part="calibration")


def _as_believed(rig: RigFile, found: Mapping[str, Calibration]) -> Iterator[Check]:
    """Whether the bench of the rig file is the one that was measured, which runs use once all its geometry was."""
    in_use = {"camera", "tank", "projector"} <= found.keys()
    bench = rig.bench
    believed = (
        ("tank", "level_mm", bench.tank.size_mm[2], "bench.tank.size_mm, or fill the tank to that level"),
        ("tank", "camera_position_mm", bench.camera.position_mm, "bench.camera.position_mm"),
        ("projector", "position_mm", bench.light_position_mm, "bench.light_position_mm"),
        ("latency", "p99_ms", rig.latency_ms, "projector.latency_ms"),
    )
    for kind, name, value, key in believed:
        if value is None or kind not in found or name not in found[kind].result:
            continue
        measured, sd = (np.asarray(table.get(name, 0.0), float) for table in (found[kind].result, found[kind].sd))
        off = measured - np.asarray(value)
        most = np.maximum(_CLOSE, 4.0 * sd)
        passed = bool((off <= most).all() if kind == "latency" else (np.abs(off) <= most).all())
        yield Check(
            f"{kind} is where the rig file has it" if kind != "latency" else "latency is within that of the rig file",
            None if in_use and not passed and kind != "latency" else passed,
            f"{name} = {_shown(measured)} measured, {_shown(value)} in the rig file"
            + ("; what was measured is used" if in_use and kind != "latency" else ""),
            f"correct {key}", "rig file",
        )  # fmt: skip


def _shown(value: Any) -> str:
    return ", ".join(f"{number:.4g}" for number in np.atleast_1d(value))


def _fits(one: Calibration, device: Any, found: Mapping[str, Calibration], folder: Path) -> Check:
    """Of the right device, not too old, measured with what is in force, the newest there is."""
    what = f"{one.kind} is calibrated"
    if device is not None:
        try:
            one.require_for(device.name, tuple(device.shape))
        except StoreError as error:
            return failed(what, error)
    named = one.path.name if one.path else ""
    for kind, hashed in one.rests_on.items():
        if kind in KINDS and (kind not in found or found[kind].hash != hashed):
            return Check(
                what, False, f"{named} was measured with another {kind} calibration than is in force",
                f"tankrig calibrate {one.kind} --rig FILE, or name both in the rig file's table [calibration]",
            )  # fmt: skip
    if one.age_days > STALE_DAYS:
        return Check(what, False, f"{named} is {one.age_days:.0f} days old", f"tankrig calibrate {one.kind} --rig FILE")
    newer = next((later for later in all_in(folder, one.kind) if isinstance(later, Calibration)), one)
    if newer.hash != one.hash:
        return Check(
            what, None, f"{named} is what the rig file names, and {newer.path and newer.path.name} is newer",
            f'calibration.{one.kind} = "{newer.hash[:12]}" in the rig file, to use that',
        )  # fmt: skip
    doubts = f"; accepted in spite of doubts: {one.doubts[0]}" if one.doubts else ""
    return Check(what, True, f"{named}: {how_well(one.kind, one.how_well)}{doubts}")


def level_check(projector: Projector, camera: CameraDevice, wall: Wall, rule: ExposureRule = _ANY) -> Check:
    """Whether the projector's levels make the light that they are taken to make; three flashes."""
    what = "projector's levels make the light they are taken to make"

    def plain(level: int) -> Pattern:
        return Pattern(f"level {level}", np.full(projector.shape, level, np.uint8))

    try:
        exposure_ms = bright_exposure_ms(projector, camera, rule)
        dark, full = (mean_of(projector, camera, plain(level), exposure_ms) for level in (0, 255))
        light, seen = full - dark, float((full - dark).max())
        dim = seen < _DIM * camera.saturation
        half = dark if dim else mean_of(projector, camera, plain(_LEVEL), exposure_ms)
    except TankrigError as error:
        return replace(failed(what, error), passed=None)  # a dark tank is no fault of the devices
    if dim:
        return Check(
            what, None, "the camera sees too little of its light to tell, as with clear water",
            "put ink into the tank, a sheet of paper where the light falls, or a diffuser before the camera",
        )  # fmt: skip
    lit = light > 0.3 * seen
    ratio, taken = float((half - dark)[lit].sum() / light[lit].sum()), float(wall.fractions[_LEVEL])
    gamma = np.log(max(ratio, 1e-6)) / np.log(_LEVEL / 255.0)
    return Check(
        what, abs(ratio - taken) <= _OFF * max(ratio, taken),
        f"level {_LEVEL} has {ratio:.1%} of level 255's light, as with gamma {gamma:.2f}; taken to have {taken:.1%}",
        "tankrig calibrate radiometry --rig FILE, or set bench.wall.gamma in the rig file",
    )  # fmt: skip

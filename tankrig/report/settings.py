"""What a run was made with, and what was left out of it, in words."""

from typing import Any

import numpy as np

from tankrig.bench import Bench
from tankrig.calibration.places import believed, measured_places
from tankrig.checked_toml import checked
from tankrig.errors import StoreError
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.run.calibrations import calibrations_of
from tankrig.run.reading import Run
from tankrig.scene.outline import edge_reach_mm

Pairs = list[tuple[str, str]]


def settings_of(run: Run) -> list[Pairs]:
    """Tables: the experiment, the bench, and where it was calibrated what was measured of it."""
    sequence: dict[str, Any] = dict(run.settings.get("sequence", {}))
    bench: dict[str, Any] = dict(run.settings.get("bench", {}))
    doses = run.events("dose_done")
    sessions = run.events("session")
    experiment: Pairs = [
        ("run", run.path.name),
        ("sequence", str(sequence.get("name", "none: imported"))),
        ("frames", f"{len(run.events('frame'))} of {run.frames.shape[1:][1]} × {run.frames.shape[1:][0]} pixels"),
        ("exposure", _exposures(run, sequence)),
        ("ink at the beginning", f"{sessions[0].get('delivered_ul', 0.0):g} µl" if sessions else "?"),
        ("doses", ", ".join(f"{event['delivered_ul']:g}" for event in doses) + " µl in all" if doses else "none"),
        ("patterns", ", ".join(pattern.name for pattern in run.patterns.values())),
        ("devices", ", ".join(dict(sessions[0]["devices"]).values()) if sessions else "?"),
        ("program", str(sessions[0]["program"]) if sessions else "?"),
        ("sessions", str(len(sessions))),
    ]
    if not bench:
        return [experiment, _of_scenes(run), *_measured(run)]
    tank, camera = bench["tank"], bench["camera"]
    lengths = " × ".join(f"{side:.5g}" for side in tank["size_mm"])
    geometry: Pairs = [
        ("rig", str(run.settings.get("rig", ""))),
        ("tank", f"{lengths} mm, {tank['surface']} surface"),
        *_light(bench),
        ("camera", f"{camera['kind']}{_at(camera.get('position_mm'))}, pixels of {camera['pixel_mm']:.4g} mm"),
    ]  # fmt: skip
    return [experiment, geometry, *_measured(run)]


def _of_scenes(run: Run) -> Pairs:
    """The geometry of somebody else's frames, as their scenes say."""
    scenes = run.scenes
    one = next(iter(scenes.values()))
    lengths = " × ".join(f"{side:.5g}" for side in one.tank.size_mm)
    return [
        ("rig", str(run.settings.get("rig", ""))),
        ("tank", f"{lengths} mm, {one.tank.surface} surface"),
        ("light", ", ".join(f"{name}: {scene.projector.kind}" for name, scene in scenes.items())),
        ("camera", f"{one.camera.kind}{_at(one.camera.position_mm)}, pixels of {one.camera.pixel_mm:.4g} mm"),
    ]


def _light(bench: dict[str, Any]) -> Pairs:
    """Where it comes from: as measured, where the bench was calibrated."""
    wall, projector = bench["wall"], bench.get("projector") or {}
    pixels = f"{wall['shape'][1]} × {wall['shape'][0]} pixels"
    if bench["light"] == "calibrated":
        return [("light", f"calibrated{_at(projector.get('position_mm'))}"), ("projector", pixels)]
    light = str(bench["light"]) + _at(bench.get("light_position_mm"))
    return [("light", light), ("projector", f"{pixels} on y = {_span(wall['y_mm'])}, z = {_span(wall['z_mm'])} mm")]


def _measured(run: Run) -> list[Pairs]:
    """A table of what the calibrations in force had found, each with its standard deviation and file; or none."""
    try:
        found = calibrations_of(run)
    except StoreError as error:
        return [[("measured", f"what it rests on cannot be told: {error}")]]
    rows: Pairs = [(one.what, f"{one.text} ({one.calibration})") for one in measured_places(found)]
    notes = dict.fromkeys(f"{one.calibration}: {one.note}" for one in measured_places(found) if one.note)
    rows += [("not in the ±", note) for note in notes]
    if rows:
        rows.append(("each ±", "is a standard deviation"))
        bench = checked(Bench, dict(run.settings["bench"]), f"{run.path}: its bench", StoreError)
        rows += [("not measured", line) for line in believed(bench, found)]
    return [rows] if rows else []


def _exposures(run: Run, sequence: dict[str, Any]) -> str:
    """As they were read back from the camera; as they were asked for where a run does not say."""
    actual = {then.camera for then in run.conditions.values() if then.camera is not None}
    if not actual:
        return f"{sequence.get('exposure_ms', '?')} ms at gain {sequence.get('gain', '?')}, as asked for"
    each = sorted((one.exposure_ms, one.gain) for one in actual)
    return ", ".join(f"{exposure_ms:g} ms at gain {gain:g}" for exposure_ms, gain in each)


def skipped_of(run: Run, plan: PhotographPlan, faintest: float) -> list[str]:
    """What did not go into the numbers, each with what is known of its effect."""
    gaps = run.events("gap")
    missing = sum(event["missing"] for event in gaps)
    failed = [event for event in run.fits if event.get("error")]
    lines = [
        _binned(plan),
        *_blurred(plan),
        f"Light paths fainter than a small share of their start: at most {100.0 * faintest:.2g} % of the image.",
        f"{missing} frames were lost by the camera while it was recording."
        if missing else "The camera lost no frame while it was recording.",
        "Pictures taken while the ink mixed were looked at and not kept.",
    ]  # fmt: skip
    if run.left_out:
        lines.append(f"Damaged frames were left out: {', '.join(map(str, run.left_out))}.")
    if run.unsure_doses:
        lines.append(f"Frames at a dose that is not known any more: {', '.join(map(str, sorted(run.unsure_doses)))}.")
    lines += [f"Of the journal, {lost}." for lost in run.lost if lost.seqs]
    lines += [f"A live fit failed: {event['error']}" for event in failed]
    if run.end is None:
        lines.append("The run has no end: it was cut off, or goes on.")
    return lines


def _binned(plan: PhotographPlan) -> str:
    bins, (tall, wide) = plan.bins, plan.camera.sides_mm
    size = f"{tall:g} mm" if tall == wide else f"{tall:.3g} × {wide:.3g} mm"
    return (
        f"Frames were averaged and binned {bins.by} × {bins.along} to pixels of {size} before they were fitted; the "
        "model averages over the same pixels."
    )


def _blurred(plan: PhotographPlan) -> list[str]:
    """What blur keeps out of the fits; nothing where nothing says that lenses blur."""
    reach_mm = max((edge_reach_mm(scene) for scene in plan.scenes.values()), default=0.0)
    if reach_mm == 0.0:
        return []
    share = 1.0 - float(np.mean([counts.mean() for counts in plan.counts.values()]))
    return [
        f"Pixels within {reach_mm:.2g} mm of an edge of the light, where lenses blur it, and what looks beside the "
        f"water: {100.0 * share:.0f} % of the pictures."
    ]


def _at(position: Any) -> str:
    return "" if position is None else f" at ({', '.join(f'{value:g}' for value in position)}) mm"


def _span(edges: Any) -> str:
    return f"{edges[0]:g} … {edges[1]:g}"

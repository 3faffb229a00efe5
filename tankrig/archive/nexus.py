"""A run as a NeXus file: NXoptical_spectroscopy as far as that fits light scattered in a tank.

What the definition asks for and a run knows stands where it belongs; dose and exposure of each frame stand beside the
frames in NXdata, and what was fitted in an NXprocess. `experiment_type` is "light scattering": the definition names
three others and asks for another term where none of them fits.
"""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tankrig.errors import StoreError
from tankrig.estimation.coordinates import NAMES
from tankrig.files import require_writable, whole_file
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.recorded import fits_that_hold
from tankrig.live.results import fits_in
from tankrig.run.reading import Run

DEFINITION = "NXoptical_spectroscopy"
DEFINITION_VERSION = "v2026.01"
URL = "https://manual.nexusformat.org/classes/applications/NXoptical_spectroscopy.html"
_PER_FRAME = {
    "delivered_ul": "µl",
    "delivered_low_ul": "µl",
    "delivered_high_ul": "µl",
    "exposure_ms": "ms",
    "gain": "",
}


def export_nexus(run: Run, target: Path) -> None:
    """Write a run as one NeXus file with all of its frames.

    Parameters
    ----------
    run
        Recorded, finished or not.
    target
        The .nxs file; it appears complete, or not at all.

    Raises
    ------
    StoreError
        When there are no frames, one of them is damaged, or the file cannot be written.
    """
    import h5py

    frames = run.events("frame")
    if not frames:
        raise StoreError(f"{run.path}: has no frames, so there is nothing to export; record some first")
    for event in frames:
        run.pixels(event)  # a damaged one is said before anything is written
    require_writable(target.parent)
    with whole_file(target) as unfinished, h5py.File(unfinished, "w") as file:
        file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": f"tankrig {version('tankrig')}"})
        entry = _group(file, "entry", "NXentry", default="data")
        _head(run, entry)
        _instrument(run, entry)
        _sample(run, entry)
        _data(run, entry)
        _fits(run, entry)


def _head(run: Run, entry: Any) -> None:
    definition = entry.create_dataset("definition", data=DEFINITION)
    definition.attrs.update({"version": DEFINITION_VERSION, "URL": URL})
    entry["title"] = str(run.settings.get("name", run.path.name))
    entry["experiment_type"] = "light scattering"
    entry["experiment_type"].attrs["custom"] = True
    entry["experiment_sub_type"] = "imaging"
    entry["start_time"] = run.journal[0].moment.utc
    if run.end is not None:
        entry["end_time"] = run.end.moment.utc
    entry["program_name"] = "tankrig"
    entry["program_name"].attrs["version"] = version("tankrig")
    settings = _group(entry, "settings", "NXcollection")
    settings["json"] = json.dumps(dict(run.settings), default=str, ensure_ascii=False)


def _instrument(run: Run, entry: Any) -> None:
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = str(run.settings.get("rig") or "unknown rig")
    plan = PhotographPlan.of_run(run)
    scene = next(iter(plan.scenes.values()), None)
    beam = _group(instrument, "beam_projector", "NXbeam")
    beam["parameter_reliability"] = "measured" if run.settings.get("calibrations") else "nominal"
    detector = _group(instrument, "detector_camera", "NXdetector")
    detector["detector_channel_type"] = "multichannel"
    detector["detector_type"] = "CCD"
    sessions = run.events("session")
    devices = dict(sessions[0].get("devices", {})) if sessions else {}
    detector["local_name"] = str(devices.get("camera", "camera"))
    if scene is not None:
        tall_mm, wide_mm = scene.camera.sides_mm
        sizes = {"x_pixel_size": wide_mm / plan.bins.along, "y_pixel_size": tall_mm / plan.bins.by}
        for name, size_mm in sizes.items():
            detector.create_dataset(name, data=size_mm).attrs["units"] = "mm"


def _sample(run: Run, entry: Any) -> None:
    sample = _group(entry, "sample", "NXsample")
    sample["name"] = str(run.settings.get("material") or run.settings.get("name", run.path.name))
    sample["physical_form"] = "liquid"


def _data(run: Run, entry: Any) -> None:
    frames = run.frames
    data = _group(entry, "data", "NXdata", signal="frames", axes=["frame", "y", "x"])
    chunks = (1, *frames.shape[1:])
    pixels = data.create_dataset("frames", frames.shape, frames.dtype, chunks=chunks, compression="gzip", shuffle=True)
    pixels.attrs.update({"units": "counts", "long_name": "counts of each pixel"})
    for number, event in enumerate(run.events("frame")):
        pixels[number] = run.pixels(event)
    for name, size in zip(("frame", "y", "x"), frames.shape, strict=True):
        data.create_dataset(name, data=np.arange(size, dtype=float)).attrs["long_name"] = f"{name}, counted from 0"
    for name, unit in _PER_FRAME.items():
        told = data.create_dataset(name, data=frames[name].values.astype(float))
        told.attrs.update({"units": unit} if unit else {})
        data.attrs[f"{name}_indices"] = [0]
    words = _group(entry, "frame_words", "NXcollection")  # NXdata holds numbers only
    for name in ("pattern", "pattern_hash", "utc"):
        words[name] = [str(one) for one in frames[name].values]


def _fits(run: Run, entry: Any) -> None:
    doses, series = fits_in([event.fields for event in fits_that_hold(run)])
    if not doses:
        return
    process = _group(entry, "estimate", "NXprocess")
    process["program"] = "tankrig"
    process["version"] = version("tankrig")
    process["sequence_index"] = 1
    found = _group(process, "doses", "NXdata", signal="sigma_s", axes=["dose_ml"])
    found.create_dataset("dose_ml", data=[one.dose_ml for one in doses]).attrs["units"] = "ml"
    for at, name in enumerate(NAMES):
        values = [one.medium.coefficients[at] for one in doses]
        found.create_dataset(name, data=values).attrs["units"] = "" if name == "g" else "1/mm"
        if all(len(one.sd) > at for one in doses):
            found.create_dataset(f"{name}_errors", data=[one.sd[at] for one in doses]).attrs["units"] = (
                "" if name == "g" else "1/mm"
            )
    if series is not None:
        ink = _group(process, "ink", "NXparameters")
        for at, name in enumerate(NAMES):
            ink.create_dataset(name, data=series.ink.coefficients[at]).attrs["units"] = "" if name == "g" else "1/mm/ml"
        ink["verdict"] = series.verdict


def _group(parent: Any, name: str, kind: str, **attributes: Any) -> Any:
    group = parent.create_group(name)
    group.attrs.update({"NX_class": kind, **attributes})
    return group

"""A run's journal as Bluesky documents, as event-model has them; nothing of the run is copied but its words.

Frames stay where they are: the documents name the run's own Zarr array, chunk by chunk.
"""

import json
import math
import uuid
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

from tankrig.errors import StoreError
from tankrig.files import whole_file
from tankrig.live.results import DoseFit, SeriesFit, from_fields
from tankrig.run.conditions import Conditions, with_conditions
from tankrig.run.journal import Event
from tankrig.run.reading import Run

Document = tuple[str, dict[str, Any]]
"""Its kind ("start", "descriptor", "event", "stream_resource", "stream_datum", "stop") and what it says."""

_SPACE = uuid.UUID("7b0f2f1c-6a5e-5d0c-9f64-3f6d2c6a0b11")
"""Of the names below: the same run gives the same documents."""
_ENDINGS = {"completed": "success", "aborted": "abort", "failed": "fail"}
_COEFFICIENTS = ("sigma_a", "sigma_s", "g")

_CAMERA = {
    "pattern": ("string", "", "what was projected"),
    "exposure_ms": ("number", "ms", "as read back from the camera"),
    "gain": ("number", "", "as read back from the camera"),
    "delivered_ul": ("number", "µl", "ink in the tank"),
    "delivered_low_ul": ("number", "µl", "at least"),
    "delivered_high_ul": ("number", "µl", "at most"),
}
_DOSER = {name: _CAMERA[name] for name in ("delivered_ul", "delivered_low_ul", "delivered_high_ul")}
_FIT = {
    "fit": ("string", "", "of a dose, or of the series: per ml"),
    "dose_ml": ("number", "ml", "ink in the tank; NaN of a series"),
    **{name: ("number", "" if name == "g" else "1/mm", "fitted") for name in _COEFFICIENTS},
    **{f"sd_{name}": ("number", "" if name == "g" else "1/mm", "standard deviation") for name in _COEFFICIENTS},
}


def documents_of(run: Run) -> Iterator[Document]:
    """A run as Bluesky documents, in the order in which Bluesky would have sent them.

    Streams are `frames` (what was true of each, and where its pixels are), `doses` and `fits`.

    Parameters
    ----------
    run
        Recorded, finished or not; one that has not ended has no "stop".

    Raises
    ------
    StoreError
        When there is nothing in its journal.
    """
    if not run.journal:
        raise StoreError(f"{run.path}: its journal is empty, so there is nothing to tell")
    first = run.journal[0]
    known = str(run.settings.get("id") or f"{run.path.name} {first.moment.utc} {first.moment.mono_ns}")
    name = _Names(known)
    settings = run.settings
    start = {
        "uid": name("start"),
        "time": _seconds(first),
        "plan_name": str(settings.get("name", run.path.name)),
        "purpose": "light scattering in a tank",
        "rig": str(settings.get("rig", "")),
        "sample": {"name": str(settings.get("material") or settings.get("name", ""))},
        "tankrig": {key: settings[key] for key in ("sequence", "bench", "scenes", "calibrations") if key in settings},
    }
    yield "start", start
    counts: dict[str, int] = {}
    for stream, documents in (("frames", _frames(run, name)), ("doses", _doses(run, name)), ("fits", _fits(run, name))):
        for kind, document in documents:
            counts[stream] = counts.get(stream, 0) + (kind == "event")
            yield kind, document
    if run.end is not None:
        yield (
            "stop",
            {
                "uid": name("stop"),
                "run_start": start["uid"],
                "time": _seconds(run.end),
                "exit_status": _ENDINGS.get(str(run.end["reason"]), "fail"),
                "reason": str(run.end.get("message", "")),
                "num_events": counts,
            },
        )


def write_documents(run: Run, target: Path) -> None:
    """Write a run's documents, one pair of kind and document on each line; a number that nobody knows is null.

    Raises
    ------
    StoreError
        When there is nothing in its journal, or the file cannot be written.
    """
    lines = [json.dumps([kind, _known(document)], ensure_ascii=False) for kind, document in documents_of(run)]
    with whole_file(target) as unfinished:
        unfinished.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _known(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _known(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_known(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Names:
    """Names that are the same whenever a run is asked."""

    def __init__(self, run: str) -> None:
        self._run = run

    def __call__(self, what: str) -> str:
        return str(uuid.uuid5(_SPACE, f"{self._run}/{what}"))


def _frames(run: Run, name: _Names) -> Iterator[Document]:
    taken = [(event, then) for event, then in with_conditions(run.journal) if event.kind == "frame"]
    if not taken:
        return
    rows, columns = run.frames.shape[1:]
    dtype = run.frames.dtype
    keys = _keys(_CAMERA, "camera")
    keys["frame"] = {
        "source": "camera", "dtype": "array", "dtype_numpy": dtype.str, "shape": [1, rows, columns],
        "dims": ["frame", "y", "x"], "units": "counts", "external": "STREAM:", "object_name": "camera",
    }  # fmt: skip
    descriptor = _descriptor("frames", keys, name, _seconds(taken[0][0]))
    yield "descriptor", descriptor
    resource = {
        "uid": name("frames resource"),
        "run_start": name("start"),
        "data_key": "frame",
        "mimetype": "application/x-zarr",
        "uri": f"file://localhost{run.path.resolve()}/",
        "parameters": {"dataset": "frames", "chunk_shape": [1, rows, columns], "join_method": "concat"},
    }
    yield "stream_resource", resource
    patterns = {key: pattern.name for key, pattern in run.patterns.items()}
    told = ((event, _said(run, event, then, patterns)) for event, then in taken)
    yield from _events(told, descriptor, name)
    numbers = [event["index"] for event, _ in taken]
    begins = [
        0,
        *(at + 1 for at, (one, following) in enumerate(pairwise(numbers)) if following != one + 1),
        len(numbers),
    ]
    for block, (begin, end) in enumerate(pairwise(begins)):
        yield (
            "stream_datum",
            {
                "uid": f"{resource['uid']}/{block}",
                "stream_resource": resource["uid"],
                "descriptor": descriptor["uid"],
                "indices": {"start": numbers[begin], "stop": numbers[end - 1] + 1},
                "seq_nums": {"start": begin + 1, "stop": end + 1},
            },
        )


def _said(run: Run, event: Event, then: Conditions, patterns: Mapping[str, str]) -> dict[str, Any]:
    unsure = event["index"] in run.unsure_doses
    tank = (math.nan, math.nan, math.nan) if unsure else (then.tank.volume_ul, then.tank.low_ul, then.tank.high_ul)
    return {
        "pattern": patterns.get(event["pattern_hash"], ""),
        "exposure_ms": then.camera.exposure_ms if then.camera else math.nan,
        "gain": then.camera.gain if then.camera else math.nan,
        **dict(zip(_DOSER, tank, strict=True)),
    }


def _doses(run: Run, name: _Names) -> Iterator[Document]:
    done = run.events("dose_done")
    if done:
        descriptor = _descriptor("doses", _keys(_DOSER, "doser"), name, _seconds(done[0]))
        yield "descriptor", descriptor
        told = ((event, {key: float(event[key]) for key in _DOSER}) for event in done)
        yield from _events(told, descriptor, name)


def _fits(run: Run, name: _Names) -> Iterator[Document]:
    made = [(event, from_fields(event.fields)) for event in run.fits]
    whole = [(event, fit) for event, fit in made if isinstance(fit, DoseFit | SeriesFit)]
    if whole:
        descriptor = _descriptor("fits", _keys(_FIT, "estimate"), name, _seconds(whole[0][0]))
        yield "descriptor", descriptor
        yield from _events(((event, _found(fit)) for event, fit in whole), descriptor, name)


def _found(fit: DoseFit | SeriesFit) -> dict[str, Any]:
    dose = isinstance(fit, DoseFit)
    liquid = fit.medium if isinstance(fit, DoseFit) else fit.ink
    sds = [*fit.sd, *[math.nan] * len(_COEFFICIENTS)]
    return {
        "fit": "dose" if dose else "series",
        "dose_ml": fit.dose_ml if isinstance(fit, DoseFit) else math.nan,
        **dict(zip(_COEFFICIENTS, liquid.coefficients, strict=True)),
        **{f"sd_{name}": sd for name, sd in zip(_COEFFICIENTS, sds, strict=False)},
    }


def _keys(told: Mapping[str, tuple[str, str, str]], source: str) -> dict[str, dict[str, Any]]:
    return {
        name: {"source": f"{source}: {what}", "dtype": dtype, "shape": [], "object_name": source}
        | ({"units": units} if units else {})
        for name, (dtype, units, what) in told.items()
    }


def _descriptor(stream: str, keys: dict[str, Any], name: _Names, time_s: float) -> dict[str, Any]:
    objects: dict[str, list[str]] = {}
    for key, said in keys.items():
        objects.setdefault(said["object_name"], []).append(key)
    return {
        "uid": name(stream), "run_start": name("start"), "time": time_s, "name": stream, "data_keys": keys,
        "object_keys": objects, "configuration": {}, "hints": {},
    }  # fmt: skip


def _events(
    told: Iterable[tuple[Event, dict[str, Any]]], descriptor: Mapping[str, Any], name: _Names
) -> Iterator[Document]:
    for number, (event, data) in enumerate(told, 1):
        time_s = _seconds(event)
        yield "event", {
            "uid": name(f"{descriptor['name']} {event.seq}"), "descriptor": descriptor["uid"], "seq_num": number,
            "time": time_s, "data": data, "timestamps": dict.fromkeys(data, time_s), "filled": {},
        }  # fmt: skip


def _seconds(event: Event) -> float:
    return datetime.fromisoformat(event.moment.utc).timestamp()

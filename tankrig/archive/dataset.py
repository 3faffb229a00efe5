"""An archive as one xarray dataset: all frames of all runs, read from disk when they are used."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tankrig.archive.runs import runs_in
from tankrig.errors import StoreError
from tankrig.run.conditions import with_conditions
from tankrig.run.reading import Run, StoredFrames, open_run

if TYPE_CHECKING:
    import xarray


def open_archive(archive: str | os.PathLike[str]) -> "xarray.Dataset":
    """Open all runs of an archive as one dataset; only journals are read before pixels are asked for.

    Parameters
    ----------
    archive
        The folder of the runs, whose cameras all have the same pixels. Runs that cannot be read are left out, and
        named in the attribute `left_out`.

    Returns
    -------
    xarray.Dataset
        `frames` (frame, y, x), counts, one dask chunk for each run; along `frame` the coordinates `run`, `rig`,
        `material`, `pattern`, `step`, `index`, `utc`, `delivered_ul`, `exposure_ms` and `gain`.

    Raises
    ------
    StoreError
        When there is no run, or their cameras differ.
    """
    import dask.array
    import xarray

    top = Path(archive)
    columns: dict[str, list[Any]] = {}
    parts, left_out, shapes = [], [], dict[tuple[int, ...], str]()
    for path in runs_in(top):
        name = path.name if path == top else str(path.relative_to(top))
        try:
            run = open_run(path)
            frames = _Frames(run)
        except StoreError as error:
            left_out.append(f"{name}: {error}")
            continue
        if not frames.shape[0]:
            left_out.append(f"{name}: has no frames")
            continue
        shapes.setdefault((*frames.shape[1:], frames.dtype.str), name)
        if len(shapes) > 1:
            raise StoreError(
                f"{top}: the runs {' and '.join(shapes.values())} are of different cameras, whose frames do not fit "
                "into one array; open a folder of runs of one camera"
            )
        parts.append(dask.array.from_array(frames, chunks=frames.shape, name=False))  # type: ignore[no-untyped-call]
        for row in _rows(run, name):
            for key, value in row.items():
                columns.setdefault(key, []).append(value)
    if not parts:
        raise StoreError(f"{top}: none of its runs has frames; {left_out[0]}")
    pixels = dask.array.concatenate(parts)  # type: ignore[no-untyped-call]
    coordinates = {key: ("frame", np.array(values)) for key, values in columns.items()}
    return xarray.Dataset({"frames": (("frame", "y", "x"), pixels)}, coordinates, {"left_out": left_out})


def _rows(run: Run, name: str) -> Iterator[dict[str, Any]]:
    names = _pattern_names(run)
    rig, material = str(run.settings.get("rig", "")), str(run.settings.get("material", ""))
    for event, then in with_conditions(run.journal):
        if event.kind == "frame":
            unsure = event["index"] in run.unsure_doses
            yield {
                "run": name, "rig": rig, "material": material, "pattern": names.get(event["pattern_hash"], ""),
                "step": event["step"], "index": event["index"],
                "utc": np.datetime64(event.moment.utc.split("+")[0], "ns"),
                "delivered_ul": np.nan if unsure else then.tank.volume_ul,
                "exposure_ms": then.camera.exposure_ms if then.camera else np.nan,
                "gain": then.camera.gain if then.camera else np.nan,
            }  # fmt: skip


def _pattern_names(run: Run) -> dict[str, str]:
    """By hash, without their pixels."""
    from tankrig.run.journal_io import load_json

    try:
        said = load_json(run.path / "patterns" / "zarr.json")["attributes"]
        return dict(zip(said["hashes"], said["names"], strict=True))
    except (OSError, KeyError, ValueError):
        return {key: pattern.name for key, pattern in run.patterns.items()}


class _Frames:
    """A run's frames as dask takes them; nothing is opened before it asks for pixels."""

    def __init__(self, run: Run) -> None:
        from tankrig.run.folder import stored_metadata

        told = stored_metadata(run.path)
        self._events = run.events("frame")
        self._path = run.path
        self.shape = (len(self._events), *told["shape"][1:])
        self.dtype, self.ndim = np.dtype(told["data_type"]), 3

    def __getitem__(self, key: tuple[Any, ...]) -> Any:
        wanted, *within = key
        stored = StoredFrames(self._path)
        numbers = np.arange(len(self._events))[wanted]
        pixels = np.stack([stored.read(self._events[int(number)]) for number in np.atleast_1d(numbers)])
        picked = pixels if np.ndim(numbers) else pixels[0]
        return picked[(slice(None), *within)] if np.ndim(numbers) else picked[tuple(within)]

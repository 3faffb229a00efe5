"""A run's frames for other programs: NetCDF and TIFF."""

import json
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.extras import needing_extra
from tankrig.files import require_writable, whole_file
from tankrig.run.reading import Run


def export_netcdf(run: Run, target: Path) -> None:
    """Write the acknowledged frames with all their coordinates as NetCDF 4, compressed; xarray and others read it.

    Parameters
    ----------
    run
        Recorded, finished or not.
    target
        The file, which is written whole or not at all.

    Raises
    ------
    StoreError
        When there are no frames, or one is damaged, or the file cannot be written.
    """
    with needing_extra("an export to NetCDF"):
        import dask.array  # noqa: F401 - what chunk() computes with
        import h5netcdf  # noqa: F401 - the engine

    frames = _frames(run).chunk(frame=1)  # so that no more than a frame is in memory at a time
    frames.attrs = {"units": "counts", "settings": json.dumps(dict(run.settings), default=str, ensure_ascii=False)}
    left_out = [f"frame {index} is left out, being damaged" for index in run.left_out]
    if missing := [str(lost) for lost in run.lost if lost.seqs] + left_out:
        frames.attrs["missing"] = "; ".join(missing)
    for name in ("pattern", "pattern_hash"):
        frames[name] = frames[name].astype(str)
    for name in ("delivered_ul", "delivered_low_ul", "delivered_high_ul"):
        frames[name].attrs["units"] = "µl"
    frames["exposure_ms"].attrs["units"] = "ms"
    encoding = {"frames": {"zlib": True, "complevel": 1, "chunksizes": (1, *frames.shape[1:])}}
    require_writable(target.parent)
    with whole_file(target) as unfinished:
        frames.to_dataset(name="frames").to_netcdf(unfinished, engine="h5netcdf", encoding=encoding)


def export_tiff(run: Run, folder: Path) -> None:
    """Write each acknowledged frame as a TIFF at its own bit depth, named by its number and pattern.

    Parameters
    ----------
    run
        Recorded, finished or not.
    folder
        Where to; made if it is not there. It appears complete, or not at all.

    Raises
    ------
    StoreError
        When there are no frames, or one is damaged, or the folder exists or cannot be written.
    """
    import cv2

    frames = _frames(run)
    if folder.exists():
        raise StoreError(f"{folder}: exists already; give another folder")
    require_writable(folder.parent)
    with whole_file(folder) as unfinished:
        unfinished.mkdir()
        for number, frame in enumerate(frames):
            name = f"{number:06d}-{frame.pattern.item() or 'unknown'}.tiff".replace("/", "-")
            if not cv2.imwrite(str(unfinished / name), frame.values):
                raise StoreError(f"{folder}: {name} cannot be written; make room on the disk")


def _frames(run: Run):  # type: ignore[no-untyped-def]  # an xarray.DataArray, which is imported where it is used
    frames = run.frames
    if not frames.sizes["frame"]:
        raise StoreError(f"{run.path}: has no frames, so there is nothing to export; record some first")
    for event in run.events("frame"):
        run.pixels(event)  # a damaged one is said before anything is written
    return frames.copy(deep=False)  # attributes of its own, and no pixels

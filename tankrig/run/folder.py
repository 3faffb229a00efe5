"""What a run's folder looks like: a Zarr group with frames, patterns and settings, and the journal beside it."""

import asyncio
import contextlib
import errno
import json
import shutil
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numcodecs.blosc import Blosc
from numpy.typing import DTypeLike
from zarr.codecs import BloscCodec
from zarr.storage import LocalStore

from tankrig.devices import Pixels
from tankrig.errors import StoreError
from tankrig.pattern import Pattern
from tankrig.run import disk
from tankrig.run.facts import FORMAT, JOURNAL, MARK, load_json

COMPRESSION = Blosc("lz4", 1, Blosc.BITSHUFFLE)
"""Of frames and patterns: what shot noise leaves to be saved, at 2.7 ms of a processor for 1280 × 1024 of 16 bit."""

_REMEDIES = {
    errno.ENOSPC: "free some space on that disk and try again",
    errno.EDQUOT: "free some of your quota and try again",
    errno.EROFS: "give a folder that can be written with --out",
    errno.EACCES: "give a folder that can be written with --out",
    errno.EPERM: "give a folder that can be written with --out",
}


@contextlib.contextmanager
def storing(path: Path, tried: str) -> Iterator[None]:
    """Turn an error of the operating system into a sentence about the run at `path`."""
    try:
        yield
    except StoreError:
        raise
    except OSError as error:
        remedy = _REMEDIES.get(error.errno or 0, "check the disk and the path and try again")
        raise StoreError(f"{path}: could not {tried} ({error.strerror or error}); {remedy}") from error


class DurableStore(LocalStore):  # type: ignore[misc]
    """A Zarr store whose files are on the disk when `set` returns; it hides the journal from Zarr."""

    async def set(self, key: str, value: Any) -> None:
        """Keep `value` under `key`."""
        await asyncio.to_thread(self.set_sync, key, value)

    async def set_if_not_exists(self, key: str, value: Any) -> None:
        """Keep `value` unless `key` is taken."""
        if not (self.root / key).exists():
            await self.set(key, value)

    def set_sync(self, key: str, value: Any) -> None:
        """Chunks are written in place, for the journal says which of them count; metadata is replaced as a whole."""
        path = self.root / key
        if not path.parent.is_dir():
            disk.make_folder(path.parent)
            disk.sync_folder(path.parent.parent)
        keep = disk.replace if path.name == "zarr.json" else disk.write
        keep(path, value.as_buffer_like())

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """Names in a folder of the store."""
        async for name in super().list_dir(prefix):
            if name != JOURNAL:
                yield name


def create_run(
    path: Path,
    frame_shape: tuple[int, int],
    dtype: DTypeLike,
    planned_frames: int,
    settings: Mapping[str, Any],
    patterns: Sequence[Pattern] = (),
) -> None:
    """Make the folder of a new run; it appears under its name complete, or not at all.

    Parameters
    ----------
    path
        Of the folder, which must not exist.
    frame_shape
        (rows, columns) of a frame.
    dtype
        uint8 or uint16.
    planned_frames
        How many frames to lay out; the array grows when more come and is trimmed when the run ends.
    settings
        What the run was made with, as JSON.
    patterns
        The pictures that will be projected, so that the run can be read without what drew them.

    Raises
    ------
    StoreError
        When the folder exists or cannot be written.
    """
    import zarr

    require_new(path)
    fresh = path.with_name(f".{path.name}.new")
    with contextlib.ExitStack() as undo, storing(path, "make the run's folder"):
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(fresh, ignore_errors=True)
        undo.callback(shutil.rmtree, fresh, ignore_errors=True)
        disk.make_folder(fresh)
        mark = {"format": FORMAT, "version": version("tankrig"), "settings": dict(settings)}
        group = zarr.create_group(DurableStore(fresh), attributes={MARK: mark})
        _create_array(group, "frames", (max(planned_frames, 1), *frame_shape), dtype, ("frame", "y", "x"))
        if patterns:
            pictures = np.stack([pattern.pixels for pattern in patterns])
            array = _create_array(group, "patterns", pictures.shape, np.uint8, ("pattern", "row", "column"))
            array[:] = pictures
            array.attrs.update(names=[p.name for p in patterns], hashes=[p.hash for p in patterns])
            disk.sync_folder(fresh / "patterns")
        _consolidate(fresh)
        disk.write(fresh / JOURNAL, b"")
        disk.sync_folder(fresh)
        disk.rename(fresh, path)


def require_new(path: Path) -> None:
    """Refuse a folder that exists: a run is never written over.

    Raises
    ------
    StoreError
        When it does.
    """
    if path.exists():
        raise StoreError(f"{path}: exists already; give another folder with --out, or resume it with --resume")


def _create_array(group: Any, name: str, shape: tuple[int, ...], dtype: DTypeLike, dimensions: tuple[str, ...]) -> Any:
    """One chunk per picture, all in one folder; pictures that are all zero are written like any other."""
    return group.create_array(
        name,
        shape=shape,
        chunks=(1, *shape[1:]),
        dtype=np.dtype(dtype).name,
        compressors=BloscCodec(cname=COMPRESSION.cname, clevel=COMPRESSION.clevel, shuffle="bitshuffle"),
        dimension_names=dimensions,
        chunk_key_encoding={"name": "default", "separator": "."},
        fill_value=0,
        config={"write_empty_chunks": True},
    )


def frames_for_writing(path: Path) -> Any:
    """The Zarr array of the run's frames; frames are put into it by `write_frame`."""
    import zarr

    _consolidate(path)  # a power cut between the two writes of `resize_frames` leaves the group behind the array
    return zarr.open_array(DurableStore(path), path="frames", mode="r+")


def write_frame(path: Path, index: int, pixels: Pixels) -> None:
    """Write the chunk that Zarr would make of a frame, at half the cost of having it made there (decision 55)."""
    chunk = COMPRESSION.encode(np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")))
    disk.write(path / "frames" / f"c.{index}.0.0", chunk)


def resize_frames(path: Path, array: Any, count: int) -> None:
    """Make room for `count` frames, or trim to that many."""
    array.resize((count, *array.shape[1:]))
    disk.sync_folder(path / "frames")
    _consolidate(path)


def _consolidate(path: Path) -> None:
    """Repeat the arrays' metadata in the group's, where xarray looks for it."""
    table = load_json(path / "zarr.json")
    arrays = {file.parent.name: load_json(file) for file in sorted(path.glob("*/zarr.json"))}
    table["consolidated_metadata"] = {"kind": "inline", "must_understand": False, "metadata": arrays}
    text = json.dumps(table, indent=2).encode()
    if text != (path / "zarr.json").read_bytes():
        disk.replace(path / "zarr.json", text)

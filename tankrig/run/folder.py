"""What a run's folder looks like: a Zarr group with frames, patterns and settings, and the journal beside it."""

import asyncio
import contextlib
import errno
import json
import os
import shutil
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
from numcodecs.blosc import Blosc
from numpy.typing import DTypeLike
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import LocalStore

from tankrig.devices import Pixels
from tankrig.errors import StoreError
from tankrig.pattern import Pattern
from tankrig.run import disk
from tankrig.run.journal_io import FORMAT, JOURNAL, MARK, load_json

COMPRESSION = Blosc("lz4", 1, Blosc.BITSHUFFLE)
"""Of frames and patterns: what shot noise leaves to be saved, at 2.7 ms of a processor for 1280 × 1024 of 16 bit."""

_PARTS = ("zarr.json", "zarr.json.new", JOURNAL, f"{JOURNAL}.torn", f"{JOURNAL}.torn.new", "frames", "patterns")

_REMEDIES = {
    errno.ENOSPC: "free some space on that disk and try again",
    errno.EDQUOT: "free some of your quota and try again",
    errno.EROFS: "give a folder that can be written with --out",
    errno.EACCES: "give a folder that can be written with --out",
    errno.EPERM: "give a folder that can be written with --out",
    errno.ELOOP: "a file of a run must not be a symbolic link; put the file itself there",
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
        compressors=[
            BloscCodec(cname=COMPRESSION.cname, clevel=COMPRESSION.clevel, shuffle="bitshuffle"),
            Crc32cCodec(),
        ],
        dimension_names=dimensions,
        chunk_key_encoding={"name": "default", "separator": "."},
        fill_value=0,
        config={"write_empty_chunks": True},
    )


def frames_for_writing(path: Path) -> Any:
    """The Zarr array of the run's frames; frames are put into it by `write_frame`.

    Raises
    ------
    StoreError
        When its metadata are damaged.
    """
    import zarr

    stored_metadata(path)
    _consolidate(path)  # a power cut between the two writes of `resize_frames` leaves the group behind the array
    for unfinished in (path / "frames").glob("c.*.new"):  # a kill in the middle of `write_frame`
        unfinished.unlink()
    return zarr.open_array(DurableStore(path), path="frames", mode="r+")


def frames_for_reading(path: Path) -> Any:
    """The Zarr array of the run's frames.

    Raises
    ------
    StoreError
        When its metadata are damaged.
    """
    stored_metadata(path)
    return array_for_reading(path, "frames")


def array_for_reading(path: Path, name: str) -> Any:
    """The Zarr array of that name in the run at `path`.

    Raises
    ------
    StoreError
        When its metadata are damaged.
    """
    import zarr

    try:
        return zarr.open_array(path / name, mode="r")
    except Exception as error:  # Zarr raises what the metadata lead it to: two dozen kinds, of several packages
        raise StoreError(
            f"{path}: the file {name}/zarr.json, which tells how they are stored, is missing or damaged "
            f"({type(error).__name__}); restore it from a copy of the run"
        ) from error


def stored_metadata(path: Path) -> dict[str, Any]:
    """The frames' metadata, which must agree with their copy in the group's but for the number of frames.

    Raises
    ------
    StoreError
        When they are missing or damaged, or differ from the copy.
    """
    copy = _copy_of_metadata(path)
    try:
        table: dict[str, Any] = load_json(path / "frames" / "zarr.json")
        if not isinstance(table, dict) or not isinstance(table["shape"], list):
            raise ValueError("no metadata")
    except (OSError, KeyError, ValueError) as error:
        remedy = f"restore it from its copy in the run's zarr.json: tankrig recover {path}"
        raise StoreError(
            f"{path}: the file frames/zarr.json, which tells how frames are stored, is missing or damaged; "
            + (remedy if copy else "restore it from a copy of the run")
        ) from error
    if copy is not None and _but_for_count(copy) != _but_for_count(table):
        raise StoreError(
            f"{path}: frames/zarr.json and its copy in zarr.json say different things of how frames are stored, so one "
            "of them is damaged; restore both from a copy of the run"
        )
    return table


def mend_metadata(path: Path, count: int) -> bool:
    """Write damaged metadata of the frames anew from their copy in the group's; whether that was needed.

    The number of frames is not trusted: there is room for `count` of them.

    Raises
    ------
    StoreError
        When there is no copy, or metadata and copy differ.
    """
    try:
        stored_metadata(path)
        return False
    except StoreError:
        copy = _copy_of_metadata(path)
        try:
            load_json(path / "frames" / "zarr.json")["shape"]
        except (OSError, KeyError, TypeError, ValueError):
            if copy is None:
                raise
        else:
            raise
    copy["shape"][0] = max(count, copy["shape"][0])
    disk.replace(path / "frames" / "zarr.json", json.dumps(copy, indent=2).encode())
    _consolidate(path)
    return True


def _copy_of_metadata(path: Path) -> dict[str, Any] | None:
    try:
        copy = load_json(path / "zarr.json")["consolidated_metadata"]["metadata"]["frames"]
        return copy if isinstance(copy, dict) and isinstance(copy["shape"], list) else None
    except (OSError, KeyError, TypeError, ValueError):
        return None


def _but_for_count(table: Mapping[str, Any]) -> dict[str, Any]:
    return {**table, "shape": table["shape"][1:]}


def has_checksums(array: Any) -> bool:
    """Whether the chunks of a Zarr array carry the checksums of Zarr's own codec."""
    return any(isinstance(codec, Crc32cCodec) for codec in array.metadata.codecs)


def write_frame(path: Path, checksum: bool, index: int, pixels: Pixels) -> None:
    """Write the chunk that Zarr would make of a frame, at half the cost of having it made there (decision 217)."""
    chunk = COMPRESSION.encode(np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")))
    if checksum:
        chunk += google_crc32c.value(chunk).to_bytes(4, "little")
    disk.create(path / "frames" / f"c.{index}.0.0", chunk)


def chunk_numbers(path: Path) -> set[int]:
    """Numbers of the frames whose chunks are there, acknowledged or not."""
    names = (file.name.split(".") for file in (path / "frames").iterdir())
    return {int(name[1]) for name in names if len(name) == 4 and name[0] == "c" and name[1].isdecimal()}


def require_no_links(path: Path) -> None:
    """Refuse to change a run of which a file or folder is a symbolic link: what it points to is no part of the run.

    Raises
    ------
    StoreError
        When there is one.
    """
    for folder in (path, path / "frames", path / "patterns"):
        for entry in os.scandir(folder) if folder.is_dir() else ():
            if entry.is_symlink() and (folder != path or entry.name in _PARTS):
                raise StoreError(
                    f"{path}: its {Path(entry.path).relative_to(path)} is a symbolic link, and nothing is written "
                    "through those; put the file itself there"
                )


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

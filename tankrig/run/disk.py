"""Durable writes: the only place where a run touches the disk.

Each function returns only when what it did would survive a power cut, except that a *new name* in a folder survives
only after `sync_folder`. None writes through a symbolic link. Keeping this to one small file lets a test record every
call of the operating system and replay a power cut after each, or let any of them fail.
"""

import contextlib
import errno
import os
from pathlib import Path


def write(path: Path, data: bytes | memoryview) -> None:
    """Write the whole file `path` and wait until its contents are on the disk."""
    _write(path, os.O_CREAT | os.O_TRUNC, data)


def replace(path: Path, data: bytes | memoryview) -> None:
    """Put `data` in place of the file `path`: a reader, or a power cut, finds the old or the new one, never half."""
    fresh = path.with_name(path.name + ".new")
    write(fresh, data)
    fresh.rename(path)
    sync_folder(path.parent)


def create(path: Path, data: bytes | memoryview) -> None:
    """Make the file `path`, which does not exist: it appears whole, or not at all, and nothing is ever written over.

    Raises
    ------
    FileExistsError
        When it does exist.
    """
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    fresh = path.with_name(path.name + ".new")
    write(fresh, data)
    fresh.rename(path)


def append(path: Path, data: bytes | memoryview) -> None:
    """Add `data` to the end of the existing file `path`; when that fails the file keeps its old length."""
    _write(path, os.O_APPEND, data)


def truncate(path: Path, size: int) -> None:
    """Cut the file `path` to its first `size` bytes."""
    handle = os.open(path, os.O_WRONLY | os.O_NOFOLLOW)
    try:
        os.ftruncate(handle, size)
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(path: Path) -> None:
    """Make the folder `path`, whose parent exists; its name is durable after `sync_folder(path.parent)`."""
    path.mkdir()


def rename(old: Path, new: Path) -> None:
    """Give the folder `old` its final name, durably."""
    old.rename(new)
    sync_folder(new.parent)


def sync_folder(path: Path) -> None:
    """Wait until the names in the folder `path` are on the disk."""
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _write(path: Path, flags: int, data: bytes | memoryview) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_NOFOLLOW | flags, 0o644)
    try:
        start = os.fstat(handle).st_size
        left = memoryview(data).cast("B")
        try:
            while left:
                left = left[os.write(handle, left) :]
            os.fsync(handle)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(handle, start)
            raise
    finally:
        os.close(handle)

"""Files that are there whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tankrig.errors import StoreError


def require_writable(folder: Path) -> None:
    """Refuse a folder that could not be written to, before any work is done for it; creates nothing.

    Raises
    ------
    StoreError
        When `folder`, or the nearest folder above it that exists, is no folder or may not be written to.
    """
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir():
        raise StoreError(f"{folder}: cannot be written because {nearest} is not a folder; give another place")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise StoreError(f"{folder}: cannot be written (no permission in {nearest}); give another place")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a name to write to beside `path`; when the block ends well it becomes `path`, else nothing is left.

    The name keeps the suffix of `path`; missing folders are made.

    Raises
    ------
    StoreError
        When the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with whole_file(Path(folder, "new", "note.txt")) as unfinished:
    ...         _ = unfinished.write_text("all of it")
    ...     Path(folder, "new", "note.txt").read_text()
    'all of it'
    """
    unfinished = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield unfinished
        unfinished.replace(path)
    except StoreError:
        raise
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror or error}); give another place") from error
    finally:
        with suppress(OSError):
            unfinished.unlink()

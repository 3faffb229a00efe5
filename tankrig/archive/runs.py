"""The runs of an archive: folders anywhere below it."""

import os
from collections.abc import Iterator
from pathlib import Path

from tankrig.errors import StoreError
from tankrig.run.journal_io import JOURNAL


def runs_in(archive: Path) -> list[Path]:
    """The folders of all runs in an archive, damaged and unfinished ones too, by their names.

    Parameters
    ----------
    archive
        A folder; runs may lie in folders within it. What begins with a dot is left out, for runs that are being made
        do, and links to folders are not followed.

    Raises
    ------
    StoreError
        When it is no folder, or there is no run in it.
    """
    if not archive.is_dir():
        raise StoreError(f"{archive}: is not a folder; give the folder that the runs lie in")
    found = sorted(_below(archive))
    if not found:
        raise StoreError(f"{archive}: there is no run in it; give the folder that the runs lie in")
    return found


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a run: it has a journal."""
    return (folder / JOURNAL).is_file()


def _below(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as entries:
        inner = [entry for entry in entries if entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".")]
    if is_run(folder):
        yield folder
        return
    for entry in inner:
        yield from _below(Path(entry.path))

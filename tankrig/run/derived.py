"""Arrays that were calculated from a run's frames, beside them, each file with the name of the frames it is made of."""

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import StoreError
from tankrig.run import disk
from tankrig.run.folder import storing

FOLDER = "derived"
_ABOUT = "about"


def write_derived(run: Path, name: str, arrays: Mapping[str, NDArray[Any]], frames: str, **about: Any) -> Path:
    """Keep arrays beside a run's frames: whole, or not at all, in place of those of this name.

    Parameters
    ----------
    run
        Its folder.
    name
        Of the file, without its ending.
    arrays
        By name.
    frames
        Names the frames by their contents, so that it can be told whether the arrays are still theirs.
    about
        What else is to be known, as JSON can say it.

    Raises
    ------
    StoreError
        When the run cannot be written.
    """
    told = json.dumps({**about, "frames": frames, "sha256": _digest(arrays)}, ensure_ascii=False)
    buffer = io.BytesIO()
    stored: dict[str, Any] = {**arrays, _ABOUT: np.array(told)}
    np.savez_compressed(buffer, **stored)
    file = run / FOLDER / f"{name}.npz"
    with storing(run, "keep what was calculated"):
        if not file.parent.is_dir():
            disk.make_folder(file.parent)
            disk.sync_folder(run)
        disk.replace(file, buffer.getvalue())
    return file


def read_derived(file: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Arrays by name, and what is told about them.

    Raises
    ------
    StoreError
        When the file is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files if name != _ABOUT}
            about = json.loads(str(stored[_ABOUT]))
        if about["sha256"] != _digest(arrays):
            raise ValueError("it is not what was written")
    except (OSError, KeyError, TypeError, ValueError, EOFError, BadZipFile) as error:
        raise StoreError(f"{file}: is damaged ({type(error).__name__}); calculate it anew") from error
    return arrays, about


def damaged_derived(run: Path) -> tuple[str, ...]:
    """Names of the files of a run that are damaged; what they hold can be calculated anew."""
    found = []
    for file in sorted((run / FOLDER).glob("*.npz")):
        try:
            read_derived(file)
        except StoreError:
            found.append(file.name)
    return tuple(found)


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of all arrays, by name."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        total.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}\n".encode())
        total.update(np.ascontiguousarray(arrays[name]).tobytes())
    return total.hexdigest()

"""Pictures that a simulated tank has been seen to make, kept in its folder: what took the Monte Carlo is done once."""

import contextlib
import os
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.bounded_reading import arrays
from tankrig.errors import StoreError
from tankrig.files import whole_file

_MOST_BYTES = 400_000_000


class PictureStore:
    """Pictures by what they are of, in a folder that does not grow for ever.

    Parameters
    ----------
    folder
        Made with the first picture; where it cannot be written, nothing is kept.
    most_bytes
        Of all pictures; those that were used longest ago go first.
    """

    def __init__(self, folder: Path, most_bytes: int = _MOST_BYTES) -> None:
        self._folder, self._most_bytes = folder, most_bytes

    def get(self, of: str) -> NDArray[np.float32] | None:
        """The picture of what `of` says in full, or None."""
        path = self._path(of)
        try:
            picture = np.asarray(arrays(path, "picture")["picture"], np.float32)
            os.utime(path)
        except (OSError, ValueError):  # none, or one that was damaged
            return None
        return picture

    def put(self, of: str, picture: NDArray[np.floating]) -> None:
        """Keep a picture; whole or not at all."""
        with contextlib.suppress(StoreError, OSError):  # another process may tidy up at the same time
            with whole_file(self._path(of)) as unfinished:
                np.savez(unfinished, picture=picture.astype(np.float32))
            self._make_room()

    def _make_room(self) -> None:
        kept = sorted(self._folder.glob("*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
        total = 0
        for path in kept:
            total += path.stat().st_size
            if total > self._most_bytes:
                path.unlink()

    def _path(self, of: str) -> Path:
        return self._folder / f"{sha256(of.encode()).hexdigest()[:24]}.npz"

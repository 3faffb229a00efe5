"""Where prepared models are kept: one file each, and beside it, while it is being made, one per image it is made from.

Every file is a zip of arrays, whose checksums show a torn or damaged one, and carries the mark of what it is for and of
the code that made it. A file that is not as it should be counts as missing, so that it is made again.
"""

import errno
import hashlib
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig import bounded_reading
from tankrig.errors import CacheError, StoreError
from tankrig.files import require_writable, whole_file
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]
Arrays = Mapping[str, NDArray[np.generic]]


def cache_folder() -> Path:
    """The folder named by TANKRIG_CACHE, else the user's cache folder."""
    named = os.environ.get("TANKRIG_CACHE")
    if named:
        return Path(named)
    from platformdirs import user_cache_path

    return user_cache_path("tankrig")


@lru_cache(maxsize=1)
def code_mark() -> str:
    """Of the code that computes light: models made by other code are outdated."""
    tankrig = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for package in ("light", "scene", "geometry"):
        for file in sorted((tankrig / package).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def regardless(scene: Scene) -> Scene:
    """A scene as models are kept for it: whatever its medium is, and the file that it was read from."""
    return replace(scene, medium=Medium(0.0, 0.01, 0.0), source="")


@dataclass(frozen=True)
class Place:
    """Files of one prepared model.

    Parameters
    ----------
    folder
        Of all prepared models.
    name
        Of this one.
    """

    folder: Path
    name: str

    @classmethod
    def of(cls, *what: object) -> "Place":
        """The place of a model described by objects whose `repr` says all that it depends on."""
        name = hashlib.sha256(repr(what).encode()).hexdigest()[:20]
        return cls(cache_folder() / "prepared", name)

    @property
    def model(self) -> Path:
        """File of the finished model."""
        return self.folder / f"{self.name}.npz"

    @property
    def parts(self) -> Path:
        """Folder of what it is made from, while it is being made."""
        return self.folder / f"{self.name}.parts"

    def require_room(self, size: int) -> None:
        """Refuse, before any work is done, a folder that cannot take `size` bytes.

        Raises
        ------
        CacheError
            In one sentence.
        """
        try:
            require_writable(self.folder)
            nearest = next(place for place in (self.folder, *self.folder.absolute().parents) if place.exists())
            free = shutil.disk_usage(nearest).free
        except OSError as error:
            raise CacheError(f"{error}; TANKRIG_CACHE names the folder of prepared models") from error
        if free < size:
            raise CacheError(
                f"{self.folder}: no room for a prepared model, which takes {size / 1e6:.0f} MB while it is made and "
                f"{free / 1e6:.0f} MB are free; make room or let TANKRIG_CACHE name another folder"
            )

    def keep(self, path: Path, arrays: Arrays) -> None:
        """Write a file, whole or not at all.

        Raises
        ------
        CacheError
            When it cannot be written.
        """
        try:
            with whole_file(path) as unfinished:
                np.savez(unfinished, mark=np.array(self._mark), **arrays)  # type: ignore[arg-type]
        except StoreError as error:
            cause = error.__cause__
            full = isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)
            raise CacheError(
                f"{path.parent}: no room for a prepared model; make room or let TANKRIG_CACHE name another folder"
                if full
                else f"{error}; TANKRIG_CACHE names the folder of prepared models"
            ) from error

    def kept(self, path: Path) -> dict[str, NDArray[np.generic]] | None:
        """Read a file; None when it is missing, damaged, outdated or something else."""
        try:
            arrays = bounded_reading.arrays(path)
        except (OSError, ValueError):
            return None
        return arrays if str(arrays.pop("mark", "")) == self._mark else None

    def part(self, name: str, shape: tuple[int, ...], make: Callable[[], NDArray[np.floating]]) -> Array:
        """Images that the model is made from, of a shape: those that an interrupted preparation has left, or made now.

        Raises
        ------
        CacheError
            When they cannot be written.
        """
        path = self.parts / f"{name}.npz"
        known = (self.kept(path) or {}).get("images")
        if known is not None and known.shape == shape and known.dtype.kind == "f":
            return known.astype(float)
        images = make()
        self.keep(path, {"images": images})
        return images.astype(float)

    def clear_parts(self) -> None:
        """Remove what the model was made from."""
        shutil.rmtree(self.parts, ignore_errors=True)

    @property
    def _mark(self) -> str:
        return f"tankrig prepared model {self.name} {code_mark()}"

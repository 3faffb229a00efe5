"""Results kept on disk as they come, so that a benchmark that was stopped goes on where it was."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.files import require_writable, whole_file

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Records:
    """A folder of results, one file each.

    Parameters
    ----------
    folder
        Made when needed.
    progress
        Told what is being computed.
    """

    folder: Path
    progress: Callable[[str], None]

    def numbers(self, name: str, compute: Callable[[], Any]) -> Any:
        """What `compute` gives, or gave: anything that JSON holds."""
        path = self.folder / f"{name}.json"
        if not path.is_file():
            self.progress(name)
            found = compute()
            require_writable(self.folder)
            with whole_file(path) as unfinished:
                unfinished.write_text(json.dumps(found), encoding="utf-8")
        return json.loads(path.read_text(encoding="utf-8"))

    def arrays(self, name: str, compute: Callable[[], dict[str, Array]]) -> dict[str, Array]:
        """The same for arrays."""
        path = self.folder / f"{name}.npz"
        if not path.is_file():
            self.progress(name)
            found = compute()
            require_writable(self.folder)
            with whole_file(path) as unfinished:
                np.savez(unfinished, allow_pickle=False, **found)
        with np.load(path) as kept:
            return {key: kept[key] for key in kept.files}

"""A pattern: the picture that a projector shows."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Pattern:
    """An 8-bit grey picture in projector pixels (rows from the top, columns from the left), with a name for people.

    Parameters
    ----------
    name
        What it is called in sequences and reports.
    pixels
        (rows, columns) uint8; made read-only.

    Examples
    --------
    >>> dark = Pattern("dark", np.zeros((4, 6), np.uint8))
    >>> dark.shape, dark.hash[:8]
    ((4, 6), '54b1861b')
    """

    name: str
    pixels: NDArray[np.uint8]

    def __post_init__(self) -> None:
        self.pixels.setflags(write=False)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        rows, columns = self.pixels.shape
        return rows, columns

    @cached_property
    def hash(self) -> str:
        """SHA-256 of shape and pixels: two patterns with the same hash light the tank alike."""
        digest = hashlib.sha256(repr(self.shape).encode())
        digest.update(self.pixels.tobytes())
        return digest.hexdigest()

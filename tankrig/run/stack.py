"""Frames of a run as one array that reads only what is asked of it."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike
from xarray import Variable
from xarray.backends import BackendArray
from xarray.core import indexing

from tankrig.devices import Pixels


def lazy_stack(read: Callable[[int], Pixels], shape: tuple[int, int, int], dtype: DTypeLike) -> Variable:
    """(frame, y, x) counts of frames that are read when they are indexed, and never kept.

    In the way that xarray's own backends are lazy (its page "How to add a new backend"), so that nothing else has to be
    installed for it.

    Parameters
    ----------
    read
        Gives the pixels of one frame, by its place in the stack.
    shape, dtype
        Of all.
    """
    return Variable(("frame", "y", "x"), indexing.LazilyIndexedArray(_Stack(read, shape, dtype)))


class _Stack(BackendArray):
    """What xarray asks for parts."""

    def __init__(self, read: Callable[[int], Pixels], shape: tuple[int, int, int], dtype: DTypeLike) -> None:
        self._read, self.shape, self.dtype = read, shape, np.dtype(dtype)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._part)

    def _part(self, key: tuple[Any, ...]) -> Pixels:
        wanted, *within = key
        numbers = np.arange(self.shape[0])[wanted]
        if numbers.ndim == 0:
            return self._cut(self._read(int(numbers)), within)
        shape = self._cut(np.empty(self.shape[1:], self.dtype), within).shape
        stack: Pixels = np.empty((len(numbers), *shape), self.dtype)
        for place, number in enumerate(numbers):
            stack[place] = self._cut(self._read(int(number)), within)
        return stack

    @staticmethod
    def _cut(pixels: Pixels, within: list[Any]) -> Pixels:
        """Rows and columns, each by its own index."""
        rows, columns = within
        cut: Pixels = pixels[rows][..., columns]
        return cut

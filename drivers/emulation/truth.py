"""What a stand-in has really delivered, and its non-volatile memory, in one file that outlives its process.

A memory-mapped file: what is written is there for the next process however this one ends, as in a real device after a
power cut.
"""

import fcntl
import json
import mmap
import os
import struct
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_SIZE = 4096
_TRUTH = slice(0, 16)
_KEPT = 1024
_HEAD = struct.Struct("<II")


@dataclass(frozen=True)
class TrueDelivery:
    """Steps of ink that have really left the tube, and when the last one did (monotonic clock)."""

    steps: int
    moved_ns: int


class TruthFile:
    """True delivery and non-volatile memory of one device; one process at a time.

    Parameters
    ----------
    path
        Made if it does not exist.

    Raises
    ------
    BlockingIOError
        If another process has the file.
    """

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(self._fd, _SIZE)
            self._map = mmap.mmap(self._fd, _SIZE)
        except OSError:
            os.close(self._fd)
            raise
        self._truth = memoryview(self._map)[_TRUTH].cast("Q")

    def step(self, steps: int = 1) -> None:
        """So many steps of ink really leave the tube."""
        self._truth[1] = time.monotonic_ns()
        self._truth[0] += steps

    @property
    def truth(self) -> TrueDelivery:
        """What really happened."""
        return TrueDelivery(self._truth[0], self._truth[1])

    def keep(self, values: dict[str, Any]) -> None:
        """Replace what the non-volatile memory holds."""
        data = json.dumps(values).encode()
        self._map[_KEPT : _KEPT + _HEAD.size + len(data)] = _HEAD.pack(len(data), zlib.crc32(data)) + data

    def kept(self) -> dict[str, Any]:
        """What the non-volatile memory holds; empty in a new file, or when it was being written as the power went."""
        length, crc = _HEAD.unpack_from(self._map, _KEPT)
        start = _KEPT + _HEAD.size
        data = self._map[start : start + length]
        values: dict[str, Any] = json.loads(data) if length and zlib.crc32(data) == crc else {}
        return values

    def close(self) -> None:
        """Let go of the file."""
        self._truth.release()
        self._map.close()
        os.close(self._fd)


def read_truth(path: Path) -> TrueDelivery:
    """What the device with this file has really delivered, also while its process runs."""
    with path.open("rb") as file:
        return TrueDelivery(*struct.unpack("@QQ", file.read(16)))


def state_in_use(path: Path) -> bool:
    """Whether a stand-in runs on this file."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False

"""The board's FRAM, and the truth beside it, in one file that outlives the emulator's process.

A memory-mapped file: what is written is there for the next process however this one ends, as FRAM is after a power cut.
"""

import struct
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from drivers.emulation.truth import TruthFile

_COMMISSIONING, _RECORDS = 32, (128, 192)
_CONFIG = struct.Struct("<8sII")
_RECORD = struct.Struct("<IIIIIIHHBB")
_CRC = struct.Struct("<I")

LOST = 0xFFFFFFFF
MOVING, STOPPED, UNSURE = 1, 2, 4
NONE, REACHED, STOP, WATCHDOG, STALL, RESET, MEMORY = range(7)


@dataclass(frozen=True)
class Commissioning:
    """What the service sketch writes when a syringe is fitted; the protocol cannot change it."""

    serial: str = "TD000001"
    dose_cap: int = 50_000
    life_cap: int = 10_000_000


@dataclass
class Record:
    """What survives a reset; meanings as on the protocol page."""

    count: int = 0
    doubt: int = 0
    life: int = 0
    dose_id: int = 0
    target: int = 0
    stops: int = 0
    boots: int = 0
    flags: int = 0
    reason: int = NONE


class StateFile(TruthFile):
    """FRAM and truth of one doser; one process at a time.

    Parameters
    ----------
    path
        Made if it does not exist.
    commissioning
        Written into a new file; an old one keeps its own.

    Raises
    ------
    BlockingIOError
        If another process has the file.
    """

    def __init__(self, path: Path, commissioning: Commissioning | None = None) -> None:
        super().__init__(path)
        self._writes = 0
        config = self._read(_COMMISSIONING, _CONFIG)
        if config is None:
            self.commissioning = new = commissioning or Commissioning()
            self.save(Record())
            self._write(_COMMISSIONING, _CONFIG, (new.serial.encode("ascii"), new.dose_cap, new.life_cap))
        else:
            serial, dose_cap, life_cap = config
            self.commissioning = Commissioning(serial.decode("ascii"), dose_cap, life_cap)

    def load(self) -> Record | None:
        """The record written last that is whole; None if there is none."""
        whole = [record for offset in _RECORDS if (record := self._read(offset, _RECORD))]
        if not whole:
            return None
        newest = max(whole)
        self._writes = newest[0]
        return Record(*newest[1:])

    def save(self, record: Record) -> None:
        """Write `record` in the place of the older of the two."""
        self._writes += 1
        values = (self._writes & 0xFFFFFFFF, *(getattr(record, field.name) for field in _FIELDS))
        self._write(_RECORDS[self._writes & 1], _RECORD, values)

    def forget(self) -> None:
        """Destroy both records."""
        for offset in _RECORDS:
            self._map[offset : offset + 4] = b"\x55\xaa\x55\xaa"

    def _read(self, offset: int, layout: struct.Struct) -> tuple[Any, ...] | None:
        end = offset + layout.size
        data = self._map[offset:end]
        return layout.unpack(data) if _CRC.unpack_from(self._map, end)[0] == _checked(data) else None

    def _write(self, offset: int, layout: struct.Struct, values: tuple[object, ...]) -> None:
        data = layout.pack(*values)
        self._map[offset : offset + layout.size + 4] = data + _CRC.pack(_checked(data))


_FIELDS = fields(Record)


def _checked(data: bytes) -> int:
    return zlib.crc32(data, 0x5A5A5A5A)

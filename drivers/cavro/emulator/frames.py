"""The pump's side of the OEM protocol, written from firmware_notes/cavro.md."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command whose checksum is right."""

    address: int
    sequence: int
    repeated: bool
    text: str


def answered(status: int, data: str) -> bytes:
    """An answer to the host.

    >>> answered(0x60, "").hex(" ")
    '02 30 60 03 51'
    """
    block = b"\x02\x30" + bytes([status]) + data.encode("ascii") + b"\x03"
    return block + bytes([checksum(block)])


def checksum(block: bytes) -> int:
    """All bytes combined by exclusive or."""
    value = 0
    for byte in block:
        value ^= byte
    return value


class Reader:
    """Finds commands in what comes in. A damaged one is dropped without an answer."""

    def __init__(self) -> None:
        self._block = bytearray()
        self._ended = False

    def feed(self, data: bytes) -> list[Command]:
        """Commands in `data`, in their order."""
        found = []
        for byte in data:
            if self._ended:
                if command := self._command(byte):
                    found.append(command)
                self._block.clear()
                self._ended = False
            elif byte == 0x02:
                self._block[:] = b"\x02"
            elif self._block:
                self._block.append(byte)
                self._ended = byte == 0x03 and len(self._block) > 3
                if len(self._block) > 260:
                    self._block.clear()
        return found

    def _command(self, check: int) -> Command | None:
        block = bytes(self._block)
        if checksum(block) != check or block[2] & 0xF0 != 0x30:
            return None
        text = block[3:-1].decode("ascii", "replace")
        return Command(block[1] - 0x30, block[2] & 7, bool(block[2] & 8), text)

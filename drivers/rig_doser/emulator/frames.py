"""The doser's side of the wire: finds requests in the bytes that come in, and puts replies into frames."""

from collections.abc import Iterator
from dataclasses import dataclass

STOP = 0x18
LONGEST = 96
GAP_S = 0.1
DIGITS = frozenset("0123456789ABCDEF")


def _crc_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return tuple(table)


_TABLE = _crc_table()


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE.

    >>> hex(crc(b"123456789"))
    '0x29b1'
    """
    value = 0xFFFF
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _TABLE[value >> 8 ^ byte]
    return value


@dataclass(frozen=True)
class Request:
    """A request whose CRC is right: the host's number, the command's letter, its arguments as they came."""

    sequence: str
    command: str
    arguments: str


class StopByte:
    """A stop byte has come."""


def framed(text: str) -> bytes:
    """A reply or banner with its CRC and line end.

    >>> framed("<05E0B")
    b'<05E0B*2D73\\n'
    """
    return b"%s*%04X\n" % (text.encode("ascii"), crc(text.encode("ascii")))


class RequestReader:
    """Finds requests and stop bytes in what comes in, whatever is lost or garbled.

    Parameters
    ----------
    protocol
        Version 02 drops a request whose number is not two digits; 01 echoes whatever it is.
    """

    def __init__(self, protocol: int = 1) -> None:
        self._numbers_only = protocol >= 2
        self._frame: bytearray | None = None
        self._last_s = 0.0

    def feed(self, data: bytes, now_s: float) -> Iterator[Request | StopByte]:
        """Requests and stop bytes in `data`, in their order."""
        if now_s - self._last_s > GAP_S:
            self._frame = None
        self._last_s = now_s
        for byte in data:
            if byte == STOP:
                yield StopByte()
            elif byte == ord(">"):
                self._frame = bytearray(b">")
            elif self._frame is not None and byte == ord("\n"):
                frame, self._frame = bytes(self._frame), None
                request = _request(frame)
                if request and (set(request.sequence) <= DIGITS or not self._numbers_only):
                    yield request
            elif self._frame is not None:
                self._frame.append(byte)
                if len(self._frame) > LONGEST:
                    self._frame = None


def _request(frame: bytes) -> Request | None:
    body, star, digits = frame.rpartition(b"*")
    if star and len(body) >= 4 and digits == b"%04X" % crc(body):
        text = body.decode("ascii", "replace")
        return Request(text[1:3], text[3], text[4:])
    return None

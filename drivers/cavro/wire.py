"""The host's side of a Cavro pump's wire in the OEM protocol (firmware_notes/cavro.md)."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from operator import xor

STX, ETX, HOST = 0x02, 0x03, 0x30
_READY = 0x20

ERRORS = {
    1: "it could not initialise",
    2: "it does not know the command",
    3: "a value is out of its range",
    4: "commands came in the wrong order",
    6: "its EEPROM fails",
    7: "it is not initialised",
    9: "its plunger met too much resistance",
    10: "its valve met too much resistance",
    11: "the plunger may not move with the valve where it is",
    15: "it was busy",
}


@dataclass(frozen=True)
class Reply:
    """What the pump answers; whether it is ready is only to be trusted in the reply to `Q`."""

    ready: bool
    error: int
    data: str

    @property
    def why(self) -> str:
        """The error, for a sentence."""
        return ERRORS.get(self.error, f"error {self.error}")


def command(address: int, sequence: int, data: str, repeat: bool = False) -> bytes:
    """A command; `sequence` is 1 to 7 and has to change with every new one.

    >>> command(1, 2, "A1500R").hex(" ")
    '02 31 32 41 31 35 30 30 52 03 15'
    >>> command(1, 2, "A1500R", repeat=True).hex(" ")
    '02 31 3a 41 31 35 30 30 52 03 1d'
    """
    body = bytes([STX, HOST + address, 0x30 | repeat << 3 | sequence]) + data.encode("ascii") + bytes([ETX])
    return body + bytes([reduce(xor, body)])


def replies(received: bytearray) -> Iterator[bytes]:
    """Take status and data of whole, undamaged replies out of `received`; what may still become one stays.

    >>> list(replies(bytearray.fromhex("FF 02 30 60 03 51")))
    [b'`']
    """
    while (start := received.find(STX)) >= 0:
        del received[:start]
        end = received.find(ETX)
        if end < 0 or len(received) < end + 2:
            return
        body, checksum = bytes(received[: end + 1]), received[end + 1]
        if len(body) >= 4 and body[1] == HOST and body[2] & 0xD0 == 0x40 and reduce(xor, body) == checksum:
            del received[: end + 2]
            yield body[2:-1]
        else:
            del received[:1]
    received.clear()


def reply(text: bytes) -> Reply:
    """The reply in a frame's status and data.

    >>> reply(b"`")
    Reply(ready=True, error=0, data='')
    """
    return Reply(bool(text[0] & _READY), text[0] & 0x0F, text[1:].decode("ascii", "replace"))

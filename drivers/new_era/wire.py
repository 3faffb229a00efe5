"""The host's side of a New Era pump's wire in Safe mode (firmware_notes/new_era.md)."""

import binascii
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal

from drivers.dosing.pump import Count

STX, ETX = 0x02, 0x03
_FRAME = 4  # bytes of a packet that its length counts besides the data: length, CRC (2), ETX
_REPLY = re.compile(r"(\d\d)(?:A\?([A-Z])|([IWSPTUX]))(.*)", re.DOTALL)
_BASIC = re.compile(rb"\x02(\d\d(?:A\?[A-Z]|[IWSPTUX])[ -~]*)\x03")
_DISPENSED = re.compile(r"I(\d*\.?\d*)W(\d*\.?\d*)(UL|ML)")

ALARMS = {
    "R": "it was reset (its power was interrupted)",
    "S": "its motor stalled; look at syringe and plunger",
    "T": "its watchdog heard nothing from the computer",
    "E": "its program has an error; reset it",
    "O": "its program phase is out of range; reset it",
}
ERRORS = {
    "": "it does not know the command",
    "NA": "the command does not apply now",
    "OOR": "a value is out of its range",
    "COM": "it received a damaged packet",
    "IGN": "it ignored the command because a phase was starting",
}


@dataclass(frozen=True)
class Reply:
    """What the pump answers: one of the status letters, or an alarm (status "A"), and data or an error."""

    address: int
    status: str
    data: str
    alarm: str | None = None

    @property
    def damaged(self) -> bool:
        """Whether the pump says that what it received was damaged: it has done nothing, and forgotten no alarm."""
        return self.data == "?COM"

    @property
    def error(self) -> str | None:
        """Why it refused, if it did."""
        if not self.data.startswith("?"):
            return None
        return ERRORS.get(self.data[1:], f"error {self.data}")


def packet(data: str) -> bytes:
    """A Safe-mode packet.

    >>> packet("SAF0").hex(" ")
    '02 08 53 41 46 30 55 43 03'
    """
    text = data.encode("ascii")
    return bytes([STX, len(text) + _FRAME]) + text + binascii.crc_hqx(text, 0).to_bytes(2, "big") + bytes([ETX])


def packets(received: bytearray) -> Iterator[bytes]:
    """Take the data of whole, undamaged packets out of `received`; what may still become one stays.

    >>> received = bytearray.fromhex("55 02 07 30 30 53 AA A6 03 02 07 30")
    >>> list(packets(received)), received.hex()
    ([b'00S'], '020730')
    """
    while (start := received.find(STX)) >= 0:
        del received[:start]
        if len(received) < 2:
            return
        length = received[1]
        if length < _FRAME:
            del received[:1]
        elif len(received) <= length:
            return
        elif received[length] == ETX and (text := _checked(bytes(received[2:length]))) is not None:
            del received[: length + 1]
            yield text
        else:
            del received[:1]
    received.clear()


def packets_or_replies(received: bytearray) -> Iterator[bytes]:
    """As `packets`, and besides the data of replies in Basic mode, which have no checksum: while the mode changes.

    >>> list(packets_or_replies(bytearray.fromhex("02 30 30 53 03 02 07 30 30 53 AA A6 03")))
    [b'00S', b'00S']
    """
    while (start := received.find(STX)) >= 0:
        del received[:start]
        if basic := _BASIC.match(received):
            data = basic[1]
            del received[: basic.end()]
            yield bytes(data)
        elif whole := next(packets(rest := received[:]), None):
            received[:] = rest
            yield whole
        else:
            return
    received.clear()


def _checked(body: bytes) -> bytes | None:
    text, crc = body[:-2], body[-2:]
    return text if binascii.crc_hqx(text, 0).to_bytes(2, "big") == crc else None


def reply(text: bytes) -> Reply | None:
    """The reply in a packet's data.

    >>> reply(b"00A?R")
    Reply(address=0, status='A', data='', alarm='R')
    """
    found = _REPLY.fullmatch(text.decode("ascii", "replace"))
    if not found:
        return None
    address, alarm, status, data = found.groups()
    return Reply(int(address), status or "A", data, alarm)


def number(thousandths: int) -> str:
    """A number as the pump takes it: at most 4 digits, at most 3 of them decimals, never an exponent.

    >>> number(999_900), number(500), number(7000)
    ('999.9', '0.500', '7.000')
    >>> number(1_000_100)
    Traceback (most recent call last):
    ValueError: 1000.1 has more than four digits
    """
    for decimals in (3, 2, 1, 0):
        scale = 10 ** (3 - decimals)
        if thousandths % scale == 0 and 0 <= thousandths // scale <= 9999:
            return f"{Decimal(thousandths) / 1000:.{decimals}f}"
    raise ValueError(f"{thousandths / 1000:g} has more than four digits")


def same(text: str, value: str) -> bool:
    """Whether two numbers are the same, however they are written."""
    try:
        return Decimal(text) == Decimal(value)
    except ArithmeticError:
        return False


def dispensed(data: str, unit_ul: float) -> Count | None:
    """Infused volume that `DIS` tells, in thousandths of a unit of `unit_ul`, within one digit of its display.

    >>> dispensed("I12.34W0.000UL", 1.0)
    Count(best=12340, low=12330, high=12350)
    """
    found = _DISPENSED.fullmatch(data)
    if not found or not any(ch.isdigit() for ch in found[1]):
        return None
    scale = (1000.0 if found[3] == "ML" else 1.0) / unit_ul * 1000.0
    best = float(found[1]) * scale
    digit = 10.0 ** -len(found[1].partition(".")[2]) * scale
    return Count(round(best), max(0, math.floor(best - digit + 1e-6)), math.ceil(best + digit - 1e-6))

"""The host's side of the rig doser's wire: puts requests into frames, reads replies (firmware_notes/rig_doser.md)."""

import binascii
from dataclasses import dataclass
from enum import IntEnum, IntFlag

PROTOCOLS = (1, 2)
RESOLVES_NAME_STOPS = 2
"""From this version on `Z` names the stops that its sender knows of, as `C` does."""
STOP = b"\x18\x18\x18"


class Flag(IntFlag):
    """What holds now."""

    MOVING = 1
    STOPPED = 2
    UNSURE = 4


class Reason(IntEnum):
    """Why the motor last came to rest."""

    NONE = 0
    REACHED = 1
    STOP = 2
    WATCHDOG = 3
    STALL = 4
    RESET = 5
    MEMORY = 6


REASONS = {
    Reason.NONE: "it has not moved",
    Reason.REACHED: "it reached its target",
    Reason.STOP: "it was stopped",
    Reason.WATCHDOG: "its watchdog heard nothing from the computer",
    Reason.STALL: "its motor stalled; look at syringe and plunger",
    Reason.RESET: "its board was reset",
    Reason.MEMORY: "its memory lost the count",
}

REFUSALS = {
    0x01: "it does not know the command",
    0x02: "it cannot read the command",
    0x03: "it is moving",
    0x04: "a stop is latched",
    0x05: "it does not know what it has delivered",
    0x06: "the dose's number is older than its last one",
    0x07: "the dose's number was used with another target",
    0x08: "more than that has been delivered already",
    0x09: "that is more than its cap for one dose",
    0x0A: "that is more than its lifetime cap; refill the syringe and commission it anew",
    0x0B: "it has been stopped again meanwhile",
    0x0C: "it is sure of its own count; open it again, which takes that over",
}


@dataclass(frozen=True)
class Banner:
    """What the board says after boot."""

    protocol: int
    serial: str
    boots: int


@dataclass(frozen=True)
class Identity:
    """Who it is and what its firmware allows, in steps."""

    protocol: int
    serial: str
    dose_cap: int
    life_cap: int
    rate: int
    watchdog_ms: int


@dataclass(frozen=True)
class State:
    """Its status; steps. The plunger has made at least `low` and at most `count` of them."""

    flags: Flag
    reason: Reason
    id: int
    target: int
    count: int
    doubt: int
    life: int
    boots: int
    stops: int

    @property
    def moving(self) -> bool:
        """Whether the motor runs."""
        return Flag.MOVING in self.flags

    @property
    def low(self) -> int:
        """Fewest steps the plunger can have made."""
        return self.count - self.doubt


@dataclass(frozen=True)
class Refusal:
    """The doser has refused a request; nothing has changed."""

    code: int

    @property
    def why(self) -> str:
        """For a sentence."""
        return REFUSALS.get(self.code, f"error {self.code:02X}")


Reply = Identity | State | Refusal


def request(sequence: int, command: str, *arguments: tuple[int, int]) -> bytes:
    r"""A request; `arguments` are (value, digits).

    >>> request(4, "C", (3, 4))
    b'>04C0003*8C00\n'
    """
    text = f">{sequence:02X}{command}" + "".join(f"{value:0{digits}X}" for value, digits in arguments)
    return f"{text}*{_crc(text.encode()):04X}\n".encode()


def reply(line: bytes) -> tuple[int, Reply] | None:
    """The sequence number and reply in a line without its end; None if it is not a whole, undamaged reply."""
    text = _undamaged(line, b"<")
    if text is None:
        return None
    try:
        sequence, letter, body = int(text[1:3], 16), text[3], text[4:]
        if letter == "I" and len(body) == 34:
            return sequence, Identity(int(body[:2], 16), body[2:10], *_numbers(body[10:], 8, 8, 4, 4))
        if letter == "S" and len(body) == 52:
            flags, reason, *rest = _numbers(body, 2, 2, 8, 8, 8, 8, 8, 4, 4)
            return sequence, State(Flag(flags), Reason(reason), *rest)
        if letter == "E" and len(body) == 2:
            return sequence, Refusal(int(body, 16))
    except ValueError:
        pass
    return None


def banner(line: bytes) -> Banner | None:
    """The banner in a line; None if it is none."""
    text = _undamaged(line, b"!")
    try:
        name, protocol, serial, boots = (text or "").split(" ")
        return Banner(int(protocol, 16), serial, int(boots, 16)) if name == "!TANKRIG-DOSER" else None
    except ValueError:
        return None


def _numbers(text: str, *digits: int) -> list[int]:
    ends = [sum(digits[: i + 1]) for i in range(len(digits))]
    return [int(text[end - width : end], 16) for end, width in zip(ends, digits, strict=True)]


def _undamaged(line: bytes, opening: bytes) -> str | None:
    """The text before the CRC, from the last opening character on; None unless its CRC is right."""
    _, found, rest = line.rpartition(opening)
    text, star, digits = (found + rest).rpartition(b"*")
    if star and text.isascii() and digits == b"%04X" % _crc(text):
        return text.decode("ascii")
    return None


def _crc(data: bytes) -> int:
    return binascii.crc_hqx(data, 0xFFFF)

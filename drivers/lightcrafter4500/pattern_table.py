"""What a LightCrafter 4500 is told to show: lines of its pattern table, as bytes."""

import struct
from dataclasses import dataclass
from enum import IntEnum

LEAST_EXPOSURE_US = (235, 700, 1570, 1700, 2000, 2500, 4500, 8333)
"""By the number of bits of a pattern, from 1 on."""
DARK_US = 230
"""By which an exposure that is not the whole period has to be shorter."""
MOST_ENTRIES = 128
LED = {"red": 1, "green": 2, "blue": 4, "white": 7}


class Trigger(IntEnum):
    """What a pattern waits for."""

    INTERNAL = 0
    RISING = 1
    FALLING = 2


@dataclass(frozen=True)
class TableEntry:
    """One pattern of a sequence.

    Parameters
    ----------
    number
        Of the pattern in its 24 bit planes: planes number · bits to number · bits + bits − 1.
    bits
        Of the pattern.
    led
        Which lamps: 1 red, 2 green, 4 blue, added.
    trigger
        What it waits for.
    black
        Whether it is followed by black, for which the exposure has to leave room.
    next_image
        Whether the next image of those in flash begins with this line.

    Examples
    --------
    >>> TableEntry(0, 8, LED["white"], Trigger.RISING).packed().hex(" ")
    '01 78 00'
    """

    number: int
    bits: int
    led: int
    trigger: Trigger = Trigger.INTERNAL
    black: bool = False
    next_image: bool = False

    def packed(self) -> bytes:
        """Its three bytes."""
        flags = self.black << 1 | self.next_image << 2
        return bytes([self.trigger | self.number << 2, self.bits | self.led << 4, flags])


@dataclass(frozen=True)
class PatternTable:
    """A whole sequence.

    Parameters
    ----------
    lines
        Its patterns, in order.
    exposure_us, period_us
        Of each: for how long it is lit, and from one to the next.
    images
        Numbers of the images in flash that it uses, in order; empty where the patterns come from the video input.
    """

    lines: tuple[TableEntry, ...]
    exposure_us: int
    period_us: int
    images: tuple[int, ...] = ()

    @property
    def from_flash(self) -> bool:
        """Whether patterns come from flash and are shown once, rather than from the video, again and again."""
        return bool(self.images)

    def configuration(self) -> bytes:
        """Number of lines, whether repeated, number of patterns, number of images; each less one."""
        last = len(self.lines) - 1
        return bytes([last, not self.from_flash, last, max(0, len(self.images) - 1)])

    def times(self) -> bytes:
        """Exposure and period."""
        return struct.pack("<II", self.exposure_us, self.period_us)

    def pattern_lines(self) -> bytes:
        """The lines, one after the other."""
        return b"".join(line.packed() for line in self.lines)

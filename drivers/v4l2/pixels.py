"""Counts out of a buffer: the kernel's uncompressed grey and colour-mosaic formats, as linux/videodev2.h names them.

Source of the layouts: the kernel's userspace API, "Luma-Only Formats" and "Raw Bayer Formats".
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.uint8] | NDArray[np.uint16]
Cells = Literal["green", "all"]
"""Which pixels of each 2×2 cell of a colour sensor are added up."""


@dataclass(frozen=True)
class Packing:
    """How the pixels of a line lie in its bytes.

    Parameters
    ----------
    pixels, bytes_
        So many pixels take so many bytes; a line holds a whole number of such groups.
    unpack
        From (rows, bytes) to (rows, columns) counts.
    """

    pixels: int
    bytes_: int
    unpack: Callable[[NDArray[np.uint8]], Counts]


def _high_bytes_then_low_bits(lines: NDArray[np.uint8], pixels: int) -> NDArray[np.uint16]:
    """Groups of bytes with the high bits of a pixel each, then one byte with the low bits of all, the first lowest."""
    low_bits = 8 // pixels
    groups = lines.reshape(len(lines), -1, pixels + 1).astype(np.uint16)
    shifts = np.arange(pixels, dtype=np.uint16) * np.uint16(low_bits)
    low = groups[..., pixels:] >> shifts & np.uint16(2**low_bits - 1)
    counts: NDArray[np.uint16] = groups[..., :pixels] << np.uint16(low_bits) | low
    return counts.reshape(len(lines), -1)


def _one_run_of_bits(lines: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Ten bits a pixel, the highest first, without regard to bytes."""
    groups = lines.reshape(len(lines), -1, 5).astype(np.uint16)
    high = np.arange(4, dtype=np.uint16)  # a pixel's first byte; six, four, two or no bits of the next are another's
    own = groups[..., high] << (2 + 2 * high) & np.uint16(0x3FF)
    counts: NDArray[np.uint16] = own | groups[..., high + 1] >> (6 - 2 * high)
    return counts.reshape(len(lines), -1)


BYTES = Packing(1, 1, lambda lines: lines)
FIRST_OF_TWO_BYTES = Packing(1, 2, lambda lines: lines[:, ::2])
LITTLE_ENDIAN = Packing(1, 2, lambda lines: lines.view("<u2"))
BIG_ENDIAN = Packing(1, 2, lambda lines: lines.view(">u2").astype(np.uint16))
MIPI_10 = Packing(4, 5, lambda lines: _high_bytes_then_low_bits(lines, 4))
MIPI_12 = Packing(2, 3, lambda lines: _high_bytes_then_low_bits(lines, 2))
RUN_OF_10 = Packing(4, 5, _one_run_of_bits)


@dataclass(frozen=True)
class PixelFormat:
    """One of the kernel's pixel formats.

    Parameters
    ----------
    code
        The kernel's four characters.
    bits
        Of a pixel.
    packing
        Of a line.
    mosaic
        Colours of a 2×2 cell, row by row; empty where all pixels are grey.
    """

    code: int
    bits: int
    packing: Packing
    mosaic: str = ""

    def line_bytes(self, columns: int) -> int | None:
        """Bytes of a line without what pads it; None for columns that such a line can't have."""
        groups, rest = divmod(columns, self.packing.pixels)
        return None if rest else groups * self.packing.bytes_

    def counts(self, buffer: NDArray[np.uint8], shape: tuple[int, int], bytes_per_line: int) -> Counts:
        """Every pixel of a picture.

        Parameters
        ----------
        buffer
            Bytes, from the first of the picture on to the last at least.
        shape
            (rows, columns).
        bytes_per_line
            From the beginning of a line to that of the next.

        Returns
        -------
        numpy.ndarray
            (rows, columns) uint8 or uint16; may be a view of `buffer`.

        Examples
        --------
        >>> packed = np.array([0b11111111, 0, 0, 0, 0b11, 99, 99, 99], dtype=np.uint8)  # three bytes pad the line
        >>> FORMATS["Y10P"].counts(packed, (1, 4), 8)
        array([[1023,    0,    0,    0]], dtype=uint16)
        """
        rows, columns = shape
        used = self.line_bytes(columns)
        assert used is not None
        return self.packing.unpack(np.ndarray((rows, used), np.uint8, buffer, strides=(bytes_per_line, 1)))

    def added(self, cells: Cells) -> int:
        """How many pixels of a cell are added up; 1 for a grey format."""
        return {"green": 2, "all": 4}[cells] if self.mosaic else 1

    def grey(self, counts: Counts, cells: Cells, clipped: int) -> Counts:
        """One grey pixel of each 2×2 cell of a mosaic: the sum of its pixels, so that no count is rounded.

        Parameters
        ----------
        counts
            (rows, columns), both even.
        cells
            The two green pixels, or all four.
        clipped
            The count at which a pixel saturates. A cell in which one does counts as saturated whole.

        Examples
        --------
        >>> counts = np.array([[9, 100], [102, 5]], dtype=np.uint8)
        >>> FORMATS["SRGGB8"].grey(counts, "green", 255), FORMATS["SRGGB8"].grey(counts, "all", 102)
        (array([[202]], dtype=uint16), array([[408]], dtype=uint16))
        """
        if not self.mosaic:
            return counts
        chosen = [
            counts[place // 2 :: 2, place % 2 :: 2]
            for place, colour in enumerate(self.mosaic)
            if cells == "all" or colour == "G"
        ]
        total = np.zeros(chosen[0].shape, np.uint16)
        saturated = np.zeros(chosen[0].shape, bool)
        for pixels in chosen:
            total += pixels
            saturated |= pixels >= clipped
        total[saturated] = len(chosen) * clipped
        return total


def _code(characters: str, big_endian: bool = False) -> int:
    return int.from_bytes(characters.ljust(4).encode("ascii"), "little") | big_endian << 31


def _mosaics() -> dict[str, PixelFormat]:
    """The raw formats, named SRGGB10 and so on by colours and bits, with a P where they are packed."""
    found = {}
    for order, one_byte, ten, twelve, sixteen, packed in (
        ("BGGR", "BA81", "BG10", "BG12", "BYR2", "pB"),
        ("GBRG", "GBRG", "GB10", "GB12", "GB16", "pG"),
        ("GRBG", "GRBG", "BA10", "BA12", "GR16", "pg"),
        ("RGGB", "RGGB", "RG10", "RG12", "RG16", "pR"),
    ):
        found[f"S{order}8"] = PixelFormat(_code(one_byte), 8, BYTES, order)
        found[f"S{order}10"] = PixelFormat(_code(ten), 10, LITTLE_ENDIAN, order)
        found[f"S{order}12"] = PixelFormat(_code(twelve), 12, LITTLE_ENDIAN, order)
        found[f"S{order}16"] = PixelFormat(_code(sixteen), 16, LITTLE_ENDIAN, order)
        found[f"S{order}10P"] = PixelFormat(_code(f"{packed}AA"), 10, MIPI_10, order)
        found[f"S{order}12P"] = PixelFormat(_code(f"{packed}CC"), 12, MIPI_12, order)
    return found


FORMATS: dict[str, PixelFormat] = {
    "Y16": PixelFormat(_code("Y16"), 16, LITTLE_ENDIAN),
    "Y16_BE": PixelFormat(_code("Y16", big_endian=True), 16, BIG_ENDIAN),
    "Y12": PixelFormat(_code("Y12"), 12, LITTLE_ENDIAN),
    "Y12P": PixelFormat(_code("Y12P"), 12, MIPI_12),
    "Y10": PixelFormat(_code("Y10"), 10, LITTLE_ENDIAN),
    "Y10P": PixelFormat(_code("Y10P"), 10, MIPI_10),
    "Y10B": PixelFormat(_code("Y10B"), 10, RUN_OF_10),
    "GREY": PixelFormat(_code("GREY"), 8, BYTES),
    "YUYV": PixelFormat(_code("YUYV"), 8, FIRST_OF_TWO_BYTES),
    **_mosaics(),
}
"""By the name that a rig file gives; the best for measuring first."""


def format_name(code: int) -> str:
    """A format's name: of `FORMATS` where it is one of them, else the kernel's four characters."""
    known = next((name for name, format_ in FORMATS.items() if format_.code == code), None)
    return known or code.to_bytes(4, "little").decode("ascii", "replace").strip()

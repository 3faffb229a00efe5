"""Which projector pixel lights what a camera pixel sees: Gray code for the stripe, phase shift for the fraction."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.pattern import Pattern

PERIOD = 16
"""Projector pixels from crest to crest of the phase-shifted waves; a stripe of the finest Gray code is half of it."""
SHIFTS = 6
"""Waves of each axis: six cancel all harmonics that a display's gamma makes of a sine but the 5th, 7th, 11th …"""
LEAST_CONTRAST = 0.02
"""Of the camera's range, between lit and dark; below it a pixel is not lit by the projector."""
LEAST_MODULATION = 0.15
"""Of that contrast, in waves and bits; below it a pixel gets its light by detours, or is blurred out."""


@dataclass(frozen=True)
class Decoded:
    """Where the light of each camera pixel comes from.

    Parameters
    ----------
    columns, rows
        (camera rows, camera columns) float32 projector coordinates, pixel centres at whole numbers; NaN where unknown.
    known
        Where both are known.
    lit
        Where the projector's white is seen at all.
    saturated
        Where white is at the highest count.
    contrast
        (camera rows, camera columns) float32 counts of white less those of black.
    fine_columns, fine_rows
        The finest stripes less their inverse, over that: from −1 to 1.
    """

    columns: NDArray[np.float32]
    rows: NDArray[np.float32]
    known: NDArray[np.bool_]
    lit: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    contrast: NDArray[np.float32]
    fine_columns: NDArray[np.float32]
    fine_rows: NDArray[np.float32]


def gray_code_patterns(shape: tuple[int, int]) -> tuple[Pattern, ...]:
    """What the projector has to show, in the order that `decode` expects.

    White, black; then for columns, and for rows: each bit of the stripe's Gray code and its inverse, from coarse to
    fine, and the shifted waves.

    Parameters
    ----------
    shape
        (rows, columns) of the projector.

    Notes
    -----
    The inverse of each bit decides it without a threshold, whatever the albedo and the ambient light (Salvi, Pagès and
    Batlle 2004). Stripes are 8 pixels wide and no finer, since lenses blur finer ones; the phase of waves of twice that
    width then tells the place to a few hundredths of a pixel.

    Examples
    --------
    >>> patterns = gray_code_patterns((768, 1024))
    >>> len(patterns), [pattern.name for pattern in patterns[:4]]
    (42, ['white', 'black', 'column bit 6', 'column bit 6 inverse'])
    """
    rows, columns = shape
    patterns = [_level("white", 255, shape), _level("black", 0, shape)]
    for axis, size in (("column", columns), ("row", rows)):
        place = np.arange(size)
        stripe = place // (PERIOD // 2)
        gray = stripe ^ (stripe >> 1)
        for bit in reversed(range(_bits(size))):
            lit = (gray >> bit & 1).astype(bool)
            patterns.append(_drawn(f"{axis} bit {bit}", lit * 255.0, axis, shape))
            patterns.append(_drawn(f"{axis} bit {bit} inverse", ~lit * 255.0, axis, shape))
        for shift in range(SHIFTS):
            wave = 127.5 + 127.5 * np.cos(2.0 * np.pi * (place / PERIOD - shift / SHIFTS))
            patterns.append(_drawn(f"{axis} wave {shift}", wave, axis, shape))
    return tuple(patterns)


def decode(frames: Sequence[NDArray[Any]], shape: tuple[int, int], saturation: int) -> Decoded:
    """Find each camera pixel's projector pixel.

    Parameters
    ----------
    frames
        (camera rows, camera columns) each, in the order of `gray_code_patterns`.
    shape
        (rows, columns) of the projector.
    saturation
        The camera's highest count.

    Raises
    ------
    ImageError
        When the number of frames or their shapes are wrong.

    Notes
    -----
    The wave's phase says where in its period a pixel lies, and the Gray code which period: it need only be right to
    within half a stripe on either side, so that a bit misread on the edge of two stripes does no harm.

    Examples
    --------
    A camera that sees the projector's picture as it is:

    >>> seen = [pattern.pixels for pattern in gray_code_patterns((48, 64))]
    >>> decoded = decode(seen, (48, 64), saturation=260)
    >>> inner = (slice(2, -2), slice(2, -2))
    >>> float(np.abs(decoded.columns - np.arange(64))[inner].max()) < 0.02, bool(decoded.known[inner].all())
    (True, True)
    """
    expected = 2 + sum(2 * _bits(size) + SHIFTS for size in shape)
    if len(frames) != expected or any(frame.shape != frames[0].shape for frame in frames):
        raise ImageError(
            f"{len(frames)} frames of shapes {sorted({frame.shape for frame in frames})}: a projector of {list(shape)} "
            f"pixels takes {expected} frames of one shape; take all of them again"
        )
    white, black = frames[0].astype(np.float32), frames[1].astype(np.float32)
    contrast = white - black
    lit = contrast > LEAST_CONTRAST * saturation
    saturated = white >= 0.995 * saturation
    known = lit & ~saturated
    rows, columns = shape
    half = 2 + 2 * _bits(columns) + SHIFTS
    across = _axis(frames[2:half], columns, contrast, known)
    down = _axis(frames[half:], rows, contrast, known)
    across[~known] = np.nan
    down[~known] = np.nan
    fine = [_finest(frames[start:], size, contrast) for start, size in ((2, columns), (half, rows))]
    return Decoded(across, down, known, lit, saturated, contrast, *fine)


def _finest(frames: Sequence[NDArray[Any]], size: int, contrast: NDArray[np.float32]) -> NDArray[np.float32]:
    """The last bit of an axis less its inverse, over the contrast."""
    last = 2 * _bits(size)
    difference = frames[last - 2].astype(np.float32) - frames[last - 1]
    found: NDArray[np.float32] = difference / np.maximum(contrast, np.float32(1.0))
    return found


def _axis(
    frames: Sequence[NDArray[Any]], size: int, contrast: NDArray[np.float32], known: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Coordinates along one axis; takes out of `known` what cannot be told."""
    bits = _bits(size)
    stripe, bit = np.zeros(contrast.shape, np.int32), np.zeros(contrast.shape, bool)
    weak, threshold = np.zeros(contrast.shape, np.uint8), np.float32(LEAST_MODULATION) * contrast
    for direct, inverse in zip(frames[0 : 2 * bits : 2], frames[1 : 2 * bits : 2], strict=True):
        difference = direct.astype(np.float32) - inverse
        weak += np.abs(difference) < threshold
        bit ^= difference > 0.0  # Gray code to binary: each bit is the exclusive or of all before it
        stripe = (stripe << 1) | bit
    sine, cosine = np.zeros(contrast.shape, np.float32), np.zeros(contrast.shape, np.float32)
    for shift, frame in enumerate(frames[2 * bits :]):
        angle = 2.0 * np.pi * shift / SHIFTS
        sine += np.float32(np.sin(angle)) * frame.astype(np.float32)
        cosine += np.float32(np.cos(angle)) * frame.astype(np.float32)
    modulation = np.hypot(sine, cosine) * np.float32(4.0 / SHIFTS)  # from trough to crest
    fraction = np.arctan2(sine, cosine) * np.float32(0.5 / np.pi)
    width = PERIOD // 2
    rough = (stripe + np.float32(0.5)) * np.float32(width) - np.float32(0.5)
    place: NDArray[np.float32] = np.float32(PERIOD) * (np.rint(rough / np.float32(PERIOD) - fraction) + fraction)
    known &= (modulation > threshold) & (np.abs(place - rough) < 0.9 * width)
    known &= weak <= 1  # on the edge of two stripes one bit is; where more are, the light is not the projector's
    known &= (place >= 1.0) & (place <= size - 2.0)  # on the picture's edge half of each wave is missing
    return place


def _bits(size: int) -> int:
    """Bits that number the stripes across `size` pixels."""
    return max(1, int(np.ceil(size / (PERIOD // 2)) - 1).bit_length())


def _level(name: str, level: int, shape: tuple[int, int]) -> Pattern:
    return Pattern(name, np.full(shape, level, np.uint8))


def _drawn(name: str, values: NDArray[np.float64], axis: str, shape: tuple[int, int]) -> Pattern:
    line = np.rint(values).astype(np.uint8)
    return Pattern(name, np.ascontiguousarray(np.broadcast_to(line if axis == "column" else line[:, None], shape)))

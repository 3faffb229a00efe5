"""The pictures in a LightCrafter's flash, each of 24 bit planes: which patterns they hold."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tankrig import bounded_reading
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .pattern_table import TableEntry, Trigger

_PLANES = 24
_ENDINGS = (".png", ".bmp", ".tif", ".tiff")
_GREEN_RED_BLUE = (1, 2, 0)
"""Planes 0 to 7 are green's, 8 to 15 red's, 16 to 23 blue's; pictures are read as blue, green, red."""


@dataclass(frozen=True)
class Place:
    """Where a pattern is.

    Parameters
    ----------
    image
        Number of the image in flash.
    number, bits
        Of the pattern in the image, as a line of the pattern table tells it.
    """

    image: int
    number: int
    bits: int


class Flash:
    """What the images in flash hold.

    Parameters
    ----------
    folder
        The pictures that were put into flash, as they were given to TI's program, sorted by name: the first is image 0.
    shape
        (rows, columns) of the mirrors.

    Raises
    ------
    DeviceError
        If there is none, one cannot be read, or one has another shape.
    """

    def __init__(self, folder: Path, shape: tuple[int, int]) -> None:
        self.folder = folder
        files = sorted(file for file in folder.glob("*") if file.suffix.lower() in _ENDINGS)
        if not files:
            raise DeviceError(f"{folder}: holds no pictures; copy those there that are in the LightCrafter's flash")
        self._places: dict[tuple[str, int], Place] = {}
        self._patterns: dict[Place, Pattern] = {}
        for image, file in enumerate(files):
            for place, pattern in _patterns_in(_read(file, shape), image):
                self._places.setdefault((pattern.hash, place.bits), place)
                self._patterns[place] = pattern

    def at(self, place: Place) -> Pattern:
        """The pattern at a place."""
        return self._patterns[place]

    def places(self, patterns: Sequence[Pattern]) -> tuple[Place, ...]:
        """Where patterns are, all of 1 bit, or else all of 8, since light of other bits is of another brightness.

        Raises
        ------
        DeviceError
            If one is not in flash.
        """
        for bits in (1, 8):
            found = [self._places.get((pattern.hash, bits)) for pattern in patterns]
            if None not in found:
                return tuple(place for place in found if place is not None)
        missing = [pattern.name for pattern in patterns if (pattern.hash, 8) not in self._places]
        raise DeviceError(
            f'{self.folder}: pattern "{missing[0]}" is in none of its pictures as 8 bits, nor are all as 1 bit; put it '
            f"into the LightCrafter's flash and its picture there, or capture it instead"
        )


def lines(places: Sequence[Place], led: int, trigger: Trigger) -> tuple[tuple[TableEntry, ...], tuple[int, ...]]:
    """Lines of the pattern table, and the images that they use.

    Raises
    ------
    DeviceError
        If there are more images than the board holds ready, two of them.
    """
    found, images = [], [places[0].image]
    for place in places:
        following = place.image != images[-1]
        if following:
            images.append(place.image)
        found.append(TableEntry(place.number, place.bits, led, trigger, black=True, next_image=following))
    if len(images) > 2:
        raise DeviceError(
            f"a burst goes through pictures {', '.join(map(str, images))} of the LightCrafter's flash, which holds two "
            f"ready; order its patterns by picture, or make several bursts of it"
        )
    return tuple(found), tuple(images)


def picture_of(patterns: Sequence[Pattern]) -> NDArray[np.uint8]:
    """A picture for flash that holds three 8-bit patterns, or up to 24 of which each pixel is lit or not.

    Parameters
    ----------
    patterns
        In the order of their numbers; what is left over is dark.

    Returns
    -------
        (rows, columns, 3) blue, green, red, for `cv2.imwrite`.

    Raises
    ------
    DeviceError
        If they are too many.

    Examples
    --------
    >>> striped = Pattern("striped", np.array([[0, 255]], np.uint8))
    >>> picture_of([striped]).tolist()
    [[[0, 0, 0], [0, 255, 0]]]
    """
    if len(patterns) > 3 and any(set(np.unique(one.pixels)) - {0, 255} for one in patterns):
        raise DeviceError(f"{len(patterns)} patterns of 8 bits do not fit into one picture of flash; give up to 3")
    if len(patterns) > _PLANES:
        raise DeviceError(f"{len(patterns)} patterns do not fit into one picture of flash; give up to {_PLANES}")
    picture = np.zeros((*patterns[0].shape, 3), np.uint8)
    for number, pattern in enumerate(patterns):
        if len(patterns) <= 3:
            picture[..., _GREEN_RED_BLUE[number]] = pattern.pixels
        else:
            picture[..., _GREEN_RED_BLUE[number // 8]] |= (pattern.pixels & 1) << (number % 8)
    return picture


def _read(file: Path, shape: tuple[int, int]) -> NDArray[np.uint8]:
    try:
        picture = bounded_reading.picture(file, cv2.IMREAD_COLOR)
        found = f"has {list(picture.shape[:2])} pixels (rows, columns)"
    except (OSError, ValueError) as error:
        picture, found = None, f"cannot be read ({bounded_reading.reason(error)})"
    if picture is None or picture.shape[:2] != shape:
        raise DeviceError(f"{file}: {found}, and the LightCrafter's mirrors are {list(shape)}; give the picture anew")
    return np.asarray(picture, np.uint8)


def _patterns_in(picture: NDArray[np.uint8], image: int) -> Iterator[tuple[Place, Pattern]]:
    for number, channel in enumerate(_GREEN_RED_BLUE):
        pixels = np.ascontiguousarray(picture[..., channel])
        yield Place(image, number, 8), Pattern(f"picture {image}, pattern {number}", pixels)
        for bit in range(8):
            plane = 8 * number + bit
            yield (
                Place(image, plane, 1),
                Pattern(f"picture {image}, plane {plane}", _lit(pixels, bit)),
            )


def _lit(pixels: NDArray[np.uint8], bit: int) -> NDArray[np.uint8]:
    return np.where(pixels >> bit & 1, np.uint8(255), np.uint8(0))

"""Checks of the fields of what a scene is made of: each refusal is one sentence."""

import math
from typing import SupportsFloat

from tankrig.checked_toml import MOST
from tankrig.errors import SceneError
from tankrig.ranges import ranges_of, require_ranges

CLOSED = {"extra": "forbid", "strict": True}
"""Read by the scene file's validation: an unknown key is refused, and a number in quotes is not a number."""


def require(condition: bool, message: str) -> None:
    """Refuse with a sentence what does not hold."""
    if not condition:
        raise SceneError(message)


def finite(name: str, given: object) -> float:
    """A finite float of what was given under a name."""
    value = float(given) if isinstance(given, SupportsFloat) else math.nan
    require(math.isfinite(value), f"{name} = {given!r} is not a finite number; give a finite one")
    require(abs(value) <= MOST, f"{name} = {value:g} is larger than any number that has a meaning here")
    return value


def number(owner: object, name: str) -> float:
    """Make a field a finite float, in place."""
    value = finite(name, getattr(owner, name))
    object.__setattr__(owner, name, value)  # the only way to set a field of a frozen dataclass
    return value


def in_ranges(owner: object) -> None:
    """Make the fields that declare a range finite floats, in place, and refuse what is outside of it."""
    for name in ranges_of(type(owner)):
        given = getattr(owner, name)
        if isinstance(given, tuple | list):
            numbers(owner, name, len(given))
        elif given is not None:
            number(owner, name)
    require_ranges(owner, SceneError)


def between(owner: object, name: str, least: float, most: float, unit: str) -> None:
    """Refuse a field that is outside of what any rig has."""
    value = getattr(owner, name)
    require(
        least <= value <= most, f"{name} = {value:g} is outside {least:g} … {most:g} {unit}, beyond any rig; mend it"
    )


MOST_SIDE = 16384
"""Rows or columns of a picture."""
MOST_PIXELS = 2**26
"""Of a picture, a camera or a projector; the largest cameras that watch a tank have a third of it."""


def picture_shape(shape: tuple[int, ...]) -> None:
    """Refuse what is no shape of a picture, before anybody makes an array of it."""
    require(
        len(shape) == 2 and min(shape) >= 1 and max(shape) <= MOST_SIDE,
        f"shape = {list(shape)} is no picture; give [rows, columns] between 1 and {MOST_SIDE}",
    )
    require(
        shape[0] * shape[1] <= MOST_PIXELS,
        f"shape = {list(shape)} has more than the {MOST_PIXELS} pixels that there may be; give fewer",
    )


def numbers(owner: object, name: str, count: int) -> tuple[float, ...]:
    """Make a field a tuple of `count` finite floats, in place."""
    given = tuple(getattr(owner, name))
    require(len(given) == count, f"{name} = {list(given)} has {len(given)} numbers; give {count}")
    values = tuple(finite(f"{name}[{index}]", value) for index, value in enumerate(given))
    object.__setattr__(owner, name, values)
    return values

"""Checks of the fields of what a scene is made of: each refusal is one sentence."""

import math
from typing import SupportsFloat

from tankrig.errors import SceneError

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
    return value


def number(owner: object, name: str) -> float:
    """Make a field a finite float, in place."""
    value = finite(name, getattr(owner, name))
    object.__setattr__(owner, name, value)  # the only way to set a field of a frozen dataclass
    return value


def numbers(owner: object, name: str, count: int) -> tuple[float, ...]:
    """Make a field a tuple of `count` finite floats, in place."""
    given = tuple(getattr(owner, name))
    require(len(given) == count, f"{name} = {list(given)} has {len(given)} numbers; give {count}")
    values = tuple(finite(f"{name}[{index}]", value) for index, value in enumerate(given))
    object.__setattr__(owner, name, values)
    return values

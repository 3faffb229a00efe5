"""Ranges of numbers, declared once beside the field that has them.

The field's dataclass refuses other numbers when it is made, in a file's own words; forms show the range.
"""

import dataclasses
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from numbers import Real
from typing import Annotated, Any

from tankrig.errors import TankrigError


@dataclass(frozen=True)
class Within:
    """What a number may be; stands in its field's type, as in `Annotated[float, Within(0.0, 1e8, "is no time; …")]`.

    Parameters
    ----------
    low, high
        The least and the largest that there may be.
    advice
        What is wrong with others, and what to give instead.
    above
        Whether `low` itself is refused.
    below
        Whether `high` itself is refused.
    beyond
        What is wrong with larger ones, where `advice` does not say it.
    """

    low: float
    high: float
    advice: str
    above: bool = False
    below: bool = False
    beyond: str = ""

    def holds(self, value: Any) -> bool:
        """Whether a number may be this; NaN may not.

        >>> [Within(0.0, 1.0, "", above=True).holds(value) for value in (0.0, 1.0, float("nan"))]
        [False, True, False]
        """
        if not isinstance(value, Real):
            return False
        number = float(value)
        low = self.low < number if self.above else self.low <= number
        return low and (number < self.high if self.below else number <= self.high)

    def refusal(self, value: Any) -> str:
        """What is wrong with a number, and what to give instead; empty where nothing is.

        >>> per_mm = Within(0.0, 1e6, "is negative; give 1/mm", beyond="is more than any liquid has; mend it")
        >>> [per_mm.refusal(value) for value in (-1.0, 0.5, 1e7)]
        ['is negative; give 1/mm', '', 'is more than any liquid has; mend it']
        """
        if self.holds(value):
            return ""
        return self.beyond if self.beyond and isinstance(value, Real) and float(value) > self.low else self.advice


def ranges_of(kind: type) -> Mapping[str, Within]:
    """The ranges that a dataclass declares, by field.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Wait:
    ...     seconds: Annotated[float, Within(0.0, 1e8, "is no time; give seconds")]
    ...     most: Annotated[float, Within(0.0, 1.0, "is no part")] | None = None
    >>> {name: (one.low, one.high) for name, one in ranges_of(Wait).items()}
    {'seconds': (0.0, 100000000.0), 'most': (0.0, 1.0)}
    """
    asked: Any = kind
    return _ranges_of(asked)


@cache
def _ranges_of(kind: Any) -> Mapping[str, Within]:
    hints = typing.get_type_hints(kind, include_extras=True)
    declared = {field.name: _declared(hints[field.name]) for field in dataclasses.fields(kind)}
    return {name: one for name, one in declared.items() if one is not None}


def _declared(hint: Any) -> Within | None:
    if typing.get_origin(hint) is Annotated:
        return next((one for one in hint.__metadata__ if isinstance(one, Within)), None)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return next((one for one in map(_declared, typing.get_args(hint)) if one is not None), None)
    return None


def require_ranges(owner: Any, error: type[TankrigError]) -> None:
    """Refuse the first field whose number, or one of whose numbers, is outside of its range; None is not looked at.

    Parameters
    ----------
    owner
        A dataclass that declares ranges.
    error
        What to raise.

    Raises
    ------
    TankrigError
        The kind that is given as `error`: the field's name, its value and the range's advice.
    """
    for name, within in ranges_of(type(owner)).items():
        value = getattr(owner, name)
        several = isinstance(value, tuple)
        for one in value if several else [value]:
            if one is not None and (refusal := within.refusal(one)):
                raise error(f"{name} = {list(value) if several else value} {refusal}")

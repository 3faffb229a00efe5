"""How well coefficients are to be known before a step stops projecting."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tankrig.errors import SequenceError
from tankrig.scene.description import CLOSED

_ORDER = ("sigma_a", "sigma_s", "g")
_SYMBOLS = {"sigma_a": "σa", "sigma_s": "σs", "g": "g"}


@dataclass(frozen=True)
class Until:
    """Standard deviations that are small enough, by the live fit of the dose under way.

    Parameters
    ----------
    sigma_a, sigma_s, g
        A share of the coefficient, such as "1 %", or a number in its own unit (1/mm; none for g); None where it does
        not matter.

    Examples
    --------
    >>> wish = Until(sigma_s="1 %", g=0.01)
    >>> str(wish)
    'σs known to 1 % and g to 0.01'
    >>> wish.reached({"sigma_a": 0.001, "sigma_s": 0.02, "g": 0.7, "sd": [1e-4, 1e-4, 0.02]})
    False
    """

    __pydantic_config__ = CLOSED
    sigma_a: str | float | None = None
    sigma_s: str | float | None = None
    g: str | float | None = None

    def __post_init__(self) -> None:
        if not dict(self._wishes()):
            raise SequenceError('until is empty; give what is to be known, such as { sigma_s = "1 %" }')

    def _wishes(self) -> Iterator[tuple[str, tuple[float, bool]]]:
        """Name, size and whether that is a share, of what matters."""
        for name in _ORDER:
            wish = getattr(self, name)
            if wish is not None:
                yield name, _parsed(name, wish)

    def reached(self, table: Mapping[str, Any]) -> bool:
        """Whether a dose's fit, as the live fit tells it, knows as much."""
        return all(
            table["sd"][_ORDER.index(name)] <= size * (abs(table[name]) if share else 1.0)
            for name, (size, share) in self._wishes()
        )

    def found(self, table: Mapping[str, Any]) -> str:
        """What such a fit knows, in words.

        Examples
        --------
        >>> Until(g=0.01).found({"g": 0.7, "sd": [1e-4, 1e-4, 0.004]})
        'g to 0.004 is known'
        """
        parts = []
        for name, (_, share) in self._wishes():
            sd = table["sd"][_ORDER.index(name)]
            value = abs(table[name])
            parts.append(
                f"{_SYMBOLS[name]} to {sd / value:.2%}" if share and value > 0.0 else f"{_SYMBOLS[name]} to {sd:.2g}"
            )
        return f"{' and '.join(parts)} {'is' if len(parts) == 1 else 'are'} known"

    def __str__(self) -> str:
        parts = [f"{size:.12g}" if not share else f"{100.0 * size:.12g} %" for _, (size, share) in self._wishes()]
        names = [_SYMBOLS[name] for name, _ in self._wishes()]
        head, *rest = [f"{name} known to {part}" if not k else f"{name} to {part}"
                       for k, (name, part) in enumerate(zip(names, parts, strict=True))]  # fmt: skip
        return " and ".join([head, *rest])


def _parsed(name: str, wish: str | float) -> tuple[float, bool]:
    share = isinstance(wish, str) and wish.rstrip().endswith("%")
    try:
        size = float(wish.rstrip().removesuffix("%")) / 100.0 if isinstance(wish, str) and share else float(wish)
    except ValueError:
        size = math.nan
    if not (0.0 < size < math.inf):
        raise SequenceError(
            f'until.{name} = {wish!r} is no standard deviation; give a share such as "1 %" or a positive number'
        )
    return size, share

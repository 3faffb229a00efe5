"""The forward model as a fit sees it: a function from a medium to an image and its derivatives."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.parameters import NAMES
from tankrig.scene import Medium

Image = NDArray[np.floating]
Forward = Callable[[Medium], Image]
"""Image of a medium; everything else about the scene is fixed."""
Slopes = Callable[[Medium], Image]
"""Derivatives of the image by σa, σs and g, shape (3, rows, columns)."""


Answer = TypeVar("Answer")


def remembered(forward: Callable[[Medium], Answer]) -> Callable[[Medium], Answer]:
    """The same function, answering at once for the few media asked for last."""
    return lru_cache(maxsize=8)(forward)


def slopes_of(forward: Forward, length_mm: float, step: float = 0.03) -> Slopes:
    """Derivatives of a forward model by central differences: six images, none where the last ones are near enough.

    One-sided differences would do to find an optimum, but their error makes directions look determined that are not.

    Parameters
    ----------
    forward
        Must be smooth in the medium: the same random numbers for every medium.
    length_mm
        Longest side of the tank. Absorption acts over paths of that order, so it is the scale on which σa = 0 is
        stepped away from.
    step
        Relative step; of (1 − g²) for g. Derivatives are used again within as much of where they were computed.

    Examples
    --------
    >>> square = lambda medium: np.full((1, 1), medium.sigma_s**2)
    >>> bool(np.isclose(slopes_of(square, 240.0)(Medium(0.0, 3.0, 0.0))[1, 0, 0], 6.0))
    True
    """
    last: list[tuple[Medium, Image]] = []

    def slopes(medium: Medium) -> Image:
        sizes = _steps(medium, step, length_mm)
        if last and all(
            abs(getattr(last[0][0], name) - getattr(medium, name)) <= size
            for name, size in zip(NAMES, sizes, strict=True)
        ):
            return last[0][1]
        found = [_slope(forward, medium, name, size) for name, size in zip(NAMES, sizes, strict=True)]
        last[:] = [(medium, np.stack(found))]
        return last[0][1]

    return slopes


def _slope(forward: Forward, medium: Medium, name: str, size: float) -> Image:
    at = getattr(medium, name)
    above = forward(replace(medium, **{name: at + size}))
    if name == "g" or at >= size:
        return (above - forward(replace(medium, **{name: at - size}))) / (2.0 * size)
    # Next to σ = 0 only one side exists.
    far = forward(replace(medium, **{name: at + 2.0 * size}))
    slope: Image = (4.0 * above - 3.0 * forward(medium) - far) / (2.0 * size)
    return slope


def _steps(medium: Medium, step: float, length_mm: float) -> tuple[float, float, float]:
    """Step of each coefficient, in the order of `NAMES`."""
    absorption = max(step * medium.sigma_a, 0.5 * step / length_mm)
    return absorption, step * medium.sigma_s, step * (1.0 - medium.g) * (1.0 + medium.g)

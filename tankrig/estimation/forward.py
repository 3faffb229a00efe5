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
Linearised = Callable[[Medium], tuple[Image, Image]]
"""Image and its derivatives by σa, σs and g, shape (3, rows, columns)."""


Answer = TypeVar("Answer")


def remembered(forward: Callable[[Medium], Answer]) -> Callable[[Medium], Answer]:
    """The same function, answering at once for the few media asked for last."""
    return lru_cache(maxsize=8)(forward)


def differentiated(forward: Forward, length_mm: float, step: float = 0.02, central: bool = False) -> Linearised:
    """Add derivatives to a forward model by differences: four images in all, or seven.

    Parameters
    ----------
    forward
        Must be smooth in the medium: the same random numbers for every medium.
    length_mm
        Longest side of the tank. Absorption acts over paths of that order, so it is the scale on which σa = 0 is
        stepped away from.
    step
        Relative step; of (1 − g²) for g.
    central
        Differences of second order. First-order ones are good enough to find an optimum, but their error makes
        directions look determined that are not.

    Examples
    --------
    >>> square = lambda medium: np.full((1, 1), medium.sigma_s**2)
    >>> linearise = differentiated(square, 240.0, central=True)
    >>> bool(np.isclose(linearise(Medium(0.0, 3.0, 0.0))[1][1, 0, 0], 6.0))
    True
    """

    def linearise(medium: Medium) -> tuple[Image, Image]:
        image = forward(medium)
        sizes = _steps(medium, step, length_mm)
        slopes: list[Image] = []
        for name, size in zip(NAMES, sizes, strict=True):
            at = getattr(medium, name)
            near = forward(replace(medium, **{name: at + size}))
            if not central:
                slopes.append((near - image) / size)
            elif name == "g" or at >= size:
                slopes.append((near - forward(replace(medium, **{name: at - size}))) / (2.0 * size))
            else:  # next to σ = 0, where only one side exists
                far = forward(replace(medium, **{name: at + 2.0 * size}))
                slopes.append((4.0 * near - 3.0 * image - far) / (2.0 * size))
        return image, np.stack(slopes)

    return linearise


def _steps(medium: Medium, step: float, length_mm: float) -> tuple[float, float, float]:
    """Step of each coefficient, in the order of `NAMES`."""
    absorption = max(step * medium.sigma_a, 0.5 * step / length_mm)
    return absorption, step * medium.sigma_s, step * (1.0 - medium.g) * (1.0 + medium.g)

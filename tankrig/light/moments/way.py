"""Whether a scene's high orders are solved for, and on what cells, with how many degrees, from which order on."""

import math
from dataclasses import dataclass

from tankrig.light.rays import shift_invariant
from tankrig.scene import Scene

DENSEST_CELL = 0.5
"""Sides of cells in free paths; measured error in the worst case (σt = .1, ϖ = .999, g = 0): .4 % at .5, .8 % at .6."""
FEWEST_CELLS = 15
MOST_CELLS = 26
"""Cells along the tank's shortest side."""


@dataclass(frozen=True)
class Way:
    """How the orders above some are solved for.

    Parameters
    ----------
    above
        Highest order that is left to paths.
    degree
        Highest degree of the moments.
    side_mm
        Of the cells, about.
    batches
        Lattices of paths that make the source.
    bound
        On the error, relative L2 of the whole image.
    """

    above: int
    degree: int
    side_mm: float
    batches: int
    bound: float


def dense_way(scene: Scene, tolerance: float) -> Way | None:
    """The way for a scene, or None where paths serve it better.

    Solved for are scenes that paths would take seconds for: deep in free paths and in transport free paths, with
    collimated light and an orthographic camera.

    Parameters
    ----------
    scene
        Any scene.
    tolerance
        Relative L2 error of the image to stay below.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> camera = Camera("orthographic", (80, 120), 2.0)
    >>> dense_way(Scene(Tank(), Medium(0.0001, 0.0999, 0.5), light, camera), 0.01).degree
    2
    >>> dense_way(Scene(Tank(), Medium(0.0001, 0.0099, 0.5), light, camera), 0.01) is None
    True
    """
    medium, g = scene.medium, abs(scene.medium.g)
    shortest = min(scene.tank.size_mm)
    depth = medium.sigma_t * shortest
    degree = 0 if g < 0.02 else 1 if g < 0.3 else 2 if g < 0.72 else 3 if g < 0.8 else 4
    shallow = depth < (5.0 if degree < 2 else 7.0) or depth * (1.0 - medium.g) < 1.5
    if shallow or not -0.02 < medium.g < 0.87 or not shift_invariant(scene):
        return None
    above = 3 if degree == 0 else 5  # fewer scatterings leave beams narrower than cells
    while above < 12 and g ** ((degree + 1) * above) > 0.004:
        above += 1
    scaled = medium.sigma_t - medium.g ** (degree + 1) * medium.sigma_s
    cells = min(max(shortest * scaled / DENSEST_CELL, FEWEST_CELLS), MOST_CELLS)
    side = shortest / cells
    batches = 6 if g < 0.6 else 12 if g < 0.8 else 24
    angular, spatial = 0.6 * g ** ((degree + 1) * above), 0.002 + 0.036 * (side * scaled) ** 3
    if 0.55 < g < 0.8:
        angular += 0.009  # measured 1 % at σt = .12, ϖ = .999, g = .7 with degree 2
    noise = 0.015 * (g / 0.85) ** 4 / math.sqrt(batches)
    bound = math.hypot(math.hypot(angular, spatial), noise)
    return Way(above, degree, side, batches, bound) if bound <= 0.75 * tolerance else None

"""Parts of a scene's light that one table of order 2 serves each, and how it is filled for them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tankrig.light.double.table import COARSE, FINE, Fineness, Stack, Table, fill_stack
from tankrig.light.rays import Geometry, light_sources
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.description import Interval

Array = NDArray[np.float64]

MOST_HEIGHTS = 4
"""Heights at most whose beams have a table each; more share one, as those of a projector's picture do."""
COARSE_FROM = 0.005
"""Tolerance from which coarse tables are enough."""


@dataclass(frozen=True)
class LitHeight:
    """Beams whose order 2 one table serves.

    Parameters
    ----------
    geometry
        Numbers of the scene, of the source that the beams come from.
    beams
        Those of the height `z_mm`; where `shared`, all of the source's.
    z_mm
        (low, high) of each beam; where `shared`, from the lowest to the highest of them.
    mirrored
        Whether the light goes by way of the surface between its two scatterings.
    shared
        Whether the beams have different heights, too many for a table each.
    """

    geometry: Geometry
    beams: tuple[Beam, ...]
    z_mm: Interval
    mirrored: bool
    shared: bool


def lit_heights(scene: Scene) -> Iterator[LitHeight]:
    """Parts whose sum is a scene's order 2: by source, height, and whether light goes by way of the surface between."""
    for geometry, beams in light_sources(scene):
        ways = (False, True) if geometry.refractive_index > 1.0 else (False,)
        heights = sorted({beam.z_mm for beam in beams})
        shared = len(heights) > MOST_HEIGHTS
        if shared:
            heights = [(heights[0][0], max(top for _, top in heights))]
        for z_mm, mirrored in product(heights, ways):
            of_height = tuple(beam for beam in beams if shared or beam.z_mm == z_mm)
            yield LitHeight(geometry, of_height, z_mm, mirrored, shared)


def filled(scene: Scene, media: Sequence[Medium], lit: LitHeight, tolerance: float) -> tuple[Table, Stack, Array]:
    """The table of a part of the light in several liquids, J at its nodes, and weights of its rays over the height."""
    given = lit.geometry, lit.z_mm, lit.mirrored, finest_of(scene), fineness_of(tolerance), lit.shared
    return fill_stack(scene, media, *given)


def fineness_of(tolerance: float) -> Fineness:
    """How close a table's nodes have to be."""
    return COARSE if tolerance >= COARSE_FROM else FINE


def finest_of(scene: Scene) -> float:
    """Length below which the image of a scene with a plain camera need not be resolved, mm."""
    return min(scene.camera.pixel_mm, scene.tank.size_mm[0] / 20.0)

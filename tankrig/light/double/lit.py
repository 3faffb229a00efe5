"""Parts of a scene's light that one table of order 2 serves each, and how it is filled for them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tankrig.light.double.filling import fill_stack
from tankrig.light.double.fineness import COARSE, FEW_APART, FINE, GLANCE, ROUGH, ROUGHEST, Fineness
from tankrig.light.double.table import LitHeight, Stack, Table
from tankrig.light.rays import light_sources
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

MOST_HEIGHTS = 4
"""Heights at most whose beams have a table each; more share one, as those of a projector's picture do."""
COARSE_FROM, ROUGH_FROM, ROUGHEST_FROM, GLANCE_FROM = 0.005, 2.0, 3.0, 4.0
"""Tolerances from which tables are coarse, and rough, and as rough as can be, and a glance. Images are asked for with 1
at most; the next two are for order 2 where there is little of it, the last tells how little."""


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


def filled(
    scene: Scene, media: Sequence[Medium], lit: LitHeight, tolerance: float, others: Sequence[PhaseFunction] = (),
    little: bool = False,
) -> tuple[Table, Stack, Array]:  # fmt: skip
    """The table of a part of the light in several liquids, J at its nodes, and weights of its rays over the height.

    `others` as for `fill_stack`, `little` as for `double_scattering_of`.
    """
    fineness = fineness_of(tolerance)
    if little:
        fineness = replace(fineness, most_apart=FEW_APART)
    return fill_stack(scene, media, lit, finest_of(scene), fineness, others)


def fineness_of(tolerance: float) -> Fineness:
    """How close a table's nodes have to be."""
    for least, rough in ((GLANCE_FROM, GLANCE), (ROUGHEST_FROM, ROUGHEST), (ROUGH_FROM, ROUGH), (COARSE_FROM, COARSE)):
        if tolerance >= least:
            return rough
    return FINE


def finest_of(scene: Scene) -> float:
    """Length below which the image of a scene with a plain camera need not be resolved, mm."""
    return min(scene.camera.pixel_mm, scene.tank.size_mm[0] / 20.0)

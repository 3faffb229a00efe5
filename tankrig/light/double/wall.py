"""Tables of order 2 for all light that enters within a height of the wall, whatever its pattern."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tankrig.light.double.lit import filled, fineness_of, finest_of, lit_heights
from tankrig.light.double.nodes import hardest, laid_out, peaked
from tankrig.light.double.table import LitHeight, Stack, Table
from tankrig.light.rays import light_sources
from tankrig.light.surface import on_surface
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.description import Interval

EDGE_MM = 1e-6
"""By which a beam may be beyond a table's height."""


@dataclass(frozen=True)
class Tabulated:
    """A table of J, and the beams that it serves.

    Parameters
    ----------
    lit
        The beams, with `shared`.
    finest_mm
        Length below which it need not resolve images.
    table, stack
        The table.
    """

    lit: LitHeight
    finest_mm: float
    table: Table
    stack: Stack


def tables_of_wall(scene: Scene, z_mm: Interval, media: Sequence[Medium], tolerance: float) -> list[Tabulated]:
    """J of light that enters anywhere within a height of the wall, for `double_scattering_of` of any pattern there.

    Parameters
    ----------
    scene
        Tank, projector and camera; its beams and its medium do not matter.
    z_mm
        Low and high.
    media
        The liquids.
    tolerance
        As for `double_scattering`.
    """
    wall, found = _wall_alone(scene, z_mm), []
    for one in lit_heights(wall):
        lit = replace(one, shared=True)
        table, stack, _ = filled(wall, media, lit, tolerance)
        found.append(Tabulated(lit, finest_of(wall), table._replace(values=np.zeros((0,) * 5)), stack))
    return found


def numbers_of_wall(scene: Scene, z_mm: Interval, media: Sequence[Medium], tolerance: float) -> int:
    """How many numbers the tables have that `tables_of_wall` makes of these."""
    wall = _wall_alone(scene, z_mm)
    given = [(one.geometry, one.z_mm, one.mirrored) for one in lit_heights(wall)]
    fineness = fineness_of(tolerance)
    lit = replace(wall, medium=hardest(media))
    sharp = any(peaked(one) for one in media)
    return len(media) * sum(laid_out(lit, *one, finest_of(wall), fineness, True, sharp)[0].values.size for one in given)


def _wall_alone(scene: Scene, z_mm: Interval) -> Scene:
    """The scene with a plain camera, and light from side wall to side wall."""
    plain = on_surface(scene)
    half = 0.5 * scene.tank.size_mm[1]
    return replace(plain, projector=replace(plain.projector, beams=(Beam((-half, half), z_mm),)))


def served(scene: Scene, known: Sequence[Tabulated]) -> tuple[list[Tabulated], Scene | None]:
    """The tables that serve a scene with a plain camera, each with its beams, and the scene with all other beams.

    None where there are no others.
    """
    if not known or known[0].finest_mm > (1.0 + 1e-9) * finest_of(scene):
        return [], scene
    low, high = known[0].lit.z_mm
    all_beams = scene.projector.beams
    inside = tuple(one for one in all_beams if low - EDGE_MM <= one.z_mm[0] and one.z_mm[1] <= high + EDGE_MM)
    if not inside:
        return [], scene
    found = []
    for geometry, beams in light_sources(replace(scene, projector=replace(scene.projector, beams=inside))):
        of_source = [replace(one, lit=replace(one.lit, beams=beams)) for one in known if one.lit.geometry == geometry]
        if not of_source:
            return [], scene
        found += of_source
    outside = tuple(beam for beam in all_beams if beam not in inside)
    return found, replace(scene, projector=replace(scene.projector, beams=outside)) if outside else None

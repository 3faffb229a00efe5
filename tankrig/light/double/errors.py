"""What the tables of order 2 err by, and where rough ones may be looked at."""

from tankrig.light.double.fineness import STEEP_G
from tankrig.light.double.lit import COARSE_FROM, ROUGH_FROM, ROUGHEST_FROM, finest_of, lit_heights
from tankrig.light.double.nodes import peaked, rays_apart
from tankrig.light.rays import light_ray, light_sources, shift_invariant
from tankrig.scene import Scene

GRAZING, GRAZING_ERROR = 0.05, 0.04
"""Sine of the angle between light and the wall below which tables are that wrong."""
PEAKED_ERROR = 0.003
"""What they err by where forward peaks are sharp."""
ROUGH_ERRORS = {ROUGHEST_FROM: 0.014, ROUGH_FROM: 0.0095}
"""What rough tables err by, relative L2 of order 2, by their tolerance; the roughest first."""
MUCH_PER_MM = 0.02
"""σs from which there is so much of order 2 that rough tables don't do, and how much isn't looked at."""


def table_error(scene: Scene, tolerance: float) -> float:
    """What the tables of a tolerance err by, relative L2 of orders 1 and 2.

    Coarse ones were off by .006 (thin) to .055 % (dense, g .85) on a bench, where fine ones are off by a few 1e-5.
    Where lines slant, fine ones are off by .05 % (two pinholes, g −.35, beside order 2 by an independent program),
    coarse ones by .1; where light of g .95 leaves through a side wall by .07 and .12 % (six beams through glass).
    Where rays of one beam are seen apart, as near pinholes have them, by up to .23 % (six scenes beside the independent
    program); where forward peaks are sharp by .3 of order 2, whether lines slant or not (Fournier and Forand's, net of
    that program's noise); where light grazes the wall it enters through by 3.8.
    """
    fine = tolerance < COARSE_FROM
    if _grazes(scene):
        return GRAZING_ERROR
    if peaked(scene.medium):
        return PEAKED_ERROR
    if shift_invariant(scene):
        return 0.0001 if fine else 0.0005
    if _seen_apart(scene):
        return 0.0025
    if scene.medium.g >= STEEP_G:
        return 0.001 if fine else 0.0015
    return 0.0005 if fine else 0.001


def may_be_rough(scene: Scene, tolerance: float) -> bool:
    """Whether rough tables are worth a look: where lines slant, for a plain camera, and nothing wants finer ones."""
    return (
        tolerance >= COARSE_FROM
        and scene.medium.sigma_s < MUCH_PER_MM
        and scene.camera.kind != "calibrated"
        and not (shift_invariant(scene) or _grazes(scene) or peaked(scene.medium) or _seen_apart(scene))
    )


def _seen_apart(scene: Scene) -> bool:
    """Whether rays of one beam are seen so far apart that its height has more of them (`rays_apart`)."""
    finest = finest_of(scene)
    return any(
        rays_apart(scene, one.geometry, one.z_mm, finest) > 0
        for one in lit_heights(scene)
        if not (one.mirrored or one.shared)
    )


def _grazes(scene: Scene) -> bool:
    """Whether light enters at less than a few degrees from the wall."""
    geometry, beams = light_sources(scene)[0]
    if not geometry.light_pinhole or not beams:
        return False
    farthest_y = min(beam.y_mm[0] for beam in beams), max(beam.y_mm[1] for beam in beams)
    farthest_z = min(beam.z_mm[0] for beam in beams), max(beam.z_mm[1] for beam in beams)
    return min(light_ray(geometry, y0, z0)[0] for y0 in farthest_y for z0 in farthest_z) < GRAZING

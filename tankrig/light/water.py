"""The water as kernels read it."""

from typing import NamedTuple

from tankrig.scene import Medium
from tankrig.scene.phase_table import PhaseRecord


class Water(NamedTuple):
    """A medium for kernels."""

    sigma_t: float
    """Extinction, 1/mm."""
    albedo: float
    phase: PhaseRecord


def water_of(medium: Medium) -> Water:
    """A medium for kernels.

    Examples
    --------
    >>> water_of(Medium(0.005, 0.015, 0.5)).albedo
    0.75
    """
    return Water(float(medium.sigma_t), float(medium.albedo), medium.phase_function.record)


def water_for_paths(medium: Medium) -> Water:
    """A medium for kernels that follow paths, see `tankrig.scene.phase_table.PhaseFunction.path_record`."""
    return water_of(medium)._replace(phase=medium.phase_function.path_record)

"""By how much what is not measured may be off."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tankrig.checked_toml import MOST
from tankrig.errors import CalibrationError
from tankrig.ranges import Within, require_ranges
from tankrig.scene.checks import CLOSED

WITHIN = 1.0 / np.sqrt(3.0)
"""Standard deviation of what lies anywhere within ± 1 (rectangular distribution; GUM 4.3.7)."""

Tolerance = Annotated[float, Within(0.0, MOST, "is no tolerance; give a number from 0 up")]


@dataclass(frozen=True)
class Tolerances:
    """What the geometry takes for granted lies within these of the truth, either way, and anywhere there.

    Parameters
    ----------
    water_index
        Refractive index of the water; 0.0005 are 5 °C, or 3 g of salt to the litre.
    wall_index, wall_mm
        Refractive index and thickness of the wall's glass.
    laid_mm, laid_deg
        Place of the board that is laid into the corner of the floor, along each wall, and how far it is turned there.
    surface_deg
        How far the water's surface leans from the tank's floor, about x and about y.
    """

    __pydantic_config__ = CLOSED
    water_index: Tolerance = 0.0005
    wall_index: Tolerance = 0.003
    wall_mm: Tolerance = 0.05
    laid_mm: Tolerance = 0.1
    laid_deg: Tolerance = 0.05
    surface_deg: Tolerance = 0.05

    def __post_init__(self) -> None:
        require_ranges(self, CalibrationError)


USUAL = Tolerances()

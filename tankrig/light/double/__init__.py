"""Order 2: light scattered exactly twice, without noise.

    I₂ = T σs² Σ_beams ∫ dy₀ dz₀ E₀(y₀, z₀) J(line of sight, light ray (y₀, z₀))

averaged over the pixel (the paper's Eq. 13 at N = 2, in the tank and not in infinite space: in a convex black tank a
straight way between two points inside stays inside). With a Fresnel surface the light may be reflected there
between its two scatterings: the same integral with the line of sight mirrored and R(ξ) as a factor.
"""

from tankrig.light.double.errors import ROUGH_ERRORS, may_be_rough, table_error
from tankrig.light.double.image import double_scattering, double_scattering_of
from tankrig.light.double.lit import GLANCE_FROM
from tankrig.light.double.wall import Tabulated, numbers_of_wall, tables_of_wall

__all__ = [
    "GLANCE_FROM", "ROUGH_ERRORS", "Tabulated", "double_scattering", "double_scattering_of", "may_be_rough",
    "numbers_of_wall", "table_error", "tables_of_wall",
]  # fmt: skip

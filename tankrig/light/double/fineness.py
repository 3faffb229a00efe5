"""How finely J is tabulated: for accurate images, for coarse ones, and for rough ones of little light."""

from dataclasses import dataclass, replace

MOST_APART, FEW_APART = 24, 4
"""How many more rays at most stand for a height whose rays are seen apart; and where the light is little, see
`double_scattering_of`."""


@dataclass(frozen=True)
class Fineness:
    """How finely J is tabulated.

    Parameters
    ----------
    nodes
        Of the Gauss–Legendre rule in every panel; of other phase functions than Henyey–Greenstein's at least as many as
        of fine tables, for rules of three pass by Mie's lobes: order 2 of beads of 2 µm was .9 % too faint.
    ratio, slanted_ratio
        Of successive nodes in δ; the latter where lines of sight or light rays slant, and leave the tank through its
        side walls.
    curvature, slanted_curvature
        Error of order 2 up to which one ray stands for a beam's whole height; the latter where lines slant, and what is
        higher is seen elsewhere.
    more_rays
        Beyond it, so many more than the height asks for.
    slanted_near
        Where lines slant: the first node in δ, in lengths below which the image need not be resolved.
    mirrored
        Power of the ratio for light by way of the surface, which comes from afar and changes slowly.
    apart
        Where lines slant and the light goes on less than steeply (g < `STEEP_G`): how many times farther apart nodes in
        y₀ are.
    most_apart
        How many more rays stand at most for a height whose rays are seen apart, see `rays_apart`.
    along
        Where lines slant: how many times farther apart nodes in x are.
    """

    nodes: int
    ratio: float
    slanted_ratio: float
    curvature: float
    slanted_curvature: float
    more_rays: int = 2
    slanted_near: float = 0.02
    mirrored: float = 1.0
    apart: float = 1.0
    most_apart: int = MOST_APART
    along: float = 1.0


FINE = Fineness(nodes=5, ratio=1.45, slanted_ratio=1.3, curvature=0.001, slanted_curvature=0.0003)
"""Errs by 0.04 % of orders 1 and 2 at most (nine scenes, g −0.4…0.95, both projectors and cameras), but where light of
g .95 slants: see `table_error`. One ray for pinholes' beams of 4.5 mm made order 2 .12 % too faint, .35 % off."""
COARSE = Fineness(
    nodes=3, ratio=1.6, slanted_ratio=1.7, curvature=0.004, slanted_curvature=0.0012,
    more_rays=1, slanted_near=0.05, mirrored=2.0, apart=2.0,
)  # fmt: skip
"""Errs by 0.1 % at most, in less than half the time, and in a fifth of it where lines slant: there, of 66 random
scenes, by .15 % of order 2 in the median, .32 in nine of ten, and .045 and .08 % of orders 1 and 2. Two rays for beams
of 3.7 to 5.2 mm took a sixth longer and erred as much; with a finest length twice as long nine of ten are within .13.
"""
ROUGH = replace(COARSE, slanted_ratio=2.0, slanted_near=0.1)
ROUGHEST = replace(ROUGH, nodes=2, slanted_curvature=0.003, apart=3.0)
"""Where lines slant, in a half and a quarter of the coarse ones' time: of 33 random scenes they err by .23 and .55 % of
order 2 in the median and by .95 and 1.4 % at most, but the latter by 2 % where there is three times more of it."""
GLANCE = replace(
    ROUGHEST, slanted_ratio=4.0, slanted_curvature=0.1, slanted_near=0.5, apart=12.0, along=8.0
)  # fmt: skip
"""To tell how much of order 2 there is, in a quarter of the roughest ones' time: of 69 random scenes within 4.1 %."""
STEEP_G = 0.9
"""Mean cosine from which J changes too much with y₀ for that: order 2 would be off by .17 instead of .12 % at g .95."""

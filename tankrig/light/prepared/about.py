"""A box of media about a liquid that is foreseen, or about what was found: what a model of one dose answers for."""

import math

from tankrig.light.prepared.box import Box
from tankrig.scene import Medium

DENSITY_ROOM, DENSITY_GRID = 1.2, 1.1
"""Factor beyond the density foreseen at either side; edges are then rounded outwards to powers of the grid."""
ASYMMETRY_ROOM, ASYMMETRY_GRID = 0.07, 0.05
ALBEDOS = (0.8, 0.5, 0.2, 0.02)
"""Lower edges of the albedo, of which the highest is taken that leaves room for twice the absorption foreseen."""
MOST_ALBEDO = 0.9999
EDGES = (5e-5, 0.5), (-0.9, 0.97)
"""Lowest and highest σt and g for which models are prepared."""
WELL_INSIDE = 1.05, 0.02
"""Factor in σt, and distance in g, from its edges within which a box is taken to hold a liquid foreseen."""


def box_for(liquid: Medium) -> Box:
    """Media that a dose can give when `liquid` is foreseen.

    One small box for each dose: a model for σt from 0.001 to 0.035 errs by ten times as much (decision 216). Edges are
    rounded, so that the next run with the same ink finds its models prepared.

    Examples
    --------
    >>> box_for(Medium(5e-4, 0.01, 0.7))
    Box(sigma_t=(0.0085..., 0.0137...), albedo=(0.8, 0.9999), g=(0.6, 0.8))
    """
    (least, most), (backward, forward) = EDGES
    step = math.log(DENSITY_GRID)
    sigma_t = min(max(liquid.sigma_t, 1.5 * least), most / 1.5)
    low = math.exp(math.floor(math.log(max(sigma_t / DENSITY_ROOM, least)) / step) * step)
    high = math.exp(math.ceil(math.log(min(sigma_t * DENSITY_ROOM, most)) / step) * step)
    g = min(max(liquid.g, backward + ASYMMETRY_ROOM), forward - ASYMMETRY_ROOM)
    g_low = math.floor(round((g - ASYMMETRY_ROOM) / ASYMMETRY_GRID, 6)) * ASYMMETRY_GRID
    g_high = math.ceil(round((g + ASYMMETRY_ROOM) / ASYMMETRY_GRID, 6)) * ASYMMETRY_GRID
    asymmetry = round(max(g_low, backward), 4), round(min(g_high, forward), 4)
    albedo = next((one for one in ALBEDOS if one < 1.0 - 2.0 * (1.0 - liquid.albedo)), ALBEDOS[-1])
    return Box((round(low, 9), round(high, 9)), (albedo, MOST_ALBEDO), asymmetry)


def holds(box: Box, liquid: Medium) -> bool:
    """Whether a liquid is well inside a box."""
    factor, distance = WELL_INSIDE
    return (
        box.sigma_t[0] * factor <= liquid.sigma_t <= box.sigma_t[1] / factor
        and box.g[0] + distance <= liquid.g <= box.g[1] - distance
        and liquid.albedo > box.albedo[0]
    )

"""From the table of J to pixels: averages over the pixel's rows and the beam's width.

For a beam between the rays y₀ = a and b, which are seen at the rows y_c(a) and y_c(b), the average over a pixel's rows
is ∫ dδ w(δ) J(δ), with w the overlap of the pixel, moved by δ, and the beam as it is seen: a trapezoid. Near the beam
the integral is cut at the trapezoid's corners and at δ = 0 and graded about it; far from it two nodes do.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.double.pair import depth_below, share_seen
from tankrig.light.rays import Geometry, sighting_row

Array = NDArray[np.float64]

FAR = 3.0
"""A beam is far from a pixel at this many times the width of both."""


@kernel
def average_rows(
    rows: Array, geometry: Geometry, pixel_mm: float, decay: float, low: float, high: float, strength: float,
    x: Array, fractions: Array, margin: float, values: Array, y0_weights: Array, z0: Array, z0_weights: Array,
    mirrored: bool, nodes: Array, weights: Array,
) -> None:  # fmt: skip
    """Add one beam's rows, at every node in x.

    Parameters
    ----------
    rows
        (rows, nx), added to: radiance averaged over the rows' height, at the nodes in x.
    low, high
        Edges of the beam on the plane x = 0, mm; a beam should not be much wider than the change of J with y₀ allows.
    strength
        Irradiance times σs².
    x, fractions, margin, values
        Of the table.
    y0_weights
        (ny,) weights that interpolate the table to the beam's middle.
    z0, z0_weights
        Where the beam's rays enter, and the weights that integrate over its height.
    mirrored
        Whether the table is of light by way of the surface.
    nodes, weights
        Gauss–Legendre rule on [−1, 1].
    """
    count = fractions.size
    first = math.log(fractions[0] / (1.0 + margin - fractions[0]))
    spacing = (-math.log(margin) - first) / (count - 1)
    profile = np.empty((2, count))
    cuts = np.empty(5)
    middle = 0.5 * (low + high)
    for j in range(z0.size):
        for i in range(x.size):
            for side in range(2):
                for k in range(count):
                    profile[side, k] = 0.0
                    for m in range(y0_weights.size):
                        profile[side, k] += y0_weights[m] * values[j, m, side, i, k]
            crossing = sighting_row(geometry, x[i], middle, z0[j])
            beam_low = sighting_row(geometry, x[i], low, z0[j])
            beam_high = sighting_row(geometry, x[i], high, z0[j])
            seen = beam_high - beam_low
            below = depth_below(geometry, x[i], middle, z0[j], mirrored)
            spans = (max(geometry.half_width + crossing, 1e-6), max(geometry.half_width - crossing, 1e-6))
            if values[j, 0, 0, i, 0] == values[j, 0, 1, i, 0]:
                spans = (2.0 * geometry.half_width, 2.0 * geometry.half_width)
            # Flux per row seen: the beam's width over its width as seen; per pixel: over the pixel.
            scale = strength * z0_weights[j] * (high - low) / (seen * pixel_mm) * math.exp(-decay * x[i])
            for row in range(rows.shape[0]):
                pixel_low = row * pixel_mm - geometry.half_width
                if pixel_low >= geometry.half_width:
                    break
                pixel_high = min(pixel_low + pixel_mm, geometry.half_width)
                pixel = pixel_high - pixel_low
                centre = 0.5 * (pixel_low + pixel_high) - 0.5 * (beam_low + beam_high)
                total = 0.0
                if abs(centre) > FAR * (pixel + seen):
                    spread = math.sqrt((pixel * pixel + seen * seen) / 12.0)
                    near = _profile(profile, spans, centre - spread, first, spacing, margin, decay)
                    far = _profile(profile, spans, centre + spread, first, spacing, margin, decay)
                    total = 0.5 * (near + far) * pixel * seen
                else:
                    cuts[0], cuts[1] = pixel_low - beam_high, pixel_low - beam_low
                    cuts[2], cuts[3] = pixel_high - beam_high, pixel_high - beam_low
                    cuts[4] = min(max(0.0, pixel_low - beam_high), pixel_high - beam_low)
                    cuts.sort()
                    for k in range(4):
                        start, end = cuts[k], cuts[k + 1]
                        panel_start = start
                        while end - panel_start > 1e-9:
                            panel_end = _panel_end(panel_start, end, pixel)
                            half = 0.5 * (panel_end - panel_start)
                            for n in range(nodes.size):
                                delta = panel_start + half * (1.0 + nodes[n])
                                overlap = min(pixel_high - delta, beam_high) - max(pixel_low - delta, beam_low)
                                total += (
                                    half * weights[n] * max(overlap, 0.0)
                                    * _profile(profile, spans, delta, first, spacing, margin, decay)
                                )  # fmt: skip
                            panel_start = panel_end
                share = 0.0
                for n in range(nodes.size):
                    y = 0.5 * (pixel_low + pixel_high + pixel * nodes[n])
                    share += 0.5 * weights[n] * share_seen(geometry, x[i], y, abs(y - crossing), below)
                rows[row, i] += scale * total * share


@kernel
def _panel_end(start: float, end: float, pixel: float) -> float:
    """End of a panel that is graded about δ = 0, where J is singular."""
    finest = 0.04 * pixel
    if start >= 0.0:
        return min(end, start + max(finest, 2.0 * start))
    reach = -start  # towards zero in thirds
    if reach <= finest:
        return min(end, 0.0)
    return min(end, start + (2.0 / 3.0) * reach)


@kernel
def _profile(
    profile: Array, spans: tuple[float, float], delta: float, first: float, spacing: float, margin: float, decay: float
) -> float:
    """J at δ by cubic interpolation between the nodes; nearer than the first it grows like −ln|δ|."""
    side = 1 if delta > 0.0 else 0
    distance = abs(delta)
    count = profile.shape[1]
    share = min(max(distance, 1e-12) / spans[side], 1.0)
    place = (math.log(share / (1.0 + margin - share)) - first) / spacing
    if place < 0.0:
        near: float = profile[side, 0] + place * (profile[side, 1] - profile[side, 0])
        return near * math.exp(-decay * distance)
    place = min(place, count - 1.0)
    k = min(max(int(place) - 1, 0), count - 4)
    t = place - k
    a, b, c, d = t, t - 1.0, t - 2.0, t - 3.0
    value: float = (
        -b * c * d / 6.0 * profile[side, k]
        + a * c * d / 2.0 * profile[side, k + 1]
        - a * b * d / 2.0 * profile[side, k + 2]
        + a * b * c / 6.0 * profile[side, k + 3]
    )
    return value * math.exp(-decay * distance)

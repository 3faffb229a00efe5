"""J: how much light goes from a ray of the projector by way of two scatterings into a line of sight.

For a light ray A(s) = A₀ + s u and a line of sight C(t), t measured down from the surface,

    J = ∫∫ ds dt exp(−σt (s + r + t)) p(u·r̂) p(r̂·v) / r²,   r = C(t) − A(s).

Every millimetre of radius around r = 0 counts equally, so J is integrated in the variables in which 1/r² is gone:
h = d tan α along the light ray (h the way from first collision to the foot of C on the ray, d its distance), and
t − t₀ = (d₀/sin γ) sinh τ along the line of sight (d₀ the lines' closest distance, γ their angle).
What is left is smooth but for the lobes of p about u and v, about which the panels of the quadrature are graded.
In T = tan(α/2) all of it is rational but for one exponential: sin α = 2T/(1 + T²), and the way back along the ray and
across to C is d (1 − T)/(1 + T) longer than h.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import reflectance
from tankrig.light.elementary import exponential
from tankrig.light.quadrature import Rule
from tankrig.light.rays import (
    Geometry,
    light_kept,
    light_ray,
    path_inside,
    sight_line,
    sighting_row,
)
from tankrig.scene.phase import phase_density
from tankrig.scene.phase_table import PhaseRecord

Array = NDArray[np.float64]

PANEL = 2.5
"""Width in τ of one panel of the outer quadrature."""

GRAZING = math.tan(0.5 * (-0.5 * math.pi + 0.15))
"""Below this T the way back along the ray is many times d, and the attenuation changes fast."""

FARTHEST = 0.7
"""From a lobe's middle, in T, to which panels are graded about it."""

MOST_CUTS = 24

SPREAD = 0.05
"""Of the water's depth: so far apart line and ray are taken to be at least, where only the share of light counts."""

BEYOND = 2.0
"""Half widths of the tank: where lines of sight would meet a ray so far aside, a table's nodes are put in the tank."""

LARGEST_EXPONENT = 700.0
"""That numbers hold."""


class Pair(NamedTuple):
    """A line of sight and a light ray that light goes between."""

    x: float
    """Where the line of sight leaves the surface, mm."""
    y: float
    y0: float
    """Where the light ray enters at x = 0, mm."""
    z0: float
    mirrored: bool
    """Whether the light is reflected at the surface between its two scatterings (Fresnel); then the line of sight is
    unfolded above z = Lz, and R(ξ) multiplies."""


@kernel
def pair_radiance(
    geometry: Geometry, sigma_t: float, phase: PhaseRecord, pair: Pair, nodes: Array, weights: Array
) -> float:
    """J of the module's heading times the surface's transmission, in 1/sr² (multiply by σs² and the ray's power).

    Parameters
    ----------
    geometry
        Numbers of the scene.
    sigma_t, phase
        Extinction in 1/mm, and the phase function.
    pair
        Of lines.
    nodes, weights
        Gauss–Legendre rule on [−1, 1] used in every panel.
    """
    found: Array = np.zeros(1)
    add_pair(found, geometry, sigma_t, phase, None, pair, (nodes, weights))
    radiance: float = found[0]
    return radiance


@kernel
def add_pair(
    found: Array, geometry: Geometry, sigma_t: float, phase: PhaseRecord, others: Array | None, pair: Pair,
    rule: Rule,
) -> None:  # fmt: skip
    """Add the same to the first of (1 + k,), and to the others how it changes with p.

    Parameters
    ----------
    found
        By the share t of the way to each of k phase functions q, (1 − t) p + t q, J changes by J(q, p) + J(p, q) less
        twice J(p, p).
    geometry, sigma_t, phase, pair, rule
        As for `pair_radiance`.
    others
        (nodes, k) q as `TableRecord.density`; None where there are none, for kernels are compiled without them then.
    """
    nodes, weights = rule
    x, y, y0, z0, mirrored = pair
    ux, uy, uz = light_ray(geometry, y0, z0)
    vx, vy, vz, transmission = sight_line(geometry, x, y)
    s_min, s_max = path_inside(geometry, 0.0, y0, z0, ux, uy, uz)
    _, t_max = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    if s_max <= s_min or t_max <= 0.0:
        return
    flip = -1.0 if mirrored else 1.0
    wx, wy, wz = -vx, -vy, -vz * flip  # how C moves with t
    ax, ay, az = vx, vy, vz * flip  # direction in which the light must leave, unfolded
    bx, by, bz = x, y - y0, geometry.height - z0
    along = wx * ux + wy * uy + wz * uz
    px, py, pz = wx - along * ux, wy - along * uy, wz - along * uz
    sine2 = px * px + py * py + pz * pz
    foot0 = bx * ux + by * uy + bz * uz
    qx, qy, qz = bx - foot0 * ux, by - foot0 * uy, bz - foot0 * uz
    if sine2 < 1e-12:
        return  # looking along the light: no camera above the water does
    t0 = -(qx * px + qy * py + qz * pz) / sine2
    sine = math.sqrt(sine2)
    nx, ny, nz = qx + t0 * px, qy + t0 * py, qz + t0 * pz
    closest = max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-9)
    cos_out = ux * ax + uy * ay + uz * az
    tau_low, tau_high = math.asinh(-t0 * sine / closest), math.asinh((t_max - t0) * sine / closest)
    cuts = np.empty(MOST_CUTS)
    at, share = np.empty(MOST_CUTS * nodes.size), np.empty(MOST_CUTS * nodes.size)
    total = 0.0
    if others is not None:
        turned, by_others = np.zeros(others.shape[1]), np.zeros(others.shape[1])
    for side in range(2):
        start = tau_low if side == 0 else max(0.0, tau_low)
        end = min(0.0, tau_high) if side == 0 else tau_high
        if end <= start:
            continue
        panels = 1 + int((end - start) / PANEL)
        half = 0.5 * (end - start) / panels
        for panel in range(panels):
            for i in range(nodes.size):
                growth = math.exp(start + half * (2 * panel + 1.0 + nodes[i]))
                t = t0 + closest / sine * 0.5 * (growth - 1.0 / growth)
                distance = closest * 0.5 * (growth + 1.0 / growth)
                foot = foot0 + along * t
                # Unit vector from the light ray to C, perpendicular to the ray.
                dx, dy, dz = (qx + t * px) / distance, (qy + t * py) / distance, (qz + t * pz) / distance
                lobe = dx * ax + dy * ay + dz * az
                count = panel_cuts(cuts, foot - s_max, foot - s_min, distance, phase, cos_out, lobe)
                if mirrored:
                    count = cut_at_critical_angle(cuts, count, geometry.refractive_index, uz, dz)
                used = 0
                for k in range(count - 1):
                    middle, width = 0.5 * (cuts[k] + cuts[k + 1]), 0.5 * (cuts[k + 1] - cuts[k])
                    for j in range(nodes.size):
                        at[used] = middle + width * nodes[j]
                        share[used] = width * weights[j]
                        used += 1
                if mirrored:
                    for k in range(used):
                        s, c = half_circle(at[k])
                        share[k] *= reflectance(abs(s * uz + c * dz), geometry.refractive_index)
                inner = 0.0
                for k in range(used):
                    s, c = half_circle(at[k])
                    value = phase_density(s, phase) * phase_density(s * cos_out + c * lobe, phase)
                    kept = exponential(-sigma_t * distance * (1.0 - at[k]) / (1.0 + at[k]))
                    inner += share[k] * 2.0 / (1.0 + at[k] * at[k]) * value * kept
                if not inner > 0.0:  # or 0 times infinity in water that is opaque over a mm, where the foot is behind
                    continue
                kept = half * weights[i] * math.exp(min(-sigma_t * (foot + t), LARGEST_EXPONENT))
                total += kept * inner
                if others is not None:
                    by_others[:] = 0.0
                    for k in range(used):
                        s, c = half_circle(at[k])
                        kept_between = exponential(-sigma_t * distance * (1.0 - at[k]) / (1.0 + at[k]))
                        light = share[k] * 2.0 / (1.0 + at[k] * at[k]) * kept_between
                        _add_turned(by_others, light, s, s * cos_out + c * lobe, phase, others)
                    turned += kept * by_others
    radiance = transmission * light_kept(geometry, uz) / sine
    found[0] += radiance * total
    if others is not None:
        for m in range(turned.size):
            found[1 + m] += radiance * (turned[m] - 2.0 * total)


@part
def _add_turned(found: Array, light: float, first: float, second: float, phase: PhaseRecord, others: Array) -> None:
    """Add to (k,) light times q(first) p(second) + p(first) q(second), of cosines."""
    steps = others.shape[0] - 1
    one = math.sqrt(max(0.5 - 0.5 * first, 0.0)) * steps
    other = math.sqrt(max(0.5 - 0.5 * second, 0.0)) * steps
    i, j = min(int(one), steps - 1), min(int(other), steps - 1)
    to_second, to_first = light * phase_density(second, phase), light * phase_density(first, phase)
    a, b = to_second * (1.0 - (one - i)), to_second * (one - i)
    c, d = to_first * (1.0 - (other - j)), to_first * (other - j)
    for k in range(found.size):
        found[k] += a * others[i, k] + b * others[i + 1, k] + c * others[j, k] + d * others[j + 1, k]


@part
def half_circle(half_tangent: float) -> tuple[float, float]:
    """Sine and cosine of α from tan(α/2)."""
    scale = 1.0 / (1.0 + half_tangent * half_tangent)
    return 2.0 * half_tangent * scale, (1.0 - half_tangent * half_tangent) * scale


@part
def _half_tangent(sine: float, cosine: float) -> float:
    """tan(α/2) from numbers in proportion to sin α and cos α ≥ 0."""
    return sine / (cosine + math.sqrt(sine * sine + cosine * cosine))


@kernel
def share_seen(geometry: Geometry, x: float, y: float, apart: float, depth: float) -> float:
    """Share of the light along the line of sight through (x, y, Lz) that it passes before it leaves through a wall.

    What a whole light ray scatters to a point of the line is about 1/√(w² + (t − D)²) at the depth t, D the ray's own
    depth and w how far apart they are; J over the integral of that changes little where a side wall cuts lines short.

    Parameters
    ----------
    geometry
        Numbers of the scene.
    x, y
        Where the line of sight leaves the surface, mm.
    apart
        Of line and ray, mm.
    depth
        Of the ray below the surface, mm; negative where it is seen mirrored in it.
    """
    return share_within(geometry.height, depth_seen(geometry, x, y), apart, depth)


@kernel
def depth_seen(geometry: Geometry, x: float, y: float) -> float:
    """How deep the line of sight through (x, y, Lz) gets before it leaves through a wall or the floor, mm."""
    vx, vy, vz, _ = sight_line(geometry, x, y)
    _, t_max = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    return max(t_max, 0.0) * vz


@part
def share_within(height: float, reached: float, apart: float, depth: float) -> float:
    """`share_seen` of a line of sight that reaches a depth, in water of a height, mm."""
    if reached >= (1.0 - 1e-12) * height:
        return 1.0  # down to the floor: nearly all lines
    wide2 = apart * apart + (SPREAD * height) ** 2
    top = _grown(-depth, wide2)
    return math.log(_grown(reached - depth, wide2) / top) / math.log(_grown(height - depth, wide2) / top)


@part
def _grown(deeper: float, wide2: float) -> float:
    """d + √(d² + w²) = w exp(asinh(d/w)) of a length d and w², without the cancellation where d is negative."""
    root = math.sqrt(deeper * deeper + wide2)
    return deeper + root if deeper > 0.0 else wide2 / (root - deeper)


@kernel
def depth_below(geometry: Geometry, x: float, y0: float, z0: float, mirrored: bool) -> float:
    """Depth of a light ray below the surface at x, mm, for `share_seen`."""
    ux, _, uz = light_ray(geometry, y0, z0)
    depth = min(max(geometry.height - z0 - x * uz / ux, 0.0), geometry.height)
    return -depth if mirrored else depth


@kernel
def meet_beyond(geometry: Geometry, x: float, y0: Array, z0: Array) -> bool:
    """Whether lines of sight through an x would meet one of the rays far beside the tank."""
    farthest = BEYOND * geometry.half_width
    for j in range(z0.size):
        for m in range(y0.size):
            if abs(sighting_row(geometry, x, y0[m], z0[j])) > farthest:
                return True
    return False


@kernel
def nearest_row(geometry: Geometry, x: float, y0: float, z0: float, beyond: bool) -> float:
    """The row of `sighting_row`; or, where some are far `beyond` the tank and this is outside, of the ray's end in it.

    Light that has left the tank scatters no more, and what it scattered changes along y as far as there is water. Where
    slanted lines nearly run beside the ray, they would meet it kilometres away, with all nodes in between.
    """
    row = sighting_row(geometry, x, y0, z0)
    if not beyond or abs(row) <= geometry.half_width:
        return row
    ux, uy, uz = light_ray(geometry, y0, z0)
    _, end = path_inside(geometry, 0.0, y0, z0, ux, uy, uz)
    return min(max(y0 + uy * end, -geometry.half_width), geometry.half_width)


@kernel
def panel_cuts(
    cuts: NDArray[np.float64],
    low: float,
    high: float,
    distance: float,
    phase: PhaseRecord,
    cos_out: float,
    lobe: float,
) -> int:
    """Fill `cuts` with ascending ends of panels in T between tan α = low/d and high/d; return how many."""
    first, last = _half_tangent(low, distance), _half_tangent(high, distance)
    cuts[0], cuts[1] = first, last
    count = 2
    peak = _half_tangent(math.copysign(1.0, lobe) * cos_out, abs(lobe))
    if first < peak < last:
        count = _insert(cuts, count, peak)
    if first < GRAZING < last:
        count = _insert(cuts, count, GRAZING)
    g, width = phase.g, phase.width
    if width < 0.35:
        forward = math.copysign(1.0, g)
        reach = width
        while reach < FARTHEST:
            at = forward * (1.0 - reach) / (1.0 + reach)
            if first < at < last:
                count = _insert(cuts, count, at)
            reach *= 3.0
        if g * lobe > 0.0:
            largest = math.sqrt(cos_out * cos_out + lobe * lobe)
            reach = math.sqrt(width * width + 0.5 * max(0.0, 1.0 - largest))
            while reach < FARTHEST:
                for step in (-reach, reach):
                    at = (peak + step) / (1.0 - peak * step)
                    if first < at < last and count < MOST_CUTS - 3:
                        count = _insert(cuts, count, at)
                reach *= 3.0
    return count


@part
def _insert(cuts: NDArray[np.float64], count: int, at: float) -> int:
    """Put one cut in its place among those that ascend, and return how many there are now."""
    place = count
    while place > 0 and cuts[place - 1] > at:
        cuts[place] = cuts[place - 1]
        place -= 1
    cuts[place] = at
    return count + 1


@kernel
def cut_at_critical_angle(cuts: NDArray[np.float64], count: int, index: float, uz: float, dz: float) -> int:
    """Add to `cuts` the T at which reflection becomes total, where R(ξ) has a kink."""
    largest = math.sqrt(uz * uz + dz * dz)
    critical = math.sqrt(1.0 - 1.0 / (index * index))
    if critical >= largest:
        return count
    centre, reach = math.atan2(uz, dz), math.acos(critical / largest)
    first, last = cuts[0], cuts[count - 1]
    for angle in (centre - reach, centre + reach):
        at = math.tan(0.5 * angle)
        if abs(angle) < 0.5 * math.pi and first < at < last:
            count = _insert(cuts, count, at)
    return count

"""J between rays of the projector and lines of sight, and a table of it that every beam and pixel is put together from.

For a light ray A(s) = A₀ + s u and a line of sight C(t), t measured down from the surface,

    J = ∫∫ ds dt exp(−σt (s + r + t)) p(u·r̂) p(r̂·v) / r²,   r = C(t) − A(s).

Every millimetre of radius around r = 0 counts equally, so J is integrated in the variables in which 1/r² is gone:
h = d tan α along the light ray (h the way from first collision to the foot of C on the ray, d its distance), and
t − t₀ = (d₀/sin γ) sinh τ along the line of sight (d₀ the lines' closest distance, γ their angle).
What is left is smooth but for the lobes of p about u and v, about which the panels of the quadrature are graded.
In T = tan(α/2) all of it is rational but for one exponential: sin α = 2T/(1 + T²), and the way back along the ray and
across to C is d (1 − T)/(1 + T) longer than h.

J depends on where the line of sight leaves the surface, x and y, and on the light ray, y₀ and z₀. It is singular like
−ln|δ| where the line meets the ray, δ = y − y_c(x; y₀, z₀) its distance from there, and smooth in all else; so nodes
are geometric in δ on both sides of the crossing, graded towards the walls in x, and few in y₀ and z₀.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import crossing_offset, reflectance
from tankrig.light.elementary import exponential
from tankrig.light.quadrature import Rule, gauss_legendre
from tankrig.light.rays import (
    Geometry,
    light_kept,
    light_ray,
    mirror_symmetric,
    path_inside,
    shift_invariant,
    sight_line,
    sighting_row,
)
from tankrig.light.water import Water, water_of
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.description import Interval
from tankrig.scene.phase import phase_density
from tankrig.scene.phase_table import PhaseFunction, PhaseRecord
from tankrig.threads import THREADS

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
    wide = math.hypot(apart, SPREAD * height)
    top = math.asinh(-depth / wide)
    return (math.asinh((reached - depth) / wide) - top) / (math.asinh((height - depth) / wide) - top)


@kernel
def depth_below(geometry: Geometry, x: float, y0: float, z0: float, mirrored: bool) -> float:
    """Depth of a light ray below the surface at x, mm, for `share_seen`."""
    ux, _, uz = light_ray(geometry, y0, z0)
    depth = min(max(geometry.height - z0 - x * uz / ux, 0.0), geometry.height)
    return -depth if mirrored else depth


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


MIRRORED = 0.05
"""Share of order 2 at most that comes by way of the surface: 1.4 to 3.6 %."""
WALL, STRAIGHT = 0.02, 1e6
"""Margins: where lines of sight slant, they leave the tank through its side walls, and J falls to 0 in a small share
of the way there; where they don't, nodes are graded towards the crossing only."""
CLOSE = 0.0125
"""Of nodes in y₀ where light leaves through the side walls: their distance over half the tank's width."""
LARGEST_EXPONENT = 700.0
"""That numbers hold."""
STEEPEST = 300.0
"""Largest exponent that is taken out of J before it is interpolated."""


@dataclass(frozen=True)
class Fineness:
    """How finely J is tabulated.

    Parameters
    ----------
    nodes
        Of the Gauss–Legendre rule in every panel.
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


FINE = Fineness(nodes=5, ratio=1.45, slanted_ratio=1.3, curvature=0.001, slanted_curvature=0.0003)
"""Errs by 0.04 % of orders 1 and 2 at most (nine scenes, g −0.4…0.95, both projectors and cameras), but where light of
g .95 slants: see `table_error`. One ray for pinholes' beams of 4.5 mm made order 2 .12 % too faint, .35 % off."""
COARSE = Fineness(
    nodes=3, ratio=1.6, slanted_ratio=1.7, curvature=0.004, slanted_curvature=0.0006,
    more_rays=1, slanted_near=0.05, mirrored=2.0, apart=2.0,
)  # fmt: skip
"""Errs by 0.1 % at most, in less than half the time, and in a fifth of it where lines slant: there by .05 to .23 % of
order 2 in eight scenes. With one ray for 4 mm and a finest length twice as long it was .17 to 1.3 %, in half the time.
"""
STEEP_G = 0.9
"""Mean cosine from which J changes too much with y₀ for that: order 2 would be off by .17 instead of .12 % at g .95."""


class Table(NamedTuple):
    """J at its nodes."""

    x_mm: Array
    """(nx,) where lines of sight leave the surface."""
    fractions: Array
    """(nk,) |δ| as a share of the distance from the crossing to the side wall."""
    margin: float
    """The shares f are even steps of ln(f / (1 + margin − f))."""
    y0_mm: Array
    """(ny,), (nz,) where light rays enter."""
    z0_mm: Array
    values: Array
    """(nz, ny, 2, nx, nk): J·exp(κ (x + |δ|)) over the share of the light seen, which changes little; the third axis
    is the side of the crossing, y below or above it."""
    decay: float
    """κ in 1/mm: σt, or less where exp(σt x) would overflow."""
    mirrored: bool
    """Whether the light goes by way of the surface."""
    inner_mm: Interval
    """The y₀ between which light doesn't reach the side walls."""


@dataclass(frozen=True)
class LitHeight:
    """Beams whose order 2 one table serves.

    Parameters
    ----------
    geometry
        Numbers of the scene, of the source that the beams come from.
    beams
        Those of the height `z_mm`; where `shared`, all of the source's.
    z_mm
        (low, high) of each beam; where `shared`, from the lowest to the highest of them.
    mirrored
        Whether the light goes by way of the surface between its two scatterings.
    shared
        Whether the beams have different heights, too many for a table each.
    """

    geometry: Geometry
    beams: tuple[Beam, ...]
    z_mm: Interval
    mirrored: bool
    shared: bool


def laid_out(
    scene: Scene,
    geometry: Geometry,
    z_mm: tuple[float, float],
    mirrored: bool,
    finest_mm: float,
    fineness: Fineness,
    between: bool = False,
) -> tuple[Table, Array]:
    """Nodes of a table for beams of one height, or of all within a height, with no values yet.

    Parameters
    ----------
    scene, geometry
        What to compute it for.
    z_mm
        Lower and upper edge of the beams on the plane x = 0.
    mirrored
        By way of the water surface.
    finest_mm
        Length below which the image need not be resolved.
    fineness
        Of nodes and panels.
    between
        With so many nodes in z₀ that their polynomial holds between them, not only for the whole height.

    Returns
    -------
    table, weights
        `weights` (nz,) integrate over z₀, mm.
    """
    height = scene.tank.size_mm[2]
    low, high = z_mm
    sigma_t = scene.medium.sigma_t
    rays = math.ceil((high - low) * max(sigma_t / 3.0, 2.0 / height))
    straight = shift_invariant(scene)
    enough = fineness.curvature if straight else fineness.slanted_curvature
    bends = curvature(high - low, sigma_t, height) * (MIRRORED if mirrored else 1.0)
    count = 1 if bends < enough else fineness.more_rays + rays
    nodes, weights = np.polynomial.legendre.leggauss(
        min(count + (_more_between(high - low, height) if between else 0), 40)
    )
    z0 = 0.5 * (low + high) + 0.5 * (high - low) * nodes
    width = 2.0 * geometry.half_width
    if straight:
        margin, ratio, near_mm = STRAIGHT, fineness.ratio, 0.02 * finest_mm
    else:
        margin, ratio, near_mm = WALL, fineness.slanted_ratio, fineness.slanted_near * finest_mm
    if mirrored:
        ratio **= fineness.mirrored
    x = _x_nodes(geometry, low, high, finest_mm, 2.0 if mirrored and not straight else 1.0)
    decades = math.log(width / near_mm)
    first, last = -decades - math.log(1.0 + margin), -math.log(margin)
    nodes_y = np.exp(np.linspace(first, last, 1 + math.ceil((last - first) / math.log(ratio))))
    fractions = (1.0 + margin) * nodes_y / (1.0 + nodes_y)
    if straight:
        y0, inner = np.zeros(1), (-math.inf, math.inf)
    else:
        apart = (fineness.apart if scene.medium.g < STEEP_G else 1.0) * (2.0 if mirrored else 1.0)
        y0, inner = _y_nodes(geometry, _lit(scene, geometry, z_mm), 0.5 * (low + high), apart)
    decay = _decay(sigma_t, geometry)
    values = np.zeros((z0.size, y0.size, 2, x.size, fractions.size))
    return Table(x, fractions, margin, y0, z0, values, decay, mirrored, inner), 0.5 * (high - low) * weights


def curvature(high_mm: float, sigma_t: float, height: float) -> float:
    """What one ray for a beam so high errs by, (thickness/scale)²/24 or so; n rays err by its n-th power."""
    return (high_mm * max(sigma_t, 4.0 / height)) ** 2 / 24.0


class Stack(NamedTuple):
    """J of several liquids at the nodes of one table."""

    values: Array
    """(nz, ny, 2, nx, nk, liquids), each as `Table.values`: what does not depend on the liquid is then worked out
    once for all of them."""
    decays: Array
    """(liquids,) κ of each."""


def hardest(media: Sequence[Medium]) -> Medium:
    """As dense as the densest of liquids, and as steep as the steepest."""
    return Medium(0.0, max(one.sigma_t for one in media), max(one.g for one in media))


def fill_stack(
    scene: Scene,
    media: Sequence[Medium],
    lit: LitHeight,
    finest_mm: float,
    fineness: Fineness,
    others: Sequence[PhaseFunction] = (),
) -> tuple[Table, Stack, Array]:
    """Compute J of several liquids at the nodes of `laid_out`, as close as the densest and the steepest want them.

    Parameters
    ----------
    scene
        Its own medium does not matter.
    media
        The liquids.
    lit
        The beams that the table is for.
    finest_mm, fineness
        As for `laid_out`.
    others
        Phase functions near that of the one liquid there is then; after J the stack holds how it changes by the share
        of the way to each.

    Returns
    -------
    table, stack, weights
        The table has the nodes, and no values; `weights` (nz,) integrate over z₀, mm.
    """
    geometry = lit.geometry
    table, weights = laid_out(
        replace(scene, medium=hardest(media)), geometry, lit.z_mm, lit.mirrored, finest_mm, fineness, lit.shared
    )
    y0 = table.y0_mm
    fill = _fill_shifted if shift_invariant(scene) else _fill_slanted
    half = y0.size // 2 if mirror_symmetric(scene) else 0
    decays = np.array([_decay(one.sigma_t, geometry) for one in media]).repeat(1 + len(others))
    found = np.empty((*table.values.shape, decays.size))
    densities = np.ascontiguousarray(np.array([one.table for one in others]).T) if others else None
    rule, each = gauss_legendre(fineness.nodes), 1 + len(others)
    with ThreadPoolExecutor(THREADS) as pool:
        for number, medium in enumerate(media):
            values = np.zeros((*table.values.shape, each))
            one_sided = table._replace(y0_mm=y0[: y0.size - half], decay=float(decays[number * each]))
            given = values[:, : y0.size - half], one_sided, geometry, water_of(medium), densities, rule
            for part in [pool.submit(fill, *given, part, THREADS) for part in range(THREADS)]:
                part.result()
            values[:, y0.size - half :] = values[:, :half, ::-1][:, ::-1]  # the other side is the mirror image
            found[..., number * each : (number + 1) * each] = values
    return table, Stack(found, decays), weights


def _decay(sigma_t: float, geometry: Geometry) -> float:
    """κ for `Table.decay`, 1/mm."""
    return float(min(sigma_t, STEEPEST / (geometry.length + 2.0 * geometry.half_width)))


def _more_between(span: float, height: float) -> int:
    """Nodes in z₀ beyond those that the whole height needs, so that the polynomial holds for beams within it.

    One does for a twentieth of the water's depth (1e-5 of orders 1 and 2), as for beams of a rolled picture.
    """
    return 1 + min(2, int(4.0 * span / height))


def _lit(scene: Scene, geometry: Geometry, z_mm: Interval) -> list[Interval]:
    """The y₀ that beams within a height light, ascending."""
    low, high = z_mm
    if geometry.reflected:
        low, high = 2.0 * geometry.height - high, 2.0 * geometry.height - low
    close = 1e-6 * geometry.height
    return sorted(
        beam.y_mm for beam in scene.projector.beams if low - close <= beam.z_mm[0] and beam.z_mm[1] <= high + close
    )


def _y_nodes(geometry: Geometry, lit: list[Interval], z0: float, apart: float) -> tuple[Array, Interval]:
    """Nodes in y₀, ascending, and within which of them light stays between the side walls.

    There few nodes make one polynomial. Beyond, J changes at once from what a ray that passes near by scatters to what
    one does that has left the tank, and nodes are close to each other, where there is light.
    """
    low, high = lit[0][0], max(end for _, end in lit)
    inner_low, inner_high = _staying(geometry, low, z0, high), _staying(geometry, high, z0, low)
    spread, middle = inner_high - inner_low, 0.5 * (inner_high + inner_low)
    near_wall = math.sqrt(max(1.0 - max(abs(low), abs(high)) / geometry.half_width, 0.1))
    many = math.ceil(2.0 + (4.0 + 3.0 * spread / geometry.half_width / near_wall) / apart) if spread > 0.0 else 0
    inner = middle - 0.5 * spread * np.cos(np.pi * (np.arange(many) + 0.5) / max(many, 1))
    close = apart * CLOSE * geometry.half_width
    below = _close_nodes([(start, min(end, inner_low)) for start, end in lit if start < inner_low], close)
    above = _close_nodes([(max(start, inner_high), end) for start, end in lit if end > inner_high], close)
    return np.concatenate([below, inner, above]), (float(inner_low), float(inner_high))


def _close_nodes(lit: list[Interval], close: float) -> Array:
    """Nodes that are close to each other in intervals, which ascend; those that nearly touch are one."""
    parts: list[Interval] = []
    for start, end in lit:
        if parts and start - parts[-1][1] < close:
            parts[-1] = parts[-1][0], max(end, parts[-1][1])
        else:
            parts.append((start, end))
    # Two parts that are each other's mirror images have as many, whatever rounding says of their widths.
    each = [np.linspace(start, end, 2 + math.ceil((end - start) / close - 1e-6)) for start, end in parts]
    return np.concatenate([np.empty(0), *each])


def _staying(geometry: Geometry, edge: float, z0: float, other: float) -> float:
    """The y₀ nearest to `edge` and no farther than `other` whose light doesn't reach a side wall."""
    from scipy.optimize import brentq

    def beyond(y0: float) -> float:
        ux, uy, _ = light_ray(geometry, y0, z0)
        return float(math.copysign(1.0, edge - other) * (y0 + uy / ux * geometry.length) - geometry.half_width)

    if beyond(edge) <= 0.0:
        return edge
    return other if beyond(other) >= 0.0 else float(brentq(beyond, min(edge, other), max(edge, other)))


def _x_nodes(geometry: Geometry, low: float, high: float, finest_mm: float, apart: float) -> Array:
    """Nodes in x, graded towards the walls and towards where lines of sight meet the beam at the walls.

    So many times farther apart than light wants that comes straight.
    """
    finest_mm *= apart
    special = [0.0, geometry.length]
    for wall in (0.0, geometry.length):
        for z in (low, high):
            special.append(_seen_from_above(geometry, wall, z))
    for z in (low, high):  # where the light itself meets the surface
        ux, _, uz = light_ray(geometry, 0.0, z)
        if abs(uz) > 1e-12:
            special.append((geometry.height - z) / uz * ux)
    places = np.array([place for place in special if 0.0 <= place <= geometry.length])
    x, nodes = 0.0, [0.0]
    largest = apart * geometry.length / 28.0
    while x < geometry.length:
        gap = np.abs(places - x)
        ahead = places[places > x + 1e-9]
        step = min(max(0.4 * gap.min(), 0.25 * finest_mm), largest)
        if ahead.size:
            step = min(step, max(ahead[0] - x, 0.25 * finest_mm) if ahead[0] - x < 1.3 * step else 0.6 * (ahead[0] - x))
        x = min(x + max(step, 0.2 * finest_mm), geometry.length)
        nodes.append(x)
    return np.array(nodes)


def _seen_from_above(geometry: Geometry, x: float, z: float) -> float:
    """The x on the surface through which the camera sees the point (x, 0, z)."""
    if not geometry.camera_pinhole:
        return x
    away, above = x - geometry.camera_x, geometry.camera_z - geometry.height
    rho = crossing_offset(abs(away), geometry.height - z, above, geometry.refractive_index, 0.0, 1.0)
    return float(geometry.camera_x + math.copysign(rho, away))


def y_weights(table: Table, at: float) -> Array:
    """Weights that interpolate between the nodes in y₀: a polynomial where light stays inside, straight elsewhere."""
    nodes, weights = table.y0_mm, np.zeros(table.y0_mm.size)
    inner = (nodes > table.inner_mm[0]) & (nodes < table.inner_mm[1])
    if table.inner_mm[0] <= at <= table.inner_mm[1]:
        weights[inner] = lagrange(nodes[inner], at)
        return weights
    outer = np.flatnonzero(~inner)
    k = int(np.clip(np.searchsorted(nodes[outer], at) - 1, 0, outer.size - 2))
    before, after = outer[k], outer[k + 1]
    weights[after] = (at - nodes[before]) / (nodes[after] - nodes[before])
    weights[before] = 1.0 - weights[after]
    return weights


def lagrange(nodes: Array, at: float) -> Array:
    """Weights of the polynomial through all `nodes` at one place."""
    weights = np.ones(nodes.size)
    for k in range(nodes.size):
        others = np.delete(nodes, k)
        weights[k] = np.prod((at - others) / (nodes[k] - others))
    return weights


@kernel
def _fill_shifted(
    values: Array, table: Table, geometry: Geometry, water: Water, others: Array | None, rule: Rule, part: int,
    parts: int,
) -> None:  # fmt: skip
    """Every second x, where only y − y₀ matters: both lines are put symmetrically about y = 0, inside the tank."""
    x, fractions, _, y0, z0, _, decay, mirrored, _ = table
    sigma_t, _, phase = water
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for k in range(fractions.size):
                delta = 2.0 * geometry.half_width * fractions[k]
                pair = Pair(x[i], y0[0] + 0.5 * delta, y0[0] - 0.5 * delta, z0[j], mirrored)
                found = values[j, 0, 0, i, k]
                add_pair(found, geometry, sigma_t, phase, others, pair, rule)
                found *= math.exp(decay * (x[i] + delta))
                values[j, 0, 1, i, k] = found


@kernel
def _fill_slanted(
    values: Array, table: Table, geometry: Geometry, water: Water, others: Array | None, rule: Rule, part: int,
    parts: int,
) -> None:  # fmt: skip
    """Every second x, with nodes between the crossing and either side wall; J over `share_seen`."""
    x, fractions, _, y0, z0, _, decay, mirrored, _ = table
    sigma_t, _, phase = water
    inside = 0.999 * geometry.half_width  # at the wall itself both are 0
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for m in range(y0.size):
                crossing = sighting_row(geometry, x[i], y0[m], z0[j])
                depth = depth_below(geometry, x[i], y0[m], z0[j], mirrored)
                for side in range(2):
                    span = geometry.half_width - crossing if side == 1 else geometry.half_width + crossing
                    for k in range(fractions.size):
                        delta = max(span, 1e-6) * fractions[k]
                        y = crossing + delta if side == 1 else crossing - delta
                        y = min(max(y, -inside), inside)
                        pair = Pair(x[i], y, y0[m], z0[j], mirrored)
                        found = values[j, m, side, i, k]
                        add_pair(found, geometry, sigma_t, phase, others, pair, rule)
                        share = max(share_seen(geometry, x[i], y, abs(y - crossing), depth), 1e-9)
                        found *= math.exp(decay * (x[i] + delta)) / share

"""The image of order 2: tables of J, averaged over pixels and beams.

For a beam between the rays y₀ = a and b, which are seen at the rows y_c(a) and y_c(b), the average over a pixel's rows
is ∫ dδ w(δ) J(δ), with w the overlap of the pixel, moved by δ, and the beam as it is seen: a trapezoid. Near the beam
the integral is cut at the trapezoid's corners and at δ = 0 and graded about it; far from it two nodes do.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.double.fineness import FINE, STEEP_G
from tankrig.light.double.lit import COARSE_FROM, GLANCE_FROM, ROUGH_FROM, filled, lit_heights
from tankrig.light.double.nodes import curvature
from tankrig.light.double.ray_and_sight import BEYOND, depth_below, depth_seen, meet_beyond, nearest_row, share_within
from tankrig.light.double.table import LitHeight, Stack, Table, lagrange, y_weights
from tankrig.light.double.wall import Tabulated, served
from tankrig.light.elementary import exponential
from tankrig.light.quadrature import Rule, gauss_legendre
from tankrig.light.rays import Geometry, shift_invariant, sighting_row
from tankrig.light.sorting import put_in_order
from tankrig.light.surface import many_to_camera, on_surface, to_camera
from tankrig.scene import Medium, Scene
from tankrig.scene.description import Interval
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

WIDEST_MM = (5.0, 0.75)
"""Widest part of a beam over which J's slow change with y₀ is taken as linear; and where light leaves through a side
wall, and J changes at once."""
STEEP_WIDEST_MM = (1.25, 0.25)
"""The same of steep light, where tables are fine."""
MIRRORED_WIDEST_MM, FINE_MIRRORED_WIDEST_MM = (10.0, 4.0), (5.0, 1.5)
"""The same of light by way of the surface, which comes from afar: where tables are coarse, and where they are fine."""
ROUGH_WIDEST_MM, ROUGH_MIRRORED_WIDEST_MM = (8.0, 1.5), (20.0, 8.0)
"""Both where tables are rough."""
GLANCED_WIDEST_MM = (40.0, 10.0)
"""Both at a glance, by way of the surface too."""
PIECES = 4
"""Of a row of pixels whose lines of sight a side wall cuts at different depths: J and the share of light seen change
together there, so that their product is averaged piece by piece. Beside steep light's edge a row was 10 % off."""
HALVES = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))
"""Of a piece, where Gauss' two nodes lie."""
NARROW_MM = 0.005
"""Half of how wide a beam counts as where it is seen edge on, or only what it scattered before it left the tank."""
FAR = 3.0
"""A beam is far from a pixel at this many times the width of both."""


def double_scattering(scene: Scene, tolerance: float = 0.001) -> Array:
    """Image of the light scattered exactly twice, W/mm²/sr.

    Parameters
    ----------
    scene
        Any scene.
    tolerance
        Error of the whole image that is asked for, of which this order takes a tenth; or a key of `ROUGH_ERRORS`, or
        `GLANCE_FROM`.

    Returns
    -------
    (rows, columns) array

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> image = double_scattering(scene)
    >>> bool(np.allclose(image, image[::-1], rtol=1e-6))  # as symmetric as the beam
    True
    """
    return np.asarray(double_scattering_of(scene, (scene.medium,), tolerance)[0])


def double_scattering_of(
    scene: Scene, media: Sequence[Medium], tolerance: float = 0.001, known: Sequence[Tabulated] = (),
    others: Sequence[PhaseFunction] = (), little: bool = False,
) -> Array:  # fmt: skip
    """The same of several liquids, for little more than the tables of each.

    Where each pixel looks at which beam does not depend on the liquid, and takes most of the time where patterns have
    many beams; nor does it how liquids of one extinction fade, where they follow each other. Tables have the nodes that
    the densest and the steepest of the liquids want.

    Parameters
    ----------
    scene
        Its own medium does not matter.
    media
        The liquids.
    tolerance
        As for one.
    known
        Tables of these liquids, of `tables_of_wall`, for the beams that enter by their heights; where they are of
        another scene, or too coarse for this one's pixels, nothing is taken from them.
    others
        Phase functions near that of the one liquid there is then.
    little
        Whether the light is a few hundredths of all that there is, so that errors of a hundredth of it do not matter:
        heights whose rays are seen apart have few more. Smooth light of a bench, 3 % of its order 2, is .6 % of itself
        off then, in a fifth of the time.

    Returns
    -------
    (media, rows, columns) array, or (1 + others, rows, columns): after the image its derivatives by the share of the
    way to each of the other phase functions, for little more than the image
    """
    if scene.camera.kind == "calibrated":
        plain = on_surface(scene)
        cell_mm = plain.camera.pixel_mm, plain.camera.pixel_mm
        images = double_scattering_of(plain, media, tolerance, known, others, little)
        return many_to_camera(scene, images, cell_mm) if len(images) > 1 else to_camera(scene, images[0], cell_mm)[None]
    camera = scene.camera
    scattering = np.array([one.sigma_s for one in media]).repeat(1 + len(others))
    images = np.zeros((scattering.size, *camera.shape))
    if not scattering.any():
        return images
    steepest = max(one.g for one in media)
    by_wall, rest = served(scene, known)
    for one in by_wall:
        widest_mm = _widest_mm(one.lit.mirrored, steepest, tolerance)
        _add_table(images, scene, one.lit, one.table, one.stack, np.empty(0), widest_mm)
    if rest is not None:
        for lit in lit_heights(rest):
            widest_mm = _widest_mm(lit.mirrored, steepest, tolerance)
            _add_table(images, scene, lit, *filled(rest, media, lit, tolerance, others, little), widest_mm)
    images *= scattering[:, None, None] ** 2
    light = images[:: 1 + len(others)]
    np.maximum(light, 0.0, out=light)  # where it is fainter than its own rounding, an interpolant may dip below
    return images


def _widest_mm(mirrored: bool, steepest: float, tolerance: float) -> Interval:
    """Widest parts of beams, inside and where light leaves, for liquids up to a g."""
    if tolerance >= GLANCE_FROM:
        return GLANCED_WIDEST_MM
    if tolerance >= ROUGH_FROM:
        return ROUGH_MIRRORED_WIDEST_MM if mirrored else ROUGH_WIDEST_MM
    fine = tolerance < COARSE_FROM
    if mirrored:
        return FINE_MIRRORED_WIDEST_MM if fine else MIRRORED_WIDEST_MM
    return STEEP_WIDEST_MM if fine and steepest >= STEEP_G else WIDEST_MM


def _add_table(
    images: Array, scene: Scene, lit: LitHeight, table: Table, stack: Stack, z0_weights: Array, widest_mm: Interval
) -> None:
    """Add what a table says of its beams, over σs², to (liquids, rows, columns) images."""
    camera = scene.camera
    rows = np.zeros((camera.shape[0], table.x_mm.size, len(images)))
    add_beams(rows, scene, lit, table, stack, z0_weights, widest_mm)
    columns = columns_of(table.x_mm, camera.shape[1], camera.pixel_mm, lit.geometry.length)
    images += np.moveaxis(rows, 2, 0) @ columns.T


def add_beams(
    rows: Array, scene: Scene, lit: LitHeight, table: Table, stack: Stack, z0_weights: Array,
    widest_mm: Interval = WIDEST_MM,
) -> None:  # fmt: skip
    """Add what tables say of their beams, over σs², to (rows, x, liquids) the light of each row of pixels."""
    rule = gauss_legendre(4)
    reached = np.empty((table.x_mm.size, len(rows), PIECES, len(HALVES)))
    _fill_reached(reached, scene.camera.pixel_mm, lit.geometry, table.x_mm)
    beyond = np.array([meet_beyond(lit.geometry, x, table.y0_mm, table.z0_mm) for x in table.x_mm])
    seen = Seen(scene.camera.pixel_mm, reached, beyond)
    for beam in lit.beams:
        height = (
            _across(table, stack, beam.z_mm, lit.geometry.height)
            if lit.shared
            else Across(table.z0_mm, z0_weights, np.eye(len(table.z0_mm)))
        )
        # Parts narrow enough where J is not shift-invariant.
        for low, high in _parts(beam.y_mm, table.inner_mm, widest_mm, shift_invariant(scene)):
            strip = Strip(low, high, beam.irradiance, y_weights(table, 0.5 * (low + high)), height)
            average_rows(rows, seen, lit.geometry, table, stack, strip, rule)


@kernel
def _fill_reached(reached: Array, pixel_mm: float, geometry: Geometry, x: Array) -> None:
    """Fill in how deep lines of sight get at two places of each piece of a row, see `Seen.reached_mm`."""
    for i in range(x.size):
        for row in range(reached.shape[1]):
            low = row * pixel_mm - geometry.half_width
            wide = (min(low + pixel_mm, geometry.half_width) - low) / PIECES
            for piece in range(PIECES):
                for n in range(len(HALVES)):
                    reached[i, row, piece, n] = depth_seen(geometry, x[i], low + wide * (piece + HALVES[n]))


def _parts(y_mm: Interval, inner_mm: Interval, widest_mm: Interval, whole: bool) -> list[Interval]:
    """A beam cut where its light begins to leave through a side wall, and into parts that are narrow enough."""
    if whole:
        return [y_mm]
    cuts = np.clip([y_mm[0], *inner_mm, y_mm[1]], *y_mm)
    parts: list[Interval] = []
    inside, leaving = widest_mm
    for low, high, widest in zip(cuts[:-1], cuts[1:], (leaving, inside, leaving), strict=True):
        if high > low:
            edges = np.linspace(low, high, 1 + math.ceil((high - low) / widest))
            parts += pairwise(edges.tolist())
    return parts


def _across(table: Table, stack: Stack, z_mm: Interval, height: float) -> "Across":
    """Rays for a beam within a table's height: as many as integrate the table's polynomial; one where that does."""
    half, middle = 0.5 * (z_mm[1] - z_mm[0]), 0.5 * (z_mm[1] + z_mm[0])
    thin = curvature(2.0 * half, float(stack.decays.max()), height) < FINE.slanted_curvature
    places, weights = np.polynomial.legendre.leggauss(1 if thin else table.z0_mm.size // 2 + 1)
    z0 = middle + half * places
    return Across(z0, half * weights, np.array([lagrange(table.z0_mm, one) for one in z0]))


def columns_of(x: Array, columns: int, pixel_mm: float, length: float) -> Array:
    """(columns, nx) weights that average the cubic interpolant through nodes `x` over each column of pixels."""
    result = np.zeros((columns, x.size))
    edges = np.minimum(np.arange(columns + 1) * pixel_mm, length)
    _fill_columns(result, x, edges, pixel_mm, *np.polynomial.legendre.leggauss(3))
    return result


@kernel
def _fill_columns(result: Array, x: Array, edges: Array, pixel_mm: float, nodes: Array, weights: Array) -> None:
    """Gauss–Legendre between the nodes and the edges of columns, of the cubics through four nodes each."""
    interval = 0
    for column in range(edges.size - 1):
        start = edges[column]
        while start < edges[column + 1]:
            while interval < x.size - 2 and x[interval + 1] <= start:
                interval += 1
            end = min(edges[column + 1], x[interval + 1]) if interval < x.size - 2 else edges[column + 1]
            first = min(max(interval - 1, 0), x.size - 4)
            for n in range(nodes.size):
                at = 0.5 * (start + end) + 0.5 * (end - start) * nodes[n]
                for k in range(first, first + 4):
                    weight = 0.5 * weights[n] * (end - start) / pixel_mm
                    for other in range(first, first + 4):
                        if other != k:
                            weight *= (at - x[other]) / (x[k] - x[other])
                    result[column, k] += weight
            start = end


class Even(NamedTuple):
    """Even steps of ln(f / (1 + margin − f)), at which a table has its nodes."""

    first: float
    spacing: float
    margin: float


class Seen(NamedTuple):
    """Where the rows of pixels look."""

    pixel_mm: float
    reached_mm: Array
    """(nx, rows, pieces, 2) how deep lines of sight get, at `HALVES` of each row's pieces: no matter which beam."""
    beyond: NDArray[np.bool_]
    """(nx,) whether lines of sight through an x would meet some of the table's rays far beside the tank."""


class Across(NamedTuple):
    """Rays that stand for a beam's height."""

    z0_mm: Array
    """(n,) where they enter."""
    weights: Array
    """(n,) that integrate over them, mm."""
    between: Array
    """(n, nz) weights that interpolate a table to each."""


class Strip(NamedTuple):
    """A beam, or a part of it along y, and what its light has of a table's nodes."""

    low: float
    """Edges on the plane x = 0, mm; it should not be much wider than the change of J with y₀ allows."""
    high: float
    strength: float
    """Irradiance."""
    y0_weights: Array
    """(ny,) weights that interpolate the table to its middle."""
    height: Across
    """The rays that stand for its height."""


@kernel
def average_rows(
    rows: Array, seen: Seen, geometry: Geometry, table: Table, stack: Stack, strip: Strip, rule: Rule
) -> None:
    """Add one strip's rows, at every node in x.

        ⟨I₂⟩/σs² = 1/Δy ∫ dδ w(δ) J(δ) · E₀ (y₀ width) / (width as seen)   over each row, w as in the module's heading

    Parameters
    ----------
    rows
        (rows, nx, liquids), added to: radiance over σs², averaged over the rows' height, at the nodes in x.
    seen
        Where rows look, by the same rule.
    geometry
        Of the scene.
    table, stack
        Of J.
    strip
        Of light.
    rule
        Gauss–Legendre.
    """
    x, fractions, margin, _, _, _, _, mirrored, _ = table
    (values, decays), (pixel_mm, reached, beyond) = stack, seen
    low, high, strength, y0_weights, (z0, z0_weights, between) = strip
    nodes, weights = rule
    count = fractions.size
    first = math.log(fractions[0] / (1.0 + margin - fractions[0]))
    even = Even(first, (-math.log(margin) - first) / (count - 1), margin)
    liquids = decays.size
    profile, total, fading = np.empty((2, count, liquids)), np.empty(liquids), np.empty(liquids)
    cuts, finest = np.empty(5), 4.0 * geometry.half_width * fractions[0]
    middle, lowest = 0.5 * (low + high), (1.0 - 1e-12) * geometry.height
    for j in range(z0.size):
        for i in range(x.size):
            for side in range(2):
                for k in range(count):
                    profile[side, k] = 0.0
                    for m in range(y0_weights.size):
                        for node in range(values.shape[0]):
                            weight = y0_weights[m] * between[j, node]
                            if weight != 0.0:  # of a whole wall's nodes few count
                                for n in range(liquids):
                                    profile[side, k, n] += weight * values[node, m, side, i, k, n]
            crossing = nearest_row(geometry, x[i], middle, z0[j], beyond[i])
            beam_low = sighting_row(geometry, x[i], low, z0[j])
            beam_high = sighting_row(geometry, x[i], high, z0[j])
            farthest = BEYOND * geometry.half_width
            if beyond[i] and (max(abs(beam_low), abs(beam_high)) > farthest or abs(crossing) == geometry.half_width):
                beam_low, beam_high = crossing, crossing
            if beam_high < beam_low:  # seen from beyond where the light's side faces meet
                beam_low, beam_high = beam_high, beam_low
            if beam_high - beam_low < 2.0 * NARROW_MM:
                beam_low, beam_high = crossing - NARROW_MM, crossing + NARROW_MM
            wide = beam_high - beam_low
            below = depth_below(geometry, x[i], middle, z0[j], mirrored)
            spans = (max(geometry.half_width + crossing, 1e-6), max(geometry.half_width - crossing, 1e-6))
            if y0_weights.size == 1:  # where only y − y₀ matters
                spans = (2.0 * geometry.half_width, 2.0 * geometry.half_width)
            # Flux per row seen: the beam's width over its width as seen; per pixel: over the pixel.
            scale = strength * z0_weights[j] * (high - low) / (wide * pixel_mm)
            for n in range(liquids):
                fading[n] = math.exp(-decays[n] * x[i])
            for row in range(rows.shape[0]):
                row_low = row * pixel_mm - geometry.half_width
                if row_low >= geometry.half_width:
                    break
                row_wide = min(row_low + pixel_mm, geometry.half_width) - row_low
                depths = reached[i, row]
                cut = depths[0, 0] < lowest or depths[PIECES - 1, 1] < lowest
                far = abs(row_low + 0.5 * row_wide - 0.5 * (beam_low + beam_high)) > FAR * (row_wide + wide)
                # J and the share change together where lines are cut about as deep as the ray.
                change = abs(depths[0, 0] - depths[PIECES - 1, 1])
                apart = abs(0.5 * (depths[0, 0] + depths[PIECES - 1, 1]) - below)
                pieces = 1 if far or change < 1e-9 or apart > change else PIECES
                for piece in range(pieces):
                    pixel = row_wide / pieces
                    pixel_low = row_low + piece * pixel
                    pixel_high = pixel_low + pixel
                    total[:] = 0.0
                    centre = 0.5 * (pixel_low + pixel_high) - 0.5 * (beam_low + beam_high)
                    if far:
                        spread = math.sqrt((pixel * pixel + wide * wide) / 12.0)
                        half = 0.5 * pixel * wide
                        _add_profile(total, half, profile, decays, spans, centre - spread, even)
                        _add_profile(total, half, profile, decays, spans, centre + spread, even)
                    else:
                        cuts[0], cuts[1] = pixel_low - beam_high, pixel_low - beam_low
                        cuts[2], cuts[3] = pixel_high - beam_high, pixel_high - beam_low
                        cuts[4] = min(max(0.0, pixel_low - beam_high), pixel_high - beam_low)
                        put_in_order(cuts)
                        for k in range(4):
                            start, end = cuts[k], cuts[k + 1]
                            panel_start = start
                            while end - panel_start > 1e-9:
                                panel_end = _panel_end(panel_start, end, min(finest, 0.04 * pixel))
                                half = 0.5 * (panel_end - panel_start)
                                for n in range(nodes.size):
                                    delta = panel_start + half * (1.0 + nodes[n])
                                    overlap = min(pixel_high - delta, beam_high) - max(pixel_low - delta, beam_low)
                                    weight = half * weights[n] * max(overlap, 0.0)
                                    _add_profile(total, weight, profile, decays, spans, delta, even)
                                panel_start = panel_end
                    share = 1.0
                    if cut:
                        # Of a whole row, two of these places are about where Gauss has his.
                        one, other = (piece, piece) if pieces > 1 else (0, PIECES - 1)
                        n, m = (0, 1) if pieces > 1 else (1, 0)
                        y = row_low + row_wide / PIECES * (one + HALVES[n])
                        share = 0.5 * share_within(geometry.height, depths[one, n], abs(y - crossing), below)
                        y = row_low + row_wide / PIECES * (other + HALVES[m])
                        share += 0.5 * share_within(geometry.height, depths[other, m], abs(y - crossing), below)
                    for n in range(liquids):
                        rows[row, i, n] += scale * share * fading[n] * total[n]


@kernel
def _panel_end(start: float, end: float, finest: float) -> float:
    """End of a panel that is graded about δ = 0, where J is singular."""
    if start >= 0.0:
        return min(end, start + max(finest, 2.0 * start))
    reach = -start  # towards zero in thirds
    if reach <= finest:
        return min(end, 0.0)
    return min(end, start + (2.0 / 3.0) * reach)


@part
def _add_profile(
    total: Array, weight: float, profile: Array, decays: Array, spans: tuple[float, float], delta: float, even: Even
) -> None:
    """Add J at δ of all liquids by cubic interpolation between nodes; nearer than the first it grows like −ln|δ|."""
    side = 1 if delta > 0.0 else 0
    distance = abs(delta)
    count = profile.shape[1]
    share = min(max(distance, 1e-12) / spans[side], 1.0)
    place = (math.log(share / (1.0 + even.margin - share)) - even.first) / even.spacing
    k, a, b, c, d = 0, 1.0 - place, place, 0.0, 0.0
    if place >= 0.0:
        place = min(place, count - 1.0)
        k = min(max(int(place) - 1, 0), count - 4)
        t, u, v, w = place - k, place - k - 1.0, place - k - 2.0, place - k - 3.0
        a, b, c, d = -u * v * w / 6.0, t * v * w / 2.0, -t * u * w / 2.0, t * u * v / 6.0
    if total.size == 1:  # a loop over one liquid would take half as long again
        total[0] += weight * _cubic(profile[side], k, 0, (a, b, c, d)) * exponential(-decays[0] * distance)
    else:
        fading, of = 1.0, 0.0
        for n in range(total.size):
            if decays[n] != of:  # liquids of one extinction, as they stand side by side, share it
                fading, of = exponential(-decays[n] * distance), decays[n]
            total[n] += weight * _cubic(profile[side], k, n, (a, b, c, d)) * fading


@part
def _cubic(profile: Array, k: int, n: int, weights: tuple[float, float, float, float]) -> float:
    """Four nodes of one liquid, from the k-th on, with their weights."""
    a, b, c, d = weights
    return float(a * profile[k, n] + b * profile[k + 1, n] + c * profile[k + 2, n] + d * profile[k + 3, n])

"""Light scattered once on a simulated bench: followed back from each camera pixel through the water to the projector.

The Monte Carlo's own order 1 spreads beams over pixels; this one asks, all along a pixel's line of sight, how bright
the projector's picture is there. So every pixel of the projector counts, blurred as its lens blurs it, and the two
check each other. Glass walls show such light mirrored, and the far one sends beams back; a diffuse floor shows what of
the picture falls on it.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import fresnel_reflectance
from tankrig.scene.description import Medium

from .bench_mirrors import Line, Mirror, by_way_of_walls, sides_of, surface_of
from .bench_optics import DEPTHS_MM, FINER, camera_rays, illumination, projector_pixels
from .bench_truth import TANK_MM, Array, TrueBench

_NODE_PX, _NODE_MM, _STEP_MM = 15, 4.0, 0.5
"""From node to node across the picture and down the water, and from point to point between those."""
_TILE, _TIMES = 32, 2
"""Side of the pieces of a picture that are dark, even or neither; how often the way of light by a pane's outer side is
looked for."""
_DARK, _EVEN, _EDGED = 0, 1, 2
LITTLE, FAINT, _EVEN_POINTS = 0.05, 1e-4, 2
"""Pieces and those beside them are even where their light differs by so much of their own brightest or of the
picture's, and there so many points do between nodes: 1e-5 off, for a third of the time."""
_NOTHING = 1e-30

_U, _V, _Y_WALL, _Z_WALL, _X, _Y, _LN = range(7)


class _Sight(NamedTuple):
    """What does not depend on the medium, at nodes (planes, rows, columns): down the water, or in a mirror image.

    Parameters
    ----------
    places
        (planes, rows, columns, 6): pixel of the projector, y and z where its light crosses the wall, x and y; mm.
    ln_strength
        Logarithm of the fluence by a white pixel there, of that on the wall before the lens, times what the surface
        lets through and walls send on, times the line of sight's length per mm of height.
    path_mm
        Through water, from the wall and on to the surface.
    cosine
        Of the angle of scattering.
    reached
        (rows − 1, columns − 1): where lines of sight may be in the water.
    """

    places: Array
    ln_strength: Array
    path_mm: Array
    cosine: Array
    reached: NDArray[np.bool_]


class _Thrown(NamedTuple):
    """The projector's pictures in the water."""

    light: Array
    """(depths, rows, columns) as `thrown_in_depth` says."""
    layers_a_mm: float
    tiles: NDArray[np.uint8]
    """Whether there is light in pieces of the picture and nearby, and whether it is even."""
    finer: int
    """Points along the side of a projector pixel."""


class _Water(NamedTuple):
    """The box of water, mm."""

    length: float
    half_width: float
    level: float


def scattered_once(bench: TrueBench, thrown: Array, medium: Medium) -> Array:
    """Radiance at the middle of each camera pixel, before the camera's own blur and vignetting.

    The integral along the line of sight of σs p(θ) e^{−σt path} times the fluence, and (1 − F)/n² at the surface; the
    light that the water's surface throws back down is scattered too.

    Parameters
    ----------
    bench
        Its truth.
    thrown
        The projector's light by depth, see `bench_optics.thrown_in_depth`.
    medium
        In the tank.

    Returns
    -------
    array (rows, columns)
        W/mm²/sr.
    """
    return _gathered(bench, _directly(bench), thrown, medium)


def mirrored_once(bench: TrueBench, thrown: Array, thrown_back: Array, medium: Medium) -> Array:
    """The same of light that glass walls have sent back: on its way to the camera, or from the far wall before.

    Parameters
    ----------
    thrown_back
        The projector's light as `thrown`, at the depths that it has come to when the far wall has sent it back.
    bench, thrown, medium
        As for `scattered_once`.
    """
    straight, from_far = _by_walls(bench)
    image = _gathered(bench, straight, thrown, medium)
    return image + _gathered(bench, from_far, thrown_back, medium)


def _gathered(bench: TrueBench, sights: tuple[_Sight, ...], thrown: Array, medium: Medium) -> Array:
    if medium.sigma_s <= 0.0:
        return np.zeros(bench.camera.shape)

    def ln_scattered(sight: _Sight) -> Array:
        ln = np.log(np.pi * bench.full * medium.sigma_s * medium.phase_function.at(sight.cosine))
        return np.asarray(sight.ln_strength - medium.sigma_t * sight.path_mm + ln)

    return _summed(bench, sights, thrown, ln_scattered)


def shown_by_floor(bench: TrueBench, thrown: Array, thrown_back: Array, medium: Medium) -> Array:
    """What a diffuse floor shows of the projector's picture, by way of glass walls too; W/mm²/sr.

    Parameters
    ----------
    bench, thrown, thrown_back, medium
        As for `mirrored_once`.
    """
    if bench.stray.floor <= 0.0:
        return np.zeros(bench.camera.shape)

    def ln_shown(sight: _Sight) -> Array:
        return np.asarray(sight.ln_strength - medium.sigma_t * sight.path_mm + math.log(bench.stray.floor * bench.full))

    straight, from_far = _on_floor(bench)
    at_once = bench.level_mm  # the floor is one place of a line of sight
    image = _summed(bench, straight, thrown, ln_shown, at_once)
    return image + _summed(bench, from_far, thrown_back, ln_shown, at_once)


def _summed(
    bench: TrueBench, sights: tuple[_Sight, ...], thrown: Array, ln_of: Callable[[_Sight], Array],
    step_mm: float = _STEP_MM,
) -> Array:  # fmt: skip
    """Light along lines of sight, W/mm²/sr.

    `ln_of` gives the logarithm of what a white pixel's light brings per mm; `step_mm` is from point to point down the
    water where light has edges.
    """
    image = np.zeros(bench.camera.shape)
    if thrown.any():
        layers_a_mm = (len(thrown) - 1) / float(DEPTHS_MM[-1])
        pictures = _Thrown(thrown, layers_a_mm, _tiles_of(thrown), FINER)
        water = _Water(TANK_MM[0], TANK_MM[1] / 2, bench.level_mm)
        for sight in sights:
            nodes = np.concatenate([sight.places, ln_of(sight)[..., None]], axis=-1)
            _gather(nodes, sight.reached, pictures, water, step_mm, image)
    return image * looks_in(bench)


@lru_cache(maxsize=2)
def looks_in(bench: TrueBench) -> Array:
    """1 for each camera pixel whose middle looks through the water's surface, else 0."""
    rows, columns = bench.camera.shape
    pixels = np.stack(np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)), axis=-1)
    x, y, _ = np.moveaxis(camera_rays(bench, pixels, filled=True)[0], -1, 0)
    return np.asarray((x > 0.0) & (x < TANK_MM[0]) & (np.abs(y) < TANK_MM[1] / 2), float)


def _tiles_of(thrown: Array) -> NDArray[np.uint8]:
    """What the light in square tiles of pictures in depth is, with those beside them: none, even, or neither."""
    _, rows, columns = thrown.shape
    down, across = -(-rows // _TILE), -(-columns // _TILE)
    beyond = ((0, 0), (0, down * _TILE - rows), (0, across * _TILE - columns))  # where it is dark
    tiles = np.pad(thrown, beyond).reshape(-1, down, _TILE, across, _TILE)
    most = maximum_filter(tiles.max(axis=(2, 4)), (1, 3, 3))
    least = minimum_filter(tiles.min(axis=(2, 4)), (1, 3, 3), mode="constant")
    even = most - least <= np.maximum(LITTLE * most, FAINT * most.max())
    found = np.where(most <= 0.0, _DARK, np.where(even, _EVEN, _EDGED))
    return np.asarray(found.max(axis=0), np.uint8)


@lru_cache(maxsize=2)
def _directly(bench: TrueBench) -> tuple[_Sight, ...]:
    """The water, and what the surface throws back down, as they are seen without a wall."""
    line = _lines_of_sight(bench)
    return tuple(_sight(bench, line, mirror) for mirror in (None, surface_of(bench)))


@lru_cache(maxsize=2)
def _by_walls(bench: TrueBench) -> tuple[tuple[_Sight, ...], tuple[_Sight, ...]]:
    """What is seen or lit by way of walls: by light that has not been to the far wall, and by that which has."""
    line = _lines_of_sight(bench)
    alone, two = by_way_of_walls(bench, line)
    aside = [mirror for wall in ("left", "right") for mirror in sides_of(bench, wall)]
    straight = [_sight(bench, one, mirror) for one in (line, *alone) for mirror in aside]
    straight += [_sight(bench, one, mirror) for one in alone for mirror in (None, surface_of(bench))]
    straight += [_sight(bench, one, None) for one in two]
    from_far = [_sight(bench, one, mirror) for one in (line, *alone) for mirror in sides_of(bench, "far")]
    seen, from_far = ([one for one in sights if one.reached.any()] for sights in (straight, from_far))
    return tuple(seen), tuple(from_far)


@lru_cache(maxsize=2)
def _on_floor(bench: TrueBench) -> tuple[tuple[_Sight, ...], tuple[_Sight, ...]]:
    """The floor, lit by light that has not been to the far wall, and by that which has."""
    line = _lines_of_sight(bench)
    alone, two = by_way_of_walls(bench, line)
    ends = [_end_of(one) for one in (line, *alone, *two)]
    mirrors = [None, surface_of(bench), *(mirror for wall in ("left", "right") for mirror in sides_of(bench, wall))]
    straight = [_floor(bench, one, mirror) for one in ends for mirror in mirrors]
    from_far = [_floor(bench, one, mirror) for one in ends for mirror in sides_of(bench, "far")]
    straight, from_far = ([one for one in sights if one.reached.any()] for sights in (straight, from_far))
    return tuple(straight), tuple(from_far)


def _end_of(line: Line) -> Line:
    """Where lines of sight come to the floor, as a layer without thickness."""
    return line._replace(points=line.points[[-1, -1]], path_mm=line.path_mm[[-1, -1]])


def _floor(bench: TrueBench, end: Line, mirror: Mirror | None) -> _Sight:
    """The sight of the floor: how much falls on it, as if it were all along a line as long as the water is deep."""
    sight, arriving = _sight_and_way(bench, end, mirror)
    falls = np.log(np.maximum(-arriving[..., 2], _NOTHING)) + np.log(-end.way[..., 2] / bench.level_mm)
    return sight._replace(ln_strength=sight.ln_strength + falls)


def _lines_of_sight(bench: TrueBench) -> Line:
    """From nodes of the picture, at even heights of the water."""
    rows, columns = (np.linspace(0.0, n - 1.0, max(2, round(n / _NODE_PX))) for n in bench.camera.shape)
    start, way = camera_rays(bench, np.stack(np.meshgrid(columns, rows), axis=-1), filled=True)
    depths = np.linspace(0.0, bench.level_mm, max(2, round(bench.level_mm / _NODE_MM)) + 1)
    down = (start[..., 2] - bench.level_mm + depths[:, None, None]) / -way[..., 2]
    in_air = np.sqrt(1.0 - bench.water_index**2 * (1.0 - (way @ bench.surface) ** 2))
    through = (1.0 - fresnel_reflectance(in_air, 1.0 / bench.water_index)) / bench.water_index**2
    return Line(start + down[..., None] * way, way, down, through)


def _sight(bench: TrueBench, line: Line, mirror: Mirror | None) -> _Sight:
    """The sight of a line's points, lit straight or by way of a mirror."""
    return _sight_and_way(bench, line, mirror)[0]


def _sight_and_way(bench: TrueBench, line: Line, mirror: Mirror | None) -> tuple[_Sight, Array]:
    """The same, and the direction in which light arrives there; worked out where lines may be in the water."""
    planes, rows, columns, _ = line.points.shape
    reached, near = _reached(line.points), np.zeros((rows, columns), bool)
    for corner in (np.s_[1:, 1:], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[:-1, :-1]):
        near[corner] |= reached
    some = Line(line.points[:, near], line.way[near], line.path_mm[:, near], line.share[near])

    def everywhere(values: Array) -> Array:
        found = np.zeros((planes, rows, columns, *values.shape[2:]))
        found[:, near] = values
        return found

    places, ln_strength, path_mm, cosine, arriving = map(everywhere, _lit_at(bench, some, mirror))
    return _Sight(places, ln_strength, path_mm, cosine, reached), arriving


def _lit_at(bench: TrueBench, line: Line, mirror: Mirror | None) -> tuple[Array, Array, Array, Array, Array]:
    """The parts of the sight of a line's points, whatever they are sorted by, and the direction."""
    points = line.points
    lit = points if mirror is None else mirror.image(points, None)
    _, arriving = projector_pixels(bench, lit, filled=True)
    if mirror is not None and mirror.aside_mm is not None:
        for _ in range(_TIMES):
            lit = mirror.image(points, arriving)
            _, arriving = projector_pixels(bench, lit, filled=True)
    pixels, strength = illumination(bench, lit, np.eye(3)[1:], filled=True)
    path = lit[..., 0] / arriving[..., 0]
    wall = lit - path[..., None] * arriving
    weight = strength / arriving[..., 0] * line.share / -line.way[..., 2]
    if mirror is not None:
        meeting = arriving @ mirror.normal
        weight = weight * mirror.share(np.clip(meeting, 0.0, 1.0))
        arriving = arriving - 2.0 * meeting[..., None] * mirror.normal
    cosine = -np.sum(arriving * line.way, axis=-1)
    places = np.stack([pixels[..., 0], pixels[..., 1], wall[..., 1], wall[..., 2], *np.moveaxis(points, -1, 0)[:2]], -1)
    ln_strength = np.log(np.maximum(weight, _NOTHING))
    return places, ln_strength, path + line.path_mm, cosine, arriving


def _reached(points: Array) -> NDArray[np.bool_]:
    """(rows − 1, columns − 1): whether lines of sight between nodes may be in the water anywhere."""
    beyond_x = np.abs(points[..., 0] - TANK_MM[0] / 2) - TANK_MM[0] / 2
    beyond_y = np.abs(points[..., 1]) - TANK_MM[1] / 2
    inside: NDArray[np.bool_] = np.any(np.maximum(beyond_x, beyond_y) < _NODE_MM, axis=0)
    return inside[1:, 1:] | inside[:-1, 1:] | inside[1:, :-1] | inside[:-1, :-1]


@kernel
def _gather(
    nodes: Array, reached: NDArray[np.bool_], thrown: _Thrown, water: _Water, step: float, image: Array
) -> None:
    """Add to each pixel the light along its line of sight: linear between nodes, but exponential in brightness.

    Σ thrown · strength Δz over points of the line at even steps.
    """
    planes, node_rows, node_columns, count = nodes.shape
    rows, columns = image.shape
    above, here, change = np.empty(count), np.empty(count), np.empty(count)
    between = np.empty((node_columns, planes, count))  # two rows of nodes
    spacing = water.level / (planes - 1)
    most = max(1, math.ceil(spacing / step))
    for row in range(rows):
        at = row * (node_rows - 1) / max(rows - 1, 1)
        r = min(int(at), node_rows - 2)
        lower = at - r
        for c in range(node_columns):
            for plane in range(planes):
                for k in range(count):
                    between[c, plane, k] = (1.0 - lower) * nodes[plane, r, c, k] + lower * nodes[plane, r + 1, c, k]
        for column in range(columns):
            at = column * (node_columns - 1) / max(columns - 1, 1)
            c = min(int(at), node_columns - 2)
            right = at - c
            if not reached[r, c]:
                continue
            total = 0.0
            for plane in range(planes):
                for k in range(count):
                    here[k] = (1.0 - right) * between[c, plane, k] + right * between[c + 1, plane, k]
                if plane > 0:
                    total += _along_stretch(above, here, change, thrown, water, most)
                for k in range(count):
                    above[k] = here[k]
            image[row, column] += total * spacing


@part
def _along_stretch(above: Array, here: Array, change: Array, thrown: _Thrown, water: _Water, most: int) -> float:
    """Mean light at points of a line of sight between two planes of nodes: few of them where light is even, none where
    it is dark. `change` is overwritten."""
    (pictures, layers_a_mm, tiles, finer), (length, half_width, level) = thrown, water
    if not _may_be_lit(above, here, level, length, half_width):
        return 0.0
    u, v = 0.5 * (above[_U] + here[_U]), 0.5 * (above[_V] + here[_V])
    far = max(abs(here[_U] - above[_U]), abs(here[_V] - above[_V])) * finer > _TILE
    kind = _EDGED if far else _tile(tiles, (v + 0.5) * finer - 0.5, (u + 0.5) * finer - 0.5)
    if kind == _DARK:
        return 0.0
    points = most
    if kind == _EVEN and _is_within(above, here, level, length, half_width):
        points = min(_EVEN_POINTS, most)
    for k in range(change.size):
        change[k] = (here[k] - above[k]) / points
    ratio = math.exp(change[_LN])
    strength = math.exp(above[_LN] - 0.5 * change[_LN])
    found = 0.0
    for point in range(points):
        strength *= ratio
        x, y = above[_X] + (point + 0.5) * change[_X], above[_Y] + (point + 0.5) * change[_Y]
        y_wall = above[_Y_WALL] + (point + 0.5) * change[_Y_WALL]
        z_wall = above[_Z_WALL] + (point + 0.5) * change[_Z_WALL]
        if not (0.0 < x < length and abs(y) < half_width):
            continue
        if not (0.0 < z_wall < level and abs(y_wall) < half_width):
            continue
        u, v = above[_U] + (point + 0.5) * change[_U], above[_V] + (point + 0.5) * change[_V]
        found += strength * _at_depth(pictures, x * layers_a_mm, (v + 0.5) * finer - 0.5, (u + 0.5) * finer - 0.5)
    return found / points


@part
def _may_be_lit(above: Array, here: Array, level: float, length: float, half_width: float) -> bool:
    """Whether light that crossed the wall in the water may be on a stretch of a line of sight."""
    if max(above[_Z_WALL], here[_Z_WALL]) <= 0.0 or min(above[_Z_WALL], here[_Z_WALL]) >= level:
        return False
    if max(above[_X], here[_X]) <= 0.0 or min(above[_X], here[_X]) >= length:
        return False
    return bool(min(abs(above[_Y]), abs(here[_Y])) < half_width)


@part
def _is_within(above: Array, here: Array, level: float, length: float, half_width: float) -> bool:
    """Whether all of a stretch of a line of sight is in the water, and lit by light that crossed the wall there."""
    for end in (above, here):
        if not (0.0 < end[_X] < length and abs(end[_Y]) < half_width):
            return False
        if not (0.0 < end[_Z_WALL] < level and abs(end[_Y_WALL]) < half_width):
            return False
    return True


@part
def _tile(tiles: NDArray[np.uint8], row: float, column: float) -> int:
    """What the light within a tile's side of a place of the picture is."""
    r, c = math.floor(row / _TILE), math.floor(column / _TILE)
    return int(tiles[min(max(r, 0), tiles.shape[0] - 1), min(max(c, 0), tiles.shape[1] - 1)])


@part
def _at_depth(thrown: Array, place: float, row: float, column: float) -> float:
    """The light between two depths, or that of all."""
    before = min(int(place), max(thrown.shape[0] - 2, 0))
    behind = place - before
    light = _between(thrown[before], row, column)
    if behind > 0.0:
        light = (1.0 - behind) * light + behind * _between(thrown[before + 1], row, column)
    return light


@part
def _between(picture: Array, row: float, column: float) -> float:
    """A picture between its pixels; 0 beside it."""
    rows, columns = picture.shape
    if not (0.0 <= row < rows - 1 and 0.0 <= column < columns - 1):
        return 0.0
    r, c = int(row), int(column)
    below, right = row - r, column - c
    upper = (1.0 - right) * picture[r, c] + right * picture[r, c + 1]
    lower = (1.0 - right) * picture[r + 1, c] + right * picture[r + 1, c + 1]
    return float((1.0 - below) * upper + below * lower)

"""Order 1 by way of clear walls: beams that walls send back, and what the camera sees mirrored in a wall.

Mirrored in the face that it meets, a line of sight runs straight on, and so does a beam: order 1 by way of faces is
order 1 of a camera, or of beams, that stand elsewhere. A camera with a viewpoint sees walls at such a slant that glass
sends all of it back, and so does a beam meet the walls beside it, and the floor. Followed are beams from the projector,
by way of one of these and from the far wall, seen directly, by way of one or two walls, and of the floor; what is sent
back twice between opposite faces, or by a side wall and the floor, is not (0.2 % of the beams' light for glass).
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from enum import Enum, auto
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.cuts import CUTS, rows_of_ends
from tankrig.light.line_of_sight import SharpBeam, add_across_sights
from tankrig.light.liquids import Liquids, liquids_of
from tankrig.light.quadrature import PixelRules, pixel_rules
from tankrig.light.rays import Edges, Geometry, Ray, light_ray, light_sources, sight_line
from tankrig.light.surface import many_to_camera, on_surface
from tankrig.light.walls.faces import (
    ENTRY,
    FAR,
    FLOOR,
    LEFT,
    RIGHT,
    ReflectingTank,
    face_table,
    sent_back,
    steepest_sights,
)
from tankrig.light.walls.mirrored_beams import NONE, Source, from_far_wall, meets, sent_aside
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

PARTS, PART_MM = 6, 0.7
"""Of a cell along x at most, and how long they need to be: where mirrored light ends is seen to that."""
STEEPEST_SINE = 0.99
"""In a pane, of light that still comes out of it within the water."""
PIECE_MM, COARSE_PIECE_MM = 8.0, 32.0
"""Width of the pieces of a beam that spreads to a wall: what the wall's inner side sends back goes with the angle."""
HALVINGS = 20
"""How often a pixel is halved to find which of its lines of sight meet a wall: to a millionth of its side."""


class Way(NamedTuple):
    """Faces that send light back, of its beam and then of a line of sight."""

    ahead: float
    """How far along x panes have moved the beam, or its mirror image in the far wall, mm."""
    spared: float
    """How much of that image's straight way goes through the far pane instead of water, mm."""
    meets_floor: bool
    """Whether the beam comes to the floor, so that its mirror image goes on above it."""
    from_far: bool
    """Whether the beam comes back from the far wall."""
    x_wall: int
    """Across x, which the line of sight meets, or `NONE`."""
    y_wall: int
    floor: bool
    outer: bool
    """Whether the light has been to the outer side of a pane, or in none."""

    @property
    def direct(self) -> bool:
        """Whether the line of sight meets no face."""
        return self.x_wall == NONE and self.y_wall == NONE and not self.floor


class SentBack(Enum):
    """Light that clear faces have sent back, told apart by how much of it there is.

    Shares are those of the light scattered once, three 4 mm rays in a tank of glass.
    """

    MIRRORED = auto()
    """What is seen by way of a face, or by a beam that a face beside it has sent on: 9 %, and 27 % in its norm."""
    FROM_FAR = auto()
    """Beams that come back from the far wall: .4 %."""
    FAINT = auto()
    """These beams once more by way of another face: .02 %."""

    @classmethod
    def of(cls, way: Way, by: int) -> "SentBack":
        """Of light on its way, of a beam or of its mirror image in the face `by`."""
        if not way.from_far:
            return cls.MIRRORED
        return cls.FROM_FAR if way.direct and by == NONE else cls.FAINT


class OnSurface(NamedTuple):
    """Light that leaves the water on its way to a camera, averaged over cells of the surface.

    Of a plain camera, whose pixels are such cells, it is the picture.
    """

    images: Array
    """(media, rows, columns), W/mm²/sr."""
    cell_mm: float

    def seen_by(self, scene: Scene) -> Array:
        """(media, rows, columns) of a scene's camera, which sees it from the same viewpoint."""
        if scene.camera.kind != "calibrated":
            return self.images
        return many_to_camera(scene, self.images, (self.cell_mm, self.cell_mm))


def by_walls_of(
    scene: Scene, media: Sequence[Medium], light: Collection[SentBack] = tuple(SentBack), coarse_mm: float | None = None
) -> OnSurface:
    """Light scattered once that clear faces have sent back before or after, on the surface.

    Of several liquids it costs little more than of one.

    Parameters
    ----------
    scene
        With sharp beams from a pinhole or collimated.
    media
        The liquids.
    light
        Which of it.
    coarse_mm
        Side of the cells, where what is seen has no edges.
    """
    plain = on_surface(scene, coarse_mm)
    side_mm, faces = plain.camera.pixel_mm, face_table(scene.tank)
    images, cells = np.zeros((len(media), *plain.camera.shape)), Cells.of(side_mm, coarse_mm is not None)
    if (faces[:, 0] % 3.0).any():
        _add_all(images, cells, replace(plain, medium=media[0]), media, faces, light)
    return OnSurface(images, side_mm)


class Cells(NamedTuple):
    """How finely light on cells of the surface is looked at."""

    side_mm: float
    parts: int
    """Of a cell along x, which are looked at by themselves."""
    piece_mm: float
    """Width of the pieces of a beam that spreads to a wall."""

    @classmethod
    def of(cls, side_mm: float, coarse: bool) -> "Cells":
        """Cells with so long sides."""
        if coarse:
            return cls(side_mm, 1, COARSE_PIECE_MM)
        return cls(side_mm, min(max(math.ceil(side_mm / PART_MM), 1), PARTS), PIECE_MM)


def _add_all(
    images: Array, cells: Cells, scene: Scene, media: Sequence[Medium], faces: Array, light: Collection[SentBack]
) -> None:
    """Add such light of a scene to (media, rows, columns) images of cells."""
    liquids, rules = liquids_of(media), pixel_rules()
    for geometry, beams in light_sources(scene):
        lit = [Source(geometry, beam) for beam in beams if beam.irradiance > 0.0]
        lit += [mirrored for one in lit for mirrored in sent_aside(one, faces, cells.piece_mm)]
        for source in lit:
            _add_source(images, cells, source, faces, liquids, rules, light)
    images *= np.array([one.sigma_s for one in media])[:, None, None]


def _add_source(
    images: Array, cells: Cells, source: Source, faces: Array, liquids: Liquids, rules: PixelRules,
    light: Collection[SentBack],
) -> None:  # fmt: skip
    """Add what is seen of a beam by way of faces, or of a mirrored one at all."""
    geometry, beam = source.geometry, source.beam
    tank = ReflectingTank(geometry, faces, steepest_sights(geometry))
    edges = (*beam.y_mm, *beam.z_mm)
    ux, _, _ = light_ray(geometry, 0.5 * sum(beam.y_mm), 0.5 * sum(beam.z_mm))
    beams = [(False, source.kept, 0.0), *((True, source.kept * share, by) for share, by in from_far_wall(faces, ux))]
    for from_far, kept, longer in beams:
        lit, there = SharpBeam(edges, kept * beam.irradiance), source._replace(ahead=source.ahead - longer)
        for way in _ways(there, faces, from_far, longer / ux) if kept > 0.0 else ():
            if SentBack.of(way, source.by) in light:
                _add_mirrored(images, cells, tank, liquids, lit, way, rules)


def _ways(source: Source, faces: Array, from_far: bool, spared_mm: float) -> list[Way]:
    """Faces that lines of sight may meet one after the other: one across x, one across y, the floor."""
    geometry = source.geometry
    clear = [bool(kind % 3.0) for kind in faces[:, 0]]
    across_x = [NONE, *([wall for wall in (ENTRY, FAR) if clear[wall]] if geometry.camera_pinhole else [])]
    across_y = [NONE, *([wall for wall in (LEFT, RIGHT) if clear[wall]] if geometry.camera_pinhole else [])]
    met = list(product(across_x, across_y, (False, True) if clear[FLOOR] else (False,)))
    meets_floor = source.by == FLOOR or meets(geometry, source.beam, FLOOR)
    return [
        Way(source.ahead, spared_mm, meets_floor, from_far, x, y, floor, outer)
        for x, y, floor in (met if from_far or source.by != NONE else met[1:])
        for outer in ((False, True) if max(x, y) != NONE or floor else (False,))
    ]


@kernel
def _add_mirrored(
    images: Array, cells: Cells, tank: ReflectingTank, liquids: Liquids, beam: SharpBeam, way: Way,
    rules: PixelRules,
) -> None:  # fmt: skip
    """Add one beam as lines of sight by way of some faces show it, for σs of 1/mm.

    ⟨I₁⟩ = 1/(Δx Δy) ∫ dx R ∫ dy I₁(mirrored line of sight)   over each cell, R what the faces send back
    """
    geometry, faces, _ = tank
    _, spared, meets_floor, from_far, x_wall, y_wall, floor, outer = way
    sights, (nodes, weights), (side_mm, parts, _) = rules.sights, rules.x, cells
    ends, found = np.empty(CUTS), np.empty(images.shape[0])
    half_width, height = geometry.half_width, geometry.height
    still = _mirrored(geometry, way, 0.0, 0.0)
    lit = _mirrored_edges(beam.edges, height, floor)
    above_edges = _mirrored_edges(beam.edges, 0.0, floor)
    aside = _farthest_aside(tank, way)
    for column in range(images.shape[2]):
        if not _in_reach(tank, x_wall, column * side_mm, side_mm, floor):
            continue
        for piece in range(parts):
            for i in range(nodes.size):
                x = (column + (piece + 0.5 + 0.5 * nodes[i]) / parts) * side_mm
                if x >= geometry.length:
                    continue
                rows_of_ends(still, _mirrored_x(geometry, way, x, 0.0), lit, ends)
                for row in range(images.shape[1]):
                    low = row * side_mm - half_width
                    high = min(low + side_mm, half_width)
                    if high <= low:
                        break
                    if not _in_reach(tank, y_wall, low, side_mm, floor):
                        continue
                    low, high = _part_in_reach(tank, way, x, low, high)
                    if high <= low:
                        continue
                    y_low, y_high = _mirrored_span(geometry, way, low, high)
                    if ends[-1] + aside <= y_low or ends[0] - aside >= y_high:
                        continue
                    vx, vy, vz, _ = sight_line(geometry, x, 0.5 * (low + high))
                    sight = Ray(x, 0.5 * (low + high), height, vx, vy, vz)
                    share, x_move, y_move, lift = _by_way(geometry, faces, sight, way)
                    if share <= 0.0:
                        continue
                    y_low, y_high = y_low + y_move, y_high + y_move
                    seen_x = _mirrored_x(geometry, way, x, x_move)
                    mirrored = _mirrored(geometry, way, x_move, y_move)
                    if outer:
                        rows_of_ends(mirrored, seen_x, lit, ends)
                        if ends[-1] <= y_low or ends[0] >= y_high:
                            continue
                    found[:] = 0.0
                    span, length = (seen_x, y_low, y_high), geometry.length - way.ahead
                    add_across_sights(found, 1.0, mirrored, span, ends, liquids, lit, sights)
                    if from_far:  # the light beyond the far wall alone: what is in two tanks less what is in one
                        near = _as_long(mirrored, length)
                        add_across_sights(found, -1.0, near, span, ends, liquids, lit, sights)
                    if floor and meets_floor:  # the light below the floor alone
                        above = _above_floor(geometry, way, x_move, y_move)
                        add_across_sights(found, -1.0, above, span, ends, liquids, above_edges, sights)
                        if from_far:
                            near = _as_long(above, length)
                            add_across_sights(found, 1.0, near, span, ends, liquids, above_edges, sights)
                    kept = beam.strength * share / side_mm * 0.5 * weights[i] / parts
                    for n in range(found.size):
                        images[n, row, column] += kept * math.exp(liquids.sigma_t[n] * (lift + spared)) * found[n]


@kernel
def _part_in_reach(tank: ReflectingTank, way: Way, x: float, low: float, high: float) -> tuple[float, float]:
    """From y to y across a pixel, of lines of sight that meet a wall across y before they end; none: high ≤ low."""
    if way.y_wall == NONE:
        return low, high
    wall_first = way.y_wall == LEFT
    near, far = (low, high) if wall_first else (high, low)
    if not _comes_to(tank, way, x, near):
        return high, low
    if _comes_to(tank, way, x, far):
        return low, high
    met = near
    for _ in range(HALVINGS):
        middle = 0.5 * (met + far)
        if _comes_to(tank, way, x, middle):
            met = middle
        else:
            far = middle
    return (low, met) if wall_first else (met, high)


@kernel
def _comes_to(tank: ReflectingTank, way: Way, x: float, y: float) -> bool:
    """Whether a line of sight comes to a wall across y before it ends."""
    geometry = tank.geometry
    _, vy, vz, _ = sight_line(geometry, x, y)
    outward = vy if way.y_wall == LEFT else -vy
    away = geometry.half_width + y if way.y_wall == LEFT else geometry.half_width - y
    return bool(away * vz < outward * geometry.height * (2.0 if way.floor else 1.0))


@part
def _farthest_aside(tank: ReflectingTank, way: Way) -> float:
    """How far panes move light, and beams that widen with depth, along y at most, mm."""
    if not way.outer:
        return 0.0
    along, steepest = 0.0, 0.0
    for wall in range(tank.faces.shape[0]):
        if wall == way.x_wall or wall == way.y_wall or (wall == FLOOR and way.floor):
            sine = min(tank.faces[wall, 4] / tank.faces[wall, 3], STEEPEST_SINE)
            along += 2.0 * tank.faces[wall, 2] * sine / math.sqrt(1.0 - sine * sine)
        if wall != FLOOR:
            steepest = max(steepest, tank.steepest[wall])
    return 3.0 * along * steepest


@part
def _in_reach(tank: ReflectingTank, wall: int, first_mm: float, pixel_mm: float, floor: bool) -> bool:
    """Whether lines of sight through a column, or row, of pixels can meet a wall before they end."""
    if wall == NONE:
        return True
    geometry = tank.geometry
    width = geometry.length if wall <= FAR else 2.0 * geometry.half_width
    from_low = first_mm if wall <= FAR else first_mm + geometry.half_width
    away = from_low if wall in (ENTRY, LEFT) else width - from_low - pixel_mm
    return bool(away <= geometry.height * (2.0 if floor else 1.0) * tank.steepest[wall])


@part
def _mirrored_x(geometry: Geometry, way: Way, x: float, x_move: float) -> float:
    """Where a line of sight crosses the surface, mirrored in the faces and then in the far wall, by which light comes.

    `x_move` is what panes move it by. Light that a pane has moved ahead is taken to be where it was, and all else is
    moved back.
    """
    seen_x = x if way.x_wall == NONE else -x if way.x_wall == ENTRY else 2.0 * geometry.length - x
    seen_x += x_move
    return (2.0 * geometry.length - seen_x if way.from_far else seen_x) - way.ahead


@part
def _mirrored_span(geometry: Geometry, way: Way, low: float, high: float) -> tuple[float, float]:
    """From y to y across a pixel, mirrored in the faces."""
    if way.y_wall == NONE:
        return low, high
    shift = 2.0 * geometry.half_width * (-1.0 if way.y_wall == LEFT else 1.0)
    return shift - high, shift - low


@part
def _mirrored_edges(edges: Edges, height: float, floor: bool) -> Edges:
    """Of a beam, as they lie over a floor that is twice as deep."""
    return (edges[0], edges[1], height - edges[3], height - edges[2]) if floor else edges


@part
def _mirrored(geometry: Geometry, way: Way, x_move: float, y_move: float) -> Geometry:
    """The tank and its mirror images, with the camera where the faces show it."""
    camera_y = geometry.camera_y
    if way.y_wall != NONE:
        camera_y = 2.0 * geometry.half_width * (-1.0 if way.y_wall == LEFT else 1.0) - camera_y
    height, floor = geometry.height, way.floor
    return Geometry(
        geometry.length * (2.0 if way.from_far else 1.0) - way.ahead, geometry.half_width,
        height * (2.0 if floor else 1.0),
        geometry.refractive_index, geometry.light_pinhole, geometry.light_x, geometry.light_y,
        height - geometry.light_z if floor else geometry.light_z, geometry.camera_pinhole,
        _mirrored_x(geometry, way, geometry.camera_x, x_move), camera_y + y_move,
        geometry.camera_z + (height if floor else 0.0), geometry.entry_index, geometry.pane, geometry.pane_index,
        geometry.reflected,
    )  # fmt: skip


@part
def _above_floor(geometry: Geometry, way: Way, x_move: float, y_move: float) -> Geometry:
    """The same where a line of sight has not met the floor yet: lit by the mirror image of the projector."""
    same = Way(way.ahead, way.spared, way.meets_floor, way.from_far, way.x_wall, way.y_wall, False, way.outer)
    one = _mirrored(geometry, same, x_move, y_move)
    return Geometry(
        one.length, one.half_width, one.height, one.refractive_index, one.light_pinhole, one.light_x, one.light_y,
        -one.light_z, one.camera_pinhole, one.camera_x, one.camera_y, one.camera_z, one.entry_index, one.pane,
        one.pane_index, one.reflected,
    )  # fmt: skip


@part
def _as_long(geometry: Geometry, length: float) -> Geometry:
    """The same with a tank of another length."""
    return Geometry(
        length, geometry.half_width, geometry.height, geometry.refractive_index, geometry.light_pinhole,
        geometry.light_x, geometry.light_y, geometry.light_z, geometry.camera_pinhole, geometry.camera_x,
        geometry.camera_y, geometry.camera_z, geometry.entry_index, geometry.pane, geometry.pane_index,
        geometry.reflected,
    )  # fmt: skip


@kernel
def _by_way(geometry: Geometry, faces: Array, sight: Ray, way: Way) -> tuple[float, float, float, float]:
    """What comes back on a line of sight by way of faces, and how panes move its mirrored image.

    Returns
    -------
    share
        0 where the line does not meet all of the faces within the water.
    x_move, y_move
        Of where the line, gone on straight, crosses the surface, mm.
    lift_mm
        By how much the way through the water is shorter than that straight line.
    """
    x, y, height, vx, vy, vz = sight
    length, half_width, floor = geometry.length, geometry.half_width, way.floor
    deep = height / vz * (2.0 if floor else 1.0)
    share, at_once, x_move, y_move, lift = 1.0, 1.0, 0.0, 0.0, 0.0
    for wall in (way.x_wall, way.y_wall):
        if wall == NONE:
            continue
        slope = vx if wall <= FAR else vy
        away = x if wall == ENTRY else length - x if wall == FAR else half_width + y if wall == LEFT else half_width - y
        outward = slope if wall in (ENTRY, LEFT) else -slope
        if outward <= 1e-9 or away / outward >= deep:
            return 0.0, 0.0, 0.0, 0.0
        back, along, inner = sent_back(faces, wall, outward)
        share, at_once = share * back, at_once * inner
        # What has been to the outer side comes out farther along the wall: down, and aside.
        tangent = math.sqrt(1.0 - outward * outward)
        down, aside = along * vz / tangent, -along * (vy if wall <= FAR else vx) / tangent
        by = down / vz
        lift += by
        # Gone back up to the surface along the mirrored line.
        if wall <= FAR:
            x_move -= by * vx
            y_move += aside + by * vy
        else:
            y_move -= by * vy
            x_move += aside + by * vx
    if floor:
        back, along, inner = sent_back(faces, FLOOR, vz)
        tangent = math.sqrt(1.0 - vz * vz)
        share, at_once = share * back, at_once * inner
        if tangent > 1e-9:
            x_move -= along * vx / tangent
            y_move -= along * vy / tangent
    if not way.outer:
        return share * at_once, 0.0, 0.0, 0.0
    return share * (1.0 - at_once), x_move, y_move, lift

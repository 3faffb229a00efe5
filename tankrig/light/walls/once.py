"""Order 1 by way of clear walls: beams that the far wall sends back, and what the camera sees mirrored in a wall.

Mirrored in the face that it meets, a line of sight runs straight on, and so does a beam: order 1 by way of faces is
order 1 of a camera, or of beams, that stand elsewhere. A camera with a viewpoint sees walls at such a slant that glass
sends all of it back. Followed are beams from the projector and from the far wall, seen directly, by way of one or two
walls, and of the floor; what is sent back twice between opposite faces is not (0.2 % of the beams' light for glass).
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.light.cuts import CUTS, rows_of_ends
from tankrig.light.line_of_sight import SharpBeam, add_across_sights
from tankrig.light.liquids import Liquids, liquids_of
from tankrig.light.quadrature import PixelRules, pixel_rules
from tankrig.light.rays import Geometry, Ray, light_ray, light_sources, sight_line
from tankrig.light.surface import on_surface, to_camera
from tankrig.light.walls.faces import ENTRY, FAR, FLOOR, LEFT, RIGHT, face_table, sent_back
from tankrig.scene import Scene

Array = NDArray[np.float64]

PARTS = 6
"""Of a pixel along x: where mirrored light ends is seen to that."""
NONE = -1


class Way(NamedTuple):
    """Faces that send light back, of its beam and then of a line of sight."""

    from_far: bool
    """Whether the beam comes back from the far wall."""
    x_wall: int
    """Across x, which the line of sight meets, or `NONE`."""
    y_wall: int
    floor: bool
    outer: bool
    """Whether the light has been to the outer side of a pane, or in none."""


def once_by_walls(scene: Scene) -> Array:
    """Light scattered once that clear faces have sent back before or after, W/mm²/sr.

    Parameters
    ----------
    scene
        With sharp beams from a pinhole or collimated.

    Returns
    -------
    (rows, columns) array
    """
    image = np.zeros(scene.camera.shape)
    faces = face_table(scene.tank)
    if scene.medium.sigma_s == 0.0 or not (faces[:, 0] % 3.0).any():
        return image
    if scene.camera.kind == "calibrated":
        plain = on_surface(scene)
        return to_camera(scene, once_by_walls(plain), (plain.camera.pixel_mm, plain.camera.pixel_mm))
    medium, pixel_mm = scene.medium, scene.camera.pixel_mm
    liquids, rules = liquids_of([medium]), pixel_rules()
    for geometry, beams in light_sources(scene):
        for beam in beams:
            if beam.irradiance == 0.0:
                continue
            edges = (*beam.y_mm, *beam.z_mm)
            ux, _, _ = light_ray(geometry, 0.5 * sum(beam.y_mm), 0.5 * sum(beam.z_mm))
            far = sent_back(faces, FAR, ux)[0]
            for from_far, kept in ((False, 1.0), (True, far)):
                lit = SharpBeam(edges, kept * medium.sigma_s * beam.irradiance)
                for way in _ways(geometry, faces, from_far) if kept > 0.0 else ():
                    _add_mirrored(image, pixel_mm, geometry, faces, liquids, lit, way, rules)
    return image


def _ways(geometry: Geometry, faces: Array, from_far: bool) -> list[Way]:
    """Faces that lines of sight may meet one after the other: one across x, one across y, the floor."""
    clear = [bool(kind % 3.0) for kind in faces[:, 0]]
    across_x = [NONE, *([wall for wall in (ENTRY, FAR) if clear[wall]] if geometry.camera_pinhole else [])]
    across_y = [NONE, *([wall for wall in (LEFT, RIGHT) if clear[wall]] if geometry.camera_pinhole else [])]
    met = list(product(across_x, across_y, (False, True) if clear[FLOOR] else (False,)))
    return [
        Way(from_far, x, y, floor, outer)
        for x, y, floor in (met if from_far else met[1:])
        for outer in ((False, True) if max(x, y) != NONE or floor else (False,))
    ]


@kernel
def _add_mirrored(
    image: Array, pixel_mm: float, geometry: Geometry, faces: Array, liquids: Liquids, beam: SharpBeam, way: Way,
    rules: PixelRules,
) -> None:  # fmt: skip
    """Add one beam as lines of sight by way of some faces show it.

    ⟨I₁⟩ = 1/(Δx Δy) ∫ dx R ∫ dy I₁(mirrored line of sight)   over each pixel, R what the faces send back
    """
    edges, (from_far, x_wall, y_wall, floor, _) = beam.edges, way
    sigma_t, sights = liquids.densest, rules.sights
    nodes, weights = rules.x
    ends, found = np.empty(CUTS), np.zeros(1)
    length, half_width, height = geometry.length, geometry.half_width, geometry.height
    for column in range(image.shape[1]):
        for piece in range(PARTS):
            for i in range(nodes.size):
                x = (column + (piece + 0.5 + 0.5 * nodes[i]) / PARTS) * pixel_mm
                if x >= length:
                    continue
                for row in range(image.shape[0]):
                    low = row * pixel_mm - half_width
                    high = min(low + pixel_mm, half_width)
                    if high <= low:
                        break
                    vx, vy, vz, _ = sight_line(geometry, x, 0.5 * (low + high))
                    sight = Ray(x, 0.5 * (low + high), height, vx, vy, vz)
                    share, x_move, y_move, lift = _by_way(geometry, faces, sight, way)
                    if share <= 0.0:
                        continue
                    # The faces' mirror images: first of the line and the camera, then of the light by the far wall.
                    seen_x = x if x_wall == NONE else -x if x_wall == ENTRY else 2.0 * length - x
                    camera_x = geometry.camera_x
                    if x_wall != NONE:
                        camera_x = -camera_x if x_wall == ENTRY else 2.0 * length - camera_x
                    y_sign = 1.0 if y_wall == NONE else -1.0
                    y_shift = 0.0 if y_wall == NONE else -2.0 * half_width if y_wall == LEFT else 2.0 * half_width
                    y_low, y_high = y_sign * low + y_shift, y_sign * high + y_shift
                    y_low, y_high = min(y_low, y_high) + y_move, max(y_low, y_high) + y_move
                    seen_x, camera_x = seen_x + x_move, camera_x + x_move
                    camera_y = y_sign * geometry.camera_y + y_shift + y_move
                    if from_far:
                        seen_x, camera_x = 2.0 * length - seen_x, 2.0 * length - camera_x
                    mirrored = Geometry(
                        2.0 * length if from_far else length, half_width, height * (2.0 if floor else 1.0),
                        geometry.refractive_index, geometry.light_pinhole, geometry.light_x, geometry.light_y,
                        height - geometry.light_z if floor else geometry.light_z, geometry.camera_pinhole,
                        camera_x, camera_y, geometry.camera_z + (height if floor else 0.0), geometry.entry_index,
                        geometry.pane, geometry.pane_index, geometry.reflected,
                    )  # fmt: skip
                    lit = (edges[0], edges[1], height - edges[3], height - edges[2]) if floor else edges
                    rows_of_ends(mirrored, seen_x, lit, ends)
                    if ends[-1] <= y_low or ends[0] >= y_high:
                        continue
                    found[0] = 0.0
                    add_across_sights(found, 1.0, mirrored, (seen_x, y_low, y_high), ends, liquids, lit, sights)
                    if from_far:  # the light beyond the far wall alone: what is in two tanks less what is in one
                        near = _as_long(mirrored, length)
                        add_across_sights(found, -1.0, near, (seen_x, y_low, y_high), ends, liquids, lit, sights)
                    gained = math.exp(sigma_t * lift)
                    image[row, column] += (
                        beam.strength * share * gained * found[0] / pixel_mm * 0.5 * weights[i] / PARTS
                    )


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

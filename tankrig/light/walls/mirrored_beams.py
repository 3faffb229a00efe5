"""Beams by way of clear faces: mirrored in the walls beside them and in the floor, and sent back by the far wall.

Mirrored in the face that it meets, a beam runs straight on. What has been to the outer side of a pane comes out farther
along it.
"""

import math
from dataclasses import replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.light.rays import Geometry, light_ray
from tankrig.light.walls.faces import FAR, FLOOR, GLASS, LEFT, RIGHT, sent_back
from tankrig.scene import Beam

Array = NDArray[np.float64]

NONE = -1
"""Stands for no face: of a beam that no face has mirrored, of a line of sight that meets none."""


class Source(NamedTuple):
    """A beam and its projector, or the mirror image of both in a wall beside it or in the floor."""

    geometry: Geometry
    beam: Beam
    kept: float = 1.0
    """Share of its light."""
    ahead: float = 0.0
    """How far along x the outer side of the pane has moved the light, mm."""
    by: int = NONE
    """The face, if it is a mirror image."""


def sent_aside(source: Source, faces: Array, piece_mm: float) -> list[Source]:
    """Mirror images of a beam in the clear faces beside it, of its pieces so wide that meet them."""
    geometry, beam = source.geometry, source.beam
    (low, high), (lower, upper) = beam.y_mm, beam.z_mm
    count = max(1, math.ceil((high - low) / piece_mm))
    edges = np.linspace(low, high, count + 1).tolist()
    heights = np.linspace(lower, upper, max(1, math.ceil((upper - lower) / piece_mm)) + 1).tolist()
    found = []
    for face, width in ((LEFT, -geometry.half_width), (RIGHT, geometry.half_width)):
        turned = geometry._replace(light_y=2.0 * width - geometry.light_y)
        for span in pairwise(edges):
            image = replace(beam, y_mm=(2.0 * width - span[1], 2.0 * width - span[0]))
            found += _by_face(source, faces, face, replace(beam, y_mm=span), Source(turned, image))
    turned = geometry._replace(light_z=-geometry.light_z)
    for span in pairwise(heights):
        image = replace(beam, z_mm=(-span[1], -span[0]))
        found += _by_face(source, faces, FLOOR, replace(beam, z_mm=span), Source(turned, image))
    return found


def _by_face(source: Source, faces: Array, face: int, piece: Beam, image: Source) -> list[Source]:
    """The mirror image of a piece of a beam, by the inner and by the outer side of a face; none if it does not meet."""
    geometry = source.geometry
    if not faces[face, 0] % 3.0 or not meets(geometry, piece, face):
        return []
    ux, uy, uz = light_ray(geometry, 0.5 * sum(piece.y_mm), 0.5 * sum(piece.z_mm))
    cosine = abs(uz) if face == FLOOR else abs(uy)
    share, along, at_once = sent_back(faces, face, cosine)
    ahead = along * ux / math.sqrt(1.0 - cosine * cosine)
    sides = ((share * at_once, 0.0), (share * (1.0 - at_once), ahead))
    return [image._replace(kept=kept, ahead=by, by=face) for kept, by in sides if kept > 0.0]


def meets(geometry: Geometry, beam: Beam, face: int) -> bool:
    """Whether some of a beam comes to a face beside it."""
    for y, z in product(beam.y_mm, beam.z_mm):
        ux, uy, uz = light_ray(geometry, y, z)
        at_y, at_z = y + uy / ux * geometry.length, z + uz / ux * geometry.length
        beyond = {LEFT: -geometry.half_width - at_y, RIGHT: at_y - geometry.half_width, FLOOR: -at_z}[face]
        if beyond > 0.0:
            return True
    return False


def from_far_wall(faces: Array, ux: float) -> list[tuple[float, float]]:
    """What the far wall's inner and outer side send back of a beam, and how much longer either's straight way is, mm.

    What has been to the outer side comes out 2 d tan θ_glass farther along the wall, where a beam that goes straight on
    is 2 d tan θ_glass/tan θ_water deeper: that says by how much it is moved, and how it spreads in the pane.
    """
    share, along, at_once = sent_back(faces, FAR, ux)
    tangent = math.sqrt(max(1.0 - ux * ux, 0.0)) / ux
    straight = 2.0 * faces[FAR, 2] * faces[FAR, 4] / faces[FAR, 3] if faces[FAR, 0] == GLASS else 0.0
    return [(share * at_once, 0.0), (share * (1.0 - at_once), along / tangent if tangent > 1e-6 else straight)]

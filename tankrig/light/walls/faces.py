"""The tank's faces as numbers for kernels: how much of the light in the water comes back, and where.

A pane of glass sends light back at both of its sides. With F₁ and F₂ the Fresnel reflectances from water to glass and
from glass to air, what comes back of incoherent light is F₁ + (1 − F₁)² F₂ / (1 − F₁ F₂): all of it beyond the angle at
which glass sends light back totally, whatever the glass is (48.75° in water of 1.33). What has been to the outer side
comes out 2 d tan θ_glass farther along the wall, d the pane's thickness.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.geometry.optics import reflectance
from tankrig.light.rays import Geometry
from tankrig.scene import Tank

Array = NDArray[np.float64]

KINDS = {"black": 0.0, "glass": 1.0, "clear": 2.0, "diffuse": 3.0}
BLACK, GLASS, CLEAR, DIFFUSE = 0, 1, 2, 3
ENTRY, FAR, LEFT, RIGHT, FLOOR = 0, 1, 2, 3, 4
ROUNDED_UP = 1.01
"""Of a slope, so that no light is lost to rounding, or to what panes move."""


class ReflectingTank(NamedTuple):
    """The tank, what its faces send back (`face_table`), and how far they show it to the camera (`steepest_sights`)."""

    geometry: Geometry
    faces: Array
    steepest: Array


def face_table(tank: Tank) -> Array:
    """(5, 5) of entry, far, left, right and floor: kind, reflectance, thickness in mm, index of the pane, of the water.

    Examples
    --------
    >>> from tankrig.scene.optics import Face, Faces
    >>> face_table(Tank(faces=Faces(floor=Face("diffuse", 0.04))))[4, :2].tolist()
    [3.0, 0.04]
    """
    rows = []
    for face in tank.faces.all:
        thickness = tank.wall_mm if face.thickness_mm is None else face.thickness_mm
        index = tank.wall_index if face.index is None else face.index
        kind = KINDS["black"] if face.dark else KINDS[face.kind]
        rows.append((kind, face.reflectance, thickness, index, tank.refractive_index))
    return np.array(rows, float)


@kernel
def sent_back(faces: Array, face: int, cosine: float) -> tuple[float, float, float]:
    """What of the light that meets a clear face comes back, and how far along it.

    Parameters
    ----------
    faces
        Of `face_table`.
    face
        Its number.
    cosine
        Of the angle of incidence in the water, 0 … 1.

    Returns
    -------
    share
        Of the light; 0 of a black or diffuse face.
    along_mm
        From where it meets the face to where what has been to the pane's outer side comes out again.
    at_once
        Part of the share that has not been there.

    Examples
    --------
    >>> from tankrig.scene.optics import Face, Faces
    >>> faces = face_table(Tank(faces=Faces(far=Face("glass", thickness_mm=5.0))))
    >>> [round(number, 3) for number in sent_back(faces, FAR, 1.0)], sent_back(faces, FAR, 0.6)[0]
    ([0.047, 0.0, 0.095], 1.0)
    """
    kind = faces[face, 0]
    if kind == CLEAR:
        return faces[face, 1], 0.0, 1.0
    if kind != GLASS:
        return 0.0, 0.0, 1.0
    glass, water = faces[face, 3], faces[face, 4]
    inner = reflectance(cosine, water / glass)
    sine = water / glass * math.sqrt(max(1.0 - cosine * cosine, 0.0))
    if sine >= 1.0 or inner >= 1.0:  # all of it turns back before the pane, or along it
        return 1.0, 0.0, 1.0
    within = math.sqrt(1.0 - sine * sine)
    outer = reflectance(within, glass)
    share = inner + (1.0 - inner) ** 2 * outer / (1.0 - inner * outer)
    return share, 2.0 * faces[face, 2] * sine / within, inner / share if share > 0.0 else 1.0


def steepest_sights(geometry: Geometry) -> Array:
    """(4,) how much a line of sight can move towards the camera per height, where it leaves by each of the walls.

    What is d mm inside of the entry, far, left or right wall, and h mm below the surface, is not seen mirrored in it
    where d is more than h times this: the line of sight would come out beyond the tank's edge. Negative where the
    camera is not on the inner side of a wall. Lines of sight that are vertical move nowhere.
    """
    if not geometry.camera_pinhole:
        return np.zeros(4)
    above = geometry.camera_z - geometry.height
    ways = np.array(
        [
            geometry.camera_x, geometry.length - geometry.camera_x,
            geometry.half_width + geometry.camera_y, geometry.half_width - geometry.camera_y,
        ]
    )  # fmt: skip
    farthest = math.hypot(max(ways[0], ways[1]), max(ways[2], ways[3]))
    sines = ways / np.hypot(ways, above) / geometry.refractive_index
    sine = farthest / math.hypot(farthest, above) / geometry.refractive_index
    return np.asarray(ROUNDED_UP * sines / math.sqrt(1.0 - sine * sine))

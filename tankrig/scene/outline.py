"""Where each beam should be in the camera's picture, and where lenses blur its sides."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.geometry.lens import to_pixels
from tankrig.geometry.pose import to_device
from tankrig.scene.description import Scene
from tankrig.scene.footprint import footprints

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Polygon = NDArray[np.float64]

REACH = 2.5
"""Standard deviations of the blur, to either side of an edge, within which a fit must not look (decision 214)."""
UNKNOWN_REACH_MM = 1.2
"""The same in mm for calibrated devices whose blur nobody has measured."""
CHANGED = 0.02
"""Share of the brightest by which blur changes the light at an edge: steps between the levels of one picture's beams
(`tankrig.scene.projection.LEVELS`), of which blur changes half, are none."""
MOST_CELLS_A_SIDE, MOST_CELLS = 30_000, 2**27
"""Of a tank; one of 2 m in cells of 0.07 mm has as many."""
CHANGED_SDS = 2.054
"""Standard deviations from a step at which blur changes the light by just that."""
LAYER_MM = 1.0
"""Height of the layers that lit volumes are drawn in."""
ALONG = 9
"""Points of a ray that are followed into the picture, in which rays are bent."""
BESIDE = -1e6
"""Coordinate, in cells, that lines of sight get which do not meet the plane: beside any tank."""
FINE, FINEST = 8, 24
"""Cells that the reach is drawn in, and points looked at along a pixel at most."""


def beam_outlines(scene: Scene) -> list[Polygon]:
    """Outline of the lit volume of each beam, as the camera sees it.

    The middle height of a beam is followed from the wall x = 0 to the far wall, bent as the light is, and projected on
    the plane z = Lz, on which pixels lie; for a calibrated camera, on its picture.

    Parameters
    ----------
    scene
        Its medium does not matter.

    Returns
    -------
    list of (4, 2) float64
        x and y in mm of the corners, in turn. A calibrated camera's picture is taken as one of square pixels of its
        `pixel_mm` that starts at x = 0, y = −Ly/2, as pictures are drawn.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> beam_outlines(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0)))[0].tolist()
    [[0.0, -2.0], [240.0, -2.0], [240.0, 2.0], [0.0, 2.0]]
    """
    outlines = []
    for beam in scene.projector.beams:
        rays = _rays(scene, np.array(beam.y_mm), np.full(2, sum(beam.z_mm) / 2.0))
        ends = _in_picture(scene, _on_surface(scene, rays[:, [0, -1]]))
        outlines.append(ends[[0, 0, 1, 1], [0, 1, 1, 0]])
    return outlines


def in_picture(scene: Scene, points_mm: Array) -> Array:
    """Where the camera's picture shows places in the water.

    Parameters
    ----------
    scene
        Its medium and its projector do not matter.
    points_mm
        (…, 3) x, y and z.

    Returns
    -------
    (…, 2) float64
        x and y in mm on the plane z = Lz, for a calibrated camera as `beam_outlines` says.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (18.0, 22.0)),))
    >>> camera = Camera("pinhole", (80, 120), 2.0, position_mm=(120.0, 0.0, 620.0))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, camera)
    >>> in_picture(scene, np.array([240.0, 60.0, 20.0])).tolist()
    [220.0, 50.0]
    """
    return _in_picture(scene, _on_surface(scene, points_mm))


def _rays(scene: Scene, y_mm: Array, z_mm: Array) -> Array:
    """(n, ALONG, 3) points from where rays through (0, y, z) enter to where they leave."""
    start = np.stack([np.zeros(y_mm.size), y_mm, z_mm], axis=1)
    way = _entering(scene, start)
    low = np.array([0.0, -scene.tank.size_mm[1] / 2.0, 0.0])
    wall = np.where(way > 0.0, low + scene.tank.size_mm, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.min(np.where(way != 0.0, (wall - start) / way, np.inf), axis=1)
    return np.asarray(start[:, None] + np.linspace(0.0, 1.0, ALONG)[:, None] * (reach[:, None] * way)[:, None])


def _entering(scene: Scene, start: Array) -> Array:
    """(n, 3) directions in which light enters at points of x = 0."""
    if scene.projector.kind == "collimated" or scene.projector.position_mm is None:
        return np.broadcast_to([1.0, 0.0, 0.0], start.shape)
    index, wall_mm, wall_index = scene.tank.entry_bends
    if index == 1.0 and wall_mm == 0.0:
        return np.asarray(start - np.array(scene.projector.position_mm))
    from tankrig.geometry.refraction import entry_wall, look_into_water

    return look_into_water(entry_wall(index, wall_mm, wall_index), scene.projector.position_mm, start).in_water


def _on_surface(scene: Scene, points: Array) -> Array:
    """(…, 2) x and y of where the camera's sight of points (…, 3) crosses the plane z = Lz."""
    camera, height = scene.camera, scene.tank.size_mm[2]
    if camera.kind == "orthographic" or camera.position_mm is None:
        return points[..., :2]
    place = np.array(camera.position_mm)
    if scene.tank.surface_index == 1.0:
        by = (place[2] - height) / (place[2] - points[..., 2:])
        return np.asarray(place[:2] + by * (points[..., :2] - place[:2]))
    from tankrig.geometry.refraction import look_into_water, water_surface

    inside = np.minimum(points, [np.inf, np.inf, height])  # a ray's end may be a rounding above
    return look_into_water(water_surface(height, scene.tank.surface_index), place, inside).entry_mm[..., :2]


def _in_picture(scene: Scene, surface: Array) -> Array:
    """(…, 2) where the camera's picture shows points of the plane z = Lz, in mm as `beam_outlines` says."""
    camera = scene.camera
    if camera.kind != "calibrated":
        return surface
    points = np.concatenate([surface, np.full((*surface.shape[:-1], 1), scene.tank.size_mm[2])], axis=-1)
    pixels = to_pixels(camera.lens, to_device(camera.pose, points))
    return np.asarray((pixels + 0.5) * camera.sides_mm[::-1] - [0.0, scene.tank.size_mm[1] / 2.0])


def edge_reach_mm(scene: Scene) -> float:
    """How far from an edge of the light, on the plane z = Lz, a fit must not look; 0 where nothing says that it blurs.

    `REACH` standard deviations of what camera and projector blur together, the projector's as wide as it has grown at
    the far wall. For a calibrated device of unknown blur, of which models have none either, `UNKNOWN_REACH_MM` at
    least; any other is as described, sharp.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),), blur_mm=0.3)
    >>> sharp, soft = (Camera("orthographic", (80, 120), 2.0, blur_mm=blur_mm) for blur_mm in (None, 0.4))
    >>> [round(edge_reach_mm(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, camera)), 3) for camera in (sharp, soft)]
    [0.75, 1.25]
    """
    light, camera = scene.projector, scene.camera
    grown = 1.0
    if light.kind != "collimated" and light.position_mm is not None:
        index, wall_mm, _ = scene.tank.entry_bends
        grown += scene.tank.size_mm[0] / index / (-light.position_mm[0] - wall_mm)
    reach = REACH * math.hypot(camera.blur_mm or 0.0, (light.blur_mm or 0.0) * grown)
    unknown = any(
        one.kind == "calibrated" and one.blur_mm is None and one.blur.sigma_mm == 0.0 for one in (light, camera)
    )
    return max(reach, UNKNOWN_REACH_MM) if unknown else reach


def edges_of_light(scene: Scene, reach_mm: float | None = None) -> Mask:
    """Pixels that look at the sides of beams: there, lenses' blur is not in the model.

    Blur spreads light to where only scattered light should be, and a fit takes it for scattering: with a projector that
    blurs by 0.3 mm, σs of thin ink came out 5 % too high. `tankrig.estimate` leaves out what its `mask` names.

    The lit part of each line of sight is drawn, and drawn again with the blur. Where the two differ there is an edge,
    wherever it comes from: a beam's side, its end at a wall or at the surface. Beams side by side have none between
    them, nor have levels of one smooth picture.

    Parameters
    ----------
    scene
        Its medium does not matter.
    reach_mm
        To either side of an edge, on the plane z = Lz; None for `edge_reach_mm`.

    Returns
    -------
    (rows, columns) bool

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-20.0, 20.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> np.flatnonzero(edges_of_light(scene, 1.2)[:, 60]).tolist()
    [29, 30, 49, 50]
    """
    import cv2

    reach = edge_reach_mm(scene) if reach_mm is None else reach_mm
    if reach <= 0.0:
        return np.zeros(scene.camera.shape, bool)
    cell, sd = _not_too_fine(scene, reach / FINE), FINE / REACH
    sharp = _lit_columns(scene, cell, FINE)
    blurred = cv2.GaussianBlur(sharp, (0, 0), sd, borderType=cv2.BORDER_CONSTANT)
    changed = (np.abs(blurred - sharp) > CHANGED * sharp.max()).astype(np.uint8)
    beyond = round(FINE - CHANGED_SDS * sd)
    near = cv2.dilate(changed, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * beyond + 1, 2 * beyond + 1)))
    parts = int(np.clip(math.ceil(max(scene.camera.sides_mm) / cell), 1, FINEST))
    rows, columns = scene.camera.shape
    return np.asarray(_seen_of(scene, near, cell, FINE, parts).reshape(rows, parts, columns, parts).any(axis=(1, 3)))


def lit_pixels(scene: Scene) -> Mask:
    """(rows, columns) pixels on whose middle line of sight the beams light something."""
    cell = _not_too_fine(scene, max(*scene.camera.sides_mm, LAYER_MM) / 4.0)
    return _seen_of(scene, (_lit_columns(scene, cell, 1) > 0.0).astype(np.uint8), cell, 1, 1)


def _not_too_fine(scene: Scene, cell_mm: float) -> float:
    """The side of a cell of which a tank, even one of a kilometre, has no more than OpenCV and memory take."""
    length, width, _ = scene.tank.size_mm
    return max(cell_mm, max(length, width) / MOST_CELLS_A_SIDE, math.sqrt(length * width / MOST_CELLS))


def _lit_columns(scene: Scene, cell_mm: float, margin: int) -> NDArray[np.float32]:
    """Irradiance times height of what is lit along each line of sight, by cells of the plane z = Lz and a margin.

    Lit volumes are drawn layer by layer, each column of cells from ray to ray, cells that a ray crosses in part: what
    one beam ends with the next begins with, to the last digit.
    """
    length, width, _ = scene.tank.size_mm
    shape = math.ceil(width / cell_mm) + 2 * margin, math.ceil(length / cell_mm) + 2 * margin
    steps, columns = np.zeros((shape[0] + 1, shape[1])), np.arange(shape[1])
    corner = np.array([0.0, -0.5 * width])
    for beam in scene.projector.beams:
        low, high = beam.z_mm
        layers = max(1, math.ceil((high - low) / LAYER_MM))
        middles = low + (np.arange(layers) + 0.5) * (high - low) / layers
        weight = beam.irradiance * (high - low) / layers
        sides = [_on_surface(scene, _rays(scene, np.full(layers, y_mm), middles)) - corner for y_mm in beam.y_mm]
        for one, other in zip(*(side / cell_mm + margin for side in sides), strict=True):
            begin, end = min(one[0, 0], other[0, 0]), max(one[-1, 0], other[-1, 0])
            lit = columns[(columns + 0.5 >= begin) & (columns + 0.5 < end)]
            for ray, sign in ((one, weight), (other, -weight)):
                at = np.clip(np.interp(lit + 0.5, ray[:, 0], ray[:, 1]), 0.0, shape[0] - 1e-9)
                row = at.astype(int)
                np.add.at(steps, (row, lit), sign * (row + 1 - at))
                np.add.at(steps, (row + 1, lit), sign * (at - row))
    canvas = np.cumsum(steps, axis=0, out=steps)[:-1]
    canvas[canvas <= 1e-6 * canvas.max()] = 0.0
    return canvas.astype(np.float32)


def _seen_of(scene: Scene, cells: NDArray[np.uint8], cell_mm: float, margin: int, parts: int) -> Mask:
    """(rows · parts, columns · parts) what the parts of each pixel see of such cells; nothing beside them."""
    import cv2

    rows, columns = scene.camera.shape
    corner = np.array([0.0, -0.5 * scene.tank.size_mm[1]])
    corners = (footprints(scene.camera, scene.tank).corners_mm - corner) / cell_mm + margin - 0.5
    corners[~np.isfinite(corners)] = BESIDE
    middles = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]) / parts  # of the parts, in pixels from the first corner
    x, y = (
        cv2.warpAffine(
            corners[..., k].astype(np.float32), middles, (columns * parts, rows * parts),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        for k in (0, 1)
    )  # fmt: skip
    seen = cv2.remap(cells, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(seen > 0)


def beside_water(scene: Scene, margin_mm: float = 0.0) -> Mask:
    """(rows, columns) pixels whose middle looks beside the plane z = Lz of the tank, or is as near to its rim."""
    length, width, _ = scene.tank.size_mm
    x, y = np.moveaxis(footprints(scene.camera, scene.tank).centres_mm, -1, 0)
    with np.errstate(invalid="ignore"):
        inside = (np.minimum(x, length - x) > margin_mm) & (0.5 * width - np.abs(y) > margin_mm)
    return np.asarray(~inside)


def blurred_pixels(scene: Scene) -> Mask:
    """Pixels that a fit must not look at, because light is blurred there that its model has sharp.

    The edges of the light, and what looks beside the water or so near to its rim that the dark beyond is blurred in.
    None, where nothing says that camera or projector blur: see `edge_reach_mm`.

    Parameters
    ----------
    scene
        Its medium does not matter.

    Returns
    -------
    (rows, columns) bool
    """
    reach = edge_reach_mm(scene)
    if reach <= 0.0:
        return np.zeros(scene.camera.shape, bool)
    rim = REACH * scene.camera.blur_mm if scene.camera.blur_mm is not None else reach
    return edges_of_light(scene, reach) | beside_water(scene, rim + 0.5 * max(scene.camera.sides_mm))

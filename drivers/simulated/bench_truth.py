"""What is true of a simulated bench that can be calibrated: drawn from a seed, and known to nobody else."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TANK_MM = (240.0, 160.0, 120.0)
_VIEW_MM = 300.0
"""Width of what the camera sees at the water."""
_PICTURE_MM = 195.0
"""Width of the projector's picture on the wall."""


@dataclass(frozen=True, eq=False)
class TrueOptics:
    """A camera or projector: a point X of the tank is at R X + t in its frame, and OpenCV's lens maps that to a pixel.

    Parameters
    ----------
    shape
        (rows, columns).
    matrix, distortion
        (3, 3) and (5,), as OpenCV has them.
    rotation, translation_mm
        R and t.
    blur_px
        Standard deviation of its point spread.
    vignetting
        Part of the light that is missing in the corners.
    """

    shape: tuple[int, int]
    matrix: Array
    distortion: Array
    rotation: Array
    translation_mm: Array
    blur_px: float
    vignetting: float

    @property
    def centre_mm(self) -> Array:
        """Viewpoint in the tank's frame."""
        return np.asarray(-self.rotation.T @ self.translation_mm)


@dataclass(frozen=True)
class TrueStray:
    """Light that goes astray; see `drivers.simulated.settings.Stray`, whose names these are."""

    camera_blur_corner: float = 1.0
    camera_halo: float = 0.0
    camera_halo_mm: float = 30.0
    veil: float = 0.0
    projector_halo: float = 0.0
    projector_halo_mm: float = 20.0
    projector_lens_mm: float = 0.0
    projector_focus_mm: float = 100.0
    floor: float = 0.0
    glass: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class TrueBench:
    """Everything about a bench; lengths in mm in the tank's frame.

    Parameters
    ----------
    camera, projector
        Above the water, and outside the wall x = 0.
    level_mm, surface
        Height of the water above the origin, and the unit normal of its surface.
    water_index
        Of refraction.
    pane_mm, pane_index
        Thickness and index of the wall's glass.
    gamma
        Light of a projector pixel at level v: (v/255)^gamma.
    board_scale
        Size of the printed board over what it should be.
    laid_mm, laid_rad
        How far off the board lies when it is laid into the corner, along x and y, and turned.
    room, full
        Radiance of white paper in the room's light, and in the projector's on the wall; W/mm²/sr.
    leak
        Part of the light of level 255 that every pixel of the projector has besides, at level 0 too.
    stray
        Light that goes astray in lenses and at walls.
    """

    camera: TrueOptics
    projector: TrueOptics
    level_mm: float
    surface: Array
    water_index: float
    pane_mm: float
    pane_index: float
    gamma: float
    board_scale: float
    laid_mm: tuple[float, float]
    laid_rad: float
    room: float = 0.9e-3
    full: float = 3e-2
    leak: float = 0.0
    stray: TrueStray = TrueStray()


def random_bench(seed: int, camera_shape: tuple[int, int], projector_shape: tuple[int, int]) -> TrueBench:
    """Draw a bench such as a lab may build.

    Examples
    --------
    >>> bench = random_bench(3, (1080, 1920), (768, 1024))
    >>> bool(90.0 < bench.level_mm < 118.0), bool(bench.projector.centre_mm[0] < -300.0)
    (True, True)
    """
    random = np.random.default_rng((seed, 73))
    level = random.uniform(104.0, 117.0)
    tilt = np.deg2rad(random.uniform(-0.05, 0.05, 2))
    surface = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
    return TrueBench(
        camera=_camera(random, camera_shape, level),
        projector=_projector(random, projector_shape),
        level_mm=level,
        surface=surface,
        water_index=1.33 + random.uniform(-5e-4, 5e-4),
        pane_mm=6.0 + random.uniform(-0.05, 0.05),
        pane_index=1.52 + random.uniform(-0.003, 0.003),
        gamma=random.uniform(1.8, 2.4),
        board_scale=1.0 + random.uniform(-1e-4, 1e-4),
        laid_mm=(random.uniform(0.0, 0.1), random.uniform(0.0, 0.1)),
        laid_rad=np.deg2rad(random.uniform(-0.05, 0.05)),
    )


def _camera(random: np.random.Generator, shape: tuple[int, int], level: float) -> TrueOptics:
    height = random.uniform(430.0, 560.0)
    focal = shape[1] * height / _VIEW_MM
    centre = np.array([120.0, 0.0, level + height]) + random.uniform(-8.0, 8.0, 3)
    target = np.array([120.0, 0.0, level / 2]) + random.uniform(-4.0, 4.0, 3)
    turn = np.deg2rad(random.uniform(-3.0, 3.0))
    rotation = _looking(target - centre, np.array([np.sin(turn), -np.cos(turn), 0.0]))
    return TrueOptics(
        shape,
        _matrix(random, shape, focal, 0.0),
        np.array([random.uniform(-0.25, -0.05), random.uniform(-0.05, 0.15), *random.uniform(-1e-3, 1e-3, 2), 0.0]),
        rotation,
        -rotation @ centre,
        blur_px=random.uniform(0.5, 0.8),
        vignetting=random.uniform(0.1, 0.4),
    )


def _projector(random: np.random.Generator, shape: tuple[int, int]) -> TrueOptics:
    rows, columns = shape
    distance = random.uniform(340.0, 430.0)
    focal = columns * distance / _PICTURE_MM
    shift = random.uniform(0.0, 0.25)  # the lens is shifted so that the picture stands above the axis
    rise = shift * rows / focal * distance
    centre = np.array([-distance, 0.0, 57.0 - rise]) + random.uniform(-8.0, 8.0, 3)
    target = np.array([0.0, 0.0, 57.0 - rise]) + random.uniform(-3.0, 3.0, 3)
    turn = np.deg2rad(random.uniform(-1.5, 1.5))
    rotation = _looking(target - centre, np.array([0.0, np.sin(turn), -np.cos(turn)]))
    return TrueOptics(
        shape,
        _matrix(random, shape, focal, shift),
        np.array([random.uniform(-0.08, 0.08), random.uniform(-0.05, 0.05), *random.uniform(-1e-3, 1e-3, 2), 0.0]),
        rotation,
        -rotation @ centre,
        blur_px=random.uniform(0.5, 0.8),
        vignetting=random.uniform(0.1, 0.4),
    )


def _matrix(random: np.random.Generator, shape: tuple[int, int], focal: float, shift: float) -> Array:
    rows, columns = shape
    off = random.uniform(-0.015, 0.015, 2)
    ratio = 1.0 + random.uniform(-1e-3, 1e-3)
    return np.array(
        [
            [focal, 0.0, (columns - 1) / 2 + off[0] * columns],
            [0.0, focal * ratio, (rows - 1) / 2 + (shift + off[1]) * rows],
            [0.0, 0.0, 1.0],
        ]
    )


def _looking(forward: Array, down: Array) -> Array:
    """Rotation into the frame of a device that looks `forward`, with `down` towards the bottom of its picture."""
    ahead = forward / np.linalg.norm(forward)
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])

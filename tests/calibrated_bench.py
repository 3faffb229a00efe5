"""A simulated bench taken through all procedures, and how far off positions in the water are afterwards."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from drivers.simulated.bench_optics import camera_rays, projector_pixels, vignetting
from drivers.simulated.bench_poses import Place
from drivers.simulated.bench_truth import TANK_MM, TrueBench, random_bench
from drivers.simulated.bench_view import BoardInView
from drivers.simulated.settings import Sensor
from tankrig.calibration.board import Board, BoardView, find_board
from tankrig.calibration.camera import CameraFound, calibrate_camera
from tankrig.calibration.gray_code import decode, gray_code_patterns
from tankrig.calibration.lit_corners import LitBoard, lit_corners
from tankrig.calibration.projector import ProjectorFound, calibrate_projector
from tankrig.calibration.tank import TankFound, calibrate_tank
from tankrig.geometry.refraction import entry_wall
from tankrig.geometry.shading import shading_terms
from tankrig.geometry.view import rays_of
from tankrig.pattern import Pattern

BOARD = Board()
SMALL = (360, 480), (192, 256)
PANE = 6.0, 1.52


class Photographer:
    """Takes pictures of a board on a bench, exposed so that white is at 70 % of the range."""

    def __init__(self, bench: TrueBench, seed: int = 0, bits: int = 12) -> None:
        self.bench, self._random = bench, np.random.default_rng(seed)
        self.sensor = Sensor(bits=bits)

    def frames(self, place: Place, number: int, patterns: tuple[Pattern, ...] = ()) -> list[np.ndarray]:
        view = BoardInView(self.bench, BOARD, place, number)
        seen = [view.radiance({pattern: 1.0}) for pattern in patterns] or [view.radiance({})]
        return [self._counted(one / seen[0].max()) for one in seen]

    def _counted(self, filled: np.ndarray) -> np.ndarray:
        """As drivers.simulated.sensor has it, with shot noise by Gauss, which takes a fifth of Poisson's time."""
        electrons = (0.7 * self.sensor.full_well * filled).astype(np.float32)
        noise = self._random.standard_normal(filled.shape, dtype=np.float32)
        electrons += noise * np.sqrt(np.maximum(electrons, 0.0) + self.sensor.read_noise**2)
        top = self.sensor.saturation
        black = self.sensor.black * top / 2**14
        values = black + electrons * ((top - black) / self.sensor.full_well)
        return np.clip(np.rint(values), 0, top).astype(np.uint16)

    def view(self, place: Place, number: int) -> BoardView:
        return find_board(self.frames(place, number)[0], BOARD, self.sensor.saturation)

    def lit(self, place: Place, number: int) -> LitBoard:
        shape = self.bench.projector.shape
        frames = self.frames(place, number, gray_code_patterns(shape))
        view = find_board(frames[0], BOARD, self.sensor.saturation)
        y, x = np.mgrid[: view.shape[0], : view.shape[1]].astype(float)
        flat = vignetting(self.bench.camera, x, y)  # which radiometry finds
        light = ((frames[0].astype(float) - frames[1]) / flat).astype(np.float32)
        return lit_corners(view, decode(frames, shape, self.sensor.saturation), BOARD, light)


@dataclass
class Calibrated:
    bench: TrueBench
    camera: CameraFound
    tank: TankFound
    projector: ProjectorFound


@cache  # tests of its places and of its intervals look at the same one
def calibrated(
    seed: int, shapes: tuple[tuple[int, int], tuple[int, int]] = SMALL, views: tuple[int, int, int] = (15, 4, 8)
) -> Calibrated:
    """All procedures on a random bench; `views` in air, in the water, and in the projector's light."""
    bench = random_bench(seed, *shapes)
    photographer = Photographer(bench, seed)
    camera = calibrate_camera([photographer.view("air", k) for k in range(views[0])], BOARD)
    seen = [("floor", photographer.view("floor", 0)), ("flooded", photographer.view("flooded", 0))]
    seen += [("water", photographer.view("water", k)) for k in range(views[1])]
    tank = calibrate_tank(seen, BOARD, camera.lens, TANK_MM, lens_covariance=camera.known.covariance)
    lit = [photographer.lit("flooded slant", k) for k in range(views[2])]
    wall = entry_wall(tank.water_index, *PANE)
    projector = calibrate_projector(
        lit, BOARD, camera.lens, tank.camera, tank.surface, wall, shapes[1], TANK_MM, tank.known
    )
    return Calibrated(bench, camera, tank, projector)


def points_and_pixels(bench: TrueBench, count: int = 2000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points all over the water, and the true camera and projector pixels of each."""
    random = np.random.default_rng(5)
    rows, columns = bench.camera.shape
    pixels = random.uniform(0.0, 1.0, (count, 2)) * [columns - 1, rows - 1]
    start, way = camera_rays(bench, pixels, filled=True)
    height = random.uniform(2.0, bench.level_mm - 2.0, count)
    points = start + ((height - start[:, 2]) / way[:, 2])[:, None] * way
    inside = (points[:, 0] > 2) & (points[:, 0] < TANK_MM[0] - 2) & (np.abs(points[:, 1]) < TANK_MM[1] / 2 - 2)
    return points[inside], pixels[inside], projector_pixels(bench, points[inside], filled=True)[0]


def position_errors_mm(found: Calibrated) -> dict[str, np.ndarray]:
    """Of points anywhere in the water: by the camera at a known height, by the projector at a known depth, by both."""
    points, seen, lit = points_and_pixels(found.bench)
    from_camera = rays_of(found.camera.lens, found.tank.camera, seen, found.tank.surface)
    from_projector = rays_of(found.projector.lens, found.projector.pose, lit, found.projector.wall)
    errors = {}
    for name, axis, (start, way) in (("camera", 2, from_camera), ("projector", 0, from_projector)):
        at = start + ((points[:, axis] - start[:, axis]) / way[:, axis])[:, None] * way
        errors[name] = np.linalg.norm(at - points, axis=1)
    errors["both"] = np.linalg.norm(_nearest(*from_camera, *from_projector) - points, axis=1)
    return errors


def shortcut_errors_mm(bench: TrueBench, off_mm: float) -> np.ndarray:
    """A homography from pixels to the plane in the middle of the water, used `off_mm` from it."""
    import cv2

    rows, columns = bench.camera.shape
    grid = np.stack(np.meshgrid(np.linspace(0, columns - 1, 30), np.linspace(0, rows - 1, 20)), axis=-1).reshape(-1, 2)
    start, way = camera_rays(bench, grid, filled=True)

    def at(height: float) -> np.ndarray:
        return (start + ((height - start[:, 2]) / way[:, 2])[:, None] * way)[:, :2]

    middle = bench.level_mm / 2
    homography, _ = cv2.findHomography(grid, at(middle), 0)
    true = at(middle + off_mm)
    inside = (true[:, 0] > 0) & (true[:, 0] < TANK_MM[0]) & (np.abs(true[:, 1]) < TANK_MM[1] / 2)
    return np.linalg.norm(cv2.perspectiveTransform(grid[None], homography)[0] - true, axis=1)[inside]


def light_errors(found: Calibrated) -> np.ndarray:
    """Of the projector's light all over the lit wall, relative to the mean, as shares."""
    y, z = np.meshgrid(np.linspace(-70.0, 70.0, 30), np.linspace(5.0, 95.0, 20))
    pixels, _ = projector_pixels(found.bench, np.stack([np.zeros_like(y), y, z], axis=-1), filled=True)
    assert found.projector.evenness is not None
    terms = shading_terms(pixels, found.bench.projector.shape)
    ratio = np.exp(terms @ found.projector.evenness.coefficients)
    ratio /= vignetting(found.bench.projector, pixels[..., 0], pixels[..., 1])
    return np.asarray(ratio / ratio.mean() - 1.0)


def _nearest(a: np.ndarray, u: np.ndarray, b: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Middle of the shortest way between lines a + s u and b + t v; unit directions."""
    between, dot = b - a, np.sum(u * v, axis=1)
    along_u, along_v = np.sum(between * u, axis=1), np.sum(between * v, axis=1)
    s = (along_u - dot * along_v) / (1 - dot**2)
    t = (dot * along_u - along_v) / (1 - dot**2)
    return (a + s[:, None] * u + b + t[:, None] * v) / 2

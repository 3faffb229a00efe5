"""Ink in the tank of a simulated bench: what its camera sees of it, and the scene for the Monte Carlo to look at."""

from dataclasses import replace

import numpy as np

from tankrig.geometry.pose import rotation_vector
from tankrig.pattern import Pattern
from tankrig.scene.description import Beam, Camera, Medium, Projector, Scene, Tank

from .bench_optics import FINER, camera_rays, illumination, thrown, vignetting
from .bench_truth import TANK_MM, Array, TrueBench, TrueOptics
from .picture_store import PictureStore
from .tank import Radiance, seed_of

_VERSION = 1
"""To be raised when a picture of the same changes, so that none from before is taken for it."""
_KEPT = 12
_CELL_MM, _SAMPLES = 1.0, 4
"""Side of the cells in which the wall is lit evenly, and samples along it."""
_DARK = 1e-4


class InkInView:
    """Pictures of the tank through a bench's own lens, glass and water: a `drivers.simulated.tank.View`.

    Order 1 is followed back from each camera pixel, orders 2 and up are the Monte Carlo's. Light is linear, and that is
    made use of: a picture of one level is white's times that level's light, and what leaks at level 0 is white's too.

    Parameters
    ----------
    bench
        Its truth.
    tolerance
        Relative L2 of the Monte Carlo's noise in a picture of pixels of about 4 mm.
    seed
        Of it.
    store
        Of pictures that were seen before, by this process or another.
    named
        What the bench was drawn from, to tell its pictures from others'.
    """

    def __init__(self, bench: TrueBench, tolerance: float, seed: int, store: PictureStore, named: str) -> None:
        self._leak, self._bench = bench.leak, replace(bench, leak=0.0)
        self._tolerance, self._seed, self._store = tolerance, seed, store
        self._named = f"{_VERSION} {named} {tolerance} {seed}"
        self._seen: dict[tuple[str, Medium], Radiance] = {}

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._bench.camera.shape

    def radiance(self, pattern: Pattern, medium: Medium) -> Radiance:
        """When all is `medium`."""
        image, stderr = np.zeros(self.shape), np.zeros(self.shape)
        white = Pattern("white", np.full(pattern.shape, 255, np.uint8))
        for part, light in (*_with_full_levels(pattern, self._bench.gamma), (self._leak, white)):
            if part > 0.0:
                seen = self._kept(light, medium)
                image, stderr = image + part * seen.image, np.hypot(stderr, part * seen.stderr)
        return Radiance(image, stderr)

    def blob(self, inlet_mm: tuple[float, float], plume_mm: float) -> Array:
        """(rows, columns) of a Gaussian about (x, y) with a standard deviation, of its mean over the tank."""
        rows, columns = self.shape
        pixels = np.stack(np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)), axis=-1)
        start, way = camera_rays(self._bench, pixels, filled=True)
        middle = start + ((self._bench.level_mm / 2 - start[..., 2]) / way[..., 2])[..., None] * way
        x, y = (
            (np.arange(n) + 0.5) * n_mm / n + low
            for n, n_mm, low in ((96, TANK_MM[0], 0.0), (64, TANK_MM[1], -TANK_MM[1] / 2))
        )
        mean = _gauss(x, y[:, None], inlet_mm, plume_mm).mean()
        return _gauss(middle[..., 0], middle[..., 1], inlet_mm, plume_mm) / mean

    def _kept(self, pattern: Pattern, medium: Medium) -> Radiance:
        key = (pattern.hash, medium)
        if key not in self._seen:
            of = f"{self._named} {pattern.hash} {medium}"
            found = self._store.get(of)
            if found is None:
                found = np.stack(self._computed(pattern, medium)).astype(np.float32)
                self._store.put(of, found)
            while len(self._seen) >= _KEPT:
                del self._seen[next(iter(self._seen))]
            self._seen[key] = Radiance(found[0], found[1])
        return self._seen[key]

    def _computed(self, pattern: Pattern, medium: Medium) -> Radiance:
        """Through the camera's lens."""
        import cv2

        from .bench_multiple import scattered_more
        from .bench_single import looks_in, scattered_once  # half a second, which boards need not wait for

        bench = self._bench
        dark = np.zeros(self.shape)
        if medium.sigma_s == 0.0:
            return Radiance(dark, dark)
        once = scattered_once(bench, thrown(bench, pattern), medium)
        if not once.any():
            return Radiance(dark, dark)
        more, stderr = scattered_more(
            bench, pattern, medium, once, self._tolerance, seed_of(self._seed, pattern, medium)
        )
        # Pixels are squares, with variance 1/12, and were looked at in their middle.
        blurred = cv2.GaussianBlur(once + looks_in(bench) * more, (0, 0), np.sqrt(bench.camera.blur_px**2 + 1.0 / 12.0))
        rows, columns = self.shape
        fade = vignetting(bench.camera, *np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)))
        return Radiance(blurred * fade, stderr * fade)


def _with_full_levels(pattern: Pattern, gamma: float) -> tuple[tuple[float, Pattern], ...]:
    """A pattern whose pixels are dark or of one level as part of the pattern in which they are white."""
    levels = np.unique(pattern.pixels)
    if not levels.any():
        return ()
    if np.count_nonzero(levels) > 1:
        return ((1.0, pattern),)
    white = np.where(pattern.pixels > 0, 255, 0).astype(np.uint8)
    return ((float(levels[-1] / 255.0) ** gamma, Pattern(pattern.name, white)),)


def _gauss(x: Array, y: Array, middle: tuple[float, float], sd: float) -> Array:
    return np.asarray(np.exp(-((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / (2 * sd**2)))


def true_scene(bench: TrueBench, pattern: Pattern, medium: Medium, binning: int = 1) -> Scene:
    """What the camera of a bench looks at.

    The light on the wall is followed by the bench's own optics, not by `tankrig.scene.projection`. Not in it are
    how the level surface leans from the tank's floor (it moves sight by 0.02 mm), and what the wall reflects, which is the
    same share of all light to 0.1 %.

    Parameters
    ----------
    bench
        Its truth.
    pattern
        On the projector.
    medium
        In the tank.
    binning
        Side, in pixels, of the blocks that the camera's pixels are put together to.
    """
    projector = Projector("pinhole", _beams(bench, pattern), _vector(bench.projector.centre_mm))
    tank = Tank(
        (TANK_MM[0], TANK_MM[1], bench.level_mm), "fresnel", bench.water_index, "glass", bench.pane_mm, bench.pane_index
    )
    return Scene(tank, medium, projector, _camera(bench.camera).binned(binning))


def _beams(bench: TrueBench, pattern: Pattern) -> tuple[Beam, ...]:
    """Small squares of the wall, each evenly lit; W/mm² by white paper's radiance π · `TrueBench.full`."""
    import cv2

    rows, columns = int(bench.level_mm / _CELL_MM), int(TANK_MM[1] / _CELL_MM)
    y = (np.arange(columns * _SAMPLES) + 0.5) * (_CELL_MM / _SAMPLES) - TANK_MM[1] / 2
    z = (np.arange(rows * _SAMPLES) + 0.5) * (_CELL_MM / _SAMPLES)
    points = np.stack([np.zeros((z.size, y.size)), *np.meshgrid(y, z)], axis=-1)
    pixels, strength = illumination(bench, points, np.eye(3)[1:], filled=True)
    u, v = np.moveaxis(((pixels + 0.5) * FINER - 0.5).astype(np.float32), -1, 0)
    light = cv2.remap(thrown(bench, pattern), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    cells = (light * strength).reshape(rows, _SAMPLES, columns, _SAMPLES).mean(axis=(1, 3)) * np.pi * bench.full
    low = y[0] - 0.5 * _CELL_MM / _SAMPLES
    return tuple(
        Beam(
            (low + column * _CELL_MM, low + (column + 1) * _CELL_MM),
            (row * _CELL_MM, (row + 1) * _CELL_MM),
            float(cells[row, column]),
        )
        for row, column in np.argwhere(cells > _DARK * cells.max()).tolist()
    )


def _camera(optics: TrueOptics) -> Camera:
    (a, b, c), (d, e, f), (g, h, i) = optics.matrix.tolist()
    return Camera(
        "calibrated",
        optics.shape,
        position_mm=_vector(optics.centre_mm),
        matrix=((a, b, c), (d, e, f), (g, h, i)),
        distortion=tuple(optics.distortion.tolist()),
        rotation=rotation_vector(optics.rotation),
    )


def _vector(of: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in of)
    return x, y, z

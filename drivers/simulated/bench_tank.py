"""The tank of a simulated bench as its camera sees it: ink, through the same lens, glass and water as boards."""

from dataclasses import replace

import numpy as np

from tankrig.pattern import Pattern
from tankrig.scene.description import Medium

from .bench_optics import BACK_MM, DEPTHS_MM, camera_rays, through_camera_lens, thrown_in_depth, vignetting
from .bench_truth import TANK_MM, Array, TrueBench, TrueStray, random_bench
from .picture_store import PictureStore
from .settings import SimulatedCameraSettings
from .tank import Radiance, seed_of

_VERSION = 5
"""To be raised when a picture of the same changes, so that none from before is taken for it."""
_KEPT = 12
_EVEN = 4.0
"""Times the tolerance of an evenly lit picture: others have a thousandth of it, which a run subtracts again."""


class InkInView:
    """Pictures of the tank through a bench's own lens, glass and water: a `drivers.simulated.tank.View`.

    Order 1, and what the floor shows of the projector's picture, are followed back from each camera pixel, by way of
    glass walls too; all else is the Monte Carlo's. Light is linear, and that is made use of: a picture of one level is
    white's times that level's light, and what leaks at level 0 is white's too.

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
        astray = "" if bench.stray == TrueStray() else f" {bench.stray}"
        self._named = f"{_VERSION} {named} {tolerance} {seed}{astray}"
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
        length, width, _ = TANK_MM
        x, y = np.arange(0.5, length), np.arange(0.5, width) - width / 2
        mean = _gauss(x, y[:, None], inlet_mm, plume_mm).mean()
        return np.asarray(_gauss(middle[..., 0], middle[..., 1], inlet_mm, plume_mm) / mean)

    def _kept(self, pattern: Pattern, medium: Medium) -> Radiance:
        key = (pattern.hash, medium)
        if key not in self._seen:
            of = f"{self._named} {pattern.hash} {medium}"
            found = self._store.get(of)
            if found is None:
                found = np.stack(self.computed(pattern, medium)).astype(np.float32)
                self._store.put(of, found)
            while len(self._seen) >= _KEPT:
                del self._seen[next(iter(self._seen))]
            self._seen[key] = Radiance(found[0], found[1])
        return self._seen[key]

    def computed(self, pattern: Pattern, medium: Medium) -> Radiance:
        """Through the camera's lens."""
        from .bench_multiple import scattered_more  # half a second, which boards need not wait for
        from .bench_single import looks_in, mirrored_once, scattered_once, shown_by_floor

        bench = self._bench
        dark = np.zeros(self.shape)
        if medium.sigma_s == 0.0:
            return Radiance(dark, dark)
        thrown = thrown_in_depth(bench, pattern, depths_mm=DEPTHS_MM)
        # Without a far wall of glass nothing comes back, and a wide lens's pictures need not be drawn once more.
        come_back = thrown_in_depth(bench, pattern, depths_mm=BACK_MM) if "far" in bench.stray.glass else thrown
        sharp = scattered_once(bench, thrown, medium)
        sharp += mirrored_once(bench, thrown, come_back, medium) + shown_by_floor(bench, thrown, come_back, medium)
        if not sharp.any():
            return Radiance(dark, dark)
        seed, even = seed_of(self._seed, pattern, medium), np.ptp(pattern.pixels) == 0
        more, stderr = scattered_more(bench, pattern, medium, sharp, self._tolerance * (_EVEN if even else 1.0), seed)
        blur_px = np.sqrt(bench.camera.blur_px**2 + 1.0 / 12.0)  # pixels are squares, and were looked at in the middle
        blurred = through_camera_lens(bench, sharp + looks_in(bench) * more, float(blur_px))
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


def true_bench(settings: SimulatedCameraSettings) -> TrueBench | None:
    """What is true of the bench that a simulated camera looks at; None where it has no table `boards`."""
    if settings.boards is None:
        return None
    boards = settings.boards
    drawn = random_bench(boards.seed, boards.camera_shape, boards.projector_shape)
    level_mm = drawn.level_mm if boards.level_mm is None else boards.level_mm
    stray = TrueStray(**settings.truth.stray.model_dump())
    return replace(drawn, level_mm=level_mm, leak=settings.truth.leak, stray=stray)

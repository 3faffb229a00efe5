"""The simulated tank: the light that leaves it, from the patterns that are shown and the ink that is really in it."""

import math
import struct
from collections.abc import Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.emulation.truth import TrueDelivery, read_truth
from tankrig.pattern import Pattern
from tankrig.scene.description import Medium
from tankrig.scene.optics import Face, Faces
from tankrig.scene.phase_functions import Mixture

from .bench_optics import astray
from .bench_truth import TrueStray
from .settings import Truth

Image = NDArray[np.float64]

_IMAGES_KEPT = 16
FINER, CHEAP = 0.4, 2_000_000
"""Share of the tolerance that pictures have which take no more photons for it: a second or two. No frame shows a
picture's own noise, so a fit of a thin dose under one pattern came out four of its standard deviations off, now two."""


class Radiance(NamedTuple):
    """Radiance that leaves the tank towards the camera, and its standard error: (rows, columns), W/mm²/sr."""

    image: Image
    stderr: Image


def seed_of(seed: int, pattern: Pattern, medium: Medium) -> int:
    """Seed of one picture's noise: with one for all, a fit of several would take their common noise for the ink."""
    return int.from_bytes(sha256(f"{seed} {pattern.hash} {medium}".encode()).digest()[:6])


def mixture(water: Medium, ink: Medium, volume_ml: float) -> Medium:
    """What is in the tank: coefficients are linear in the dose, and light is turned by what scatters it.

    Parameters
    ----------
    water
        Per mm.
    ink
        Per mm and ml.
    volume_ml
        Of ink in the tank.

    Examples
    --------
    >>> mixture(Medium(0.001, 0.0, 0.0), Medium(0.0, 0.01, 0.8), 2.0)
    Medium(sigma_a=0.001, sigma_s=0.02, g=0.8)
    """
    sigma_a = water.sigma_a + volume_ml * ink.sigma_a
    sigma_s = water.sigma_s + volume_ml * ink.sigma_s
    if sigma_s > 0.0 and (water.phase or ink.phase):
        shares = water.sigma_s / sigma_s, volume_ml * ink.sigma_s / sigma_s
        return Medium(sigma_a, sigma_s, phase=Mixture((water.phase_function, ink.phase_function), shares))
    turned = water.sigma_s * water.g + volume_ml * ink.sigma_s * ink.g
    return Medium(sigma_a, sigma_s, turned / sigma_s if sigma_s > 0.0 else 0.0)


class View(Protocol):
    """What a camera sees of the tank through its lens, whatever lights it and whatever is in it."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""

    def radiance(self, pattern: Pattern, medium: Medium) -> Radiance:
        """When all is `medium`."""

    def blob(self, inlet_mm: tuple[float, float], plume_mm: float) -> Image:
        """(rows, columns) of a Gaussian about (x, y) with a standard deviation, of its mean over the tank."""


class SimulatedTank:
    """Radiance by Monte Carlo, computed once for each pattern and medium, and a plume on top of it.

    A plume is ink that has not spread yet. The image is that of the tank when all ink has, times 1 + u (b − 1): u is
    the part of the ink that has not spread and decays exponentially from the end of each dose; b is a Gaussian about
    the inlet, with mean 1. So structure fades and brightness stays: what light scattered once would do.

    Parameters
    ----------
    truth
        What is in it.
    state
        The doser's state file, which counts the plunger's steps; where there is none, no ink is in the tank.
    seed
        Of the Monte Carlo.
    view
        Through which it is seen; None: as `truth.bench` says.
    """

    def __init__(self, truth: Truth, state: Path, seed: int, view: View | None = None) -> None:
        self.truth = truth
        self._state = state
        self._view: View = _IdealView(truth, seed) if view is None else view
        self._images: dict[tuple[str, Medium], Radiance] = {}
        self._blob = self._view.blob(truth.inlet_mm, truth.plume_mm)
        self._unspread = _Unspread(truth.mixing_s)

    @property
    def ink_ml(self) -> float:
        """Ink that is in the tank."""
        return self._ml(self._delivery())

    @property
    def medium(self) -> Medium:
        """What is in the tank once all ink has spread."""
        return self._medium(self._delivery())

    def radiance(self, pattern: Pattern, medium: Medium) -> Radiance:
        """What leaves towards the camera when all is `medium`; computed once, and not to be changed."""
        key = (pattern.hash, medium)
        if key not in self._images:
            while len(self._images) >= _IMAGES_KEPT:
                del self._images[next(iter(self._images))]
            self._images[key] = self._view.radiance(pattern, medium)
        return self._images[key]

    def seen(self, shown: Mapping[Pattern, float], now_ns: int) -> Image:
        """(rows, columns) mean radiance, W/mm²/sr, when patterns are `shown` for parts of the time, by `now_ns`."""
        delivery = self._delivery()
        medium = self._medium(delivery)
        image = np.zeros(self._view.shape)
        for pattern, part in shown.items():
            image += part * self.radiance(pattern, medium).image
        return image * (1.0 + self._unspread.part(delivery, now_ns) * (self._blob - 1.0))

    def _ml(self, delivery: TrueDelivery) -> float:
        return delivery.steps / self.truth.steps_per_ul / 1000.0

    def _medium(self, delivery: TrueDelivery) -> Medium:
        return mixture(self.truth.water, self.truth.ink, self._ml(delivery))

    def _delivery(self) -> TrueDelivery:
        try:
            return read_truth(self._state)
        except (FileNotFoundError, struct.error):  # no doser was ever opened on this tank, or one is just being made
            return TrueDelivery(steps=0, moved_ns=0)


class _Unspread:
    """Follows the part of the ink that has not spread, in plunger steps; a dose arrives as a whole when it ends."""

    def __init__(self, mixing_s: float) -> None:
        self._mixing_ns = mixing_s * 1e9
        self._steps, self._unspread, self._at_ns = 0, 0.0, 0

    def part(self, delivery: TrueDelivery, now_ns: int) -> float:
        """Of all ink in the tank."""
        now_ns = max(now_ns, self._at_ns)
        arrived_ns = min(max(delivery.moved_ns, self._at_ns), now_ns)
        self._unspread *= math.exp((self._at_ns - now_ns) / self._mixing_ns)
        self._unspread += (delivery.steps - self._steps) * math.exp((arrived_ns - now_ns) / self._mixing_ns)
        self._steps, self._at_ns = delivery.steps, now_ns
        return self._unspread / delivery.steps if delivery.steps else 0.0


class _IdealView:
    """The tank as `Truth.bench` has it: order 1 in the camera's pixels, the rest in blocks of them."""

    def __init__(self, truth: Truth, seed: int) -> None:
        self._truth, self._seed = truth, seed

    @property
    def shape(self) -> tuple[int, int]:
        return self._truth.bench.camera.shape

    def radiance(self, pattern: Pattern, medium: Medium) -> Radiance:
        truth = self._truth
        if medium.sigma_s == 0.0 or not truth.bench.wall.beams(pattern, truth.bench.tank):
            dark = np.zeros(truth.bench.camera.shape)
            return Radiance(dark, dark)
        from tankrig.montecarlo import simulate_to  # half a second, which a dark first picture need not wait for

        scene = truth.bench.scene(pattern, medium)
        seed = seed_of(self._seed, pattern, medium)
        stray = TrueStray(**truth.stray.model_dump())
        faces = Faces(**{name: Face("glass") for name in stray.glass}, floor=Face("diffuse", stray.floor))
        if not faces.dark:
            scene = replace(scene, tank=replace(scene.tank, faces=faces))
        tally = simulate_to(scene, truth.tolerance, seed=seed, coarsen=truth.coarsen)
        finer = FINER * truth.tolerance
        if tally.photons * (tally.noise / finer) ** 2 < CHEAP:
            tally = simulate_to(scene, finer, seed=seed, coarsen=truth.coarsen)
        seen = astray(stray, tally.image, tally.image, 1.0 / scene.camera.pixel_mm)
        return Radiance(np.asarray(seen, np.float64), tally.stderr)

    def blob(self, inlet_mm: tuple[float, float], plume_mm: float) -> Image:
        camera, width_mm = self._truth.bench.camera, self._truth.bench.tank.size_mm[1]
        rows, columns = camera.shape
        x_mm = (np.arange(columns) + 0.5) * camera.pixel_mm - inlet_mm[0]
        y_mm = (np.arange(rows) + 0.5) * camera.pixel_mm - width_mm / 2 - inlet_mm[1]
        blob: Image = np.exp(-(x_mm**2 + y_mm[:, None] ** 2) / (2 * plume_mm**2))
        blob /= blob.mean()
        return blob

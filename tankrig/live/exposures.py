"""What a run has photographed so far: sums of its frames by dose and pattern, and the photographs they make.

The same sums are kept in shared memory while a run goes on, and in ordinary memory when a run is read back.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.bench import Bench
from tankrig.checked_toml import checked
from tankrig.devices import Pixels
from tankrig.errors import StoreError
from tankrig.pattern import Pattern
from tankrig.run.journal import Event
from tankrig.run.reading import Run
from tankrig.scene.description import Camera, Medium, Scene
from tankrig.sequence import Capture, Dose, Sequence
from tankrig.sequence.loading import sequence_from_table

Array = NDArray[np.float64]

FIT_PIXEL_MM = 4.0
"""Frames are binned to pixels of at most this before a fit: the tank's light is smooth, and beams are as wide."""
ANY = Medium(0.001, 0.01, 0.5)
"""Of scenes whose medium is to be found."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """One pattern at one dose, averaged over its frames.

    Parameters
    ----------
    pattern
        Its name.
    dose_ml, dose_sd_ml
        Ink in the tank.
    scene
        What is seen; its medium means nothing.
    image, noise
        (rows, columns) counts per ms less the dark, binned, and their standard deviation.
    offset
        0 where the dark was subtracted, else "free".
    frames
        How many it is the mean of.
    """

    pattern: str
    dose_ml: float
    dose_sd_ml: float
    scene: Scene
    image: Array
    noise: Array
    offset: Any
    frames: int


@dataclass(frozen=True)
class Plan:
    """What a run is going to photograph; plain enough to be sent to another process.

    Parameters
    ----------
    bench
        Of the rig.
    patterns
        By hash, in the order of the sums.
    doses
        How many different ones there can be.
    exposures
        ms times gain of each step of the sequence.
    """

    bench: Bench
    patterns: dict[str, Pattern]
    doses: int
    exposures: tuple[float, ...]

    @classmethod
    def of(cls, bench: Bench, sequence: Sequence, patterns: list[Pattern]) -> "Plan":
        """For a sequence on a bench."""
        actions = [task.action for task in sequence.tasks]
        settings = [sequence.camera_settings(one) if isinstance(one, Capture) else None for one in actions]
        exposures = tuple(one.exposure_ms * one.gain if one else 1.0 for one in settings)
        doses = 2 + sum(isinstance(one, Dose) for one in actions)
        return cls(bench, {pattern.hash: pattern for pattern in patterns}, doses, exposures)

    @classmethod
    def of_run(cls, run: Run) -> "Plan":
        """For a run that was recorded."""
        bench = checked(Bench, dict(run.settings["bench"]), f"{run.path}: its bench", StoreError)
        sequence = sequence_from_table(dict(run.settings["sequence"]), str(run.path))
        return cls.of(bench, sequence, list(run.patterns.values()))

    @property
    def binning(self) -> int:
        """Pixels along a bin: as many as fit into `FIT_PIXEL_MM` and divide the frame."""
        camera = self.bench.camera
        most = max(1, int(FIT_PIXEL_MM / camera.pixel_mm))
        return max(by for by in range(1, most + 1) if camera.shape[0] % by == 0 and camera.shape[1] % by == 0)

    @property
    def camera(self) -> Camera:
        """The camera as the fit sees it."""
        by, camera = self.binning, self.bench.camera
        shape = (camera.shape[0] // by, camera.shape[1] // by)
        return Camera(camera.kind, shape, camera.pixel_mm * by, camera.position_mm)

    @property
    def size(self) -> int:
        """Numbers that the sums take."""
        rows, columns = self.camera.shape
        return 1 + self.doses * 2 + self.doses * len(self.patterns) * (1 + 2 * rows * columns)


class Exposures:
    """Sums of frames by dose and pattern.

    Parameters
    ----------
    plan
        What can come.
    numbers
        (plan.size,) float64 to keep all in, zeros at first.
    """

    def __init__(self, plan: Plan, numbers: Array | None = None) -> None:
        self.plan = plan
        numbers = np.zeros(plan.size) if numbers is None else numbers
        shape = (plan.doses, len(plan.patterns), *plan.camera.shape)
        cuts = np.cumsum([1, plan.doses * 2, shape[0] * shape[1], int(np.prod(shape))])
        self._now, doses, counts, sums, squares = np.split(numbers, cuts)
        self._doses, self._counts = doses.reshape(plan.doses, 2), counts.reshape(shape[:2])
        self._sums, self._squares = sums.reshape(shape), squares.reshape(shape)
        self._index = {key: index for index, key in enumerate(plan.patterns)}

    @property
    def dose(self) -> int:
        """Number of the dose under way."""
        return int(self._now[0])

    @property
    def dose_ml(self) -> float:
        """Ink in the tank."""
        return float(self._doses[self.dose, 0])

    @property
    def frames(self) -> int:
        """Frames taken in so far, dark ones not counted."""
        lit = [self._index[key] for key in self._lit()]
        return int(self._counts[:, lit].sum())

    def take(self, event: Event, pixels: Pixels | None) -> bool:
        """Take a run's event in; whether there is something new to fit."""
        if event.kind == "session" or event.kind == "dose_done":
            self._set_dose(event["delivered_ul"], event["delivered_low_ul"], event["delivered_high_ul"])
        elif event.kind == "frame" and pixels is not None and event["pattern_hash"] in self._index:
            by, pattern = self.plan.binning, self._index[event["pattern_hash"]]
            rows, columns = self.plan.camera.shape
            binned = pixels.reshape(rows, by, columns, by).mean(axis=(1, 3)) / self.plan.exposures[event["step"]]
            self._sums[self.dose, pattern] += binned
            self._squares[self.dose, pattern] += binned**2
            self._counts[self.dose, pattern] += 1
            return event["pattern_hash"] in self._lit()
        return False

    def photographs(self, dose: int | None = None) -> list[Photograph]:
        """What has been photographed with ink in the tank, of one dose or of all, in the order of the doses."""
        doses = range(self.dose + 1) if dose is None else (dose,)
        return [
            self._photograph(one, key)
            for one in doses
            for key in self._lit()
            if self._doses[one, 0] > 0.0 and self._counts[one, self._index[key]] > 0
        ]

    def _set_dose(self, volume_ul: float, low_ul: float, high_ul: float) -> None:
        if volume_ul / 1000.0 != self.dose_ml and self._counts[self.dose].any():
            self._now[0] += 1
        # Anywhere between its bounds alike: the standard deviation is the width by √12.
        self._doses[self.dose] = volume_ul / 1000.0, (high_ul - low_ul) / 1000.0 / np.sqrt(12.0)

    def _lit(self) -> list[str]:
        return [key for key, pattern in self.plan.patterns.items() if pattern.pixels.any()]

    def _photograph(self, dose: int, key: str) -> Photograph:
        pattern, plan = self.plan.patterns[key], self.plan
        count, mean, variance = self._mean(dose, self._index[key])
        dark_at = [index for other, index in self._index.items() if not plan.patterns[other].pixels.any()]
        offset: Any = "free"
        total = _photon_transfer(mean, variance, count) / count
        if dark_at and self._counts[dose, dark_at[0]]:
            dark_count, dark, dark_variance = self._mean(dose, dark_at[0])
            mean = mean - dark
            if dark_count > 1:
                total = total + float(np.mean(dark_variance)) / dark_count
            offset = 0.0
        scene = plan.bench.scene(pattern, ANY)
        scene = Scene(scene.tank, ANY, scene.projector, plan.camera)
        dose_ml, sd_ml = (float(value) for value in self._doses[dose])
        return Photograph(pattern.name, dose_ml, sd_ml, scene, mean, np.sqrt(total), offset, count)

    def _mean(self, dose: int, pattern: int) -> tuple[int, Array, Array]:
        """Frames, their mean, and their variance from frame to frame."""
        count = int(self._counts[dose, pattern])
        mean = self._sums[dose, pattern] / count
        variance = np.maximum(self._squares[dose, pattern] / count - mean**2, 0.0) * count / max(count - 1, 1)
        return count, mean, variance


def _photon_transfer(mean: Array, variance: Array, count: int) -> Array:
    """Variance of one frame as a straight line in its brightness, from what frames of the same scene differ by.

    A line through thousands of pixels is known far better than any pixel's own variance from a few frames. One frame
    has no differences to tell; it is taken to be noisy by 0.5 % of the peak.
    """
    if count < 2:
        return np.full(mean.shape, (0.005 * float(mean.max())) ** 2)
    design = np.stack([np.ones(mean.size), mean.ravel()], axis=1)
    line = np.linalg.lstsq(design, variance.ravel(), rcond=None)[0]
    floor = max(0.1 * float(variance.mean()), 1e-12 * float(mean.max()) ** 2)
    spread: Array = np.maximum((design @ line).reshape(mean.shape), floor)
    return spread


def exposures_of(run: Run) -> Exposures:
    """All that a run has photographed, read back from disk."""
    exposures = Exposures(Plan.of_run(run))
    for event, pixels in replayed(run):
        exposures.take(event, pixels)
    return exposures


def replayed(run: Run) -> Iterator[tuple[Event, Pixels | None]]:
    """A run's events in their order, each frame with its pixels: what those heard who listened to it."""
    frames = iter(run.frames if run.events("frame") else ())
    for event in run.journal:
        yield event, next(frames).values if event.kind == "frame" else None

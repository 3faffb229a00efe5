"""What a run has photographed so far: sums of its frames by dose and pattern, and the photographs they make.

The same sums are kept in shared memory while a run goes on, and in ordinary memory when a run is read back.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tankrig.devices import CameraSettings, Delivered, Pixels
from tankrig.estimation.observation import pixel_noise
from tankrig.live.photograph_plan import DOSE, MIXING, PhotographPlan
from tankrig.pattern import Pattern
from tankrig.run.conditions import Conditions, JournalFollower
from tankrig.run.journal import Event
from tankrig.run.reading import Run
from tankrig.scene.description import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNSETTLED = 0.01
"""A frame that differs from those before it by more than this share of the picture shows ink that has not mixed yet."""
UNSETTLED_SIGMAS = 6.0
BLOCKS = 16
"""Along the longer side of a frame, whose means are compared: noise is small in them, and what has not mixed is not."""
MIXES = 0.03
"""Share of a picture of ink that mixes, relative L2, by which another one differs that is looked at anew."""
SAME_ML = 1e-6
"""Volumes that differ by no more are one dose: a nanolitre is less than any doser tells apart."""


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
    mask
        (rows, columns), True where a bin tells nothing of the liquid, see `PhotographPlan.counts`; None: all tell.
    """

    pattern: str
    dose_ml: float
    dose_sd_ml: float
    scene: Scene
    image: Array
    noise: Array
    offset: Any
    frames: int
    mask: Mask | None = None

    @property
    def used(self) -> Mask:
        """(rows, columns) bins that count."""
        return np.ones(self.image.shape, bool) if self.mask is None else ~self.mask


def has_changed(image: NDArray[np.floating], before: NDArray[np.floating]) -> bool:
    """Whether ink that mixes looks otherwise than before, by more than noise of a picture.

    Examples
    --------
    >>> one = np.ones((2, 3))
    >>> has_changed(1.1 * one, one), has_changed(1.001 * one, one)
    (True, False)
    """
    return bool(np.linalg.norm(image - before) > MIXES * np.linalg.norm(image))


class Exposures:
    """Sums of frames by dose and pattern, each frame at the dose and with the exposure that were true of it.

    Parameters
    ----------
    plan
        What can come.
    numbers
        (plan.size,) float64 to keep all in, zeros at first.
    """

    def __init__(self, plan: PhotographPlan, numbers: Array | None = None) -> None:
        self.plan = plan
        numbers = np.zeros(plan.size) if numbers is None else numbers
        shape = (plan.doses, len(plan.patterns), *plan.camera.shape)
        bins = int(np.prod(plan.camera.shape))
        sizes = [3, plan.doses * DOSE, shape[0] * shape[1], *[shape[0] * shape[1] * bins] * 3, MIXING, bins]
        # The dose under way, the newest frame, and frames that could not be taken in.
        self._now, doses, counts, sums, squares, seen, self._mixing, *mixing = np.split(numbers, np.cumsum(sizes))
        # Of each dose: ml, its standard deviation, frames left out, whether the last one was, whole sheets of waves.
        self._doses, self._counts = doses.reshape(plan.doses, DOSE), counts.reshape(shape[:2])
        # Of each bin: the sum over its frames that are not saturated there, that of their squares, and their number.
        self._sums, self._squares, self._seen = (one.reshape(shape) for one in (sums, squares, seen))
        # Of ink that has nearly mixed: ml, their standard deviation, the pattern's number and one; the picture itself,
        # and its bins that are not saturated.
        self._mixing_image, self._mixing_below = (one.reshape(plan.camera.shape) for one in mixing)
        self._mixing_told = np.zeros(plan.camera.shape)
        self._index = {key: index for index, key in enumerate(plan.patterns)}
        self._lit = list(plan.scenes)
        self._conditions = JournalFollower()

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
        lit = [self._index[key] for key in self._lit]
        return int(self._counts[:, lit].sum())

    @property
    def newest(self) -> int:
        """Number of the newest lit frame, as the run counts them."""
        return int(self._now[1])

    @property
    def not_seen(self) -> int:
        """Frames that could not be taken in: their pixels could not be had, or nobody has foreseen them."""
        return int(self._now[2])

    @property
    def doses(self) -> list[int]:
        """Numbers of the doses that frames were taken at, and of the one under way; the newest first."""
        taken = np.flatnonzero(np.any(self._counts, axis=1)).tolist()
        return [self.dose, *sorted(set(taken) - {self.dose}, reverse=True)]

    def volume_ml(self, dose: int) -> float:
        """Ink in the tank at a dose."""
        return float(self._doses[dose, 0])

    def left_out(self, dose: int) -> int:
        """Frames of a dose that were left out because the ink had not mixed."""
        return int(self._doses[dose, 2])

    def settling(self, dose: int) -> bool:
        """Whether the newest frame of a dose still differed from those before it: what there is shows no one liquid."""
        return bool(self._doses[dose, 3])

    def sheets(self, dose: int) -> int:
        """Sheets of a dose of which all waves are recorded."""
        return int(self._doses[dose, 4])

    def take(self, event: Event, pixels: Pixels | None) -> bool:
        """Take a run's event in; whether there is something new to fit, or to say of a fit.

        Parameters
        ----------
        event
            The next of the run's journal: none may be left out, for lines of earlier versions rest on those before.
        pixels
            Of a frame; None where they cannot be had, and the frame is counted as not seen.
        """
        then = self._conditions.at(event)
        if event.kind == "session" or event.kind == "dose_done":
            self._enter(then.tank)
        elif event.kind == "step" and event["state"] == "done" and event["step"] in self.plan.sheet_ends:
            self._doses[self.dose, 4] += 1.0
            return True
        elif event.kind == "frame" and event["pattern_hash"] in self._index:
            lit = event["pattern_hash"] in self._lit
            if lit:
                self._now[1] = event.get("index", 0)
            settings = then.camera or self.plan.settings[event["step"]]
            if pixels is None or not self._sees(settings) or not self._enter(then.tank):
                self._now[2] += 1
                return False
            self._add(self._index[event["pattern_hash"]], lit, *self.plan.binned(pixels, settings))
            return lit
        return False

    def watch(self, pattern: Pattern, pixels: Pixels, conditions: Conditions) -> bool:
        """Keep a picture of ink that has nearly mixed in place of the one before; whether it shows anything new.

        Parameters
        ----------
        pattern
            That is shown; the picture is let go if it lights nothing, or if fits do not know it.
        pixels
            Of the picture, which is not recorded.
        conditions
            When it was taken.
        """
        settings, tank = conditions.camera, conditions.tank
        if settings is None or not self._sees(settings):
            return False
        if pattern.hash not in self._lit or not np.isfinite(tank.high_ul):
            return False
        dose_ml, first = tank.volume_ul / 1000.0, not self._mixing[2]
        first = first or abs(float(self._mixing[0]) - dose_ml) > SAME_ML
        self._mixing[:] = dose_ml, self._sd_ml(tank), 1.0 + self._index[pattern.hash]
        self._mixing_image[:], self._mixing_below[:] = self.plan.binned(pixels, settings)
        new = first or has_changed(self._mixing_image, self._mixing_told)
        if new:
            self._mixing_told = self._mixing_image.copy()
        return new

    @property
    def while_mixing(self) -> Photograph | None:
        """The newest picture of ink that has nearly mixed; None where its dose has frames, or there is none."""
        dose_ml, sd_ml, number = (float(one) for one in self._mixing)
        taken = np.any(self._counts, axis=1) & (np.abs(self._doses[:, 0] - dose_ml) <= SAME_ML)
        if not number or taken.any():
            return None
        key = list(self._index)[int(number) - 1]
        used = self.plan.counts[key] & (self._mixing_below > 0.0)
        image = self._mixing_image.copy()
        noise = np.sqrt(_photon_transfer(image, np.zeros_like(image), 1, used if used.any() else image >= 0.0))
        name, scene = self.plan.patterns[key].name, self.plan.scenes[key]
        return Photograph(name, dose_ml, sd_ml, scene, image, noise, "free", 1, ~used)

    def photographs(self, dose: int | None = None) -> list[Photograph]:
        """What has been photographed with ink in the tank, of one dose or of all, in the order of the doses."""
        doses = sorted(self.doses, key=lambda one: float(self._doses[one, 0])) if dose is None else (dose,)
        return [
            self._photograph(one, key)
            for one in doses
            for key in self._lit
            if self._doses[one, 0] > 0.0 and self._counts[one, self._index[key]] > 0
        ]

    def _sees(self, settings: CameraSettings) -> bool:
        return self.plan.radiometry is None or self.plan.radiometry.knows(settings.gain)

    @staticmethod
    def _sd_ml(tank: Delivered) -> float:
        """Standard deviation of what the tank holds, anywhere between its bounds alike: their distance by √12."""
        return float((tank.high_ul - tank.low_ul) / 1000.0 / np.sqrt(12.0))

    def _enter(self, tank: Delivered) -> bool:
        """Make what the tank holds the dose under way; False when nobody knows that, or there is no room for it."""
        if not np.isfinite(tank.high_ul):
            return False
        dose_ml = tank.volume_ul / 1000.0
        sd_ml = self._sd_ml(tank)
        taken: NDArray[np.bool_] = np.any(self._counts, axis=1)
        if not taken[self.dose] or abs(self.dose_ml - dose_ml) > SAME_ML:
            same = taken & (np.abs(self._doses[:, 0] - dose_ml) <= SAME_ML)
            free = np.flatnonzero(same if same.any() else ~taken)
            if not free.size:
                return False
            self._now[0] = free[0]
        if taken[self.dose]:
            self._doses[self.dose, 1] = max(sd_ml, self._doses[self.dose, 1])
        else:
            sheets = self._doses[self.dose, 4] if abs(self.dose_ml - dose_ml) <= SAME_ML else 0.0
            self._doses[self.dose] = dose_ml, sd_ml, 0.0, 0.0, sheets
        return True

    def _add(self, pattern: int, lit: bool, binned: Array, below: Mask) -> None:
        if lit:
            self._leave_out_what_had_not_mixed(pattern, binned, below)
        binned = np.where(below, binned, 0.0)
        self._sums[self.dose, pattern] += binned
        self._squares[self.dose, pattern] += binned**2
        self._seen[self.dose, pattern] += below
        self._counts[self.dose, pattern] += 1

    def _leave_out_what_had_not_mixed(self, pattern: int, binned: Array, below: Mask) -> None:
        """Begin the dose anew where a frame is not of the liquid that the frames before it are of."""
        if self._counts[self.dose, pattern] == 0:
            return
        seen = self._seen[self.dose, pattern]
        both = below & (seen > 0)
        before = self._sums[self.dose, pattern] / np.maximum(seen, 1)
        changed = bool(both.any()) and differs(np.where(both, binned, 0.0), np.where(both, before, 0.0))
        self._doses[self.dose, 3] = changed
        if changed:
            lit = [self._index[key] for key in self._lit]
            self._doses[self.dose, 2] += self._counts[self.dose, lit].sum()
            for kept in (self._counts, self._sums, self._squares, self._seen):
                kept[self.dose, lit] = 0.0

    def _photograph(self, dose: int, key: str) -> Photograph:
        pattern, plan = self.plan.patterns[key], self.plan
        count, seen, mean, variance = self._mean(dose, self._index[key])
        used = plan.counts[key] & (seen > 0)
        dark_at = [index for other, index in self._index.items() if not plan.patterns[other].pixels.any()]
        offset: Any = "free"
        total = _photon_transfer(mean, variance, count, used if used.any() else seen > 0) / np.maximum(seen, 1)
        if dark_at and self._counts[dose, dark_at[0]]:
            dark_count, _, dark, dark_variance = self._mean(dose, dark_at[0])
            mean = mean - dark
            if dark_count > 1:
                total = total + float(np.mean(dark_variance)) / dark_count
            offset = 0.0
        dose_ml, sd_ml = (float(value) for value in self._doses[dose, :2])
        return Photograph(pattern.name, dose_ml, sd_ml, plan.scenes[key], mean, np.sqrt(total), offset, count, ~used)

    def _mean(self, dose: int, pattern: int) -> tuple[int, Array, Array, Array]:
        """Frames, how many of them show each bin, their mean, and their variance from frame to frame."""
        seen = self._seen[dose, pattern]
        count = np.maximum(seen, 1.0)
        mean = self._sums[dose, pattern] / count
        variance = np.maximum(self._squares[dose, pattern] / count - mean**2, 0.0) * count / np.maximum(count - 1, 1)
        return int(self._counts[dose, pattern]), seen, mean, variance


def differs(frame: Array, before: Array) -> bool:
    """Whether a frame's structure is another than before, by more than noise and by more than a share of it.

    Brightness alone does not count: a lamp may flicker, and ink that mixes changes shapes.

    Examples
    --------
    >>> rows, columns = np.mgrid[:40, :60]
    >>> tank = 1000.0 * np.exp(-columns / 30.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 5.0, tank.shape)
    >>> plume = 100.0 * np.exp(-((columns - 20.0) ** 2 + (rows - 20.0) ** 2) / 200.0)
    >>> differs(1.02 * tank + noise, tank), differs(tank + plume + noise, tank)
    (False, True)
    """
    change = frame - before * float(np.vdot(frame, before) / np.vdot(before, before))
    rows, columns = frame.shape
    scale = min(1.0, BLOCKS / max(rows, columns))
    size = max(1, round(columns * scale)), max(1, round(rows * scale))
    blocks, bright = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (change, before))
    chance = pixel_noise(change, np.ones(frame.shape, bool)) ** 2 * blocks.size / frame.size
    seen = float(np.mean(blocks**2))
    beyond = chance * (1.0 + UNSETTLED_SIGMAS * np.sqrt(2.0 / blocks.size))
    return bool(seen > beyond and seen > UNSETTLED**2 * float(np.mean(bright**2)))


def _photon_transfer(mean: Array, variance: Array, count: int, used: Mask) -> Array:
    """Variance of one frame as a straight line in its brightness, from what frames of the same scene differ by.

    A line through thousands of pixels is known far better than any pixel's own variance from a few frames. One frame
    has no differences to tell; it is taken to be noisy by 0.5 % of the peak.
    """
    if count < 2:
        return np.full(mean.shape, (0.005 * float(mean[used].max())) ** 2)
    design = np.stack([np.ones(mean.size), mean.ravel()], axis=1)
    line = np.linalg.lstsq(design[used.ravel()], variance[used], rcond=None)[0]
    floor = max(0.1 * float(variance[used].mean()), 1e-12 * float(mean[used].max()) ** 2)
    spread: Array = np.maximum((design @ line).reshape(mean.shape), floor)
    return spread


def exposures_of(run: Run) -> Exposures:
    """All that a run has photographed, read back from disk."""
    exposures = Exposures(PhotographPlan.of_run(run))
    for event, pixels in replayed(run):
        exposures.take(event, pixels)
    return exposures


def replayed(run: Run) -> Iterator[tuple[Event, Pixels | None]]:
    """A run's events in their order, each frame with its pixels: what those heard who listened to it.

    A frame of which nobody knows what the tank held comes without.
    """
    for event in run.journal:
        known = event.kind == "frame" and event["index"] not in run.unsure_doses
        yield event, run.pixels(event) if known else None

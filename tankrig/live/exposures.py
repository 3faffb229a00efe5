"""What a run has photographed so far: sums of its frames by dose and pattern, and the photographs they make.

The same sums are kept in shared memory while a run goes on, and in ordinary memory when a run is read back.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tankrig.bench import Bench, KnownScenes
from tankrig.calibration.radiometry import Radiometry
from tankrig.checked_toml import checked
from tankrig.devices import CameraSettings, Delivered, Pixels
from tankrig.errors import SceneError, StoreError
from tankrig.estimation.observation import pixel_noise
from tankrig.image.bins import HALF, Bins, Seen, bins_for
from tankrig.materials.coefficients import optics
from tankrig.materials.dosing import tank_volume_ml
from tankrig.materials.library import material
from tankrig.pattern import Pattern
from tankrig.run.calibrations import radiometry_of_run
from tankrig.run.conditions import JournalFollower, clamped
from tankrig.run.journal import Event
from tankrig.run.reading import Run
from tankrig.scene.description import Camera, Medium, Scene, Tank
from tankrig.scene.outline import edge_reach_mm
from tankrig.scene.phase_table import PhaseFunction
from tankrig.sequence import Burst, Capture, Dose, Sequence
from tankrig.sequence.loading import sequence_from_table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNSETTLED = 0.01
"""A frame that differs from those before it by more than this share of the picture shows ink that has not mixed yet."""
UNSETTLED_SIGMAS = 6.0
BLOCKS = 16
"""Along the longer side of a frame, whose means are compared: noise is small in them, and what has not mixed is not."""
DOSE = 5
"""Numbers that are kept of each dose."""
SAME_ML = 1e-6
"""Volumes that differ by no more are one dose: a nanolitre is less than any doser tells apart."""
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


@dataclass(frozen=True)
class PhotographPlan:
    """What a run is going to photograph; plain enough to be sent to another process.

    Parameters
    ----------
    bench
        Of the rig; of a run that was imported, the scenes that came with it.
    patterns
        By hash, in the order of the sums.
    doses_ml
        Ink in the tank, as the sequence means to dose it, rising.
    settings
        Of the camera in each step of the sequence.
    radiometry
        Of the camera, where it was calibrated for all of them.
    more_doses
        How many different ones a run has recorded already, foreseen or not.
    saturation
        Count from which on the camera's pixels are saturated, where that is known.
    ink
        What is expected of it, per mm and ml; None where nothing is. Only which models are prepared rests on it.
    phase
        Which phase functions are fitted, as in `tankrig.estimate`.
    sheet_ends
        Numbers of the steps after which all waves of a sheet are recorded.
    """

    bench: Bench | KnownScenes
    patterns: dict[str, Pattern]
    doses_ml: tuple[float, ...]
    settings: tuple[CameraSettings, ...]
    radiometry: Radiometry | None = None
    more_doses: int = 0
    saturation: float | None = None
    ink: Medium | None = None
    phase: str | PhaseFunction = "hg"
    sheet_ends: frozenset[int] = frozenset()

    @classmethod
    def of(
        cls,
        bench: Bench,
        sequence: Sequence,
        patterns: list[Pattern],
        radiometry: Radiometry | None = None,
    ) -> "PhotographPlan":
        """For a sequence on a bench.

        Waves of a `separate` step are not photographs: each would need a model of its own, and all of them together
        tell a fit little more than one sheet does. `tankrig.separation` is what reads them.
        """
        patterns = [one for one in patterns if one.name not in sequence.waves]
        actions = [task.action for task in sequence.tasks]
        unused = CameraSettings(1.0)
        settings = tuple(
            sequence.camera_settings(one) if isinstance(one, Capture | Burst) else unused for one in actions
        )
        gains = {one.gain for one in settings if one is not unused}
        if radiometry is not None and not all(radiometry.knows(gain) for gain in gains):
            radiometry = None
        doses = tuple(one.total_ul / 1000.0 for one in actions if isinstance(one, Dose))
        return cls(
            bench, {pattern.hash: pattern for pattern in patterns}, doses, settings, radiometry,
            ink=ink_expected(sequence, bench.tank), phase=phase_of(sequence),
            sheet_ends=sequence.sheet_ends,
        )  # fmt: skip

    @classmethod
    def of_run(cls, run: Run) -> "PhotographPlan":
        """For a run that was recorded."""
        conditions = run.conditions.values()
        more_doses, saturation = len({one.tank.volume_ul for one in conditions}), run.settings.get("saturation")
        if "scenes" in run.settings:
            known = KnownScenes(run.scenes)
            return cls(known, run.patterns, (), (), more_doses=more_doses, saturation=saturation)
        bench = checked(Bench, dict(run.settings["bench"]), f"{run.path}: its bench", StoreError)
        sequence = sequence_from_table(dict(run.settings["sequence"]), str(run.path))
        radiometry = radiometry_of_run(run)
        if radiometry is not None and not all(radiometry.knows(one.camera.gain) for one in conditions if one.camera):
            radiometry = None
        plan = cls.of(bench, sequence, list(run.patterns.values()), radiometry)
        return replace(plan, more_doses=more_doses, saturation=saturation)

    @property
    def doses(self) -> int:
        """How many different ones there can be: those recorded, those to come, what the tank held before, and one that
        a person has set right."""
        return 2 + len(self.doses_ml) + self.more_doses

    @cached_property
    def scenes(self) -> dict[str, Scene]:
        """What the fit sees of the patterns that light anything, by hash; the media mean nothing."""
        whole = self._whole_scenes.items()
        return {key: Scene(scene.tank, ANY, scene.projector, self.camera) for key, scene in whole}

    @cached_property
    def _whole_scenes(self) -> dict[str, Scene]:
        """The same with the whole camera."""
        lit = {key: pattern for key, pattern in self.patterns.items() if pattern.pixels.any()}
        scenes = {key: self.bench.scene(pattern, ANY) for key, pattern in lit.items()}
        if len(lit) == len(self.patterns):
            return scenes
        # What the dark pattern shows is subtracted, and the light of dark parts of a picture is in it.
        return {
            key: replace(scene, projector=replace(scene.projector, black_level=0.0)) for key, scene in scenes.items()
        }

    @cached_property
    def _seen(self) -> dict[str, Seen]:
        """Of the lit patterns by hash."""
        return {key: Seen.of(scene) for key, scene in self._whole_scenes.items()}

    @cached_property
    def bins(self) -> Bins:
        """That frames are put together to."""
        return bins_for(self.bench.camera, list(self._seen.values()))

    @cached_property
    def camera(self) -> Camera:
        """The camera as the fit sees it."""
        return self.bins.camera(self.bench.camera)

    @cached_property
    def counts(self) -> dict[str, Mask]:
        """(rows, columns) bins that count for a fit, by the hash of the pattern.

        Left out are bins that blur matters to, in any of their pixels, and bins most of whose pixels are hot.
        """
        healthy = self.bins.shares(self._healthy) > HALF if self._healthy is not None else True
        return {key: (self.bins.shares(seen.sharp) == 1.0) & healthy for key, seen in self._seen.items()}

    @cached_property
    def _healthy(self) -> Mask | None:
        """(rows, columns) pixels that are not hot; None where all are, as far as is known."""
        hot = self.radiometry.hot if self.radiometry is not None else np.zeros(0, bool)
        return ~hot if hot.any() else None

    def require_left(self) -> None:
        """Refuse patterns that lenses blur so far that nothing of their light is left to fit.

        Raises
        ------
        SceneError
            Naming how far it blurs, and what to do.
        """
        for key, seen in self._seen.items():
            if seen.nothing_left:
                raise SceneError(
                    f"camera and projector blur light to {edge_reach_mm(self._whole_scenes[key]):.2g} mm on either "
                    "side of an edge, which leaves nothing of its light to fit; make its stripes or rays wider, or "
                    "focus and calibrate anew"
                )

    @property
    def size(self) -> int:
        """Numbers that the sums take."""
        rows, columns = self.camera.shape
        return 3 + self.doses * DOSE + self.doses * len(self.patterns) * (1 + 3 * rows * columns)

    def binned(self, pixels: Pixels, settings: CameraSettings) -> tuple[Array, Mask]:
        """A frame as the fit sees it: counts per ms at gain 1, made proportional to radiance where that is known.

        Each bin is the mean of its pixels that are not hot.

        Parameters
        ----------
        pixels
            (rows, columns) counts.
        settings
            Of the camera, as read back.

        Returns
        -------
        (rows, columns) of the bins, and which of them neither hold nor adjoin a saturated pixel

        Raises
        ------
        StoreError
            When the camera was calibrated, but not at this gain.
        """
        below = self.bins.clear_of(self._saturated(pixels, settings))
        if self.radiometry is not None:
            return self.bins.means(self.radiometry.light(pixels, settings), self._healthy), below
        per_ms = self.bins.size * settings.exposure_ms * settings.gain
        return self.bins.sums(pixels) / per_ms, below

    def _saturated(self, pixels: Pixels, settings: CameraSettings) -> Mask:
        full = np.asarray(pixels >= (np.inf if self.saturation is None else self.saturation))
        return full if self.radiometry is None else full | self.radiometry.saturated(pixels, settings)


def phase_of(sequence: Sequence) -> str | PhaseFunction:
    """Which phase functions the fits of a sequence's run search: those asked for, the material's, or the ink's.

    Raises
    ------
    SceneError
        When the material is unknown, or nobody has published what it is at the wavelength.
    """
    if sequence.phase is not None:
        return sequence.phase
    if sequence.material and sequence.wavelength_nm is not None:
        return optics(material(sequence.material), sequence.wavelength_nm).searched
    ink = sequence.ink
    return "hg" if ink is None or ink.phase is None else ink.phase


def ink_expected(sequence: Sequence, tank: Tank) -> Medium | None:
    """What a sequence says of its ink, per mm and ml; else what is published of its material, undiluted.

    Raises
    ------
    SceneError
        When the material is unknown, or nobody has published what it is at the wavelength.
    """
    if sequence.ink is not None or not sequence.material or sequence.wavelength_nm is None:
        return sequence.ink
    stock = optics(material(sequence.material), sequence.wavelength_nm).medium
    tank_ml = tank_volume_ml(tank)
    return Medium(stock.sigma_a / tank_ml, stock.sigma_s / tank_ml, stock.g)


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
        cuts = np.cumsum([3, plan.doses * DOSE, shape[0] * shape[1], *[int(np.prod(shape))] * 2])
        # The dose under way, the newest frame, and frames that could not be taken in.
        self._now, doses, counts, sums, squares, seen = np.split(numbers, cuts)
        # Of each dose: ml, its standard deviation, frames left out, whether the last one was, whole sheets of waves.
        self._doses, self._counts = doses.reshape(plan.doses, DOSE), counts.reshape(shape[:2])
        # Of each bin: the sum over its frames that are not saturated there, that of their squares, and their number.
        self._sums, self._squares, self._seen = (one.reshape(shape) for one in (sums, squares, seen))
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

    def _enter(self, tank: Delivered) -> bool:
        """Make what the tank holds the dose under way; False when nobody knows that, or there is no room for it."""
        if not np.isfinite(tank.high_ul):
            return False
        dose_ml = tank.volume_ul / 1000.0
        # Anywhere between its bounds alike: the standard deviation is the width by √12.
        sd_ml = (tank.high_ul - tank.low_ul) / 1000.0 / np.sqrt(12.0)
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


def wave_names(run: Run) -> frozenset[str]:
    """Names of the patterns of a run's `separate` steps, whose frames are not fitted."""
    if "sequence" not in run.settings:
        return frozenset()
    return frozenset(sequence_from_table(dict(run.settings["sequence"]), str(run.path)).waves)


def fits_that_hold(run: Run) -> tuple[Event, ...]:
    """The fits that a run recorded, but for those of a tankrig that took the exposure that was asked for.

    Where the camera had set another one, and the frames' lines do not say so, they are wrong and are made anew.
    """
    older = [event for event in run.events("frame") if event.get("exposure_ms") is None]
    asked = PhotographPlan.of_run(run).settings if older and run.fits else ()
    for event in older if asked else ():
        actual = run.conditions[event["index"]].camera
        if actual is not None and clamped(asked[event["step"]], actual):
            return ()
    return run.fits


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

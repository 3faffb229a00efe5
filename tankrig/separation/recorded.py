"""Separation of a run's frames, by dose and sheet, with what casts doubt on it."""

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from tankrig.bench import Bench
from tankrig.checked_toml import checked
from tankrig.errors import ImageError, StoreError
from tankrig.image.bins import Bins
from tankrig.pattern.kinds import Wave
from tankrig.run.calibrations import radiometry_of_run
from tankrig.run.reading import Run
from tankrig.scene.description import Camera, Interval
from tankrig.separation.order_one import OrderOne, order_one
from tankrig.separation.transfer import Transfer, bins_for_waves, transfer_of
from tankrig.separation.waves import Array, Changed, Mask, Waves, demodulated, noise_of_pairs, what_changed
from tankrig.sequence import Separate
from tankrig.sequence.loading import sequence_from_table
from tankrig.sequence.steps import separations

SAME_ML = 1e-6
"""By which doses may differ and be one."""
REMEMBERED = 48
"""How waves reach the picture, of so many waves."""
FULL_SHARE = 0.001
"""Share of the sheet's pixels that may be saturated in any of its frames before it is said."""
FAINT = 2.0
"""Times the noise of a pixel that the light which follows the finest wave has to be, both root mean square. What of the
sheet follows a wave comes out 8 % too small at 2, and 21 % at 1."""


@dataclass(frozen=True, eq=False)
class Separation:
    """A sheet at one dose, separated.

    Parameters
    ----------
    dose_ml
        Ink in the tank.
    z_mm
        (low, high) of the sheet.
    bench, camera
        Of the run; the camera as the frames are binned.
    waves
        By period in mm, the finest first.
    transfers
        How order 1 brings each wave into the picture, in the same order.
    changed
        What changed while they were photographed, the worst of all waves.
    saturated
        (rows, columns) bins that are saturated in one of the frames; they tell nothing.
    frames
        Names of its frames by their contents: SHA-256 of the frames' own, in their order.
    left_out
        A sentence for each period that nothing can be measured with.
    """

    dose_ml: float
    z_mm: Interval
    bench: Bench
    camera: Camera
    waves: Mapping[float, Waves]
    transfers: tuple[Transfer, ...]
    changed: Changed
    saturated: Mask
    frames: str
    left_out: tuple[str, ...] = field(default=())

    @property
    def order_one(self) -> OrderOne | None:
        """Order 1 by itself; None with fewer than two periods that can be measured, or where nothing is left of it."""
        return self._first if isinstance(self._first, OrderOne) else None

    @cached_property
    def _first(self) -> OrderOne | str:
        """Order 1, or why there is none; nothing is said of periods, which `left_out` does."""
        if len(self.transfers) < 2:
            return ""
        transfers = [
            Transfer(one.wave, np.where(self.saturated, 0.0, one.factor), one.blurred) for one in self.transfers
        ]
        try:
            return order_one([self.waves[one.wave.period_mm] for one in transfers], transfers)
        except ImageError as error:
            return str(error)

    @property
    def sheet(self) -> Array:
        """(rows, columns) image under the whole sheet: the mean over all waves, counts per ms."""
        return np.asarray(np.mean([one.sheet for one in self.waves.values()], axis=0))

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences, each with what to do; empty where there is no reason for doubt."""
        return *self.left_out, *filter(None, [self.lost_in_noise]), *self.faults

    @property
    def lost_in_noise(self) -> str:
        """A sentence where pixels show more noise than light; empty elsewhere.

        This is no fault: what is told with its uncertainty, of all pixels together, holds.
        """
        if not self.transfers:
            return ""
        finest = self.transfers[0]
        waves = self.waves[finest.wave.period_mm]
        noise = 2.0 * float(np.square(waves.wave_sd[finest.seen]).mean())
        light = float(np.square(np.abs(waves.wave[finest.seen])).mean()) - noise
        if light >= FAINT**2 * noise:
            return ""
        return (
            "the pictures show noise, for in a pixel it is as large as the light that follows the waves, and parts "
            "without an uncertainty come out wrong; dose ink, expose for longer or take more frames, and separate anew"
        )

    @property
    def faults(self) -> tuple[str, ...]:
        """Those of the doubts for which its order 1 speaks neither for nor against a fit."""
        found = []
        if self.changed:
            found.append(f"{self.changed}; wait until it has mixed, or let the lamp warm up, and separate anew")
        share = float(self.saturated[self._lit].mean())
        if share > FULL_SHARE:
            found.append(f"{100.0 * share:.3g} % of the sheet is saturated in one of its frames; expose for less")
        first = self._first.doubt if isinstance(self._first, OrderOne) else self._first
        if first and (share <= FULL_SHARE or isinstance(self._first, OrderOne)):
            found.append(first)
        return tuple(found)

    @property
    def _lit(self) -> Mask:
        sheet = self.sheet
        return np.asarray(sheet > 0.05 * float(sheet.max()))

    def arrays(self) -> dict[str, Array]:
        """All images by name, for a file."""
        found = {"sheet": self.sheet}
        for period_mm, one in self.waves.items():
            found |= {
                f"modulated_{period_mm:g}mm": one.modulated, f"even_{period_mm:g}mm": one.even,
                f"wave_sd_{period_mm:g}mm": one.wave_sd, f"sheet_sd_{period_mm:g}mm": one.sheet_sd,
            }  # fmt: skip
        if self.order_one is not None:
            first = self.order_one
            found |= {"order_1": first.image, "order_1_noise": first.noise, "order_1_model": first.model}
        return found


def separations_of_run(run: Run, dose_ml: float | None = None) -> list[Separation]:
    """All sheets that a run separated, by dose and then by height.

    Parameters
    ----------
    run
        With a `separate` step in its sequence.
    dose_ml
        The only dose of which frames are read; None for all.

    Returns
    -------
    list of Separation
        Of those of which all shifts of a wave, and a dark frame, are recorded.

    Raises
    ------
    StoreError
        When its sequence separates nothing, or a frame cannot be read.
    ImageError
        When no sheet is complete.
    """
    sequence = sequence_from_table(dict(run.require_sequence()), str(run.path))
    steps = _different(separations(sequence.steps))
    if not steps:
        raise StoreError(
            f'{run.path}: its sequence has no step that separates orders of scattering; record one with do = "separate"'
        )
    bench = checked(Bench, dict(run.settings["bench"]), f"{run.path}: its bench", StoreError)
    means = _means(run, bench, steps, dose_ml)
    bins = [bins_for_waves(bench.camera, step.periods_mm) for step in steps]
    found = [one for step, its in zip(steps, bins, strict=True) for one in _of_step(bench, step, its, means[its])]
    if not found:
        raise ImageError(f"{run.path}: no sheet has all shifts of a wave and a dark frame; let the run come to its end")
    return sorted(found, key=lambda one: (one.dose_ml, one.z_mm))


def _different(steps: Iterable[Separate]) -> list[Separate]:
    """Steps of which none has all of its waves in another: what one says of a sheet is said once."""
    waves = {frozenset(step.patterns): step for step in steps}
    return [step for names, step in waves.items() if not any(names < other for other in waves)]


def _of_step(bench: Bench, step: Separate, bins: Bins, means: "Means") -> Iterator[Separation]:
    camera = bins.camera(bench.camera)
    for dose_ml in sorted({dose_ml for dose_ml, _ in means}):
        if (dose_ml, "dark") not in means:
            continue
        dark = means[dose_ml, "dark"]
        for z_mm in step.sheets:
            names = _names(step, z_mm)
            complete = {p: of for p, of in names.items() if all((dose_ml, name) in means for name in of)}
            if not complete:
                continue
            lit = {p: [means[dose_ml, name] for name in of] for p, of in complete.items()}
            pictures = {p: np.stack([one.image - dark.image for one in of]) for p, of in lit.items()}
            noise = dict(zip(pictures, noise_of_pairs(list(pictures.values())), strict=True))
            waves = {p: demodulated(pictures[p], noise[p]) for p in sorted(pictures)}
            changed = max((what_changed(pictures[p], noise[p]) for p in pictures), key=lambda one: one.share)
            told = [_transfer(step.patterns[names[p][0]], bench, camera, step.shifts) for p in waves]
            yield Separation(
                dose_ml, z_mm, bench, camera, waves,
                tuple(one for one in told if isinstance(one, Transfer)),
                changed,
                np.any([one.full for of in lit.values() for one in of], axis=0),
                _digest([sha for of in lit.values() for one in of for sha in one.sha256]),
                tuple(one for one in told if isinstance(one, str)),
            )  # fmt: skip


def _names(step: Separate, z_mm: Interval) -> dict[float, list[str]]:
    """The patterns' names of one sheet by period, in the order of their shifts."""
    here = {name: wave for name, wave in step.patterns.items() if wave.z_mm == z_mm}
    return {
        period_mm: sorted((name for name in here if here[name].period_mm == period_mm), key=lambda n: here[n].shift)
        for period_mm in step.periods_mm
    }


@lru_cache(maxsize=REMEMBERED)
def _transfer(wave: Wave, bench: Bench, camera: Camera, shifts: int) -> Transfer | str:
    """On a calibrated bench it takes 8 CPU s, and is the same at every dose."""
    try:
        return transfer_of(wave, bench, camera, shifts)
    except ImageError as error:
        return str(error)


@dataclass(eq=False)
class _Mean:
    """Of the frames of one pattern at one dose, so far."""

    image: Array = field(default_factory=lambda: np.zeros(()))
    full: Mask = field(default_factory=lambda: np.zeros((), bool))
    sha256: list[str] = field(default_factory=list)

    def add(self, image: Array, full: Mask, sha256: str) -> None:
        """Take in one more."""
        count = len(self.sha256)
        self.image = (count * self.image + image) / (count + 1)
        self.full = self.full | full
        self.sha256.append(sha256)


Means = dict[tuple[float, str], _Mean]
"""By dose in ml and name of the pattern."""


def _means(run: Run, bench: Bench, steps: Sequence[Separate], only_ml: float | None) -> dict[Bins, Means]:
    """Counts per ms of all frames that show a wave of the steps, or the dark, in each of the bins that steps ask for.

    Other frames are not read, nor those of other doses than `only_ml`, and none is read twice.
    """
    wanted: dict[Bins, set[str]] = {}
    for step in steps:
        wanted.setdefault(bins_for_waves(bench.camera, step.periods_mm), {"dark"}).update(step.patterns)
    shown = {key: pattern.name for key, pattern in run.patterns.items()}
    radiometry, saturation = radiometry_of_run(run), run.settings.get("saturation")
    means: dict[Bins, Means] = {bins: {} for bins in wanted}
    for event in run.events("frame"):
        name = shown.get(event["pattern_hash"])
        asking = [bins for bins, names in wanted.items() if name in names]
        then = run.conditions[event["index"]]
        if name is None or not asking or event["index"] in run.unsure_doses or then.camera is None:
            continue  # whoever records waves tells how the camera was set
        dose_ml = then.tank.volume_ul / 1000.0
        if only_ml is not None and abs(dose_ml - only_ml) > SAME_ML:
            continue
        settings, pixels = then.camera, run.pixels(event)
        full = np.asarray(pixels >= (np.inf if saturation is None else saturation))
        counts: Mask | None = None
        if radiometry is not None and radiometry.knows(settings.gain):
            light, counts = radiometry.light(pixels, settings), ~radiometry.hot
            full |= radiometry.saturated(pixels, settings)
        else:
            light = pixels / (settings.exposure_ms * settings.gain)
        for bins in asking:
            seen = means[bins].setdefault((dose_ml, name), _Mean())
            seen.add(bins.means(light, counts), ~bins.clear_of(full), event["sha256"])
    return means


def _digest(names: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(names).encode()).hexdigest()

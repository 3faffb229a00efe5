"""All that is known of one source, from its journal and from what was computed of it; pages only draw it.

One `Shown` belongs to one `Source` and takes in nothing of another. What the background finds comes back to the object
that had asked for it, so that no page can show what belongs to something else.
"""

from array import array
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import Enum
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from tankrig.live.results import DoseFit, FailedFit, SeriesFit, from_fields
from tankrig.run.conditions import JournalFollower
from tankrig.run.journal import Event
from ui.window.source import Kind, Source

if TYPE_CHECKING:
    from tankrig.live.exposures import Photograph
    from tankrig.run.regions import Counted
    from ui.window.jobs import Comparison, Found, Reading, Suggestion
    from ui.window.separated import SeparatedSheet, SheetKey

NO_FIT = "No fit yet. Fits come by themselves while a run goes on, from the first dose of ink."


class StepState(Enum):
    """How far a step is, and the sign that stands before it."""

    TO_COME = " "
    BEGUN = "▶"
    DONE = "✓"


@dataclass(frozen=True)
class TimedFit:
    """A fit of a dose, and when the newest frame that it rests on was recorded: seconds from the run's first line."""

    time_s: float
    fit: DoseFit


@dataclass(frozen=True)
class PhotographKey:
    """Names a photograph of a source: one pattern at one dose."""

    pattern: str
    dose_ml: float


@dataclass
class _Clock:
    """When frames were recorded, in seconds from the first line of the journal."""

    begin: datetime | None = None
    frames_s: "array[float]" = field(default_factory=lambda: array("d"))
    newest_s: dict[float, float] = field(default_factory=dict)
    """By dose in ml."""

    def at(self, event: Event) -> float:
        now = datetime.fromisoformat(event.moment.utc)
        self.begin = self.begin or now
        return (now - self.begin).total_seconds()

    def frame(self, index: int, dose_ml: float, time_s: float) -> None:
        self.frames_s.extend([time_s] * (index + 1 - len(self.frames_s)))
        self.frames_s[index] = self.newest_s[dose_ml] = time_s

    def of_fit(self, fit: DoseFit) -> float | None:
        if fit.newest is not None and 0 <= fit.newest < len(self.frames_s):
            return self.frames_s[fit.newest]
        return next((at for dose, at in self.newest_s.items() if abs(dose - fit.dose_ml) < 1e-6), None)


class Shown(QObject):
    """What there is to see of one source.

    Parameters
    ----------
    source
        Which it belongs to, for good.
    labels
        Of the steps of its run.
    sheet_ends
        Numbers of those steps after which all waves of a sheet are recorded.
    """

    fits_changed = Signal()
    """Fits, photographs, verdict or what is said in their place."""
    steps_changed = Signal()
    """All steps."""
    step_changed = Signal(int)
    compared = Signal()
    """The model's picture of the photograph that is chosen has come, or another one was chosen."""
    advised = Signal()
    """Advice, or a comparison of models, has come."""
    counted_changed = Signal()
    """What was counted in regions of its run has come."""
    separable = Signal()
    """More of its sheets can be separated than before, or told more of."""
    separated_changed = Signal()
    """Sheets that were separated, or what is said in their place."""
    read = Signal()
    """A recorded run has been read from disk, and can be played."""

    def __init__(self, source: Source, labels: Sequence[str] = (), sheet_ends: Collection[int] = ()) -> None:
        super().__init__()
        self.source = source
        self.labels = list(labels)
        self.steps = [StepState.TO_COME] * len(self.labels)
        self.fits: list[TimedFit] = []
        self.series: SeriesFit | None = None
        self.says = NO_FIT if source.kind is Kind.LIVE else ""
        self.ending = ""
        self.left_out: tuple[str, ...] = ()
        self.reading: Reading | None = None
        self.photographs: dict[PhotographKey, Photograph] = {}
        self.chosen: PhotographKey | None = None
        """Of the photographs, the one that a person looks at; it follows the newest dose until somebody chooses."""
        self.follows_newest = True
        self.advice: tuple[Suggestion, ...] = ()
        """What to photograph next, the best first."""
        self.advice_says = ""
        self.designed: Suggestion | None = None
        """A picture that was designed for it."""
        self.design_says = ""
        self.models: tuple[tuple[str, ...], ...] | None = None
        """A row for each model of the light."""
        self.models_of = ""
        self.counted: tuple[Counted, ...] = ()
        """In regions of its run's frames, as it is saved with the run."""
        self.dark: float | None = None
        """Median count of its last dark frame."""
        self.separated: dict[SheetKey, SeparatedSheet] = {}
        """Sheets of light told apart by waves."""
        self.separation_says = ""
        """What is wrong with them, or what they wait for."""
        self._sheet_ends = frozenset(sheet_ends)
        self._compared: dict[PhotographKey, tuple[DoseFit, Comparison | None]] = {}
        self._clock, self._conditions = _Clock(), JournalFollower()

    # -- what comes in -------------------------------------------------------------------------------------------------

    def take(self, event: Event, photographs: "Iterable[Photograph]" = ()) -> None:
        """Take in the next line of the run's journal, and with a fit the photographs that it is of."""
        time_s, then = self._clock.at(event), self._conditions.at(event)
        if event.kind == "frame":
            self._clock.frame(event["index"], then.tank.volume_ul / 1000.0, time_s)
        elif event.kind == "step":
            self._step(event)
        elif event.kind == "session":
            self._end("")
        elif event.kind == "end":
            self._end(str(event["reason"]))
            if self.separates:
                self.separable.emit()  # with the fits that came later than their waves
        elif event.kind == "fit":
            self._fit(event.fields, time_s, photographs)

    def _end(self, reason: str) -> None:
        self.ending = reason
        if self.source.kind is Kind.LIVE:
            self.source = replace(self.source, ended=bool(reason))

    def take_reading(self, reading: "Reading") -> None:
        """Take in a run that was read from disk; of a refit all but the recorded fits, which it is not about."""
        self.reading = reading
        self.labels = list(reading.labels)
        self.steps = [StepState.TO_COME] * len(self.labels)
        leave_out = reading.without_fits or self.source.kind is Kind.REFIT
        before = self.blockSignals(True)
        for event in reading.run.journal:
            if not (leave_out and event.kind == "fit"):
                self.take(event)
        self.blockSignals(before)
        if self.source.kind is Kind.REPLAY and not self.fits:
            self.says = "This run has no fit that holds."
        self.counted = reading.counted
        self.steps_changed.emit()
        self.fits_changed.emit()
        self.read.emit()
        self.counted_changed.emit()

    def take_found(self, found: "Found") -> None:
        """Take in what the background has found, in place of what was known before."""
        self.fits = [TimedFit(self._clock.of_fit(fit) or 0.0, fit) for fit in found.doses] if self._anew else self.fits
        if self._anew:
            self.series = found.series
        self.left_out, self.says = found.left_out, " ".join(found.left_out)
        self._photographed(found.photographs)
        self.fits_changed.emit()

    def fail(self, sentence: str) -> None:
        """Say why something of it could not be found; what is known stays."""
        self.says = sentence
        self.fits_changed.emit()

    def choose(self, key: PhotographKey | None) -> None:
        """Look at one photograph; None: at one of the newest dose, and follow it."""
        self.follows_newest = key is None
        self.chosen = key or self._newest_like(self.chosen)
        self.compared.emit()

    def take_comparison(self, key: PhotographKey, fit: DoseFit, comparison: "Comparison") -> None:
        """The model's picture of one of its photographs at a fit."""
        self._compared[key] = fit, comparison
        if key == self.chosen:
            self.compared.emit()

    def take_advice(self, advice: "tuple[Suggestion, ...]", says: str = "") -> None:
        """What to photograph next; or, where there is no advice, why."""
        self.advice, self.advice_says = advice, says
        self.advised.emit()

    def take_design(self, designed: "Suggestion | None", says: str = "") -> None:
        """A picture that was designed; or, where there is none, why, or what it waits for."""
        self.designed, self.design_says = designed, says
        self.advised.emit()

    def take_models(self, rows: "tuple[tuple[str, ...], ...] | None", of: str) -> None:
        """One of its photographs fitted by several models; `of` says which, or why there is nothing."""
        self.models, self.models_of = rows, of
        self.advised.emit()

    def take_counted(self, counted: "tuple[Counted, ...]") -> None:
        """What was counted in regions of its run."""
        self.counted = counted
        self.counted_changed.emit()

    def take_separated(self, found: "Iterable[SeparatedSheet]") -> None:
        """Sheets of its run told apart by waves, in place of what was known of them."""
        self.separated |= {one.key: one for one in found}
        self.separation_says = ""
        self.separated_changed.emit()

    def say_of_separation(self, sentence: str) -> None:
        """Why there is nothing more of its sheets, or not yet."""
        self.separation_says = sentence
        self.separated_changed.emit()

    def fail_comparison(self, key: PhotographKey, fit: DoseFit, sentence: str) -> None:
        """The model's picture could not be made; it is not asked for again until there is another fit."""
        self._compared[key] = fit, None
        self.fail(f"The model's picture could not be made: {sentence}")

    # -- what there is -------------------------------------------------------------------------------------------------

    @property
    def by_dose(self) -> list[DoseFit]:
        """The last fit of each dose, rising."""
        last = {one.fit.dose_ml: one.fit for one in self.fits}
        return [last[dose_ml] for dose_ml in sorted(last)]

    @property
    def newest(self) -> DoseFit | None:
        """The fit of the newest frames; of several such, the one that came last."""
        return max(reversed(self.fits), key=lambda one: one.time_s).fit if self.fits else None

    @property
    def designable(self) -> "tuple[DoseFit, tuple[Photograph, ...]] | None":
        """The fit of the newest frames and its photographs, which a picture can be designed from."""
        fit = self.newest
        here = tuple(one for key, one in self.photographs.items() if fit is not None and key.dose_ml == fit.dose_ml)
        return None if fit is None or not here else (fit, here)

    def fit_of(self, key: PhotographKey) -> DoseFit | None:
        """The last fit of the dose that a photograph was taken at."""
        return next((fit for fit in self.by_dose if fit.dose_ml == key.dose_ml), None)

    @property
    def awaits_sheets(self) -> bool:
        """Whether its run has steps that separate, of which no sheet is whole yet."""
        return bool(self._sheet_ends) and not self.separates

    @property
    def separates(self) -> bool:
        """Whether there are, or may be, waves of a whole sheet among its frames."""
        if self.reading is not None:
            return self.reading.separates
        return any(self.steps[number] is StepState.DONE for number in self._sheet_ends)

    @property
    def comparison(self) -> "Comparison | None":
        """Of the photograph that is chosen; None until it has come."""
        found = self._compared.get(self.chosen) if self.chosen is not None else None
        return found[1] if found is not None else None

    @property
    def wants_comparison(self) -> "tuple[PhotographKey, Photograph, DoseFit] | None":
        """What has to be computed next for the photograph that is chosen; None where it is there, or cannot be."""
        key = self.chosen
        photograph, fit = (self.photographs.get(key), self.fit_of(key)) if key is not None else (None, None)
        if key is None or photograph is None or fit is None:
            return None
        known = self._compared.get(key)
        return None if known is not None and known[0] is fit else (key, photograph, fit)

    # ------------------------------------------------------------------------------------------------------------------

    @property
    def _anew(self) -> bool:
        """Whether what the background finds takes the place of what the journal has said."""
        return self.source.kind is Kind.REFIT

    def _step(self, event: Event) -> None:
        number = int(event["step"])
        if number >= len(self.labels):
            return
        self.steps[number] = StepState.DONE if event["state"] == "done" else StepState.BEGUN
        self.step_changed.emit(number)
        if number in self._sheet_ends and self.steps[number] is StepState.DONE:
            self.separable.emit()

    def _fit(self, fields: Mapping[str, object], time_s: float, photographs: "Iterable[Photograph]") -> None:
        fit = from_fields(fields)
        if isinstance(fit, FailedFit):
            of = "the series" if fit.dose_ml is None else f"{fit.dose_ml:.4g} ml"
            self.says = f"The fit of {of} could not be made: {fit.error}"
        elif isinstance(fit, SeriesFit):
            self.series, self.says = fit, ""
        else:
            at_s = self._clock.of_fit(fit)
            self.fits.append(TimedFit(time_s if at_s is None else at_s, fit))
            self.says = ""
            self._photographed(photographs)
            if any(one.over_fit is None and one.key.dose_ml == fit.dose_ml for one in self.separated.values()):
                self.separable.emit()
        self.fits_changed.emit()

    def _photographed(self, photographs: "Iterable[Photograph]") -> None:
        for one in photographs:
            self.photographs[PhotographKey(one.pattern, one.dose_ml)] = one
        if self.follows_newest or self.chosen not in self.photographs:
            self.chosen = self._newest_like(self.chosen)
            self.compared.emit()

    def _newest_like(self, before: PhotographKey | None) -> PhotographKey | None:
        """The same pattern at the newest dose that was fitted; any other where that has none."""
        newest = self.newest
        here = [key for key in self.photographs if newest is not None and key.dose_ml == newest.dose_ml]
        here = here or list(self.photographs)[-1:]
        same = [key for key in here if before is not None and key.pattern == before.pattern]
        return next(iter(same or here), None)

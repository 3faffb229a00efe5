"""The one source that the window looks at, and the objects that hold what is known of each source."""

import logging
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from PySide6.QtCore import QObject, Signal

from tankrig.run.journal import Event
from tankrig.run.regions import Region
from ui.window import jobs
from ui.window.jobs import Found, Reading
from ui.window.separated import separate
from ui.window.shown import Shown
from ui.window.source import LIVE, Kind, RefitSettings, Source

if TYPE_CHECKING:
    from tankrig.advice.design import Wanted
    from tankrig.sequence import Pace

_log = logging.getLogger(__name__)


DESIGNING = (
    "A picture is being designed. For a liquid that none was designed for yet, the light of its cells is computed "
    "first; the line at the bottom of the window tells how long that takes, and calls it off."
)


class Worker(Protocol):
    """Does work elsewhere and hands the result back in the window's thread."""

    def run(
        self,
        work: Callable[..., Any],
        *arguments: Any,
        then: Callable[[Any], object],
        failed: Callable[[str], object] | None = None,
        name: str = "",
    ) -> object:
        """Call `work(*arguments)` elsewhere, then `then(result)` or `failed(sentence)` here."""


class Reads(Protocol):
    """Reads from disk elsewhere and hands what was read back in the window's thread."""

    def run(
        self,
        work: Callable[..., Any],
        *arguments: Any,
        then: Callable[[Any], object],
        failed: Callable[[str], object] | None = None,
    ) -> object:
        """Call `work(*arguments)` elsewhere, then `then(result)` or `failed(sentence)` here."""


class OnScreen(QObject):
    """Which source is on screen, and one `Shown` for each source that was.

    Pages draw `shown` and nothing else. A source is changed here only; `changed` is emitted in the same turn, and all
    pages have drawn the new one, or nothing, before it returns.

    Parameters
    ----------
    reader
        Reads runs from disk.
    background
        Computes what takes seconds.
    """

    changed = Signal(object)
    """The Shown that is on screen from now on."""
    refitted = Signal(object)
    """Source of a refit that has come when something else was on screen."""
    retitled = Signal(object)
    """The Source on screen, whose title is another one now."""
    told = Signal(str)

    def __init__(self, reader: Reads, background: Worker) -> None:
        super().__init__()
        self.reader, self._background = reader, background
        self._live = Shown(LIVE)
        self._shown = self._live
        self._refits: dict[Source, Shown] = {}
        self._awaited: set[Shown] = set()
        self._pace: tuple[Pace, float] | None = None
        self._comparing: Shown | None = None
        self._separating: dict[Shown, bool] = {}
        """Whose sheets are being separated, and whether there has come more since."""
        self._listen(self._live)

    @property
    def shown(self) -> Shown:
        """What is on screen."""
        return self._shown

    @property
    def source(self) -> Source:
        """Whose it is."""
        return self._shown.source

    def set_rig(self, pace: "Pace", most_ul: float) -> None:
        """How long steps take on the rig, and what its tank may hold, µl: advice rests on both."""
        self._pace = pace, most_ul

    def refits_of(self, run: Path) -> list[Source]:
        """Refits of a run that are known, in the order in which they were asked for."""
        return [source for source in self._refits if source.run == run]

    # -- from one source to another ------------------------------------------------------------------------------------

    def open(self, run: Path) -> None:
        """Show a recorded run as it was."""
        shown = Shown(Source(Kind.REPLAY, run))
        shown.says = "Reading the run…"
        self._show(shown)
        self._read(shown, self._ask_for_photographs)

    def leave(self) -> None:
        """Back to the camera, and to the last run that was recorded here."""
        self._show(self._live)

    def begin(
        self, run: Path, labels: Sequence[str], before: Sequence[Event] = (), sheet_ends: Collection[int] = ()
    ) -> None:
        """A run begins, or goes on: `before` is what its journal holds already.

        After the steps `sheet_ends` all waves of a sheet are recorded.
        """
        self._forget_refits(run)
        self._live = live = Shown(Source(Kind.LIVE, run), labels, sheet_ends)
        for event in before:
            live.take(event)
        live.separable.connect(partial(self.separate, live))
        self._show(live)
        if live.separates:
            self.separate(live)

    def take(self, run: Path, event: Event, photographs: Sequence[Any] = ()) -> None:
        """A line of the journal of the run that goes on."""
        if self._live.source.run != run:
            return
        title = self._live.source.title
        self._live.take(event, photographs)
        if self._live is self._shown and self.source.title != title:
            self.retitled.emit(self.source)

    def refit(self, run: Path, settings: RefitSettings) -> Source:
        """Fit a run anew; it is shown when it has come, if the run is still on screen."""
        source = Source(Kind.REFIT, run, settings)
        shown = Shown(source)
        self._awaited.add(shown)

        def failed(sentence: str) -> None:
            self._awaited.discard(shown)
            self.told.emit(f"{source.title}: {sentence}")

        self._background.run(
            jobs.refit, run, settings, then=partial(self._take_refit, shown), failed=failed, name=source.title
        )
        return source

    def show_refit(self, source: Source) -> None:
        """Show a refit that is known."""
        if source in self._refits:
            self._show(self._refits[source])

    def forget(self, run: Path) -> None:
        """A run is no more: nothing of it stays on screen."""
        self._forget_refits(run)
        if self._live.source.run == run:
            self._live = Shown(LIVE)
        if self.source.run == run:
            self._show(self._live)

    # -- what belongs to a source --------------------------------------------------------------------------------------

    def compare(self) -> None:
        """Have the model's picture made of the photograph that is chosen, one at a time."""
        shown = self._shown
        wanted = shown.wants_comparison
        if wanted is None or self._comparing is not None:
            return
        key, photograph, fit = wanted
        self._comparing = shown

        def then(found: Any) -> None:
            self._comparing = None
            shown.take_comparison(key, fit, found)
            self.compare()

        def failed(sentence: str) -> None:
            self._comparing = None
            shown.fail_comparison(key, fit, sentence)
            self.compare()

        self._background.run(
            jobs.compare, photograph, fit, then=then, failed=failed,
            name=f"the model's picture of {key.pattern} at {key.dose_ml:.4g} ml",
        )  # fmt: skip

    def separate(self, shown: Shown) -> None:
        """Have the sheets of a source's run separated, those that are known already not again."""
        run, live = shown.source.run, shown.source.kind is Kind.LIVE
        if run is None:
            return
        if shown in self._separating:
            self._separating[shown] = True
            return
        self._separating[shown] = False
        if not shown.separated:
            shown.say_of_separation("The waves are being read and separated…")
        known = {key: one.basis for key, one in shown.separated.items()}
        fits = tuple(shown.by_dose) if shown.source.kind is Kind.REFIT else None

        def ended() -> None:
            if self._separating.pop(shown, False):
                self.separate(shown)

        def then(found: Any) -> None:
            shown.take_separated(found)
            ended()

        def failed(sentence: str) -> None:
            shown.say_of_separation(sentence)
            ended()

        self._background.run(
            separate, run, known, fits, live, then=then, failed=failed, name=f"separating the waves of {run.name}"
        )

    def look_up(self, source: Source, failed: Callable[[str], object]) -> Shown:
        """What is known of a source that need not be on screen; read from disk where nothing is."""
        if source in self._refits:
            return self._refits[source]
        shown = Shown(source)
        self.reader.run(jobs.read, source.run, then=shown.take_reading, failed=failed)
        return shown

    def advise(self) -> None:
        """Ask what to photograph next in the run that is on screen."""
        shown = self._shown
        run = shown.source.run
        if run is None or self._pace is None:
            return
        shown.take_advice((), "Models are being prepared and compared; this may take a minute…")

        def failed(sentence: str) -> None:
            shown.take_advice((), sentence)

        self._background.run(
            jobs.advise, run, *self._pace, then=shown.take_advice, failed=failed, name=f"advice for {run.name}"
        )

    def design(self, wanted: "Wanted", heights_mm: tuple[float, ...] = ()) -> None:
        """Ask for a picture that tells most of `wanted`, beside what the run on screen has photographed by now."""
        shown = self._shown
        run, begin = shown.source.run, shown.designable
        if run is None or begin is None:
            return
        shown.take_design(None, DESIGNING)

        def failed(sentence: str) -> None:
            shown.take_design(None, sentence)

        self._background.run(
            jobs.design, run, *begin, wanted, heights_mm, then=shown.take_design, failed=failed,
            name=f"a picture for {run.name}",
        )  # fmt: skip

    def compare_models(self) -> None:
        """Fit the photograph that is chosen by several models."""
        shown, key = self._shown, self._shown.chosen
        photograph = shown.photographs.get(key) if key is not None else None
        if key is None or photograph is None:
            return
        of = f"{key.pattern} at {key.dose_ml:.4g} ml"
        shown.take_models(None, f"{of} is being fitted by several models…")

        def then(rows: tuple[tuple[str, ...], ...]) -> None:
            shown.take_models(rows, f"{of}; a coefficient in brackets is not determined")

        def failed(sentence: str) -> None:
            shown.take_models(None, sentence)

        self._background.run(jobs.compare_models, photograph, then=then, failed=failed, name=f"models of {of}")

    def count_regions(self, regions: Sequence[Region]) -> None:
        """Have regions counted in all frames of the run that is on screen, and saved with it."""
        shown = self._shown
        run = shown.source.run
        if run is None or not regions:
            return

        def failed(sentence: str) -> None:
            self.told.emit(f"regions of {run.name}: {sentence}")

        self._background.run(
            jobs.count_regions, run, tuple(regions), then=shown.take_counted, failed=failed,
            name=f"the regions of {run.name}",
        )  # fmt: skip

    def _show(self, shown: Shown) -> None:
        if shown is self._shown:
            return
        for signal in (self._shown.fits_changed, self._shown.compared):
            signal.disconnect(self.compare)
        self._shown = shown
        self._listen(shown)
        _log.info("on screen: %s", shown.source.title)
        self.changed.emit(shown)
        self.compare()

    def _listen(self, shown: Shown) -> None:
        for signal in (shown.fits_changed, shown.compared):
            signal.connect(self.compare)

    def _read(self, shown: Shown, then: Callable[[Shown], object]) -> None:
        def taken(reading: Reading) -> None:
            shown.take_reading(reading)
            for doubt in reading.doubts:
                self.told.emit(doubt)
            then(shown)
            if shown.separates and shown.source.kind is Kind.REPLAY:
                self.separate(shown)

        def failed(sentence: str) -> None:
            shown.fail(sentence)
            self.told.emit(sentence)
            if self._shown is shown:
                self.leave()

        self.reader.run(jobs.read, shown.source.run, then=taken, failed=failed)

    def _ask_for_photographs(self, shown: Shown) -> None:
        run = shown.source.run
        assert run is not None
        name = f"the photographs of {run.name}"
        self._background.run(jobs.found_in, run, then=shown.take_found, failed=shown.fail, name=name)

    def _take_refit(self, shown: Shown, found: Found) -> None:
        run = shown.source.run
        on_screen = self.source.recorded == run

        def there(read: Shown) -> None:
            if read not in self._awaited:  # the run has gone on meanwhile, or is no more
                return
            self._awaited.discard(read)
            read.take_found(found)
            self._refits[read.source] = read
            if read.separates:
                self.separate(read)
            if on_screen and self.source.recorded == run:
                self._show(read)
            else:
                self.refitted.emit(read.source)

        self._read_refit(shown, there)

    def _read_refit(self, shown: Shown, then: Callable[[Shown], object]) -> None:
        """The run that was fitted: from what is on screen, or from disk."""
        here = self._shown.reading if self.source.recorded == shown.source.run else None
        if here is not None:
            shown.take_reading(here)
            then(shown)
        else:
            self._read(shown, then)

    def _forget_refits(self, run: Path) -> None:
        self._refits = {source: shown for source, shown in self._refits.items() if source.run != run}
        self._awaited = {shown for shown in self._awaited if shown.source.run != run}

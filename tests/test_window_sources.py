"""Everything on screen belongs to one source: whatever a person does, in whatever order, and whenever results come."""

import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QFile
from PySide6.QtWidgets import QFileDialog

from tankrig.live.formatting import with_error
from tankrig.live.results import fits_in
from tankrig.run.reading import open_run
from tests import on_page
from tests import recorded_runs as runs
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window import jobs
from ui.window.on_screen import OnScreen
from ui.window.result import result_of
from ui.window.run_catalogue import RunCatalogue
from ui.window.runs_page import PATH
from ui.window.shown import Shown, StepState
from ui.window.source import Kind, RefitSettings

ACTIONS, WINDOW_ACTIONS = 10_000, 500
FEW = 600


@dataclass
class Pending:
    """Something asked for elsewhere, whose answer comes whenever the test says so."""

    work: Callable[..., Any]
    arguments: tuple[Any, ...]
    then: Callable[[Any], object]
    failed: Callable[[str], object] | None


class Elsewhere:
    """Stands in for the reader's thread and the background's process: nothing comes before `come`."""

    def __init__(self) -> None:
        self.pending: list[Pending] = []

    def run(self, work: Any, *arguments: Any, then: Any, failed: Any = None, **_: Any) -> None:
        self.pending.append(Pending(work, arguments, then, failed))

    def come(self, number: int) -> None:
        """One of the answers comes."""
        one = self.pending.pop(number)
        try:
            found = self.answer(one.work, *one.arguments)
        except Exception as error:
            if one.failed is not None:
                one.failed(str(error))
            return
        one.then(found)

    def answer(self, work: Any, *arguments: Any) -> Any:
        """What really reads a run does; what would take seconds is told by the names of what it was asked for."""
        if work is jobs.read:
            return jobs.read(*arguments)
        if work is jobs.compare:
            photograph, fit = arguments
            return SimpleNamespace(run=photograph.run, pattern=photograph.pattern, dose_ml=photograph.dose_ml, fit=fit)
        path = arguments[0]
        if not path.exists():
            raise OSError(f"{path}: is gone")
        if work is jobs.found_in:
            fits, series = stored(path)
            return jobs.Found(tuple(fits), series, tuple(photographs(path, fits)))
        assert work is jobs.refit
        return refitted(path, arguments[1])


def photographs(path: Path, fits: Any) -> list[Any]:
    return [SimpleNamespace(run=path, pattern=runs.PATTERN, dose_ml=fit.dose_ml, offset=0.0) for fit in fits]


def refitted(path: Path, settings: RefitSettings) -> Any:
    """Fits that no run has recorded, other ones for other settings."""
    by = 2.0 + settings.free_background
    fits, series = stored(path)
    anew = tuple(replace(one, gain=by * one.gain, medium=replace(one.medium, g=0.1 * by)) for one in fits)
    again = None if series is None else replace(series, gain=by * series.gain)
    return jobs.Found(anew, again, tuple(photographs(path, anew)))


def stored(path: Path) -> Any:
    """What a run holds, read from the disk anew."""
    return fits_in([event.fields for event in open_run(path).fits])


def steps_done(path: Path) -> set[int]:
    return {event["step"] for event in open_run(path).events("step") if event["state"] == "done"}


class Trial:
    """A window's state without its widgets, on a folder of runs, driven at random."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.random, self.folder, self.made = random.Random(seed), folder, 0
        self.reader, self.background = Elsewhere(), Elsewhere()
        for doses in (0, 1, 2, 3):
            runs.recorded(self.new_path(), doses, "completed" if doses != 1 else "")
        self.screen = OnScreen(self.reader, self.background)
        self.drawn: list[Shown] = []
        self.screen.changed.connect(self.drawn.append)
        self.catalogue = RunCatalogue(folder)
        self.catalogue.refresh()
        self.live: Path | None = None
        self.going_on = False
        self.asked_anew: dict[Any, Any] = {}
        self.selected_before: Path | None = None
        self.exports: list[tuple[Path, Path]] = []
        self.asking: list[tuple[Path, Callable[[], None]]] = []
        self.log: list[str] = []

    def new_path(self) -> Path:
        self.made += 1
        return self.folder / f"run-{self.made:05d}"

    def act(self) -> None:
        """One thing that a person, the rig or the background does."""
        names = [
            "open", "refit", "resume", "filter", "delete", "export", "run", "leave", "select", "record", "end",
            "read", "come", "accept", "show_refit", "choose", "refresh",
        ]  # fmt: skip
        name = self.random.choices(names, [4, 3, 1, 3, 1, 2, 1, 2, 4, 8, 1, 8, 8, 2, 2, 3, 1])[0]
        self.log.append(name)
        getattr(self, name)()

    def selected(self) -> Path | None:
        one = self.catalogue.selected
        return None if one is None else one.path

    def open(self) -> None:
        if self.selected() and not self.going_on:
            self.screen.open(self.selected())

    def refit(self) -> None:
        run = self.screen.source.recorded
        if run is not None:
            settings = RefitSettings((runs.PATTERN,), self.random.random() < 0.5)
            self.screen.refit(run, settings)

    def show_refit(self) -> None:
        known = [one for run in sorted(self.folder.iterdir()) for one in self.screen.refits_of(run)]
        if known and not self.going_on:
            self.screen.show_refit(self.random.choice(known))

    def resume(self) -> None:
        one = self.catalogue.selected
        if one is None or self.going_on or not one.resumable or not one.path.exists():
            return
        self.live, self.going_on = one.path, True
        before = open_run(one.path).journal
        labels = jobs.read(one.path).labels
        self.screen.begin(one.path, labels, before)
        self.note(runs.session(one.path, 60.0 * (len(stored(one.path)[0]) + 1)))

    def run(self) -> None:
        if self.going_on:
            return
        self.live, self.going_on = self.new_path(), True
        runs.begin_run(self.live)
        self.screen.begin(self.live, jobs.read(self.live).labels, ())
        self.note(runs.session(self.live))
        self.catalogue.refresh()

    def leave(self) -> None:
        self.screen.leave()

    def note(self, event: Any, shots: Any = ()) -> None:
        self.screen.take(self.live, event, shots)

    def record(self) -> None:
        """The run that goes on takes another dose; a line of some other run arrives late."""
        if not self.going_on:
            return
        fits, _ = stored(self.live)
        if len(fits) < 8:
            for event in runs.add_dose(self.live, len(fits), "d" * 64, series=self.random.random() < 0.7):
                late = self.folder / "run-00000"
                self.screen.take(late, event)
                shots = (
                    photographs(self.live, [runs.dose_fit(self.live, len(fits))]) if event.get("fit") == "dose" else ()
                )
                self.note(event, shots)

    def end(self) -> None:
        if self.going_on:
            why = self.random.choice(["completed", "aborted", "failed"])
            self.note(runs.add(self.live, "end", 3000.0, reason=why))
            self.going_on = False
            self.catalogue.refresh()

    def filter(self) -> None:
        self.catalogue.sift(
            self.random.choice(["", "completed", "aborted", "run-0000", str(self.made), "nothing at all"])
        )

    def refresh(self) -> None:
        self.catalogue.refresh()

    def select(self) -> None:
        visible = self.catalogue.visible
        if visible:
            self.catalogue.select(self.random.choice(visible).path)

    def delete(self) -> None:
        run = self.selected()
        if run is not None and run != (self.live if self.going_on else None) and len(self.catalogue.runs) > 3:
            shutil.rmtree(run)
            self.screen.forget(run)
            self.catalogue.refresh()

    def export(self) -> None:
        """The question for a file is opened now and answered later, when another run may be selected."""
        run = self.selected()
        if run is not None:
            self.asking.append((run, lambda: self.exports.append((run, run))))

    def accept(self) -> None:
        if self.asking:
            asked, answer = self.asking.pop(self.random.randrange(len(self.asking)))
            answer()
            assert self.exports[-1][0] == asked

    def choose(self) -> None:
        keys = list(self.screen.shown.photographs)
        self.screen.shown.choose(self.random.choice([None, *keys]))

    def read(self) -> None:
        if self.reader.pending:
            self.reader.come(self.random.randrange(len(self.reader.pending)))

    def come(self) -> None:
        if self.background.pending:
            self.background.come(self.random.randrange(len(self.background.pending)))

    # -- what has to hold ----------------------------------------------------------------------------------------------

    def disagreements(self) -> list[str]:
        """Where what pages would draw is not what the store, or the refit that was asked for, says."""
        shown, found = self.screen.shown, []
        source = shown.source
        selected, visible = self.catalogue.selected, [one.path for one in self.catalogue.visible]
        if selected is not None and selected.path not in visible:
            found.append(f"{selected.path.name} is selected and hidden")
        if source.run is not None and not source.run.exists():
            found.append(f"{source.title}: on screen and deleted")
            return found
        if source.run is None:
            if shown.fits or shown.series or shown.photographs or shown.steps:
                found.append("the camera alone has results")
            return found
        if source.kind is not Kind.LIVE and shown.reading is None:
            if shown.fits or shown.series or shown.steps:
                found.append(f"{source.title}: results before it was read")
            return found
        fits, series = stored(source.run)
        if source.kind is Kind.REFIT:
            anew = refitted(source.run, source.settings)
            fits, series = list(anew.doses), anew.series
        if shown.by_dose != fits:
            found.append(f"{source.title}: fits {shown.by_dose} are not {fits}")
        if shown.series != series:
            found.append(f"{source.title}: another series")
        done = {number for number, state in enumerate(shown.steps) if state is StepState.DONE}
        if done != steps_done(source.run):
            found.append(f"{source.title}: other steps are done")
        for one in shown.fits:
            if abs(one.time_s - 60.0 * (one.fit.newest + 1)) > 1e-3:
                found.append(f"{source.title}: {one.fit.dose_ml} ml stands at {one.time_s} s")
        found += [f"a photograph of {one.run}" for one in shown.photographs.values() if one.run != source.run]
        compared: Any = shown.comparison
        if compared is not None and (compared.run, compared.dose_ml) != (source.run, shown.chosen.dose_ml):
            found.append(f"{source.title}: a picture of something else")
        result = result_of(shown)
        if (result is None) != (not fits) or (result is not None and result.title != source.title):
            found.append(f"{source.title}: another result")
        return found


def drive(folder: Path, seed: int, actions: int) -> None:
    trial = Trial(folder, seed)
    for number in range(actions):
        shown, selected = trial.screen.shown, trial.selected()
        trial.act()
        assert not (wrong := trial.disagreements()), (number, trial.log[-8:], wrong)
        if trial.screen.shown is not shown:
            assert trial.drawn[-1] is trial.screen.shown, "pages were not told in the same turn"
        if trial.log[-1] not in ("select", "filter", "delete", "run", "end", "refresh"):
            assert trial.selected() == selected, "another run was selected by itself"


@pytest.mark.usefixtures("qapp")
@pytest.mark.parametrize("seed", range(10, 12))
def test_no_order_of_actions_shows_what_belongs_to_something_else(tmp_path, seed):
    """A person draws conclusions from what stands together on screen; it must be of one run and one fit."""
    drive(tmp_path, seed, FEW)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.usefixtures("qapp")
@pytest.mark.parametrize("seed", range(4))
def test_none_does_in_ten_thousand(tmp_path, seed):
    drive(tmp_path, seed, ACTIONS // 4)


SHORT = 'name = "short"\nexposure_ms = 5\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n'
WAITS = SHORT + '[[steps]]\ndo = "wait"\nseconds = 60\n'


class Soon(Elsewhere):
    """Answers a little later, from the event loop, in any order."""

    def __init__(self, at_random: random.Random) -> None:
        super().__init__()
        self._random = at_random
        self.tasks: tuple[Any, ...] = ()

    def run(self, *asked: Any, **answer: Any) -> None:
        from PySide6.QtCore import QTimer

        super().run(*asked, **answer)
        QTimer.singleShot(self._random.randrange(120), self._one)

    def _one(self) -> None:
        if self.pending:
            self.come(self._random.randrange(len(self.pending)))

    def answer(self, work: Any, *arguments: Any) -> Any:
        if work is not jobs.compare:
            return arguments[0] if work in (jobs.export, jobs.report) else super().answer(work, *arguments)
        photograph, fit = arguments
        image, bench = np.ones((20, 30)), jobs.read(photograph.run).bench
        rmse = {"1": 0.4, "1–3": 0.3, "1–20": 0.2, "all": fit.gain / 1e4}
        one = (photograph.pattern, photograph.dose_ml, image, image, image, rmse, bench.tank, bench.camera)
        return jobs.Comparison(*one)


class WindowTrial:
    """The real window on a small rig, driven at random, and what its pages say beside what the store holds."""

    def __init__(self, window: Any, home: Path, seed: int) -> None:
        self.window, self.home, self.random = window, home, random.Random(seed)
        self.background = Soon(self.random)
        window.background.run = self.background.run
        self.made, self.log = 0, []
        (home / "short.toml").write_text(SHORT)
        (home / "waits.toml").write_text(WAITS)

    def act(self) -> None:
        names = {
            "open": 6, "refit": 4, "show_refit": 3, "resume": 1, "filter": 4, "delete": 2, "export": 3, "run": 1,
            "leave": 3, "select": 6, "choose": 3, "against": 2, "look": 3, "make": 3,
        }  # fmt: skip
        name = self.random.choices(list(names), list(names.values()))[0]
        self.log.append(name)
        getattr(self, name)()

    def press(self, words: str) -> None:
        on_page.button(self.window.runs, words).click()

    def open(self) -> None:
        self.press("Open")

    def refit(self) -> None:
        on_page.button(self.window.runs, "fit the background").setChecked(self.random.random() < 0.5)
        self.window.runs.refits.button.click()

    def show_refit(self) -> None:
        known = self.window.runs.refits.list
        row = self.random.randrange(known.count())
        known.setCurrentIndex(row)
        known.activated.emit(row)

    def filter(self) -> None:
        words = ["", "completed", "aborted", "run-", "20", "nothing at all"]
        on_page.line(self.window.runs, "only runs with these words").setText(self.random.choice(words))

    def select(self) -> None:
        table = on_page.rows_of(self.window.runs, "runs")
        if table.rowCount():
            table.selectRow(self.random.randrange(table.rowCount()))

    def delete(self) -> None:
        if len(self.window.runs.catalogue.runs) > 4:
            button = on_page.button(self.window.runs, "Delete")
            button.click()
            button.click()

    def export(self) -> None:
        """Ask, look at something else, answer."""
        selected = self.window.runs.catalogue.selected
        self.window.runs.export_selected("NetCDF")
        questions = self.window.runs.findChildren(QFileDialog)
        if not questions:
            assert selected is None
            return
        self.select()
        self.made += 1
        questions[0].selectFile(str(self.home / f"out-{self.made}.nc"))
        before = len(self.background.pending)
        questions[0].accept()
        asked = [one for one in self.background.pending[before:] if one.work is jobs.export]
        assert asked[0].arguments[0] == selected.path, "another run was exported than was asked about"
        questions[0].deleteLater()

    def leave(self) -> None:
        self.window.runs.bar.left.emit()

    def choose(self) -> None:
        doses = on_page.choice(self.window.fit, "at")
        row = self.random.randrange(max(1, doses.count()))
        doses.setCurrentIndex(row)
        doses.activated.emit(row)

    def against(self) -> None:
        on_page.choice(self.window.fit, "what the curves stand against").setCurrentIndex(self.random.randrange(2))

    def look(self) -> None:
        pages = (self.window.fit, self.window.runs, self.window.sequence, self.window.doser, self.window.compare)
        self.window.show_page(self.random.choice(pages))

    def make(self) -> None:
        """A run appears in the folder, as if another program had recorded it."""
        if len(self.window.runs.catalogue.runs) < 9:
            self.made += 1
            path = self.window.folder / f"run-{self.made:04d}"
            runs.recorded(path, self.random.randrange(4), self.random.choice(["completed", "aborted"]))
            self.window.runs.refresh()

    def run(self) -> None:
        """A real run, to its end or stopped in the middle."""
        whole = self.random.random() < 0.5
        self.window.sequence.load(self.home / ("short.toml" if whole else "waits.toml"))
        until(
            lambda: self.window.status.state.value == "ready" and self.window.sequence.document.plan is not None, 60.0
        )
        self.window.run()
        self.go_through(whole)

    def resume(self) -> None:
        """Go on with a run that was stopped in the middle; those that were made by hand are of another bench."""
        real = [one for one in self.window.runs.catalogue.runs if one.resumable and one.name == "short"]
        if real:
            self.window.resume(self.random.choice(real).path)
            self.go_through(whole=False)

    def go_through(self, whole: bool) -> None:
        ended: list[Any] = []
        self.window.host.run_ended.connect(ended.append)
        try:
            until(lambda: self.window.status.running or ended or self.window.status.trouble, 60.0)
            while not ended:
                assert not (wrong := self.disagreements()), wrong
                if not whole and self.window.sequence.run_list.lines()[:1] and (
                    self.window.sequence.run_list.lines()[0].startswith("✓")
                ):  # fmt: skip
                    self.window.stop()
                wait_ms(30)
            until(lambda: self.window.status.state.value == "ready", 60.0)
        finally:
            self.window.host.run_ended.disconnect(ended.append)

    def disagreements(self) -> list[str]:
        """Every page beside the store, in the turn after what was done."""
        window, found = self.window, []
        source, shown = window.on_screen.source, window.on_screen.shown
        titles = {one.title.text() for one in (window.live_frame, window.sequence.run_frame, window.runs.frame,
                                               window.compare.frame)}  # fmt: skip
        if titles != {source.title}:
            found.append(f"titles {titles} over {source.title}")
        if window.live.frame is not None and window.live.frame.run != source.recorded:
            found.append(f"a picture of {window.live.frame.run} under {source.title}")
        selected, table = window.runs.catalogue.selected, on_page.rows_of(window.runs, "runs")
        marked = {item.data(PATH) for item in table.selectedItems()}
        if marked != ({str(selected.path)} if selected is not None else set()):
            found.append(f"{marked} is marked and {selected} selected")
        card = window.fit.card
        fits, series, done = self.expected(shown)
        if fits is None:
            return found
        best = series.ink if series is not None else (shown.newest.medium if shown.newest is not None else None)
        sd = series.sd if series is not None else (shown.newest.sd if shown.newest is not None else ())
        text = card.values["sigma_s"][1].text()
        if (text == "–") != (not fits):
            found.append(f"{source.title}: the card says {text} of {len(fits)} fits")
        if best is not None and text != with_error(best.sigma_s, 1.96 * sd[1]).split(" ± ")[0]:
            found.append(f"{source.title}: the card says {text}")
        if shown.newest is not None and shown.newest not in fits:
            found.append(f"{source.title}: a fit that the store does not have")
        points = sorted(y for _, y in on_page.dots(window.fit, "σs"))
        if points and not set(points) <= {fit.medium.sigma_s for fit in fits}:
            found.append(f"{source.title}: the curve shows {points}")
        ticked = {row for row, line in enumerate(window.sequence.run_list.lines()) if line.startswith("✓")}
        if ticked != done:
            found.append(f"{source.title}: steps {ticked} are ticked and {done} done")
        left = on_page.bar(window.fit, "all orders").format()
        allowed = {f"{100.0 * fit.gain / 1e4:.2g} % left" for fit in fits} | {"–"}
        if left not in allowed:
            found.append(f"{source.title}: the bars say {left}")
        return found

    def expected(self, shown: Shown) -> Any:
        source = shown.source
        if source.run is None:
            return [], None, set()
        if source.kind is not Kind.LIVE and shown.reading is None:
            return [], None, set()
        if not source.run.exists() or (source.kind is Kind.LIVE and self.window.status.busy):
            return None, None, None  # lines are still on their way to the window
        fits, series = stored(source.run)
        if source.kind is Kind.REFIT:
            anew = refitted(source.run, source.settings)
            fits, series = list(anew.doses), anew.series
        return fits, series, steps_done(source.run)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(21, 26))
def test_five_hundred_actions_through_the_real_window(tmp_path, monkeypatch, seed):
    """What pages draw is what the store holds, whatever is pressed in whatever order."""
    monkeypatch.setattr("PySide6.QtGui.QDesktopServices.openUrl", lambda _: True)
    monkeypatch.setattr(QFile, "moveToTrash", lambda run: shutil.rmtree(run) is None)
    for number in range(4):
        runs.recorded(tmp_path / "runs" / f"run-first-{number}", number)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        trial = WindowTrial(window, tmp_path, seed)
        for number in range(WINDOW_ACTIONS // 5):
            trial.act()
            assert not (wrong := trial.disagreements()), (number, trial.log[-6:], wrong)
            wait_ms(trial.random.choice([0, 1, 20, 60]))
            assert not (wrong := trial.disagreements()), (number, trial.log[-6:], wrong)
        print({name: trial.log.count(name) for name in sorted(set(trial.log))})

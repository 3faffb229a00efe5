"""The window: the live view, the pages in docks around it, and what ties them to the rig."""

import logging
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSettings, Qt, QTimer
from PySide6.QtGui import (
    QCloseEvent,
    QDragEnterEvent,
    QDropEvent,
    QGuiApplication,
    QKeySequence,
    QResizeEvent,
    QShortcut,
)
from PySide6.QtWidgets import QLabel, QMainWindow, QMessageBox, QToolBar, QVBoxLayout, QWidget

from tankrig.errors import TankrigError
from ui.window import theme
from ui.window.background import Background
from ui.window.banner import Banner
from ui.window.build_pages import pages
from ui.window.docks import Docks
from ui.window.dropped import Dropped, kind_of
from ui.window.elided import Elided
from ui.window.event_loop_monitor import EventLoopMonitor
from ui.window.files import ask_for_file
from ui.window.focus_ring import FocusRing
from ui.window.fresh_water import WAY, asks_for_it
from ui.window.gc_timer import GcTimer
from ui.window.kept_draft import KeptDraft
from ui.window.kept_log import KeptLog
from ui.window.keys import BY_NAME, KEYS, KeyCard
from ui.window.live_view import LiveView
from ui.window.notices import NOT_NOW, SEQUENCE, Notices
from ui.window.page_actions import actions_of
from ui.window.palette import Action, Palette
from ui.window.recent_files import RecentFiles
from ui.window.rig_file import RigSource
from ui.window.rig_host import RigHost
from ui.window.rig_parts import RunOrder, import_ahead
from ui.window.saving import Saving
from ui.window.source_frame import SourceFrame
from ui.window.status import RigState, RigStatus
from ui.window.stop_keys import StopKeys
from ui.window.threads import OwnedThread
from ui.window.top_bar import TopBar
from ui.window.words import volume
from ui.window.work_strip import WorkStrip

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.run.journal import Event
    from tankrig.run.runner import Outcome
    from tankrig.sequence.sequence import Sequence
    from ui.window.calibration_page import CalibrationPage
    from ui.window.compare_page import ComparePage
    from ui.window.doser_page import DoserPage
    from ui.window.fit_page import FitPage
    from ui.window.log_panel import LogPanel
    from ui.window.on_screen import OnScreen
    from ui.window.projector_page import ProjectorPage
    from ui.window.reader import Reader
    from ui.window.regions_page import RegionsPage
    from ui.window.replay import Replay
    from ui.window.runs_page import RunsPage
    from ui.window.separation_page import SeparationPage
    from ui.window.sequence_page import SequencePage
    from ui.window.shown import Shown
    from ui.window.source import Source

_log = logging.getLogger(__name__)

LAYOUT = 5
"""Raised when docks are added, so that an old layout is not restored."""
PICTURE_MS = 3000
"""The pages are made once the first picture is on screen, or after this."""
BREATH_MS = 15
"""Between two pages that are made: what was shown is painted, and keys are heard."""
END_S = 60.0


class MainWindow(QMainWindow):
    """One window on one rig: the live view at once, and the pages around it as soon as that shows a picture.

    Parameters
    ----------
    host
        Of the rig; closed with the window.
    runs
        Folder of the runs.
    settings
        Remembers docks, theme and the last sequence.
    sequence
        To open, rather than the last.
    log
        That is kept already, since before the rig was opened; None to keep one from now on.

    Attributes
    ----------
    rig
        As it was opened last; None until it has been.
    """

    sequence: "SequencePage"
    fit: "FitPage"
    separation: "SeparationPage"
    compare: "ComparePage"
    doser: "DoserPage"
    projector: "ProjectorPage"
    runs: "RunsPage"
    calibration: "CalibrationPage"
    regions: "RegionsPage"
    log: "LogPanel"
    on_screen: "OnScreen"

    def __init__(
        self, host: RigHost, runs: Path, settings: QSettings, sequence: Path | None = None, log: KeptLog | None = None
    ) -> None:
        super().__init__()
        self.setObjectName("tankrig")
        self.setWindowTitle("tankrig")
        self.setAcceptDrops(True)
        self._settings, self.folder, self._first_sequence = settings, runs, sequence
        self._kept_log, self.recent = log or KeptLog(runs), RecentFiles(settings)
        self.status = RigStatus()
        self.event_loop, self.background, self.host = EventLoopMonitor(), Background(), host
        self._replay: Replay | None = None
        self._reader: Reader | None = None
        self._frames: list[SourceFrame] = []
        self.rig: RigFile | None = None
        self._ending: OwnedThread | None = None
        self._offered = self.built = False
        self._asked: str | None = None
        self._actions: dict[str, Callable[[], object]] = {}
        self.top, self.banner, self.live = TopBar("rig", host.source.simulated), Banner(), LiveView(host.frames)
        self.notices = Notices(self.banner)
        self.live_frame = SourceFrame(self.live)
        self.docks = Docks(self)
        self._lay_out()
        self._connect()
        self.make_keys(
            {"help": self.show_keys, "quit": self.ask_to_close, "theme": self._other_theme,
             "full-screen": self._full_screen, "layout": self.docks.reset}
        )  # fmt: skip
        self.stop_keys, self.ring = StopKeys(self, self.stop, lambda: host.in_motion), FocusRing(self)
        self._restore()
        host.tell_rig()  # it may have been opened meanwhile
        self.setFocus()  # what is typed goes nowhere before a person chooses a field
        self._pulse = QTimer(self)
        self._pulse.timeout.connect(host.window_alive)
        self._pulse.start(1000)
        self._building = self._built_in_turn()
        self.live.first_shown.connect(self._build_soon)
        QTimer.singleShot(PICTURE_MS, self._go_on_building)

    # -- the pages -----------------------------------------------------------------------------------------------------

    def build_pages(self) -> None:
        """Make the pages that are not there yet, now."""
        for _ in self._building:
            pass

    def _go_on_building(self) -> None:
        """One page at a time, and in between whatever else there is to do."""
        if self._ending is None and next(self._building, None):
            self._build_soon()

    def _build_soon(self) -> None:
        QTimer.singleShot(BREATH_MS, self._go_on_building)

    def _built_in_turn(self) -> Iterator[bool]:
        from ui.window.on_screen import OnScreen
        from ui.window.reader import Reader

        self._reader = Reader()
        self.on_screen = OnScreen(self._reader, self.background)
        self.saving = Saving(self, self.live, self.docks, self.on_screen, self._reader, self.notices.tell)
        for made in pages(self.folder, self.on_screen, self.background, self.host.source, self.live):
            for name, title, page, frame in made:
                setattr(self, name, page)
                self._frames.append(frame)
                self.docks.put(title, page, frame)
            yield True
        self._connect_pages()
        self._begin_with_pages()

    def _connect_pages(self) -> None:
        self._connect_running()
        self._connect_rig_pages()
        self._connect_sequence()
        self._connect_recorded_runs()
        for teller in (self.sequence, self.runs, self.calibration, self.on_screen, self.compare, self.regions):
            teller.told.connect(self.notices.tell)
        self._make_keys_of_pages()

    def _connect_running(self) -> None:
        """What the rig's host says of a run that goes on."""
        host, queued = self.host, Qt.ConnectionType.QueuedConnection
        for signal, slot in (
            (host.run_began, self.began), (host.left_unfitted, self.offer_to_fit), (host.run_ended, self.ended),
            (host.recorded, self.on_screen.take),
            (host.pattern_shown, self.projector.shown),
        ):  # fmt: skip
            signal.connect(slot, queued)

    def _connect_rig_pages(self) -> None:
        """Projector, doser, calibration and camera."""
        host = self.host
        self.projector.show_asked.connect(host.show)
        self.projector.screen_asked.connect(self.use_screen)
        self.doser.dose_asked.connect(self.dose_to)
        self.doser.aside_asked.connect(self.dose_aside)
        self.doser.rate_asked.connect(host.set_rate)
        self.doser.resolve_asked.connect(host.resolve)
        self.doser.clear_asked.connect(host.clear_stop)
        self.doser.refill_asked.connect(host.refill)
        self.doser.give_up_asked.connect(host.reopen)
        self.calibration.reopen_asked.connect(host.reopen)
        self.calibration.wrong_line.connect(partial(self.show_page, self.calibration))
        self.calibration.wizard.lend_asked.connect(host.lend)
        self.live.counted.connect(self.regions.take)
        self.live.regions_asked.connect(self.show_regions)

    def _connect_sequence(self) -> None:
        """The sequence, and pages that add steps to it."""
        self.sequence.run_asked.connect(self.run)
        self.compare.next.step_asked.connect(self.sequence.append)
        self.separation.step_asked.connect(self.separate)
        self.sequence.rig_asked.connect(self.ask_for_rig)
        self.sequence.opened.connect(self.remember)
        self.sequence.recent_asked.connect(self.open_path)
        self.sequence.list_recent(self.recent.still_there())
        self.sequence.runs_asked.connect(lambda: self.show_page(self.runs))
        self.sequence.dropped.connect(self.offer_text)
        self.sequence.wrong.connect(partial(self.notices.tell, key=SEQUENCE))
        self.sequence.water_asked.connect(self.show_fresh_water)
        for signal in (self.sequence.document.changed, self.sequence.document.checked):
            signal.connect(self._follow_sequence)

    def _connect_recorded_runs(self) -> None:
        """Runs that were recorded, and what of them is on screen."""
        self.on_screen.changed.connect(self._show_source)
        self.on_screen.retitled.connect(self._name_source)
        self.on_screen.refitted.connect(self._offer_refit)
        self.runs.resume_asked.connect(self.resume)
        self.runs.open_asked.connect(self.show_run)
        self.runs.report_told.connect(self.notices.say_of_report)
        self.runs.deleted.connect(self.notices.forget_run)
        self.runs.bar.left.connect(self.on_screen.leave)

    def _make_keys_of_pages(self) -> None:
        undo, pages = self.sequence.document.undo, (
            self.sequence, self.fit, self.doser, self.projector, self.runs, self.calibration, self.log,
            self.compare, self.regions, self.separation,
        )  # fmt: skip
        self.make_keys({
            "palette": self.show_palette, "screenshot": self.saving.save_screenshot,
            "layout-align": partial(self.docks.arrange, self.projector, 0.36),
            "layout-calibrate": partial(self.docks.arrange, self.calibration, 0.6),
            "layout-run": partial(self.docks.arrange, self.sequence, 0.5),
            "layout-look": partial(self.docks.arrange, self.fit, 0.64),
        })  # fmt: skip
        self.make_keys(
            {"run": self.run, "pause": self.pause, "dry-run": self.sequence.dry_run,
             "open": self.sequence.open_file, "save": self.sequence.save, "undo": undo.undo, "redo": undo.redo}
            | {f"page-{number}": partial(self.show_page, page) for number, page in enumerate(pages, 1)}
        )  # fmt: skip

    def _begin_with_pages(self) -> None:
        """All pages are there: tell them what is known."""
        self._draft = KeptDraft(self._settings, self.sequence.document, self.notices.tell)
        self.built = True
        self._show_source(self.on_screen.shown)
        last, typed = self._first_sequence or self._draft.file, self._draft.text
        if last is not None:
            self.sequence.load(last)
        if typed and not self._first_sequence:
            self.sequence.document.edit_text(typed)
        elif typed:
            self.offer_text(typed)
        if self.sequence.beginning and self.focusWidget() in (None, self):
            self.sequence.first.buttons["Try it"].setFocus()  # who has no mouse begins with the space bar
        self._opened(self.rig, afresh=True)  # last, so that an offer to go on with a run stands before other notices
        self.follow(self.status)
        theme.paint_plots(self)
        self._draft.follow()
        self._gc_timer = GcTimer(lambda: not self.status.running)
        assert self._reader is not None
        self._reader.run(import_ahead, then=lambda _: None)

    # -- the rig -------------------------------------------------------------------------------------------------------

    def _opened(self, rig: "RigFile | None", afresh: bool = False) -> None:
        if rig is None:
            return
        new, self.rig = afresh or rig != self.rig, rig
        if self._replay is None:
            self.live.set_bench(rig.bench)
        if not self.host.source.simulated:
            self.top.name_rig(rig.name)
        for frame in self._frames:
            frame.name_rig(rig.name)
        if not self.built:
            return
        self.calibration.set_rig(rig)
        self.on_screen.set_rig(rig.pace, rig.limits.tank_ul)
        self.regions.set_bench(rig.bench)
        if new:
            for page in (self.sequence.document, self.doser, self.projector):
                page.set_rig(rig)
            self.sequence.patterns.set_bench(rig.bench)
            self.sequence.steps.set_wall(rig.bench.wall)
        if not self._offered:
            self._offered = True
            run = self.runs.latest_interrupted(rig.name)
            if run is not None:
                self.notices.say_interrupted(run, partial(self.resume, run.path))

    def follow(self, status: RigStatus) -> None:
        """Show where the rig stands, on all pages."""
        before, self.status = self.status, status
        self.stop_keys.follow()
        self._words.say(status.words)
        self._held.setText("" if status.tank is None else f"{volume(status.tank.volume_ul)} of ink in the tank")
        self.live.set_camera(self.host.camera_settings, status.state is RigState.IDLE)
        self.notices.follow_rig(before, status, self.host.reopen, self.show_fresh_water if self.built else None)
        failed = status.state is RigState.FAILED
        self.live_frame.say_trouble("NO PICTURE: the rig cannot be used" if failed else "")
        self.live.say_over(status.over_the_picture)
        self.live.say_trouble("no picture: the rig cannot be used; the line above says why" if failed else "")
        if not self.built:
            if status.state in (RigState.FAILED, RigState.ASKING):  # no picture will come
                self.build_pages()
            return
        for page in (self.sequence, self.doser, self.projector, self.calibration):
            page.follow(status)
        self.top.follow(status, self.sequence.hindrance)
        self.runs.set_busy(status.busy)
        if status.undecided is not None and self._asked != status.undecided:
            self.show_page(self.doser)
        self._asked = status.undecided

    # -- runs ----------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Carry out the sequence that is being edited."""
        sequence = self.sequence.document.reading.sequence
        if sequence is None or self.sequence.document.plan is None:
            problem = self.sequence.document.problem
            if problem is None:
                self.notices.tell("the rig is not ready; wait until it is, then run", NOT_NOW)
            elif asks_for_it(problem.sentence):
                self.notices.tell(problem.sentence, SEQUENCE, WAY, self.show_fresh_water)
            else:
                self.notices.tell(problem.sentence, SEQUENCE)
        elif self.status.busy:
            self.notices.tell("a run or a dose goes on; wait for its end or stop it, then run", NOT_NOW)
        else:
            path = self.folder / datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
            self.host.start_run(RunOrder(path, sequence))
            self.stop_keys.follow()

    def resume(self, path: Path) -> None:
        """Go on with an interrupted run."""
        if self.status.busy:
            self.notices.tell("a run or a dose goes on; wait for its end or stop it, then resume", NOT_NOW)
        else:
            self.host.start_run(RunOrder(path))
            self.stop_keys.follow()

    def dose_to(self, total_ul: float) -> None:
        """Dose by hand, until the tank holds so much."""
        self.host.dose_to(total_ul)
        self.stop_keys.follow()

    def dose_aside(self, volume_ul: float) -> None:
        """Fill the tube: deliver so much into a waste vessel."""
        self.host.dose_aside(volume_ul)
        self.stop_keys.follow()

    def pause(self) -> None:
        """Pause at the end of the step, or go on."""
        from tankrig.run.state import RunState

        if self.status.run_state in (RunState.PAUSED, RunState.PAUSING):
            self.host.resume()
        else:
            self.host.pause()

    def stop(self) -> None:
        """Stop the doser at once."""
        self.host.stop()
        self.notices.say_stopped()

    def began(self, path: Path, sequence: "Sequence", before: "tuple[Event, ...]") -> None:
        """A run has begun, or goes on with what its journal holds already."""
        self.notices.forget_last_run()
        self.compare.read_anew(path)
        self.on_screen.begin(path, [task.label for task in sequence.tasks], before, sequence.sheet_ends)
        self.sequence.show_run()
        self.show_page(self.sequence)
        _log.info("the run is recorded in %s", path)

    def ended(self, outcome: "Outcome") -> None:
        """A run is over."""
        path = outcome.path
        self.compare.read_anew(path)
        self.runs.refresh()
        if self.live.regions.drawn and self.on_screen.source.run == path:
            self.regions.count()
        self.notices.say_ended(outcome, partial(self.runs.report, path), partial(self.resume, path))

    def offer_to_fit(self, path: Path, missing: str) -> None:
        """A run is over that was not fitted to its end."""

        def show() -> None:
            self.show_run(path)
            self.show_page(self.runs)

        self.notices.say_unfitted(path, missing, show)

    def show_run(self, path: Path) -> None:
        """Show a recorded run in the same views."""
        if self.status.busy:
            self.notices.tell("a run goes on in the live view; open another when it has ended", NOT_NOW)
        else:
            self.on_screen.open(path)
            self.remember(path)

    def _show_source(self, shown: "Shown") -> None:
        """Have every page draw this source, or nothing, before anything else happens."""
        replay, self._replay = self._replay, None
        if replay is not None:
            replay.close()
        self.runs.bar.set_replay(None)
        self.host.look_away(shown.source.recorded is not None)
        for page in (self.live, self.fit, self.separation, self.sequence, self.compare, self.regions):
            page.show_source(shown)
        for frame in (self.live_frame, *self._frames):
            frame.show_source(shown.source)
        if shown.source.recorded is None:
            if self.rig is not None:
                self.live.set_bench(self.rig.bench)
        elif shown.reading is not None:
            self._play(shown)
        else:
            shown.read.connect(lambda: self._play(shown))

    def _name_source(self, source: "Source") -> None:
        """Say anew above everything whose it is."""
        pages = self.sequence.run_frame, self.runs.frame, self.compare.frame
        for frame in (self.live_frame, *self._frames, *pages):
            frame.show_source(source)

    def _play(self, shown: "Shown") -> None:
        """The frames of a run that has been read."""
        from ui.window.replay import Replay

        if shown is not self.on_screen.shown or shown.reading is None or self._replay is not None:
            return
        self.live.set_bench(shown.reading.bench)
        self._replay = Replay(shown.reading.run, self.host.frames.put)
        self.runs.bar.set_replay(self._replay)

    def _offer_refit(self, source: "Source") -> None:
        """A refit has come while something else was on screen."""
        self.notices.say_refitted(source, partial(self._show_refit, source))

    def _show_refit(self, source: "Source") -> None:
        if self.status.busy:
            self.notices.tell("a run goes on in the live view; look at a refit when it has ended", NOT_NOW)
        else:
            self.on_screen.show_refit(source)
            self.show_page(self.fit)

    # -- the window ----------------------------------------------------------------------------------------------------

    def _follow_sequence(self) -> None:
        self.notices.follow_sequence(self.sequence.document.problem)

    def show_fresh_water(self) -> None:
        """Bring the button for a tank that was filled anew to the front."""
        self.show_page(self.doser)
        self.doser.show_fresh_water()

    def offer_text(self, text: str) -> None:
        """A sequence was opened over edits that no file has: offer them back."""
        self.notices.say_unsaved(partial(self.sequence.edit_unsaved, text))

    def show_page(self, page: QWidget) -> None:
        """Bring a page to the front."""
        self.docks.show(page)

    def show_regions(self) -> None:
        """Bring the regions to the front, with one to begin with."""
        self.show_page(self.regions)
        if not self.live.regions.drawn:
            self.regions.add()

    def separate(self) -> None:
        """Append a step that separates orders of scattering, and show its form."""
        self.show_page(self.sequence)
        self.sequence.append_separation()

    def set_theme(self, name: str) -> None:
        """Dark or light."""
        theme.apply(name)
        theme.paint_plots(self)
        self._settings.setValue("theme", name)

    def ask_to_close(self) -> None:
        """Close the window; while something moves, a person is asked first, and what goes on goes on meanwhile."""
        if not self.host.in_motion:
            self.close()
            return
        question = QMessageBox(self)
        question.setIcon(QMessageBox.Icon.Question)
        question.setWindowTitle("Close the window?")
        question.setText("A run, a dose or a calibration goes on. Closing the window stops it; a run can be resumed.")
        end = question.addButton("Stop it and close", QMessageBox.ButtonRole.DestructiveRole)
        stay = question.addButton("Stay", QMessageBox.ButtonRole.RejectRole)
        question.setDefaultButton(stay)
        question.setEscapeButton(stay)
        question.setModal(False)
        question.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        end.clicked.connect(self.close)
        self.question = question
        question.show()

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802 - Qt's name
        """Pages keep their share of the width."""
        super().resizeEvent(event)
        self.docks.window_resized()

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802 - Qt's name
        """Stop, end the run, let go of everything; the window stays, and answers, until that is done."""
        if self._ending is None and event.spontaneous() and self.host.in_motion and not _session_ends():
            event.ignore()  # the window's own cross: a person's slip must not end a run
            self.ask_to_close()
            return
        if self._ending is None:
            if self.status.running:
                self.host.stop()
                self.notices.say_window_closes()
            if self._replay is not None:
                self._replay.close()
            self._ending = OwnedThread("end", lambda _: self.host.close(), END_S)
        if self._ending.alive:
            QTimer.singleShot(20, self.close)
            event.ignore()
            return
        self._settings.setValue("layout", self.saveState(LAYOUT))
        self._settings.setValue("geometry", self.saveGeometry())
        self._pulse.stop()
        self.stop_keys.end()
        self.ring.end()
        self.docks.end()
        self.live.close_view()
        self.background.close()
        if self._reader is not None:
            self._reader.close()
        if self.built:
            self._draft.keep()
            self.log.close_log()
            self._gc_timer.close()
        self._kept_log.close()
        event.accept()

    def _lay_out(self) -> None:
        bar = QToolBar("always there")
        bar.setObjectName("top")
        bar.setMovable(False)
        bar.addWidget(self.top)
        strip = QToolBar("what is told")
        strip.setObjectName("told")
        strip.setMovable(False)
        strip.addWidget(self.banner)
        for one in (bar, strip):
            one.toggleViewAction().setEnabled(False)
            self.addToolBar(one)
            self.addToolBarBreak()
        centre, column = QWidget(), QVBoxLayout()
        column.setContentsMargins(6, 6, 6, 0)
        column.addWidget(self.live_frame, 1)
        centre.setLayout(column)
        self.setCentralWidget(centre)
        self._words, self._held = Elided(1), QLabel()
        self._words.say("opening the rig")
        self.statusBar().addWidget(self._words, 1)
        self.statusBar().addPermanentWidget(WorkStrip(self.background))
        self.statusBar().addPermanentWidget(self._held)
        self.resize(1280, 800)

    def _connect(self) -> None:
        host, queued = self.host, Qt.ConnectionType.QueuedConnection
        host.status_changed.connect(self.follow, queued)
        host.rig_opened.connect(self._opened, queued)
        self.live.camera_asked.connect(host.configure)
        self.top.stop_asked.connect(self.stop)
        self.top.run_asked.connect(self.run)
        self.top.pause_asked.connect(self.pause)
        self.top.theme_asked.connect(self._other_theme)
        self.top.help_asked.connect(self.show_keys)

    def ask_for_rig(self) -> None:
        """Ask for a rig file, and work with that rig from then on."""
        ask_for_file(self, "Open a rig file", Path.cwd(), "Rig files (*.toml)", self.use_rig)

    def use_rig(self, file: Path) -> None:
        """Work with another rig."""
        if self.host.in_motion:
            self.notices.tell("a run or a dose goes on; wait for its end or stop it, then open another rig", NOT_NOW)
            return
        source = RigSource(file, self.folder / "simulated.rig")
        self.host.use(source)
        self.top.use_rig(file.stem, simulated=False)
        self.calibration.use_rig(source)
        self._offered, self.rig = False, None
        self.remember(file)
        self.show_page(self.calibration)

    def show_palette(self) -> None:
        """Every action by its name, and the files that were open lately."""
        actions = [Action(key.what, " or ".join(key.keys), self._actions[key.name]) for key in KEYS
                   if key.name in self._actions]  # fmt: skip
        actions.append(Action(BY_NAME["stop"].what, "F12", self.stop))
        actions.append(Action("open a rig file", "", self.ask_for_rig))
        actions += [
            Action("open a scene and predict its picture", "", self.ask_for_scene),
            Action("copy what is on screen as Python", "", self.saving.copy_as_python),
            Action("save this frame, its counts as they are", "", self.saving.save_frame),
            Action("save what the page in front shows as a figure", "", self.saving.save_figure),
            Action("copy what the page in front shows as a picture", "", self.saving.copy_figure),
        ]
        actions += actions_of("Camera", self.live, self.live.setFocus)
        for title, page in self.docks.pages():
            actions += actions_of(title, page, partial(self.show_page, page))
        actions += [Action(f"open {path}", "", partial(self.open_path, path)) for path in self.recent.still_there()]
        self._palette = Palette(self, actions)
        self._palette.show()
        self._palette.field.setFocus()

    def open_path(self, path: Path) -> None:
        """Open a run, a sequence or a rig file."""
        kind = kind_of(path)
        if kind is Dropped.RUN:
            self.show_run(path)
        elif kind is Dropped.SEQUENCE:
            self.sequence.load(path)
            self.show_page(self.sequence)
        elif kind is Dropped.RIG:
            self.use_rig(path)
        elif kind is Dropped.SCENE:
            self.open_scene(path)
        else:
            self.notices.tell(
                f"{path}: is no run, no sequence, no rig file and no scene, so that there is nothing to open"
            )

    def open_scene(self, path: Path) -> None:
        """Predict the picture of a scene, in a window of its own."""
        from tankrig.scene import load_scene
        from ui.window.scene_window import SceneWindow

        try:
            scene = load_scene(path)
        except TankrigError as error:
            self.notices.tell(str(error))
            return
        self.scene = SceneWindow(self, path, scene, self.background)
        self.scene.show()
        theme.paint_plots(self.scene)
        self.remember(path)

    def ask_for_scene(self) -> None:
        """Ask for a scene file and predict its picture."""
        ask_for_file(self, "Open a scene", Path.cwd(), "Scenes (*.toml)", self.open_scene)

    def remember(self, path: Path) -> None:
        """List this among what was open lately, first."""
        self.recent.remember(path)
        self.sequence.list_recent(self.recent.still_there())

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:  # noqa: N802 - Qt's name
        """A file or folder may be dropped."""
        if self.built and event.mimeData().hasUrls():
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:  # noqa: N802 - Qt's name
        """Open what was dropped."""
        for url in event.mimeData().urls()[:1]:
            self.open_path(Path(url.toLocalFile()))
        event.acceptProposedAction()

    def use_screen(self, identity: dict[str, str]) -> None:
        """Have this screen for the projector."""
        try:
            self.host.source.choose_screen(identity)
        except TankrigError as error:
            self.notices.tell(str(error))
        else:
            self.host.reopen()

    def _other_theme(self) -> None:
        self.set_theme("light" if theme.current().name == "dark" else "dark")

    def show_keys(self) -> None:
        """List the keys."""
        self._card = KeyCard(self)
        self._card.show()

    def make_keys(self, actions: Mapping[str, Callable[[], object]]) -> None:
        """Have keys, by their names in `keys`, do something."""
        self._actions |= actions
        for name, do in actions.items():
            for keys in BY_NAME[name].keys:
                shortcut = QShortcut(QKeySequence(keys), self)
                shortcut.setContext(Qt.ShortcutContext.ApplicationShortcut)
                shortcut.activated.connect(do)

    def _full_screen(self) -> None:
        self.setWindowState(self.windowState() ^ Qt.WindowState.WindowFullScreen)

    def _restore(self) -> None:
        self.set_theme(str(self._settings.value("theme") or theme.of_system()))
        self.docks.reset()
        geometry, layout = self._settings.value("geometry"), self._settings.value("layout")
        if geometry is not None:
            self.restoreGeometry(geometry)
        if layout is not None:
            self.restoreState(layout, LAYOUT)


def _session_ends() -> bool:
    """Whether the desktop is being left, which asks nobody."""
    app = QGuiApplication.instance()
    return isinstance(app, QGuiApplication) and app.isSavingSession()

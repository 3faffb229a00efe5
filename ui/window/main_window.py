"""The window: the live view, the pages in docks around it, and what ties them to the rig."""

import logging
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSettings, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import QLabel, QMainWindow, QToolBar, QVBoxLayout, QWidget

from tankrig.errors import TankrigError
from tankrig.run.state import FinishReason
from ui.window import theme
from ui.window.background import Background
from ui.window.banner import Banner
from ui.window.docks import Docks
from ui.window.furnishing import pages
from ui.window.gap import GapMonitor
from ui.window.garbage import GarbageTimer
from ui.window.keys import BY_NAME, KeyCard
from ui.window.live_view import LiveView
from ui.window.rig_host import RigHost
from ui.window.rig_parts import RunOrder, import_ahead
from ui.window.status import RigState, RigStatus
from ui.window.threads import OwnedThread
from ui.window.top_bar import TopBar
from ui.window.words import volume

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.run.reading import Run
    from tankrig.run.runner import Outcome
    from ui.window.calibration_page import CalibrationPage
    from ui.window.doser_page import DoserPage
    from ui.window.fit_page import FitPage
    from ui.window.log_panel import LogPanel
    from ui.window.projector_page import ProjectorPage
    from ui.window.replay import Replay
    from ui.window.runs_page import RunsPage
    from ui.window.sequence_page import SequencePage

_log = logging.getLogger(__name__)

LAYOUT = 1
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
    """

    sequence: "SequencePage"
    fit: "FitPage"
    doser: "DoserPage"
    projector: "ProjectorPage"
    runs: "RunsPage"
    calibration: "CalibrationPage"
    log: "LogPanel"

    def __init__(self, host: RigHost, runs: Path, settings: QSettings, sequence: Path | None = None) -> None:
        super().__init__()
        self.setObjectName("tankrig")
        self.setWindowTitle("tankrig")
        self._settings, self.folder, self._first_sequence = settings, runs, sequence
        self.status = RigStatus()
        self.gaps, self.background, self.host = GapMonitor(), Background(), host
        self._replay: Replay | None = None
        self._rig: RigFile | None = None
        self._ending: OwnedThread | None = None
        self._offered = self.furnished = False
        self._asked: str | None = None
        self.top, self.banner, self.live = TopBar("rig", host.source.simulated), Banner(), LiveView(host.frames)
        self.docks = Docks(self)
        self._lay_out()
        self._connect()
        self.make_keys(
            {"stop": self.stop, "help": self.show_keys, "quit": self.close, "theme": self._other_theme,
             "full-screen": self._full_screen, "layout": self.docks.reset}
        )  # fmt: skip
        self._restore()
        host.tell_rig()  # it may have been opened meanwhile
        self.live.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.live.setFocus()
        self._pulse = QTimer(self)
        self._pulse.timeout.connect(host.window_alive)
        self._pulse.start(1000)
        self._furnishing = self._furnished_in_turn()
        self.live.first_shown.connect(self._furnish_soon)
        QTimer.singleShot(PICTURE_MS, self._go_on_furnishing)

    # -- the pages -----------------------------------------------------------------------------------------------------

    def furnish(self) -> None:
        """Make the pages that are not there yet, now."""
        for _ in self._furnishing:
            pass

    def _go_on_furnishing(self) -> None:
        """One page at a time, and in between whatever else there is to do."""
        if self._ending is None and next(self._furnishing, None):
            self._furnish_soon()

    def _furnish_soon(self) -> None:
        QTimer.singleShot(BREATH_MS, self._go_on_furnishing)

    def _furnished_in_turn(self) -> Iterator[bool]:
        for made in pages(self.folder, self.background, self.host.source):
            for name, title, page in made:
                setattr(self, name, page)
                self.docks.put(title, page)
            yield True
        self._connect_pages()
        self._begin_with_pages()

    def _connect_pages(self) -> None:
        host, queued = self.host, Qt.ConnectionType.QueuedConnection
        for signal, slot in (
            (host.run_began, self.began), (host.run_ended, self.ended), (host.event_recorded, self.sequence.see),
            (host.fitted, self.fit.add), (host.pattern_shown, self.projector.shown),
        ):  # fmt: skip
            signal.connect(slot, queued)
        self.projector.show_asked.connect(host.show)
        self.projector.screen_asked.connect(self.use_screen)
        self.doser.dose_asked.connect(host.dose_to)
        self.doser.resolve_asked.connect(host.resolve)
        self.doser.clear_asked.connect(host.clear_stop)
        self.doser.refill_asked.connect(host.refill)
        self.doser.give_up_asked.connect(host.reopen)
        self.calibration.reopen_asked.connect(host.reopen)
        self.calibration.wizard.lend_asked.connect(host.lend)
        self.fit.gain_found.connect(self.take_gain)
        self.sequence.run_asked.connect(self.run)
        self.sequence.dropped.connect(self.offer_text)
        self.runs.resume_asked.connect(self.resume)
        self.runs.opened.connect(self.show_run)
        self.runs.refitted.connect(self.fit.show_fits)
        self.runs.bar.left.connect(self.leave_replay)
        for teller in (self.sequence.told, self.runs.told, self.calibration.told):
            teller.connect(self.tell)
        undo, pages = self.sequence.document.undo, (
            self.sequence, self.fit, self.doser, self.projector, self.runs, self.calibration, self.log
        )  # fmt: skip
        self.make_keys(
            {"run": self.run, "pause": self.pause, "dry-run": self.sequence.dry_run,
             "open": self.sequence.open_file, "save": self.sequence.save, "undo": undo.undo, "redo": undo.redo}
            | {f"page-{number}": partial(self.show_page, page) for number, page in enumerate(pages, 1)}
        )  # fmt: skip

    def _begin_with_pages(self) -> None:
        """All pages are there: tell them what is known."""
        self.furnished = True
        self._opened(self._rig, afresh=True)
        self._follow(self.status)
        theme.paint_plots(self)
        last = self._first_sequence or self._settings.value("sequence")
        if last and (self._first_sequence or Path(str(last)).is_file()):
            self.sequence.load(Path(str(last)))
        draft = self._settings.value("draft")
        if draft and not self._first_sequence:  # what was typed and not saved when the window was closed
            self.sequence.document.edit_text(str(draft))
        self._garbage = GarbageTimer(lambda: not self.status.running)
        OwnedThread("import-ahead", lambda _: import_ahead(), END_S)

    # -- the rig -------------------------------------------------------------------------------------------------------

    def _opened(self, rig: "RigFile | None", afresh: bool = False) -> None:
        if rig is None:
            return
        new, self._rig = afresh or rig != self._rig, rig
        self.live.set_bench(rig.bench)
        if not self.host.source.simulated:
            self.top.name_rig(rig.name)
        if not self.furnished:
            return
        self.calibration.set_rig(rig)
        if new:
            for page in (self.sequence.document, self.doser, self.projector):
                page.set_rig(rig)
            self.sequence.patterns.set_wall(rig.bench.wall)
        if not self._offered:
            self._offered = True
            self._offer_resume(rig.name)

    def _offer_resume(self, rig: str) -> None:
        """After a crash, or an abort, say so where the person looks first."""
        run = self.runs.latest_interrupted(rig)
        if run is not None:
            why = f" ({run.message})" if run.message else ""
            words = f"The last run, {run.path.name}, was {run.ending}{why}. What it recorded is safe; it can go on."
            self.banner.say(words, action="Resume it", do=lambda: self.resume(run.path))

    def _follow(self, status: RigStatus) -> None:
        before, self.status = self.status, status
        self._words.setText(status.words)
        self._held.setText("" if status.tank is None else f"{volume(status.tank.volume_ul)} of ink in the tank")
        self.live.set_camera(self.host.camera_settings, status.state is RigState.IDLE)
        if status.trouble and status.trouble != before.trouble:
            again = status.state is RigState.FAILED
            self.banner.say(status.trouble, "bad", "Open the rig again" if again else "", self.host.reopen)
        if status.state is RigState.FAILED:
            self.live.say_empty("no picture: the rig cannot be used; the line above says why")
        if not self.furnished:
            if status.state in (RigState.FAILED, RigState.ASKING):  # no picture will come
                self.furnish()
            return
        for page in (self.sequence, self.doser, self.projector, self.calibration):
            page.follow(status)
        self.top.follow(status, self.sequence.document.plan is not None)
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
            self.tell(problem.sentence if problem else "the rig is not ready; wait until it is, then run")
        elif self.status.busy:
            self.tell("a run or a dose goes on; wait for its end or stop it, then run")
        else:
            self.leave_replay()
            path = self.folder / datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
            self.host.start_run(RunOrder(path, sequence))

    def resume(self, path: Path) -> None:
        """Go on with an interrupted run."""
        if self.status.busy:
            self.tell("a run or a dose goes on; wait for its end or stop it, then resume")
        else:
            self.leave_replay()
            self.host.start_run(RunOrder(path))

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
        self.banner.say("STOP: the doser is stopped; a run that went on is being aborted and can be resumed.", "bad")

    def began(self, path: Path, sequence: object) -> None:
        """A run has begun."""
        self.banner.hide()
        self.sequence.begin(sequence)  # type: ignore[arg-type]
        self.fit.begin(f"No fit yet of {path.name}. Fits come by themselves from the first dose of ink.")
        self.show_page(self.sequence)
        _log.info("the run is recorded in %s", path)

    def ended(self, outcome: "Outcome") -> None:
        """A run is over."""
        name = outcome.path.name
        if outcome.error is not None:
            words, level = f"The run {name} {outcome.reason.value}: {outcome.error}", "bad"
        else:
            words, level = (
                f"The run {name} was {outcome.reason.value}.",
                "good" if outcome.reason is FinishReason.COMPLETED else "",
            )
        _log.info("%s", words)
        self.sequence.run_list.end(words)
        self.runs.refresh()
        done = outcome.reason is FinishReason.COMPLETED
        if done:
            self.banner.say(words, level, "Write its report", self.runs.report)
        else:
            words += " What it recorded is safe."
            self.banner.say(words, level, "Resume it", lambda: self.resume(outcome.path))

    # -- replay --------------------------------------------------------------------------------------------------------

    def show_run(self, run: "Run") -> None:
        """Show a recorded run in the same views."""
        from tankrig.live.exposures import PhotographPlan
        from ui.window.replay import Replay

        if self.status.busy:
            self.tell("a run goes on in the live view; open another when it has ended")
            return
        self.leave_replay()
        self.live.set_bench(PhotographPlan.of_run(run).bench)
        self._replay = Replay(run, self.host.frames.put)
        self.host.look_away(True)
        self.runs.bar.set_replay(self._replay)
        self.fit.show_run(run.path)

    def leave_replay(self) -> None:
        """Back to the camera."""
        replay, self._replay = self._replay, None
        if replay is not None:
            replay.close()
            self.runs.bar.set_replay(None)
            self.host.look_away(False)
            self.host.tell_rig()

    # -- the window ----------------------------------------------------------------------------------------------------

    def tell(self, sentence: str) -> None:
        """Say something that a person has to know."""
        _log.warning("%s", sentence)
        self.banner.say(sentence[:1].upper() + sentence[1:])

    def offer_text(self, text: str) -> None:
        """A sequence was opened over edits that no file has: offer them back."""
        words = "The sequence that was being edited had not been saved."
        self.banner.say(words, action="Edit it again", do=lambda: self.sequence.edit_unsaved(text))

    def show_page(self, page: QWidget) -> None:
        """Bring a page to the front."""
        self.docks.show(page)

    def set_theme(self, name: str) -> None:
        """Dark or light."""
        theme.apply(name)
        theme.paint_plots(self)
        self._settings.setValue("theme", name)

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802 - Qt's name
        """Stop, end the run, let go of everything; the window stays, and answers, until that is done."""
        if self._ending is None:
            if self.status.running:
                self.host.stop()
                self.banner.say("The run is being ended; the window closes when all it recorded is safe.", "bad")
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
        self.live.close_view()
        self.background.close()
        if self.furnished:
            document = self.sequence.document
            self._settings.setValue("sequence", str(document.path or ""))
            self._settings.setValue("draft", document.text if document.unsaved else "")
            self.log.close_log()
            self._garbage.close()
        event.accept()

    def _lay_out(self) -> None:
        bar = QToolBar("always there")
        bar.setObjectName("top")
        bar.setMovable(False)
        bar.addWidget(self.top)
        bar.toggleViewAction().setEnabled(False)
        self.addToolBar(bar)
        centre, column = QWidget(), QVBoxLayout()
        column.setContentsMargins(6, 6, 6, 0)
        column.addWidget(self.banner)
        column.addWidget(self.live, 1)
        centre.setLayout(column)
        self.setCentralWidget(centre)
        self._words, self._held = QLabel("opening the rig"), QLabel()
        self.statusBar().addWidget(self._words, 1)
        self.statusBar().addPermanentWidget(self._held)
        self.resize(1280, 800)

    def _connect(self) -> None:
        host, queued = self.host, Qt.ConnectionType.QueuedConnection
        host.status_changed.connect(self._follow, queued)
        host.rig_opened.connect(self._opened, queued)
        self.live.camera_asked.connect(host.configure)
        self.top.stop_asked.connect(self.stop)
        self.top.run_asked.connect(self.run)
        self.top.pause_asked.connect(self.pause)
        self.top.theme_asked.connect(self._other_theme)
        self.top.help_asked.connect(self.show_keys)

    def use_screen(self, identity: dict[str, str]) -> None:
        """Have this screen for the projector."""
        try:
            self.host.source.choose_screen(identity)
        except TankrigError as error:
            self.tell(str(error))
        else:
            self.host.reopen()

    def take_gain(self, gain: float) -> None:
        """What a fit has found counts to be."""
        self.live.radiometry.gain = gain

    def _other_theme(self) -> None:
        self.set_theme("light" if theme.current().name == "dark" else "dark")

    def show_keys(self) -> None:
        """List the keys."""
        self._card = KeyCard(self)
        self._card.show()

    def make_keys(self, actions: Mapping[str, Callable[[], object]]) -> None:
        """Have keys, by their names in `keys`, do something."""
        for name, do in actions.items():
            for keys in BY_NAME[name].keys:
                shortcut = QShortcut(QKeySequence(keys), self)
                everywhere = Qt.ShortcutContext.ApplicationShortcut
                shortcut.setContext(Qt.ShortcutContext.WindowShortcut if keys == "Esc" else everywhere)
                shortcut.setAutoRepeat(name != "stop")
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

"""The window: the live view, the pages in docks around it, and what ties them to the rig."""

import logging
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSettings, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import QDockWidget, QLabel, QMainWindow, QScrollArea, QTabWidget, QToolBar, QVBoxLayout, QWidget

from tankrig.errors import TankrigError
from ui.window import theme
from ui.window.background import Background
from ui.window.banner import Banner
from ui.window.calibration_page import CalibrationPage
from ui.window.doser_page import DoserPage
from ui.window.fit_page import FitPage
from ui.window.gap import GapMonitor
from ui.window.garbage import GarbageTimer
from ui.window.keys import BY_NAME, KeyCard
from ui.window.live_view import LiveView
from ui.window.log_panel import LogPanel
from ui.window.projector_page import ProjectorPage
from ui.window.replay import Replay
from ui.window.rig_host import RigHost, RunOrder
from ui.window.runs_page import RunsPage
from ui.window.sequence_page import SequencePage
from ui.window.status import RigState, RigStatus
from ui.window.top_bar import TopBar
from ui.window.words import volume

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.run.reading import Run
    from tankrig.run.runner import Outcome

_log = logging.getLogger(__name__)

LAYOUT = 1
"""Raised when docks are added, so that an old layout is not restored."""


class MainWindow(QMainWindow):
    """One window on one rig.

    Parameters
    ----------
    host
        Of the rig; closed with the window.
    runs
        Folder of the runs.
    settings
        Remembers docks, theme and the last sequence.
    """

    def __init__(self, host: RigHost, runs: Path, settings: QSettings) -> None:
        super().__init__()
        self.setObjectName("tankrig")
        self.setWindowTitle("tankrig")
        self._settings, self._runs = settings, runs
        self.status = RigStatus()
        self.gaps, self.background, self.host = GapMonitor(), Background(), host
        source = host.source
        self._replay: Replay | None = None
        self._closing = self._offered = False
        self.top, self.banner = TopBar("rig", source.simulated), Banner()
        self.live, self.sequence, self.fit = LiveView(self.host.frames), SequencePage(), FitPage(self.background)
        self.doser, self.projector = DoserPage(), ProjectorPage()
        self.runs, self.calibration = RunsPage(runs, self.background), CalibrationPage(source)
        self.log = LogPanel()
        self._lay_out()
        self._connect()
        self._make_keys()
        self._restore()
        self._garbage = GarbageTimer()
        host.tell_rig()  # it may have been opened meanwhile
        self.live.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.live.setFocus()
        self._pulse = QTimer(self)
        self._pulse.timeout.connect(self.host.window_alive)
        self._pulse.start(1000)

    # -- the rig -------------------------------------------------------------------------------------------------------

    def _opened(self, rig: "RigFile") -> None:
        self.live.set_bench(rig.bench)
        for page in (self.sequence.document, self.doser, self.projector, self.calibration):
            page.set_rig(rig)
        self.sequence.patterns.set_wall(rig.bench.wall)
        if not self.host.source.simulated:
            self.top.name_rig(rig.name)
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
        held = "" if status.tank is None else f"{volume(status.tank.volume_ul)} of ink in the tank"
        self._held.setText(held)
        for page in (self.sequence, self.doser, self.projector, self.calibration):
            page.follow(status)
        self.top.follow(status, self.sequence.document.plan is not None)
        self.runs.set_busy(status.busy)
        self.live.set_camera(self.host.camera_settings, status.state is RigState.IDLE)
        if status.trouble and status.trouble != before.trouble:
            again = status.state is RigState.FAILED
            self.banner.say(status.trouble, "bad", "Open the rig again" if again else "", self.host.reopen)
        if status.undecided is not None and before.undecided is None:
            self.show_page(self.doser)
        if status.state is RigState.FAILED:
            self.live.say_empty("no picture: the rig cannot be used; the line above says why")

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
            self._leave_replay()
            path = self._runs / datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
            self.host.start_run(RunOrder(path, sequence))

    def resume(self, path: Path) -> None:
        """Go on with an interrupted run."""
        if self.status.busy:
            self.tell("a run or a dose goes on; wait for its end or stop it, then resume")
        else:
            self._leave_replay()
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

    def _began(self, path: Path, sequence: object) -> None:
        self.banner.hide()
        self.sequence.begin(sequence)  # type: ignore[arg-type]
        self.fit.begin(f"No fit yet of {path.name}. Fits come by themselves from the first dose of ink.")
        self.show_page(self.sequence)
        _log.info("the run is recorded in %s", path)

    def _ended(self, outcome: "Outcome") -> None:
        name = outcome.path.name
        if outcome.error is not None:
            words, level = f"The run {name} {outcome.reason.value}: {outcome.error}", "bad"
        else:
            words, level = (
                f"The run {name} was {outcome.reason.value}.",
                "good" if outcome.reason.value == "completed" else "",
            )
        _log.info("%s", words)
        self.sequence.run_list.end(words)
        self.runs.refresh()
        done = outcome.reason.value == "completed"
        if done:
            self.banner.say(words, level, "Write its report", self.runs.report)
        else:
            words += " What it recorded is safe."
            self.banner.say(words, level, "Resume it", lambda: self.resume(outcome.path))

    # -- replay --------------------------------------------------------------------------------------------------------

    def show_run(self, run: "Run") -> None:
        """Show a recorded run in the same views."""
        from tankrig.live.exposures import Plan

        if self.status.busy:
            self.tell("a run goes on in the live view; open another when it has ended")
            return
        self._leave_replay()
        self.live.set_bench(Plan.of_run(run).bench)
        self._replay = Replay(run, self.host.frames.put)
        self.host.look_away(True)
        self.runs.bar.set_replay(self._replay)
        self.fit.show_run(run.path)

    def _leave_replay(self) -> None:
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

    def show_page(self, page: QWidget) -> None:
        """Bring a page to the front."""
        dock = self.docks[page]
        dock.show()
        dock.raise_()

    def set_theme(self, name: str) -> None:
        """Dark or light."""
        theme.apply(name)
        theme.paint_plots(self)
        self._settings.setValue("theme", name)

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802 - Qt's name
        """Stop, end the run, let go of everything; the window stays until that is done."""
        if self.status.running and not self._closing:
            self._closing = True
            self.host.stop()
            self.banner.say("The run is being ended; the window closes when all it recorded is safe.", "bad")
            QTimer.singleShot(100, self._close_when_ended)
            event.ignore()
            return
        if self.status.running:
            event.ignore()
            return
        self._leave_replay()
        self._settings.setValue("layout", self.saveState(LAYOUT))
        self._settings.setValue("geometry", self.saveGeometry())
        if self.sequence.document.path:
            self._settings.setValue("sequence", str(self.sequence.document.path))
        self._pulse.stop()
        self.host.close()
        self.background.close()
        self.log.close_log()
        self._garbage.close()
        event.accept()

    def _close_when_ended(self) -> None:
        if self.status.running:
            QTimer.singleShot(100, self._close_when_ended)
        else:
            self.close()

    def reset_layout(self) -> None:
        """All docks where they were at first."""
        first, size = next(iter(self.docks.values())), self.size()
        for dock in self.docks.values():
            dock.setFloating(False)
            self.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, dock)
            if dock is not first:
                self.tabifyDockWidget(first, dock)
            dock.show()
        self.resize(size)
        self.resizeDocks([first], [int(self.width() * 0.54)], Qt.Orientation.Horizontal)
        first.raise_()

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
        self.setDockOptions(QMainWindow.DockOption.AllowTabbedDocks | QMainWindow.DockOption.AnimatedDocks |
                            QMainWindow.DockOption.AllowNestedDocks)  # fmt: skip
        self.setTabPosition(Qt.DockWidgetArea.RightDockWidgetArea, QTabWidget.TabPosition.North)
        self.docks: dict[QWidget, QDockWidget] = {}
        pages: dict[str, QWidget] = {
            "Sequence": self.sequence, "Fit": self.fit, "Doser": self.doser, "Projector": self.projector,
            "Runs": self.runs, "Calibration": self.calibration, "Log": self.log,
        }  # fmt: skip
        for title, page in pages.items():
            dock = QDockWidget(title)
            dock.setObjectName(title)
            dock.setWidget(_scrolled(page))
            self.docks[page] = dock
        self._words, self._held = QLabel("opening the rig"), QLabel()
        self.statusBar().addWidget(self._words, 1)
        self.statusBar().addPermanentWidget(self._held)
        self.resize(1280, 800)

    def _connect(self) -> None:
        host, queued = self.host, Qt.ConnectionType.QueuedConnection
        for signal, slot in (
            (host.status_changed, self._follow), (host.rig_opened, self._opened), (host.run_began, self._began),
            (host.run_ended, self._ended), (host.event_recorded, self.sequence.see), (host.fitted, self.fit.add),
            (host.pattern_shown, self.projector.shown),
        ):  # fmt: skip
            signal.connect(slot, queued)
        self.live.camera_asked.connect(host.configure)
        self.projector.show_asked.connect(host.show)
        self.projector.screen_asked.connect(self._use_screen)
        self.doser.dose_asked.connect(host.dose_to)
        self.doser.resolve_asked.connect(host.resolve)
        self.doser.clear_asked.connect(host.clear_stop)
        self.doser.refill_asked.connect(host.refill)
        self.doser.give_up_asked.connect(host.reopen)
        self.calibration.reopen_asked.connect(host.reopen)
        self.fit.gain_found.connect(self._take_gain)
        self.sequence.run_asked.connect(self.run)
        self.runs.resume_asked.connect(self.resume)
        self.runs.opened.connect(self.show_run)
        self.runs.refitted.connect(self.fit.show_tables)
        self.runs.bar.left.connect(self._leave_replay)
        for teller in (self.sequence.told, self.runs.told, self.calibration.told):
            teller.connect(self.tell)
        self.top.stop_asked.connect(self.stop)
        self.top.run_asked.connect(self.run)
        self.top.pause_asked.connect(self.pause)
        self.top.theme_asked.connect(self._other_theme)
        self.top.help_asked.connect(self.show_keys)

    def _use_screen(self, identity: dict[str, str]) -> None:
        try:
            self.host.source.choose_screen(identity)
        except TankrigError as error:
            self.tell(str(error))
        else:
            self.host.reopen()

    def _take_gain(self, gain: float) -> None:
        self.live.radiometry.gain = gain

    def _other_theme(self) -> None:
        self.set_theme("light" if theme.current().name == "dark" else "dark")

    def show_keys(self) -> None:
        """List the keys."""
        self._card = KeyCard(self)
        self._card.show()

    def _make_keys(self) -> None:
        undo = self.sequence.document.undo
        actions: dict[str, Callable[[], object]] = {
            "stop": self.stop, "run": self.run, "pause": self.pause, "dry-run": self.sequence.dry_run,
            "open": self.sequence.open_file, "save": self.sequence.save, "undo": undo.undo, "redo": undo.redo,
            "theme": self._other_theme, "full-screen": self._full_screen, "help": self.show_keys, "quit": self.close,
        }  # fmt: skip
        pages = {f"page-{number}": page for number, page in enumerate(self.docks, 1)}
        actions |= {name: partial(self.show_page, page) for name, page in pages.items()}
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
        self.reset_layout()
        geometry, layout = self._settings.value("geometry"), self._settings.value("layout")
        if geometry is not None:
            self.restoreGeometry(geometry)
        if layout is not None:
            self.restoreState(layout, LAYOUT)
        last = self._settings.value("sequence")
        if last and Path(str(last)).is_file():
            self.sequence.load(Path(str(last)))


def _scrolled(page: QWidget) -> QScrollArea:
    """A page that small screens scroll."""
    area = QScrollArea()
    area.setWidgetResizable(True)
    area.setFrameShape(QScrollArea.Shape.NoFrame)
    area.setWidget(page)
    return area

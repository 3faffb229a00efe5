"""The pages around the live view: made one at a time once a picture is on screen, and tied to window and rig."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt

if TYPE_CHECKING:
    from ui.window.main_window import MainWindow


def furnish(window: "MainWindow") -> Iterator[bool]:
    """Make a window's pages; between two of them it may do something else."""
    from ui.window.sequence_page import SequencePage

    window.sequence = SequencePage()
    window.docks.put("Sequence", window.sequence)
    yield True
    from ui.window.doser_page import DoserPage
    from ui.window.projector_page import ProjectorPage

    window.doser, window.projector = DoserPage(), ProjectorPage()
    window.docks.put("Doser", window.doser)
    window.docks.put("Projector", window.projector)
    yield True
    from ui.window.fit_page import FitPage

    window.fit = FitPage(window.background)
    window.docks.put("Fit", window.fit)
    yield True
    from ui.window.calibration_page import CalibrationPage
    from ui.window.log_panel import LogPanel
    from ui.window.runs_page import RunsPage

    window.runs = RunsPage(window.folder, window.background)
    window.calibration, window.log = CalibrationPage(window.host.source), LogPanel()
    window.docks.put("Runs", window.runs)
    window.docks.put("Calibration", window.calibration)
    window.docks.put("Log", window.log)
    yield True
    _connect(window)
    window.begin_with_pages()


def _connect(window: "MainWindow") -> None:
    host, queued = window.host, Qt.ConnectionType.QueuedConnection
    for signal, slot in (
        (host.run_began, window.began), (host.run_ended, window.ended), (host.event_recorded, window.sequence.see),
        (host.fitted, window.fit.add), (host.pattern_shown, window.projector.shown),
    ):  # fmt: skip
        signal.connect(slot, queued)
    window.projector.show_asked.connect(host.show)
    window.projector.screen_asked.connect(window.use_screen)
    window.doser.dose_asked.connect(host.dose_to)
    window.doser.resolve_asked.connect(host.resolve)
    window.doser.clear_asked.connect(host.clear_stop)
    window.doser.refill_asked.connect(host.refill)
    window.doser.give_up_asked.connect(host.reopen)
    window.calibration.reopen_asked.connect(host.reopen)
    window.calibration.wizard.lend_asked.connect(host.lend)
    window.fit.gain_found.connect(window.take_gain)
    window.sequence.run_asked.connect(window.run)
    window.sequence.dropped.connect(window.offer_text)
    window.runs.resume_asked.connect(window.resume)
    window.runs.opened.connect(window.show_run)
    window.runs.refitted.connect(window.fit.show_tables)
    window.runs.bar.left.connect(window.leave_replay)
    for teller in (window.sequence.told, window.runs.told, window.calibration.told):
        teller.connect(window.tell)
    undo, pages = window.sequence.document.undo, (
        window.sequence, window.fit, window.doser, window.projector, window.runs, window.calibration, window.log
    )  # fmt: skip
    window.make_keys(
        {"run": window.run, "pause": window.pause, "dry-run": window.sequence.dry_run,
         "open": window.sequence.open_file, "save": window.sequence.save, "undo": undo.undo, "redo": undo.redo}
        | {f"page-{number}": partial(window.show_page, page) for number, page in enumerate(pages, 1)}
    )  # fmt: skip

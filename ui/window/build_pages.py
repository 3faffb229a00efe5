"""The pages around the live view, made a few at a time once a picture is on screen."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtWidgets import QWidget

from ui.window.source_frame import SourceFrame

if TYPE_CHECKING:
    from ui.window.live_view import LiveView
    from ui.window.on_screen import OnScreen, Worker
    from ui.window.rig_file import RigSource

Page = tuple[str, str, QWidget, SourceFrame]
"""Name of the window's attribute, title of the dock, the page, and the frame around it."""


def pages(
    folder: Path, on_screen: "OnScreen", background: "Worker", source: "RigSource", live: "LiveView"
) -> Iterator[tuple[Page, ...]]:
    """Make a window's pages; between what this yields it may do something else.

    Parameters
    ----------
    folder
        Of the runs.
    on_screen
        What the window looks at.
    background
        Where the pages have work done.
    source
        Of the rig.
    live
        On whose picture regions are drawn.
    """
    from ui.window.sequence_page import SequencePage

    yield (_of_rig("sequence", "Sequence", SequencePage(source.simulated), "SEQUENCE for"),)
    from ui.window.doser_page import DoserPage
    from ui.window.projector_page import ProjectorPage

    yield _of_rig("doser", "Doser", DoserPage()), _of_rig("projector", "Projector", ProjectorPage())
    from ui.window.fit_page import FitPage

    fit = FitPage()
    yield (("fit", "Fit", fit, SourceFrame(fit)),)
    from ui.window.calibration_page import CalibrationPage
    from ui.window.compare_page import ComparePage
    from ui.window.log_panel import LogPanel
    from ui.window.regions_page import RegionsPage
    from ui.window.runs_page import RunsPage
    from ui.window.separation_page import SeparationPage

    regions = RegionsPage(live.regions, live.profile, on_screen)
    runs, separation = RunsPage(folder, on_screen, background), SeparationPage()
    yield (
        ("separation", "Waves", separation, SourceFrame(separation)),
        _of_rig("runs", "Runs", runs, "RUNS recorded with"),
        _of_rig("compare", "Compare", ComparePage(runs.catalogue, on_screen), "COMPARISON of runs, beside"),
        _of_rig("calibration", "Calibration", CalibrationPage(source)),
        ("regions", "Regions", regions, SourceFrame(regions)),
        _of_rig("log", "Log", LogPanel(), "LOG of this window, with"),
    )


def _of_rig(name: str, title: str, page: QWidget, about: str = "LIVE:") -> Page:
    return name, title, page, SourceFrame(page, about)

"""The pages around the live view, made a few at a time once a picture is on screen."""

from collections.abc import Iterator
from pathlib import Path

from PySide6.QtWidgets import QWidget

from ui.window.background import Background
from ui.window.rig_file import RigSource

Page = tuple[str, str, QWidget]
"""Name of the window's attribute, title of the dock, and the page."""


def pages(folder: Path, background: Background, source: RigSource) -> Iterator[tuple[Page, ...]]:
    """Make a window's pages; between what this yields it may do something else.

    Parameters
    ----------
    folder
        Of the runs.
    background
        Where the pages have work done.
    source
        Of the rig.
    """
    from ui.window.sequence_page import SequencePage

    yield (("sequence", "Sequence", SequencePage()),)
    from ui.window.doser_page import DoserPage
    from ui.window.projector_page import ProjectorPage

    yield ("doser", "Doser", DoserPage()), ("projector", "Projector", ProjectorPage())
    from ui.window.fit_page import FitPage

    yield (("fit", "Fit", FitPage(background)),)
    from ui.window.calibration_page import CalibrationPage
    from ui.window.log_panel import LogPanel
    from ui.window.runs_page import RunsPage

    yield (
        ("runs", "Runs", RunsPage(folder, background)),
        ("calibration", "Calibration", CalibrationPage(source)),
        ("log", "Log", LogPanel()),
    )

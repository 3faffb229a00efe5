"""A picture that is designed beside a live fit: asked for by name, told how far it is, called off, appended, shown."""

import os
import time

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from tankrig.errors import SequenceError
from tankrig.live.exposures import exposures_of
from tankrig.live.refit import refit
from tankrig.live.results import fits_in
from tankrig.run.reading import open_run
from tankrig.sequence.until import Until
from tests import on_page
from tests.window_rig import until, window_on, write_rig
from ui.cli import main
from ui.window import jobs
from ui.window.on_screen import DESIGNING
from ui.window.work_strip import WorkStrip

FIRST = """
name = "first"
exposure_ms = 5.0
steps = [
    { do = "dose", total_ul = 300.0 },
    { do = "wait", seconds = 1.0 },
    { do = "capture", pattern = "full", frames = 4, until = { sigma_s = "0.01 %" } },
    { do = "wait", seconds = 600.0 },
]
"""


def ask_by_name(window) -> None:
    """Without a mouse."""
    palette = on_page.palette_of(window)
    QTest.keyClicks(palette.field, "design a picture")
    assert palette.list.count() == 1
    QTest.keyClick(palette.field, Qt.Key.Key_Return)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_picture_is_designed_while_a_run_goes_on_and_the_next_run_shows_it(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    home = tmp_path_factory.mktemp("live")  # the palette finds files by the words of their paths, too
    (home / "first.toml").write_text(FIRST)
    with window_on(home, write_rig(home)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        window.sequence.load(home / "first.toml")
        until(lambda: window.top.run.isEnabled(), 60.0)
        next_steps = window.compare.next
        assert not next_steps.design.isEnabled(), "nothing is known yet"
        ended = []
        window.host.run_ended.connect(ended.append)
        window.run()
        until(lambda: window.on_screen.shown.designable is not None, 200.0, "no fit came")
        shown, running = window.on_screen.shown, window.on_screen.source.run
        ask_by_name(window)
        assert next_steps.isVisible()
        assert shown.design_says == DESIGNING
        until(lambda: window.background.tasks and window.background.tasks[0].left_s, 120.0, "no time left was told")
        until(lambda: "left" in on_page.words_on(window.findChild(WorkStrip)))
        window.background.cancel(window.background.tasks[0])
        until(lambda: shown.design_says == "cancelled", 60.0)
        assert shown.designed is None
        ask_by_name(window)
        until(lambda: shown.designed is not None, 300.0, "no picture came")
        assert window.status.running, "all this beside the run"
        if folder := os.environ.get("SCREENSHOTS"):
            window.grab().save(f"{folder}/designed.png")
        assert shown.designed.more["until"] == {"sigma_s": "0.01 %"}
        (append,) = next_steps.buttons
        append.setFocus()
        QTest.keyClick(append, Qt.Key.Key_Space)
        document = window.sequence.document
        assert document.reading.table["steps"][-1]["pattern"] == "designed"
        assert "appended" in window.banner.text
        window.stop()
        until(lambda: ended and not window.status.busy, 60.0)
        window.host.clear_stop()
        document.edit_text(document.text.replace("seconds = 600.0", "seconds = 0.1"))
        assert document.problem is None, document.problem
        until(lambda: window.top.run.isEnabled(), 60.0)
        window.run()
        until(lambda: len(ended) == 2 and not window.status.busy, 300.0)
        second = window.on_screen.source.run
        assert second != running
        (fit,) = fits_in([event.fields for event in open_run(second).fits])[0]
        assert set(fit.patterns) == {"full", "designed"}
        assert fit.frames == 8, "until was not reached, so that all frames were taken"


@pytest.fixture(scope="module")
def beginning(tmp_path_factory: pytest.TempPathFactory):
    """A run of one dose, its fit and its photographs."""
    home = tmp_path_factory.mktemp("begun")
    rig, file = write_rig(home), home / "first.toml"
    file.write_text(FIRST.replace("seconds = 600.0", "seconds = 0.1"))
    assert main(["run", str(file), "--rig", str(rig), "--out", str(home / "run"), "--no-fit"]) == 0
    refit(home / "run")
    run = open_run(home / "run")
    (fit,) = fits_in([event.fields for event in run.fits])[0]
    return run, fit, tuple(exposures_of(run).photographs())


def test_the_next_picture_takes_less_than_a_second_once_the_cells_light_is_kept(beginning) -> None:
    """Also after the fit has moved a little, as it does from frame to frame."""
    run, fit, photographs = beginning
    jobs.design(run.path, fit, photographs)
    began = time.process_time()
    again = jobs.design(run.path, fit, photographs)
    assert time.process_time() - began < 1.0
    assert set(again.table) == {"kind", "y_mm", "z_mm", "light"}
    assert again.more["exposure_ms"] == 5.0


def test_an_until_that_is_reached_does_not_keep_the_picture_from_being_shown(
    beginning, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, fit, photographs = beginning
    assert jobs.design(run.path, fit, photographs).frames == 4
    monkeypatch.setattr(Until, "reached", lambda *_: True)
    assert "until" not in jobs.design(run.path, fit, photographs).more


@pytest.mark.parametrize(
    ("heights_mm", "said"),
    [
        ((200.0,), "is not in the tank, which is 120 mm high"),
        ((60.0, 61.0), "overlap"),
        ((20.0, 40.0, 60.0, 80.0), "than the 3"),
    ],
)
def test_heights_that_cannot_be_are_refused_in_a_sentence(beginning, heights_mm: tuple[float, ...], said: str) -> None:
    run, fit, photographs = beginning
    with pytest.raises(SequenceError, match=said):
        jobs.design(run.path, fit, photographs, "all", heights_mm)

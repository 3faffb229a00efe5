"""One experiment, whole, by mouse and keyboard: from a file to a fit, a report and an exported run."""

from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QPushButton

import tankrig
from tests import on_page
from tests.window_rig import until, window_on, write_rig

SEQUENCE = """
name = "two doses"
exposure_ms = 5.0
[patterns.sheet]
kind = "sheet"
y_mm = [-60.0, 60.0]
z_mm = [56.0, 64.0]
[[steps]]
do = "capture"
pattern = "dark"
frames = 2
[[steps]]
do = "series"
total_ul = [300.0, 700.0]
steps = [
    { do = "wait", seconds = 0.3 },
    { do = "capture", pattern = "sheet", frames = 3 },
]
"""


def press(page, words):
    """The button that says so, with the mouse."""
    found = [button for button in page.findChildren(QPushButton) if button.text().startswith(words)]
    QTest.mouseClick(found[0], Qt.MouseButton.LeftButton)


def test_a_whole_experiment_by_mouse_and_keyboard(tmp_path, monkeypatch):
    """If any link between page, runner, store, fit and report is broken, no experiment is done in the window."""
    monkeypatch.setattr("PySide6.QtGui.QDesktopServices.openUrl", lambda _: True)
    (tmp_path / "two.toml").write_text(SEQUENCE)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        ended = []
        window.host.run_ended.connect(ended.append)
        window.sequence.load(tmp_path / "two.toml")
        until(lambda: window.top.run.isEnabled())
        QTest.keyClick(window, Qt.Key.Key_F7)
        assert "700 µl of ink, 8 frames" in window.sequence.plan_list.says
        QTest.keyClick(window, Qt.Key.Key_F5)
        until(lambda: window.status.running)
        QTest.keyClick(window, Qt.Key.Key_F6)
        until(lambda: window.status.words.startswith("paused before step"))
        assert window.top.pause.text().startswith("Go on")
        QTest.mouseClick(window.top.pause, Qt.MouseButton.LeftButton)
        until(lambda: ended, 120.0)
        assert ended[0].reason.value == "completed", ended[0].error
        until(lambda: window.status.state.value == "ready")
        assert window.status.tank.volume_ul == 700.0
        assert window.sequence.run_list.lines()[0].startswith("✓")
        run = tankrig.open_run(ended[0].path)
        assert run.frames.sizes["frame"] == 8
        assert {event.get("fit") for event in run.fits} >= {"dose"}
        shown = window.on_screen.shown
        until(lambda: on_page.dots(window.fit, "g,"), what="no fit came to the Fit page")
        assert shown.newest.gain > 0.0
        until(lambda: shown.comparison is not None, 60.0, "the model's picture did not come")
        assert shown.comparison.rmse["all"] < shown.comparison.rmse["1"]
        window.show_page(window.runs)
        until(lambda: window.runs.catalogue.selected is not None)
        press(window.runs, "Open")
        assert window.on_screen.source.title == f"REPLAY of {ended[0].path.name}"
        until(lambda: "frame 1 of 8: dark" in on_page.words_on(window.runs.bar))
        on_page.choice(window.runs.bar, "how fast frames").setCurrentText("as fast as it goes")
        press(window.runs, "Play")
        until(lambda: "frame 8 of 8: sheet" in on_page.words_on(window.runs.bar))
        press(window.runs, "Back to the camera")
        window.runs.export(ended[0].path, tmp_path / "run.nc")
        window.runs.export(ended[0].path, tmp_path / "run-tiff")
        until(lambda: (tmp_path / "run-tiff" / "000007-sheet.tiff").exists(), 60.0)
        import xarray

        with xarray.open_dataset(tmp_path / "run.nc") as exported:
            assert (exported.frames.values == run.frames.values).all()
            assert exported.pattern.values.tolist() == run.frames.pattern.values.tolist()
        press(window.runs, "Report")
        until(lambda: (ended[0].path / "report.html").exists(), 90.0, "the report was not written")

"""The window from opening to closing: which rig it says, what it remembers, and a rig file that is wrong."""

import os
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QFileDialog

import drivers.rig
from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError, SceneError
from tests import on_page
from tests.window_rig import LONG_DOSE, until, window_on, write_rig
from ui.window import frame_renderer
from ui.window.live_view import LiveView
from ui.window.marked_text import MarkedText
from ui.window.observed_devices import LatestValue, SeenFrame
from ui.window.rig_file import RigSource
from ui.window.status import RigState
from ui.window.threads import OwnedThread


def test_it_opens_on_the_simulated_rig_and_says_so(tmp_path):
    """Somebody who takes a simulation for the bench draws wrong conclusions."""
    with window_on(tmp_path, None) as window:
        until(lambda: window.live.displayed)
        assert "SIMULATED" in window.top.badge.text()
        assert window.top.stop.isVisible()


def test_the_picture_comes_while_the_doser_still_boots(tmp_path, monkeypatch):
    """A pump takes up to four seconds to answer; somebody who waits for a window starts a second one."""
    booted, open_device = threading.Event(), drivers.rig.open_device

    def opened(name: str, settings: dict[str, Any]) -> Any:
        if name == "simulated-doser":
            assert booted.wait(30.0)
        return open_device(name, settings)

    monkeypatch.setattr(drivers.rig, "open_device", opened)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.live.displayed > 3)
        assert window.status.state is RigState.OPENING
        assert not window.top.run.isEnabled()
        booted.set()
        until(lambda: window.status.state is RigState.IDLE)


def test_a_picture_that_is_ready_at_once_is_shown(tmp_path, monkeypatch):
    """One that was ready before the view listened was never taken, and no later one told of: a window in some hundreds
    opened without a picture, and stayed so."""
    frames: LatestValue[SeenFrame] = LatestValue()

    class Prompt(OwnedThread):
        def __init__(self, *its: Any) -> None:
            super().__init__(*its)
            frames.put(SeenFrame(np.full((20, 30), 100, np.uint16), 4095, CameraSettings(20.0), None))
            time.sleep(0.3)  # as where this thread comes first

    with window_on(tmp_path, None) as window:
        until(lambda: window.live.displayed)
        monkeypatch.setattr(frame_renderer, "OwnedThread", Prompt)
        view = LiveView(frames)
        try:
            view.set_bench(window.rig.bench)
            until(lambda: view.displayed, 10.0)
        finally:
            view.close_view()


def test_a_doser_that_does_not_answer_is_told_though_the_camera_saw(tmp_path, monkeypatch):
    """Pictures must not hide that no ink can be dosed."""
    seen, open_device = threading.Event(), drivers.rig.open_device

    def opened(name: str, settings: dict[str, Any]) -> Any:
        if name == "simulated-doser":
            assert seen.wait(30.0)
            raise DeviceError("doser: no reply; check the cable")
        return open_device(name, settings)

    monkeypatch.setattr(drivers.rig, "open_device", opened)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.live.displayed)
        seen.set()
        until(lambda: window.status.state is RigState.FAILED)
        assert "no reply; check the cable" in window.banner.text


def test_theme_and_docks_are_remembered(tmp_path):
    """What a person arranged must be there the next day."""
    rig = write_rig(tmp_path)
    with window_on(tmp_path, rig) as first:
        QTest.keyClick(first, Qt.Key.Key_T, Qt.KeyboardModifier.ControlModifier)
        assert QApplication.instance().property("theme") == "light"
        first.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, first.docks[first.log])
    with window_on(tmp_path, rig) as second:
        assert second.dockWidgetArea(second.docks[second.log]) == Qt.DockWidgetArea.LeftDockWidgetArea
        assert QApplication.instance().property("theme") == "light"


def test_edits_that_were_not_saved_are_kept(tmp_path):
    """Opening another file, or closing the window, must not cost an hour of typing; and STOP works meanwhile."""
    rig = write_rig(tmp_path)
    (tmp_path / "long.toml").write_text(LONG_DOSE)
    (tmp_path / "other.toml").write_text(LONG_DOSE.replace("long", "other"))
    with window_on(tmp_path, rig) as first:
        until(lambda: first.status.state.value == "ready")
        document = first.sequence.document
        first.sequence.load(tmp_path / "long.toml")
        document.edit_text(LONG_DOSE.replace("900", "800"))
        QTest.keyClick(first, Qt.Key.Key_O, Qt.KeyboardModifier.ControlModifier)
        (question,) = first.findChildren(QFileDialog)
        assert not question.isModal()
        QTest.keyClick(question, Qt.Key.Key_F12)
        until(lambda: "STOP" in first.banner.text)
        question.selectFile(str(tmp_path / "other.toml"))
        question.accept()
        until(lambda: document.path == tmp_path / "other.toml")
        first.banner.press()
        assert document.text == LONG_DOSE.replace("900", "800")
    with window_on(tmp_path, rig) as second:
        assert second.sequence.document.text == LONG_DOSE.replace("900", "800")
        assert second.sequence.document.unsaved


def test_a_wrong_rig_file_opens_with_its_line_marked_and_the_rest_usable(tmp_path):
    """Mending a rig file by trial and error costs an afternoon."""
    rig = write_rig(tmp_path)
    rig.write_text(rig.read_text().replace("tank_ul = 4000.0", 'tank_ul = "much"'))
    (tmp_path / "long.toml").write_text(LONG_DOSE)
    with window_on(tmp_path, rig) as window:
        text = window.calibration.findChild(MarkedText)
        until(lambda: text.marked)
        assert rig.read_text().splitlines()[text.marked - 1] == 'tank_ul = "much"'
        assert "limits.tank_ul" in window.banner.text
        window.sequence.load(tmp_path / "long.toml")
        assert window.sequence.document.reading.sequence is not None
        text.setPlainText(text.toPlainText().replace('"much"', "4000.0"))
        on_page.button(window.calibration, "Save and open again").click()
        until(lambda: window.live.displayed)
        assert text.marked == 0


def test_signals_with_booleans_do_not_bring_the_program_down():
    """PySide6 6.12.0 on Python 3.11 lost a reference to True with each emitted signal and aborted after some 570."""
    program = (
        "from PySide6.QtCore import QObject, Signal\n"
        "class Bell(QObject):\n    rung = Signal(bool)\n"
        "bell = Bell()\n"
        "heard = []\n"
        "bell.rung.connect(heard.append)\n"
        "for _ in range(20000): bell.rung.emit(True)\n"
        "print(len(heard))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "20000")


def test_the_projector_s_screen_is_chosen_in_the_rig_file(tmp_path):
    """Light on the wrong screen is no experiment; comments in the file are the person's own."""
    rig = write_rig(tmp_path)
    source = RigSource(rig, tmp_path)
    with pytest.raises(SceneError, match="simulated-projector, which needs no screen"):
        source.choose_screen({"output": "HDMI-1"})
    rig.write_text("# ours\n" + rig.read_text().replace('"simulated-projector"', '"hdmi-projector"', 1))
    source.choose_screen({"serial": "X1", "model": "Beamer"})
    assert tomllib.loads(rig.read_text())["projector"]["screen"] == {"serial": "X1", "model": "Beamer"}
    assert rig.read_text().startswith("# ours\n")


NEEDED_LATER = ("numba", "scipy", "matplotlib", "cv2", "zarr", "xarray", "tomlkit", "yaml", "pandas", "dask")
HANGS_S = 100
"""Without a picture, after which the program tells where each of its threads is, and ends."""
FIRST_PICTURE = """
import faulthandler, sys
faulthandler.dump_traceback_later(int(sys.argv[3]), exit=True)  # a window that hangs says where
if __name__ == "__main__":
    from ui.cli import main
    from ui.window import app
    from PySide6.QtCore import QSettings, QTimer
    app.settings = lambda: QSettings(sys.argv[1] + "/w.ini", QSettings.Format.IniFormat)
    made, told = app.application, []

    def look():
        from PySide6.QtWidgets import QApplication
        windows = [one for one in QApplication.topLevelWidgets() if one.objectName() == "tankrig"]
        if windows and windows[0].live.displayed:
            print("imported:", *told[0])
            timer.stop()
            windows[0].close()

    timer = QTimer()
    timer.timeout.connect(look)

    def application():
        program = made()
        from ui.window import frame_renderer

        picture = frame_renderer.Picture

        def developed(*parts):  # in the renderer's thread: nothing that comes later can be there yet
            told.append(sorted(set(sys.argv[2].split(",")) & set(sys.modules)))
            return picture(*parts)

        frame_renderer.Picture = developed
        timer.start(0)
        return program

    app.application = application
    sys.exit(main(["gui", "--runs", sys.argv[1] + "/runs"]))
"""


def test_the_first_picture_waits_for_no_library_that_it_does_not_need(tmp_path):
    """Half a second of numba before the camera's picture, only to say that no fit goes on."""
    (tmp_path / "start.py").write_text(FIRST_PICTURE)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, str(tmp_path / "start.py"), str(tmp_path), ",".join(NEEDED_LATER), str(HANGS_S)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=2 * HANGS_S)
    assert done.returncode == 0, done.stderr
    assert "imported:" in done.stdout, done.stderr
    assert done.stdout.split("imported:")[1].split() == []

"""The program on a real X server, driven by real key presses: focus, shortcuts, and a window that fits."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import tankrig
from drivers.emulation.truth import read_truth
from tests.window_rig import LONG_DOSE, write_rig
from tests.xserver import start_x_server, stop_x_server

pytestmark = pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool (./start test installs them)"
)


@pytest.fixture
def display() -> Iterator[str]:
    """An X server of the test's own."""
    server, name = start_x_server("Xvfb", "-screen", "0", "1280x800x24", "-nolisten", "tcp")
    assert name, "Xvfb does not start"
    yield name
    stop_x_server(server)


def until(true: Callable[[], object], timeout_s: float = 40.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_keys_start_stop_and_close_on_a_real_x_server(tmp_path: Path, display: str) -> None:
    """What works on a make-believe platform may fail where a person stands: focus and keys are the server's."""
    rig = write_rig(tmp_path)
    (tmp_path / "long.toml").write_text(LONG_DOSE)
    environment = {**os.environ, "DISPLAY": display, "QT_QPA_PLATFORM": "xcb", "XDG_CONFIG_HOME": str(tmp_path)}
    program = "import sys; from ui.cli import main; sys.exit(main())"
    words = ["gui", "long.toml", "--rig", str(rig), "--runs", "runs"]
    child = subprocess.Popen([sys.executable, "-c", program, *words], env=environment, cwd=tmp_path)

    def xdotool(*command: str) -> str:
        done = subprocess.run(["xdotool", *command], env=environment, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    def size() -> str:
        return xdotool("getwindowgeometry", window).rpartition("Geometry: ")[2]

    try:
        until(lambda: xdotool("search", "--onlyvisible", "--name", "^tankrig$"))
        window = xdotool("search", "--onlyvisible", "--name", "^tankrig$").splitlines()[-1]
        xdotool("windowfocus", "--sync", window)
        state, journals = tmp_path / "rig" / "tank" / "state", tmp_path / "runs"
        until(state.exists)

        def ran() -> bool:
            xdotool("key", "F5")
            time.sleep(0.3)
            return bool(list(journals.glob("*/journal.jsonl")))

        until(ran)  # the key does nothing before the rig is ready
        until(lambda: read_truth(state).steps > 300)
        xdotool("key", "F12")
        (journal,) = journals.glob("*/journal.jsonl")
        until(lambda: b'"end"' in journal.read_bytes())
        held = read_truth(state).steps
        assert 300 < held < 9000
        assert tankrig.open_run(journal.parent).end["reason"] == "aborted"
        assert size() == "1280x800"
        xdotool("key", "ctrl+q")
        assert child.wait(40) == 0
        assert read_truth(state).steps == held
    finally:
        child.kill()
        child.wait()


@pytest.mark.parametrize("key", ["F12", "Escape"])
def test_both_keys_stop_from_an_open_list_on_a_real_x_server(tmp_path: Path, display: str, key: str) -> None:
    """While a list hangs open it has the keyboard, and Qt asks no shortcut; the pump must stop all the same."""
    rig = write_rig(tmp_path)
    (tmp_path / "long.toml").write_text(LONG_DOSE)
    environment = {**os.environ, "DISPLAY": display, "QT_QPA_PLATFORM": "xcb", "XDG_CONFIG_HOME": str(tmp_path)}
    program = (
        "import sys\nfrom PySide6.QtCore import QTimer\nfrom PySide6.QtWidgets import QApplication\n"
        "from ui.window import main_window\n"
        "began = main_window.MainWindow.began\n"
        "def opening(self, *words):\n"
        "    began(self, *words)\n"
        "    QTimer.singleShot(300, self.live._colours.showPopup)\n"
        "main_window.MainWindow.began = opening\n"
        "from ui.cli import main\nsys.exit(main())\n"
    )
    words = ["gui", "long.toml", "--rig", str(rig), "--runs", "runs"]
    child = subprocess.Popen([sys.executable, "-c", program, *words], env=environment, cwd=tmp_path)

    def xdotool(*command: str) -> str:
        done = subprocess.run(["xdotool", *command], env=environment, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    try:
        until(lambda: xdotool("search", "--onlyvisible", "--name", "^tankrig$"))
        window = xdotool("search", "--onlyvisible", "--name", "^tankrig$").splitlines()[-1]
        xdotool("windowfocus", "--sync", window)
        before = len(xdotool("search", "--onlyvisible", "--class", "").splitlines())

        def ran() -> bool:
            xdotool("key", "F5")
            time.sleep(0.3)
            return bool(list((tmp_path / "runs").glob("*/journal.jsonl")))

        until(ran)
        state = tmp_path / "rig" / "tank" / "state"
        until(lambda: len(xdotool("search", "--onlyvisible", "--class", "").splitlines()) > before)
        xdotool("key", key)
        (journal,) = (tmp_path / "runs").glob("*/journal.jsonl")
        until(lambda: b'"end"' in journal.read_bytes())
        assert tankrig.open_run(journal.parent).end["reason"] == "aborted"
        assert read_truth(state).steps < 9000
    finally:
        child.kill()
        child.wait()

"""A small, fast simulated rig in a file, and the window on it, for tests that drive the real window."""

import gc
import os

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PySide6.QtCore import QEventLoop, QSettings, QTimer
from PySide6.QtTest import QTest

RIG = """
name = "test rig"
folder = "rig"
[projector]
driver = "simulated-projector"
folder = "./rig/tank"
shape = [30, 40]
{projector}
[camera]
driver = "simulated-camera"
folder = "./rig/tank"
{camera}
[camera.truth]
tolerance = 0.05
mixing_s = 0.1
[camera.truth.ink]
sigma_a = 4e-4
sigma_s = 0.012
g = 0.71
[camera.truth.bench]
light = "collimated"
tank = {{ size_mm = [240.0, 160.0, 120.0] }}
wall = {{ shape = [30, 40], y_mm = [-80.0, 80.0], z_mm = [0.0, 120.0] }}
camera = {{ kind = "orthographic", shape = [20, 30], pixel_mm = 8.0 }}
[doser]
driver = "simulated-doser"
folder = "./rig/tank"
steps_per_ul = 10.0
{doser}
[limits]
dose_ul = 1000.0
run_ul = 2000.0
tank_ul = 4000.0
[pace]
dose_ul_per_s = 200.0
mixing_s = 0.5
[bench]
light = "collimated"
tank = {{ size_mm = [240.0, 160.0, 120.0] }}
wall = {{ shape = [30, 40], y_mm = [-80.0, 80.0], z_mm = [0.0, 120.0] }}
camera = {{ kind = "orthographic", shape = [20, 30], pixel_mm = 8.0 }}
"""

LONG_DOSE = 'name = "long"\n[[steps]]\ndo = "dose"\ntotal_ul = 900\n'


def write_rig(folder: Path, projector: str = "", camera: str = "", doser: str = "") -> Path:
    """A rig file in `folder`; the rest are lines for its tables."""
    file = folder / "rig.toml"
    file.write_text(RIG.format(projector=projector, camera=camera, doser=doser))
    return file


@contextmanager
def window_on(folder: Path, rig: Path | None, sequence: Path | None = None) -> Iterator[Any]:
    """The real window, active, with all that it remembers in `folder`; closed at the end, whatever happens."""
    from ui.window.app import application

    application()
    from ui.window.kept_log import KeptLog
    from ui.window.main_window import MainWindow
    from ui.window.rig_file import RigSource
    from ui.window.rig_host import RigHost

    settings = QSettings(str(folder / "window.ini"), QSettings.Format.IniFormat)
    if settings.value("theme") is None:
        settings.setValue("theme", "dark")
    log = KeptLog(folder / "runs")
    host = RigHost(RigSource(rig, folder / "simulated.rig"))
    window = MainWindow(host, folder / "runs", settings, sequence, log)
    window.build_pages()
    with _garbage_of_the_window_alone():
        window.show()
        window.activateWindow()
        assert QTest.qWaitForWindowActive(window, 10_000)
        try:
            yield window
        finally:
            window.close()
            until(lambda: not window.isVisible())
            window.deleteLater()
            wait_ms(1)


@contextmanager
def _garbage_of_the_window_alone() -> Iterator[None]:
    """Look for garbage at the end, but not among all that was there before, which the window has frozen.

    To go through what hundreds of tests have left took half of a window's time.
    """
    freeze, unfreeze, frozen = gc.freeze, gc.unfreeze, []

    def noted() -> None:  # to have Python count what is frozen would go through all of it
        frozen.append(True)
        freeze()

    gc.freeze, gc.unfreeze = noted, lambda: None
    try:
        yield
    finally:
        gc.freeze, gc.unfreeze = freeze, unfreeze
        if frozen:  # after a run the window freezes what it holds itself
            unfreeze()
        gc.collect()
        gc.freeze()


def wait_ms(milliseconds: int) -> None:
    """Let the window work for a while, and all other threads, which `QTest.qWait` would keep the interpreter from."""
    loop = QEventLoop()
    QTimer.singleShot(milliseconds, loop.quit)
    loop.exec()


def until(true: Callable[[], object], timeout_s: float = 60.0, what: str = "") -> None:
    """Let the window work until something is true."""
    deadline = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < deadline, what or "it did not come true in time"
        wait_ms(10)

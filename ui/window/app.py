"""Starting the window."""

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSettings, Qt, QTimer

from ui.window.rig_file import RigSource
from ui.window.rig_host import RigHost

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication

SWITCH_S = 0.002
"""Threads hand the interpreter over this often, so that frames and fits do not hold the window up."""


def application() -> "QApplication":
    """The one QApplication, made on first use."""
    from PySide6.QtGui import QGuiApplication
    from PySide6.QtWidgets import QApplication

    app = QApplication.instance()
    if not isinstance(app, QApplication):
        QGuiApplication.setHighDpiScaleFactorRoundingPolicy(Qt.HighDpiScaleFactorRoundingPolicy.PassThrough)
        app = QApplication(sys.argv[:1])
        app.setApplicationName("tankrig")
        app.setOrganizationName("tankrig")
    sys.setswitchinterval(SWITCH_S)
    return app


def settings() -> QSettings:
    """Where the window's habits are remembered."""
    return QSettings(QSettings.Format.IniFormat, QSettings.Scope.UserScope, "tankrig", "window")


def run_window(rig: Path | None, runs: Path, sequence: Path | None) -> int:
    """Open the window and stay until it is closed.

    Parameters
    ----------
    rig
        A rig file; None for the simulated rig.
    runs
        Folder of the runs; the simulated rig remembers its tank there, too.
    sequence
        A sequence to open.

    Returns
    -------
    int
        Exit status.
    """
    host = RigHost(RigSource(rig, runs / "simulated.rig"))  # opens the rig while all else is imported
    app = application()
    from ui.window import theme
    from ui.window.main_window import MainWindow

    remembered = settings()
    theme.apply(str(remembered.value("theme") or theme.of_system()))
    window = MainWindow(host, runs, remembered, sequence)
    window.show()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: QTimer.singleShot(0, window.close))
    return int(app.exec())

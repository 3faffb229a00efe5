"""Starting the window."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSettings, Qt, QTimer, QtMsgType, qInstallMessageHandler

from ui.window.kept_log import KeptLog
from ui.window.rig_file import RigSource
from ui.window.rig_host import RigHost

if TYPE_CHECKING:
    from PySide6.QtWidgets import QApplication

_REMEDY = (
    "run it where there is a screen (DISPLAY or WAYLAND_DISPLAY names it; ssh -X brings one), and install what it "
    "names; on Debian or Ubuntu: sudo apt install libxcb-cursor0 libxkbcommon-x11-0 libxcb-icccm4 libxcb-keysyms1"
)
SWITCH_S = 0.0001
"""Threads hand the interpreter over this often, so that frames and fits do not hold the window up."""


def application() -> "QApplication":
    """The one QApplication, made on first use."""
    from PySide6.QtGui import QGuiApplication
    from PySide6.QtWidgets import QApplication

    app = QApplication.instance()
    if not isinstance(app, QApplication):
        QGuiApplication.setHighDpiScaleFactorRoundingPolicy(Qt.HighDpiScaleFactorRoundingPolicy.PassThrough)
        with _one_sentence_for_an_abort():
            app = QApplication(sys.argv[:1])
        app.setApplicationName("tankrig")
        app.setOrganizationName("tankrig")
    sys.setswitchinterval(SWITCH_S)
    return app


@contextmanager
def _one_sentence_for_an_abort() -> Iterator[None]:
    """End the program with a sentence where Qt would abort it: without a display, or without what its plugins need.

    Qt tells the reasons as warnings and then aborts from within; there is nothing that could be caught.
    """
    said: list[str] = []

    def hear(kind: QtMsgType, _: object, text: str | None) -> None:
        said.extend((text or "").strip().splitlines())
        if kind == QtMsgType.QtFatalMsg:
            print(f"tankrig: the window cannot be opened ({said[0]}); {_REMEDY}", file=sys.stderr, flush=True)  # noqa: T201
            os._exit(1)

    before = qInstallMessageHandler(hear)
    try:
        yield
    finally:
        qInstallMessageHandler(before)
        for line in said:
            print(line, file=sys.stderr)  # noqa: T201 - as Qt would have


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
    # Calibrations work in another folder, so that the file is named as it is from anywhere.
    rig = rig.absolute() if rig is not None else None
    log = KeptLog(runs)  # first: a rig that fails at once has its reason there
    host = RigHost(RigSource(rig, runs / "simulated.rig"))  # opens the rig while all else is imported
    app = application()
    from ui.window import theme
    from ui.window.main_window import MainWindow

    remembered = settings()
    theme.apply(str(remembered.value("theme") or theme.of_system()))
    window = MainWindow(host, runs, remembered, sequence, log)
    window.show()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: QTimer.singleShot(0, window.close))
    return int(app.exec())

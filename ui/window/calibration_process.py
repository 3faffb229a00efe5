"""A calibration command, carried out in a process of its own and led by the window."""

import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from PySide6.QtCore import QObject, QProcess, QProcessEnvironment, QTimer, Signal

from ui.guide import GUIDED

_PATIENCE_MS = 5000
_RUN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from ui.cli import main
sys.exit(main())
"""
"""A window that a script started in the background ignores SIGINT, and so would the program, which it ends with it."""


class CalibrationProcess(QObject):
    """`tankrig calibrate …`, whose requests and pictures arrive as signals; see `ui.guide`.

    Parameters
    ----------
    words
        The command, from "calibrate" on.
    folder
        To work in: of the simulated rig, or anywhere.
    """

    asked = Signal(str, bool)
    """A request, and whether it wants a number."""
    said = Signal(str, bool)
    """A line, and whether it is to be replaced by the next such."""
    looked = Signal(object)
    """Fields of a `Look`."""
    kept = Signal(object)
    """The result."""
    ended = Signal(int, str)
    """Exit status, and the sentence that says what was wrong."""

    def __init__(self, words: Sequence[str], folder: Path) -> None:
        super().__init__()
        self._errors = ""
        self._process = QProcess()
        environment = QProcessEnvironment.systemEnvironment()
        environment.insert(GUIDED, "1")
        environment.insert("PYTHONUNBUFFERED", "1")
        self._process.setProcessEnvironment(environment)
        folder.mkdir(parents=True, exist_ok=True)
        self._process.setWorkingDirectory(str(folder))
        self._process.readyReadStandardOutput.connect(self._read)
        self._process.readyReadStandardError.connect(self._complain)
        self._process.finished.connect(self._finish)
        self._process.start(sys.executable, ["-c", _RUN, *words])

    def answer(self, text: str = "") -> None:
        """To the last request."""
        self._process.write(f"{text}\n".encode())

    def stop(self) -> None:
        """Stop its devices and end it; from any thread."""
        number = self._process.processId()
        if number:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGINT)

    def cancel(self) -> None:
        """`stop`; killed when it does not end soon."""
        self.stop()
        QTimer.singleShot(_PATIENCE_MS, self._process.kill)

    def _read(self) -> None:
        while self._process.canReadLine():
            line = bytes(self._process.readLine().data()).decode(errors="replace")
            try:
                ((key, value),) = json.loads(line).items()
            except (AttributeError, ValueError):
                self.said.emit(line.strip(), False)
                continue
            match key:
                case "ask" | "number":
                    self.asked.emit(value, key == "number")
                case "say" | "watch":
                    self.said.emit(value, key == "watch")
                case "look":
                    self.looked.emit(value)
                case "kept":
                    self.kept.emit(value)

    def _complain(self) -> None:
        text = bytes(self._process.readAllStandardError().data()).decode(errors="replace")
        self._errors += text
        for line in filter(str.strip, text.splitlines()):
            if not line.startswith("tankrig: "):
                self.said.emit(line.strip(), False)

    def _finish(self, status: int) -> None:
        self._read()
        lines = [line for line in self._errors.splitlines() if line.startswith("tankrig: ")]
        self.ended.emit(status, lines[-1].removeprefix("tankrig: ") if lines else "")

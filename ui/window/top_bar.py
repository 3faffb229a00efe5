"""The bar that is always there: which rig, what goes on, run and pause, and STOP."""

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QSizePolicy, QWidget

from tankrig.run.state import RunState
from ui.window.status import RigStatus
from ui.window.theme import set_role
from ui.window.words import duration

SIMULATED = "SIMULATED RIG, nothing real moves"


class TopBar(QWidget):
    """Buttons large enough for wet hands."""

    stop_asked = Signal()
    run_asked = Signal()
    pause_asked = Signal()
    theme_asked = Signal()
    help_asked = Signal()

    def __init__(self, rig: str, simulated: bool) -> None:
        super().__init__()
        self.badge = QLabel(SIMULATED if simulated else rig)
        self.badge.setObjectName("badge")
        self.badge.setProperty("real", "false" if simulated else "true")
        self.stop = QPushButton("STOP  F12")
        self.stop.setObjectName("stop")
        self.stop.setToolTip("stop the doser at once and abort the run (F12 or Esc, from anywhere in the window)")
        self.stop.setAccessibleName("STOP")
        self.stop.pressed.connect(self.stop_asked)  # on the press, not on the release
        self.run, self.pause = QPushButton("Run  F5"), QPushButton("Pause  F6")
        self.run.setObjectName("primary")
        self.run.clicked.connect(self.run_asked)
        self.pause.clicked.connect(self.pause_asked)
        theme, keys = QPushButton("Theme"), QPushButton("Keys  F1")
        theme.setToolTip("dark or light (Ctrl+T)")
        theme.clicked.connect(self.theme_asked)
        keys.clicked.connect(self.help_asked)
        self._bar = QProgressBar()
        self._bar.setFormat("no run")
        self._bar.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        row = QHBoxLayout(self)
        row.setContentsMargins(8, 4, 8, 4)
        row.setSpacing(10)
        for widget in (self.badge, self.run, self.pause):
            row.addWidget(widget)
        row.addWidget(self._bar, 1)
        for widget in (theme, keys, self.stop):
            row.addWidget(widget)

    def use_rig(self, name: str, simulated: bool) -> None:
        """Another rig: a real one looks other than a simulated one."""
        self.badge.setText(SIMULATED if simulated else name)
        set_role(self.badge, "false" if simulated else "true", "real")

    def name_rig(self, name: str) -> None:
        """Of a real rig, once its file has been read."""
        self.badge.setText(name)

    def follow(self, status: RigStatus, hindrance: str) -> None:
        """Show what goes on, which buttons make sense, and what keeps a sequence from being run; empty for nothing."""
        self.run.setEnabled(not hindrance and not status.busy)
        self.run.setToolTip(hindrance or "carry out the sequence (F5)")
        halted = status.run_state in (RunState.PAUSED, RunState.PAUSING)
        self.pause.setEnabled(status.run_state in (RunState.RUNNING, RunState.PAUSED, RunState.PAUSING))
        self.pause.setText("Go on  F6" if halted else "Pause  F6")
        now = status.progress
        if now is None or not status.running:
            self._bar.setMaximum(1)
            self._bar.setValue(0)
            self._bar.setFormat("no run")
            return
        self._bar.setMaximum(max(1, now.steps))
        self._bar.setValue(now.step)
        if status.finishing:
            self._bar.setFormat(f"all {now.steps} steps are done")
        else:
            self._bar.setFormat(f"step {min(now.step + 1, now.steps)} of {now.steps}, {duration(now.remaining_s)} left")

"""Play, halt, speed and place of a replay."""

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QComboBox, QLabel, QPushButton, QSlider, QVBoxLayout, QWidget

from ui.window.flow import Flow
from ui.window.replay import SPEEDS, Replay


class ReplayBar(QWidget):
    """Drives one replay, or says that there is none."""

    left = Signal()
    """Back to the camera is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self._replay: Replay | None = None
        self._play = QPushButton("Play")
        self._play.setCheckable(True)
        self._play.toggled.connect(self._toggle)
        self._speed = QComboBox()
        self._speed.addItems(list(SPEEDS))
        self._speed.setCurrentText("1 ×")
        self._speed.setToolTip("how fast frames follow each other; waits of more than two seconds are cut short")
        self._speed.currentTextChanged.connect(self._set_speed)
        self._slider = QSlider(Qt.Orientation.Horizontal)
        self._slider.setToolTip("frame of the run")
        self._slider.sliderMoved.connect(self._jump)
        self._live = QPushButton("Back to the camera")
        self._live.clicked.connect(self.left)
        self._words = QLabel("Open a run to replay it.")
        self._words.setProperty("role", "faint")
        self._slider.setMinimumWidth(120)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(Flow(self._play, self._speed, self._live))
        column.addWidget(self._slider)
        column.addWidget(self._words)
        self.set_replay(None)

    def set_replay(self, replay: Replay | None) -> None:
        """Drive this one from now on."""
        self._replay = replay
        for widget in (self._play, self._speed, self._slider, self._live):
            widget.setEnabled(replay is not None)
        self._play.setChecked(False)
        self._words.setText("Open a run to replay it.")
        if replay is not None:
            self._slider.setRange(0, max(0, len(replay.frames) - 1))
            self._slider.setValue(0)
            queued = Qt.ConnectionType.QueuedConnection
            replay.moved.connect(self._moved, queued)
            replay.ended.connect(self._ended, queued)
            self._set_speed(self._speed.currentText())
            replay.jump(0)

    def _toggle(self, on: bool) -> None:
        self._play.setText("Halt" if on else "Play")
        if self._replay is not None:
            self._replay.play(on)

    def _set_speed(self, words: str) -> None:
        if self._replay is not None:
            self._replay.speed = SPEEDS[words]

    def _jump(self, frame: int) -> None:
        if self._replay is not None:
            self._replay.jump(frame)

    def _ended(self, replay: Replay, words: str) -> None:
        if replay is self._replay:
            self._words.setText(words)
            self._play.setChecked(False)

    def _moved(self, replay: Replay, frame: int, words: str) -> None:
        if replay is not self._replay:
            return  # what an earlier one had still to say
        if not self._slider.isSliderDown():
            self._slider.setValue(frame)
        self._words.setText(words)
        if frame + 1 >= len(replay.frames) and self._play.isChecked():
            self._play.setChecked(False)

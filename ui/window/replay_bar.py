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
        self._slider.actionTriggered.connect(lambda _: self._jump(self._slider.sliderPosition()))
        self._pattern, self._dose = QComboBox(), QComboBox()
        self._pattern.setToolTip("look at frames of one pattern; the slider then goes through its repeats")
        self._dose.setToolTip("look at frames of one dose")
        for box in (self._pattern, self._dose):
            box.activated.connect(lambda _: self._narrow())
        self._chosen: list[int] = []
        self._rank: dict[int, int] = {}
        self._live = QPushButton("Back to the camera")
        self._live.clicked.connect(self.left)
        self._words = QLabel("Open a run to replay it.")
        self._words.setProperty("role", "faint")
        self._slider.setMinimumWidth(120)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(Flow(self._play, self._speed, self._pattern, self._dose, self._live))
        column.addWidget(self._slider)
        column.addWidget(self._words)
        self.set_replay(None)

    def set_replay(self, replay: Replay | None) -> None:
        """Drive this one from now on."""
        self._replay = replay
        for widget in (self._play, self._speed, self._slider, self._pattern, self._dose, self._live):
            widget.setEnabled(replay is not None)
        self._list_axes(replay)
        self._play.setChecked(False)
        self._words.setText("Open a run to replay it.")
        if replay is not None:
            queued = Qt.ConnectionType.QueuedConnection
            replay.moved.connect(self._moved, queued)
            replay.ended.connect(self._ended, queued)
            self._set_speed(self._speed.currentText())
            self._narrow()

    def _list_axes(self, replay: Replay | None) -> None:
        """Patterns and doses that there are frames of."""
        axes = replay.axes if replay is not None else []
        for box, all_of, values in (
            (self._pattern, "all patterns", [(name, name) for name in dict.fromkeys(name for name, _ in axes)]),
            (self._dose, "all doses", [(f"{dose:.4g} ml", dose) for dose in sorted({dose for _, dose in axes})]),
        ):
            box.clear()
            box.addItem(all_of, None)
            for words, value in values:
                box.addItem(words, value)

    def _narrow(self) -> None:
        """Go through frames of the chosen pattern and dose only."""
        if self._replay is None:
            return
        self._chosen = self._replay.places(self._pattern.currentData(), self._dose.currentData())
        self._rank = {frame: rank for rank, frame in enumerate(self._chosen)}
        self._slider.setRange(0, max(0, len(self._chosen) - 1))
        self._slider.setValue(0)
        self._slider.setEnabled(len(self._chosen) > 1)
        if self._chosen:
            self._replay.jump(self._chosen[0])
        else:
            self._words.setText("No frame of this pattern was taken at this dose.")

    def _toggle(self, on: bool) -> None:
        self._play.setText("Halt" if on else "Play")
        if self._replay is not None:
            self._replay.play(on)

    def _set_speed(self, words: str) -> None:
        if self._replay is not None:
            self._replay.speed = SPEEDS[words]

    def _jump(self, place: int) -> None:
        if self._replay is not None and place < len(self._chosen):
            self._replay.jump(self._chosen[place])

    def _ended(self, replay: Replay, words: str) -> None:
        if replay is self._replay:
            self._words.setText(words)
            self._play.setChecked(False)

    def _moved(self, replay: Replay, frame: int, words: str) -> None:
        if replay is not self._replay:
            return  # what an earlier one had still to say
        if not self._slider.isSliderDown() and frame in self._rank:
            self._slider.setValue(self._rank[frame])
        self._words.setText(words)
        if frame + 1 >= len(replay.frames) and self._play.isChecked():
            self._play.setChecked(False)

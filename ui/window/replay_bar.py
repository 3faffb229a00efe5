"""Play, halt, speed of a replay, and its place: by frame, or by pattern, dose and repeat, each with a slider."""

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QPushButton, QSlider, QVBoxLayout, QWidget

from ui.window.elided import Elided
from ui.window.flow import Flow
from ui.window.replay import SPEEDS, Replay

NOTHING = "Open a run to replay it."


class AxisSlider:
    """A slider through the values of one axis, with the axis' name before it and the value after it.

    Parameters
    ----------
    name, tip
        For people.
    moved
        Called when a person has moved it.
    """

    def __init__(self, name: str, tip: str, moved: Callable[[], object]) -> None:
        self.name, self.value, self.slider = QLabel(name), QLabel(), QSlider(Qt.Orientation.Horizontal)
        self.name.setBuddy(self.slider)
        self.slider.setToolTip(tip)
        self.slider.setAccessibleName(f"{name}: {tip}")
        self.slider.setPageStep(1)
        self.value.setMinimumWidth(70)
        self.value.setProperty("role", "faint")
        self.slider.actionTriggered.connect(lambda _: moved())
        self._values: list[Any] = []
        self._words: Callable[[Any], str] = str

    def set_values(self, values: list[Any], words: Callable[[Any], str] = str) -> None:
        """What it goes through, and how a value is written."""
        self._values, self._words = values, words
        self.slider.setRange(0, max(0, len(values) - 1))
        self.slider.setEnabled(len(values) > 1)
        self.say()

    def choose(self, value: Any) -> None:
        """Stand at a value; where a person holds the slider, it stays in their hand."""
        if value in self._values and not self.slider.isSliderDown():
            self.slider.setValue(self._values.index(value))
        self.say()

    @property
    def chosen(self) -> Any:
        """The value that it stands at; None where there is none."""
        place = self.slider.sliderPosition()
        return self._values[place] if place < len(self._values) else None

    def say(self) -> None:
        """Write the value behind the slider."""
        self.value.setText(self._words(self.chosen) if self._values else "")


class ReplayBar(QWidget):
    """Drives one replay, or says that there is none."""

    left = Signal()
    """Back to the camera is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self._replay: Replay | None = None
        self._listed: tuple[str, float] | None = None
        self._places: list[int] = []
        """Frames of the pattern and the dose in `_listed`."""
        self._play = QPushButton("Play")
        self._play.setCheckable(True)
        self._play.toggled.connect(self._toggle)
        self._speed = QComboBox()
        self._speed.addItems(list(SPEEDS))
        self._speed.setCurrentText("1 ×")
        self._speed.setToolTip("how fast frames follow each other; waits of more than two seconds are cut short")
        self._speed.currentTextChanged.connect(self._set_speed)
        self.frame = AxisSlider("frame", "frames in the order in which they were taken", self._to_frame)
        self.pattern = AxisSlider("pattern", "the same dose lit by another pattern", self._to_place)
        self.dose = AxisSlider("dose", "the same pattern at another dose", self._to_place)
        self.repeat = AxisSlider("repeat", "frames of this pattern at this dose", self._to_place)
        self._axes = (self.frame, self.pattern, self.dose, self.repeat)
        self._live = QPushButton("Back to the camera")
        self._live.clicked.connect(self.left)
        self._words = Elided(2)
        self._words.setProperty("role", "faint")
        column, grid = QVBoxLayout(self), QGridLayout()
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(Flow(self._play, self._speed, self._live))
        for number, axis in enumerate(self._axes):
            for place, widget in enumerate((axis.name, axis.slider, axis.value)):
                grid.addWidget(widget, number // 2, 3 * (number % 2) + place)
        for place in (1, 4):
            grid.setColumnStretch(place, 1)
        column.addLayout(grid)
        column.addWidget(self._words)
        self.set_replay(None)

    def set_replay(self, replay: Replay | None) -> None:
        """Drive this one from now on."""
        self._replay = replay
        for widget in (self._play, self._speed, self._live):
            widget.setEnabled(replay is not None)
        axes = replay.axes if replay is not None else []
        self.frame.set_values(list(range(len(axes))), lambda place: f"{place + 1} of {len(axes)}")
        self.pattern.set_values(list(dict.fromkeys(name for name, _ in axes)))
        self.dose.set_values(sorted({dose for _, dose in axes}), lambda dose: f"{dose:.4g} ml")
        self.repeat.set_values([])
        self._listed = None
        self._play.setChecked(False)
        self._words.say(NOTHING)
        if replay is not None:
            queued = Qt.ConnectionType.QueuedConnection
            replay.moved.connect(self._moved, queued)
            replay.ended.connect(self._ended, queued)
            self._set_speed(self._speed.currentText())
            if axes:
                self._stand_at(0)
                replay.jump(0)

    def _stand_at(self, place: int) -> None:
        """All sliders at one frame."""
        assert self._replay is not None
        pattern, dose_ml = self._replay.axes[place]
        self.frame.choose(place)
        self.pattern.choose(pattern)
        self.dose.choose(dose_ml)
        self._list_repeats(pattern, dose_ml)
        self.repeat.choose(place)

    def _list_repeats(self, pattern: str, dose_ml: float) -> list[int]:
        assert self._replay is not None
        if (pattern, dose_ml) != self._listed:
            self._listed = pattern, dose_ml
            self._places = places = self._replay.places(pattern, dose_ml)
            self.repeat.set_values(places, lambda place: f"{places.index(place) + 1} of {len(places)}")
        return self._places

    def _to_frame(self) -> None:
        """A person has moved the slider of all frames."""
        if self._replay is not None and self.frame.chosen is not None:
            self.frame.say()
            self._replay.jump(self.frame.chosen)

    def _to_place(self) -> None:
        """A person has moved one of the sliders of pattern, dose and repeat."""
        if self._replay is None or self.pattern.chosen is None:
            return
        pattern, dose_ml, rank = self.pattern.chosen, self.dose.chosen, self.repeat.slider.sliderPosition()
        for axis in (self.pattern, self.dose):
            axis.say()
        places = self._list_repeats(pattern, dose_ml)
        if places:
            self._replay.jump(places[min(rank, len(places) - 1)])
        else:
            self._words.say(f"No frame of {pattern} was taken at {dose_ml:.4g} ml.")

    def _toggle(self, on: bool) -> None:
        self._play.setText("Halt" if on else "Play")
        if self._replay is not None:
            self._replay.play(on)

    def _set_speed(self, words: str) -> None:
        if self._replay is not None:
            self._replay.speed = SPEEDS[words]

    def _ended(self, replay: Replay, words: str) -> None:
        if replay is self._replay:
            self._words.say(words)
            self._play.setChecked(False)

    def _moved(self, replay: Replay, frame: int, words: str) -> None:
        if replay is not self._replay:
            return  # what an earlier one had still to say
        self._stand_at(frame)
        self._words.say(words)
        if frame + 1 >= len(replay.frames) and self._play.isChecked():
            self._play.setChecked(False)

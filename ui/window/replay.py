"""A recorded run played through the same views as a live one."""

import threading
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, Signal

from tankrig.devices import CameraSettings
from tankrig.errors import StoreError
from ui.window.observed_devices import SeenFrame
from ui.window.threads import OwnedThread

if TYPE_CHECKING:
    from tankrig.run.reading import Run

SPEEDS = {"¼ ×": 0.25, "1 ×": 1.0, "4 ×": 4.0, "16 ×": 16.0, "as fast as it goes": float("inf")}
LONGEST_WAIT_S = 2.0
UNKNOWN = "unknown pattern"
SAME_ML = 1e-6


class Replay(QObject):
    """Plays a run's frames in a thread of its own.

    Parameters
    ----------
    run
        What to play.
    show
        Called, in that thread, with each frame.
    """

    moved = Signal(object, int, str)
    """Itself, the number of the frame that is shown, and what it is in words."""
    ended = Signal(object, str)
    """Itself, and why it cannot go on."""

    def __init__(self, run: "Run", show: Callable[[SeenFrame], object]) -> None:
        super().__init__()
        self._run, self._show = run, show
        self.frames = run.events("frame")
        self._places = {event["index"]: place for place, event in enumerate(self.frames)}
        patterns, conditions = run.patterns, run.conditions
        self.axes = [
            (patterns[key].name if (key := event["pattern_hash"]) in patterns else UNKNOWN,
             conditions[event["index"]].tank.volume_ul / 1000.0)
            for event in self.frames
        ]  # fmt: skip
        """Of each frame: its pattern, and the ink in the tank in ml."""
        self._at, self._jumped = 0, False
        self.speed = 1.0
        self._playing, self._change = False, threading.Condition()
        self._thread = OwnedThread("replay", self._work, 5.0)

    def places(self, pattern: str | None, dose_ml: float | None) -> list[int]:
        """Frames of one pattern at one dose, in their order; None: of all."""
        return [
            place
            for place, (name, dose) in enumerate(self.axes)
            if pattern in (None, name) and (dose_ml is None or abs(dose - dose_ml) < SAME_ML)
        ]

    @property
    def path(self) -> Path:
        """Folder of the run."""
        return self._run.path

    def play(self, on: bool) -> None:
        """Go on, or halt; from the beginning when it had come to the end."""
        with self._change:
            if on and self._at >= len(self.frames):
                self._at = 0
            self._playing = on
            self._change.notify_all()

    def jump(self, frame: int) -> None:
        """Show this frame next."""
        with self._change:
            self._at, self._jumped = min(max(frame, 0), max(0, len(self.frames) - 1)), True
            self._change.notify_all()

    def close(self) -> None:
        """End the thread."""
        self._thread.ending.set()
        with self._change:
            self._change.notify_all()
        self._thread.close()

    def _work(self, ending: threading.Event) -> None:
        before_ns: int | None = None
        while not ending.is_set():
            with self._change:
                self._change.wait_for(lambda: self._playing or self._jumped or ending.is_set())
                if ending.is_set():
                    return
                if self._at >= len(self.frames):
                    self._playing = self._jumped = False
                    continue
                event, jumped = self.frames[self._at], self._jumped
                self._at, self._jumped = self._at + 1, False
            if before_ns is not None and not jumped:
                self._pause(event["exposure_start_ns"] - before_ns)
            before_ns = event["exposure_start_ns"]
            self._put(event)

    def _pause(self, gap_ns: int) -> None:
        """What lay between two frames; long waits are cut short, for nothing is seen in them."""
        wait_s = min(max(0.0, gap_ns / 1e9 / self.speed), LONGEST_WAIT_S)
        if wait_s > 0.0:
            with self._change:
                self._change.wait_for(lambda: self._jumped or not self._playing or self._thread.ending.is_set(), wait_s)
        else:
            time.sleep(0)

    def _put(self, event: Any) -> None:
        try:
            pixels = self._run.pixels(event)
        except StoreError as error:
            self.ended.emit(self, str(error))
            with self._change:
                self._playing = False
            return
        pattern = self._run.patterns.get(event["pattern_hash"])
        saturation = 255 if pixels.dtype.itemsize == 1 else int(self._run.settings.get("saturation", 65535))
        settings = self._run.conditions[event["index"]].camera or CameraSettings(20.0)
        self._show(SeenFrame(pixels, saturation, settings, pattern, self._run.path))
        place = self._places[event["index"]]
        name, dose_ml = self.axes[place]
        at = datetime.fromisoformat(event.moment.utc).astimezone()
        words = f"frame {place + 1} of {len(self.frames)}: {name} at {dose_ml:.4g} ml, {at:%H:%M:%S}"
        self.moved.emit(self, place, words)

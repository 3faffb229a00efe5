"""Camera and projector as the window sees them: the devices themselves, and a look at what passes through them."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from PySide6.QtCore import QObject, Signal

from tankrig.devices import CameraDevice, CameraSettings, Flip, Frame, Pixels, Projector
from tankrig.pattern import Pattern

T = TypeVar("T")
LONG_S = 1.0
"""A person is told how long an exposure still takes that is longer than this."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """A frame to be looked at.

    Parameters
    ----------
    pixels
        (rows, columns) counts.
    saturation
        Count at which pixels saturate.
    settings
        Of the camera, as read back.
    pattern
        What the projector showed, if that is known.
    run
        Folder of the run that it was recorded in; None for what the camera sees now.
    """

    pixels: Pixels
    saturation: int
    settings: CameraSettings
    pattern: Pattern | None
    run: Path | None = None


class LatestValue(QObject, Generic[T]):
    """Hands the newest of many values to the window's thread: older ones are let go, and no queue builds up.

    `arrived` comes once for all values that were put before the window takes one.
    """

    arrived = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._value: T | None = None
        self._told = False

    def put(self, value: T) -> None:
        """Hand over a value, from any thread; never waits for the window."""
        with self._lock:
            self._value, told, self._told = value, self._told, True
        if not told:
            self.arrived.emit()

    def take(self) -> T | None:
        """The newest value, or None where there was none since the last `take`."""
        with self._lock:
            value, self._value, self._told = self._value, None, False
            return value


class ObservedProjector:
    """A projector that tells what it shows; implements `tankrig.devices.Projector`."""

    def __init__(self, projector: Projector, shown: Callable[[Pattern], object]) -> None:
        self._projector, self._shown = projector, shown
        self.pattern: Pattern | None = None

    @property
    def name(self) -> str:
        """The device's name, for messages."""
        return self._projector.name

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._projector.shape

    def show(self, pattern: Pattern) -> Flip:
        """Show, and tell."""
        flip = self._projector.show(pattern)
        self.pattern = pattern
        self._shown(pattern)
        return flip

    def close(self) -> None:
        """Close the projector."""
        self._projector.close()


class ObservedCamera:
    """A camera that passes on each frame it hands out; implements `tankrig.devices.CameraDevice`."""

    def __init__(self, camera: CameraDevice, projector: ObservedProjector, seen: Callable[[SeenFrame], object]) -> None:
        self._camera, self._projector, self._seen = camera, projector, seen
        self._settings = CameraSettings(0.0)
        self._began_s: float | None = None

    @property
    def name(self) -> str:
        """The device's name, for messages."""
        return self._camera.name

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._camera.shape

    @property
    def saturation(self) -> int:
        """Count at which pixels saturate."""
        return self._camera.saturation

    @property
    def exposing_left_s(self) -> float | None:
        """About how long a long exposure under way still takes; None where none is under way, or a short one."""
        began_s, exposure_s = self._began_s, 1e-3 * self._settings.exposure_ms
        if began_s is None or exposure_s < LONG_S:
            return None
        return max(0.0, exposure_s - (time.monotonic() - began_s))

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set the camera; returns what it reads back."""
        self._settings = self._camera.configure(settings)
        return self._settings

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        """Capture, and pass on."""
        self._began_s = time.monotonic()
        try:
            frame = self._camera.capture(after_ns, timeout_s)
        finally:
            self._began_s = None
        self._seen(SeenFrame(frame.pixels, self.saturation, self._settings, self._projector.pattern))
        return frame

    def close(self) -> None:
        """Close the camera."""
        self._camera.close()

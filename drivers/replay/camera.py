"""The camera that replays: frames keep their order and, at the recorded pace, their intervals."""

import math
import threading
import time
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager

from tankrig.devices import CameraSettings, Frame
from tankrig.errors import DeviceError

from .recording import read_recording
from .settings import ReplayCameraSettings


class ReplayCamera:
    """Implements `tankrig.devices.CameraDevice`.

    The recording begins when it is opened: exposures "begin" at that moment plus their recorded times, or, at full
    pace, when they are asked for.

    Parameters
    ----------
    settings
        From the rig file.

    Raises
    ------
    DeviceError
        When there is nothing to replay.
    """

    def __init__(self, settings: ReplayCameraSettings) -> None:
        self._settings = settings
        self._recording = read_recording(settings)
        rows, columns = self._recording.pixels(0).shape
        self._shape = (rows, columns)
        starts = self._recording.starts_ns
        self._lasts_ns = starts[-1] + (starts[-1] // (len(starts) - 1) if len(starts) > 1 else 1_000_000)
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._next = 0
        self._origin_ns = time.monotonic_ns()

    @property
    def name(self) -> str:
        """For messages."""
        return f"replay of {self._settings.source}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self._shape

    @property
    def saturation(self) -> int:
        """The count at which pixels saturate."""
        return self._recording.saturation

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Changes nothing; returns what the frames were recorded with.

        Raises
        ------
        DeviceError
            If a value is not positive, this is closed, or a capture is under way.
        """
        for name, value in (("exposure_ms", settings.exposure_ms), ("gain", settings.gain)):
            if not (math.isfinite(value) and value > 0.0):
                raise DeviceError(f"{self.name}: cannot set {name} to {value}; give a positive number")
        with self._my_turn("configure"):
            return CameraSettings(self._recording.exposure_ms, self._recording.gain)

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        """First frame whose exposure "began" after `after_ns`.

        Raises
        ------
        DeviceError
            If none does within `timeout_s`, all have been handed out, this is closed, or another capture is under way.
        """
        deadline_ns = time.monotonic_ns() + int(timeout_s * 1e9)
        with self._my_turn("capture"):
            number, start_ns = self._number_and_start(after_ns)
            index = number % len(self._recording.starts_ns)
            if number != index and not self._settings.loop:
                raise DeviceError(f"{self.name}: all its {len(self._recording.starts_ns)} frames have been handed out")
            arrival_ns = start_ns
            if self._settings.pace == "recorded":
                arrival_ns += round(self._recording.exposure_ms * 1e6)
            self._wait(min(arrival_ns, deadline_ns))
            if arrival_ns > deadline_ns:
                raise DeviceError(f"{self.name}: has no frame within {timeout_s:g} s; allow more time")
            pixels = self._recording.pixels(index).copy()
            self._next = number + 1
            return Frame(pixels, start_ns, start_ns - self._origin_ns, time.monotonic_ns(), number)

    def close(self) -> None:
        """Wakes a capture that waits."""
        self._closed.set()

    def _number_and_start(self, after_ns: int) -> tuple[int, int]:
        """Of the frame that is to be handed out, counted on through all loops."""
        starts = self._recording.starts_ns
        if self._settings.pace == "full":
            return self._next, max(after_ns + 1, time.monotonic_ns())
        loop, since_ns = divmod(max(after_ns - self._origin_ns, -1), self._lasts_ns)
        number = max(self._next, loop * len(starts) + bisect_right(starts, since_ns))
        loop, index = divmod(number, len(starts))
        return number, self._origin_ns + loop * self._lasts_ns + starts[index]

    def _wait(self, until_ns: int) -> None:
        self._closed.wait(max(0, until_ns - time.monotonic_ns()) / 1e9)
        self._require_open()

    @contextmanager
    def _my_turn(self, what: str) -> Iterator[None]:
        self._require_open()
        if not self._lock.acquire(blocking=False):
            raise DeviceError(f"{self.name}: cannot {what} while a capture is under way; let one owner have the camera")
        try:
            yield
        finally:
            self._lock.release()

    def _require_open(self) -> None:
        if self._closed.is_set():
            raise DeviceError(f"{self.name}: is closed; open it again")

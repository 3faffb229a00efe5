"""The simulated camera: looks at the simulated tank by the light that is in it while it exposes."""

import math
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from tankrig.devices import CameraSettings, Frame
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .bench_poses import Held
from .bench_tank import InkInView, true_bench
from .bench_view import BoardsInView
from .diffuser import behind_diffuser
from .light import frame_buffer
from .picture_store import PictureStore
from .sensor import counts
from .settings import CameraFaults, SimulatedCameraSettings
from .stream import Stream
from .tank import SimulatedTank
from .triggered import TriggeredStream

_EXPOSURE_STEP_MS = 0.1
_CLOCK_AHEAD_NS = 5_000_000_000
_LOOK_S = 0.002


class SimulatedCamera:
    """Implements `tankrig.devices.CameraDevice` and `TriggeredCamera`.

    It streams all the time, like a video camera: see `Stream`. What a frame shows is worked out when the program takes
    it, from what was in the frame buffer while it was exposed; working out a picture that was not seen before takes
    the Monte Carlo's time, for which the stream is held, so that no frames are lost to it.

    Parameters
    ----------
    settings
        From the rig file.

    Attributes
    ----------
    faults
        In force now; may be replaced at any time.
    tank
        What it looks at.
    before_lens
        What a person has put before its lens: "nothing", a "cap", a "diffuser" that the projector lights, or the
        "diffuser turned" by half a turn.
    """

    BEFORE_LENS = ("nothing", "cap", "diffuser", "diffuser turned")

    def __init__(self, settings: SimulatedCameraSettings) -> None:
        self._settings = settings
        self.faults: CameraFaults = settings.faults
        self._boards, view = _bench(settings)
        self.tank = SimulatedTank(settings.truth, settings.folder / "state", settings.seed, view)
        self.before_lens = "nothing"
        self._buffer = frame_buffer(settings.folder)
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._handed_out, self._number = 0, 0
        self._frozen: NDArray[np.uint16] = np.zeros(self.shape, np.uint16)
        self._configured = CameraSettings(exposure_ms=20.0)
        self._armed: TriggeredStream | None = None
        self._start_stream()

    @property
    def name(self) -> str:
        """For messages."""
        return f"simulated camera of {self._settings.folder}"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        boards = self._settings.boards
        return boards.camera_shape if boards else self._settings.truth.bench.camera.shape

    @property
    def saturation(self) -> int:
        """The count at which pixels saturate."""
        return self._settings.sensor.saturation

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set exposure and gain, as near as the camera can; returns what is set.

        Raises
        ------
        DeviceError
            If a value is not positive, the camera is gone or closed, or a capture is under way.
        """
        for name, value in (("exposure_ms", settings.exposure_ms), ("gain", settings.gain)):
            if not (math.isfinite(value) and value > 0.0):
                raise DeviceError(f"{self.name}: cannot set {name} to {value}; give a positive number")
        with self._my_turn("configure"):
            least_ms, most_ms = self._settings.exposure_range_ms
            exposure_ms = round(settings.exposure_ms / _EXPOSURE_STEP_MS) * _EXPOSURE_STEP_MS
            gain = min(max(settings.gain, self._settings.gain_range[0]), self._settings.gain_range[1])
            self._configured = CameraSettings(round(min(max(exposure_ms, least_ms), most_ms), 6), gain)
            self._start_stream()
            return self._configured

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        """First frame whose exposure began after `after_ns`.

        Raises
        ------
        DeviceError
            If none arrives within `timeout_s`, the camera is gone or closed, or another capture is under way.
        """
        deadline_ns = time.monotonic_ns() + int(timeout_s * 1e9)
        with self._my_turn("capture"):
            if self._armed is not None:
                raise DeviceError(f"{self.name}: exposes on triggers only; disarm it first")
            number = self._next(after_ns, deadline_ns, timeout_s)
            self._number = number + 1
            start_ns = self._stream.start_ns(number)
            pixels = self._pixels(number, start_ns)
            self._require_there()
            self._handed_out += 1
            return Frame(pixels, start_ns, start_ns + _CLOCK_AHEAD_NS, time.monotonic_ns(), number)

    def arm(self) -> None:
        """Expose once for each trigger from now on, and no more by itself; drop what waits from before.

        Raises
        ------
        DeviceError
            If the camera is gone or closed, or a capture is under way.
        """
        with self._my_turn("be armed"):
            period_ns = max(self._exposure_ns(), self._ns(1000.0 / self._settings.most_per_s))
            self._armed = TriggeredStream(time.monotonic_ns(), period_ns)

    def triggered(self, timeout_s: float) -> Frame | None:
        """The next exposure, in order; None when no trigger came, or its frame did not arrive, within `timeout_s`.

        Raises
        ------
        DeviceError
            If the camera is not armed, is gone or closed, or a capture is under way.
        """
        deadline_ns = time.monotonic_ns() + int(timeout_s * 1e9)
        with self._my_turn("wait for a trigger"):
            start_ns = self._next_triggered(deadline_ns)
            if start_ns is None:
                return None
            number, self._number = self._number, self._number + 1
            pixels = self._pixels(number, start_ns)
            self._handed_out += 1
            return Frame(pixels, start_ns, start_ns + _CLOCK_AHEAD_NS, time.monotonic_ns(), number)

    def disarm(self) -> None:
        """Expose freely again; may be called any number of times."""
        with self._my_turn("be disarmed"):
            if self._armed is not None:
                self._armed = None
                self._start_stream()

    def close(self) -> None:
        """Stop streaming; wakes a capture that waits."""
        self._closed.set()

    def _start_stream(self) -> None:
        exposure_ns, latency_ns = self._exposure_ns(), self._ns(self._settings.latency_ms)
        period_ns = max(exposure_ns, self._ns(1000.0 / self._settings.most_per_s))
        delay_ns = exposure_ns + latency_ns
        self._stream = Stream(time.monotonic_ns(), self._number, period_ns, delay_ns, self._settings.queue)

    def _next(self, after_ns: int, deadline_ns: int, timeout_s: float) -> int:
        """Wait for the exposure that is to be handed out."""
        while True:
            self._require_there()
            number = self._stream.take(time.monotonic_ns())
            arrival_ns = self._stream.arrival_ns(number)
            if arrival_ns > deadline_ns or self._is("silent"):
                self._stream.give_back(number)
                self._wait(deadline_ns)
                raise DeviceError(f"{self.name}: gave no frame within {timeout_s:g} s; check its cable and exposure")
            self._wait(arrival_ns)
            if np.random.default_rng((self._settings.seed, 2, number)).random() < self.faults.dropped:
                continue
            if self._stream.start_ns(number) > after_ns or self._is("stale"):
                return number

    def _next_triggered(self, deadline_ns: int) -> int | None:
        """Start of the next exposure that arrives in time."""
        if self._armed is None:
            raise DeviceError(f"{self.name}: waits for no triggers; arm it first")
        while True:
            start_ns = None if self._is("silent") else self._armed.take(self._buffer.triggers(0))
            if start_ns is None:
                if time.monotonic_ns() > deadline_ns:
                    return None
                self._wait(time.monotonic_ns() + int(_LOOK_S * 1e9))
                continue
            self._wait(start_ns + self._exposure_ns() + self._ns(self._settings.latency_ms))
            if np.random.default_rng((self._settings.seed, 2, self._number)).random() >= self.faults.dropped:
                return start_ns
            self._number += 1

    def _pixels(self, number: int, start_ns: int) -> NDArray[np.uint16]:
        if self._is("frozen"):
            pixels = self._frozen.copy()
        else:
            pixels = self._exposed(number, start_ns)
            self._frozen = pixels.copy()
        if self._is("saturated"):
            pixels[:] = self.saturation
        return pixels[:-1].copy() if self._is("misshapen") else pixels

    def _exposed(self, number: int, start_ns: int) -> NDArray[np.uint16]:
        began_ns = time.monotonic_ns()
        shown = self._buffer.shown(start_ns, start_ns + self._exposure_ns())
        radiance = self._radiance(shown, start_ns)
        random = np.random.default_rng((self._settings.seed, 3, number))
        pixels = counts(radiance, self._settings.sensor, self._configured, random)
        self._stream.hold(time.monotonic_ns() - began_ns)
        return pixels

    def put(self, what: str) -> None:
        """Put one of `BEFORE_LENS` before the lens, as a person would at a real camera.

        Raises
        ------
        DeviceError
            If it is none of them.
        """
        if what not in self.BEFORE_LENS:
            raise DeviceError(f"{self.name}: has no {what} to put before it; give one of {', '.join(self.BEFORE_LENS)}")
        self.before_lens = what
        with self._my_turn("look elsewhere"):
            self._start_stream()  # none that waits was exposed to the new light

    def hold(self, place: Held, number: int = 0) -> None:
        """Hold the board before the camera, as a person would at a real one.

        Parameters
        ----------
        place
            Where; see `Place`. "nothing" takes it away.
        number
            Of the view.

        Raises
        ------
        DeviceError
            If the rig file gives it no bench for boards.
        """
        if self._boards is None:
            raise DeviceError(
                f"{self.name}: no board can be held before it; give the rig file a table [camera.boards], or "
                f"leave --rig out to use the one that ships"
            )
        self._boards.hold(place, number)
        with self._my_turn("look elsewhere"):
            self._start_stream()

    def _radiance(self, shown: Mapping[Pattern, float], start_ns: int) -> NDArray[np.float64]:
        if self._boards is not None and self._boards.held and self.before_lens == "nothing":
            return self._boards.radiance(shown)
        if self.before_lens == "nothing":
            return self.tank.seen(shown, start_ns)
        if self.before_lens == "cap":
            return np.zeros(self.shape)
        bench = self._boards.bench if self._boards else None
        return behind_diffuser(shown, self._settings.truth, self.before_lens == "diffuser turned", bench)

    @contextmanager
    def _my_turn(self, what: str) -> Iterator[None]:
        self._require_there()
        if not self._lock.acquire(blocking=False):
            raise DeviceError(f"{self.name}: cannot {what} while a capture is under way; let one owner have the camera")
        try:
            yield
        finally:
            self._lock.release()

    def _wait(self, until_ns: int) -> None:
        self._closed.wait(max(0, until_ns - time.monotonic_ns()) / 1e9)
        self._require_there()

    def _require_there(self) -> None:
        if self._closed.is_set():
            raise DeviceError(f"{self.name}: is closed; open it again")
        if self._is("unplugged"):
            raise DeviceError(f"{self.name}: is gone; plug it in and open it again")

    def _is(self, fault: str) -> bool:
        first: int | None = getattr(self.faults, f"{fault}_from")
        return first is not None and self._handed_out >= first

    def _exposure_ns(self) -> int:
        return self._ns(self._configured.exposure_ms)

    def _ns(self, time_ms: float) -> int:
        return max(1, round(time_ms * self._settings.time_scale * 1e6))


def _bench(settings: SimulatedCameraSettings) -> tuple[BoardsInView | None, InkInView | None]:
    """What stands in place of the tank of `Truth.bench`, where there is a bench: boards, and ink through its optics."""
    bench, boards = true_bench(settings), settings.boards
    if bench is None or boards is None:
        return None, None
    store = PictureStore(settings.folder / "pictures")
    ink = InkInView(bench, settings.truth.tolerance, settings.seed, store, repr(boards))
    return BoardsInView(bench, boards.board), ink

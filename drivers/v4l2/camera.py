"""A V4L2 camera: frames by the time at which their exposure began, and never one that only may be right."""

import math
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.devices import CameraSettings, Frame
from tankrig.errors import DeviceError

from .exposure import Exposure
from .node import GONE, Control, Node, explained
from .pixels import FORMATS
from .settings import V4l2CameraSettings
from .stream import Filled, Stream, StreamBrokenError
from .times import FrameCount, FrameTimes

_STALL_S = 1.0
_RESTART_PAUSE_S = 0.02
_CLOCK_TOLERANCE_NS = 1_000_000
_SLOWEST_READOUT_NS = 100_000_000
_SETTLE_FRAMES = 3
_FOLLOWED_FRAMES = 24
_FOLLOW_TIMEOUT_S = 5.0


@dataclass
class _Wait:
    """How long a capture waits for a frame, and what was wrong with those that came.

    Parameters
    ----------
    timeout_s, deadline_ns
        Of the whole capture.
    since_ns
        When the last frame came that could be true, or the waiting began.
    stall_ns
        How long none may come.
    good
        Whether any could.
    fault, remedy
        Of the last frame, where it could not be true.
    """

    timeout_s: float
    deadline_ns: int
    since_ns: int
    stall_ns: int
    good: bool = False
    fault: str = ""
    remedy: str = ""

    @property
    def left_s(self) -> float:
        """Until the deadline, or until no frame has come for too long."""
        return (min(self.deadline_ns, self.since_ns + self.stall_ns) - time.monotonic_ns()) / 1e9

    @property
    def stalled(self) -> bool:
        """Whether no frame that could be true has come for too long."""
        return time.monotonic_ns() >= self.since_ns + self.stall_ns

    def met(self, fault: str, remedy: str) -> None:
        """A frame came, or the stream broke off."""
        self.fault, self.remedy = fault, remedy

    def came(self) -> None:
        """A frame came that can be true."""
        self.since_ns, self.good, self.fault = time.monotonic_ns(), True, ""


class V4l2Camera:
    """Implements `tankrig.devices.CameraDevice`.

    A camera that was unplugged is opened again, by its path, with the next call; it must be the same model.

    Parameters
    ----------
    settings
        From the rig file.

    Raises
    ------
    DeviceError
        When it is not there, is not the one described, or does not give what was asked for.
    """

    def __init__(self, settings: V4l2CameraSettings) -> None:
        self._settings = settings
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._wake = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._card = settings.card
        self._settle_frames = settings.settle_frames
        self._following = False
        self._node: Node | None = None
        self._stream: Stream | None = None
        self._asked = CameraSettings(exposure_ms=20.0)
        self._count = FrameCount()
        self._frame_ns = 0
        try:
            self._open()
        except BaseException:
            os.close(self._wake)
            raise

    @property
    def name(self) -> str:
        """For messages."""
        return str(self._settings.device)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns), as turned."""
        rows, columns = self._settings.shape
        if FORMATS[self._settings.format].mosaic:
            rows, columns = rows // 2, columns // 2
        return (columns, rows) if self._settings.turn_deg % 180 else (rows, columns)

    @property
    def saturation(self) -> int:
        """The count at which pixels saturate."""
        return self._settings.saturation

    @property
    def settle_frames(self) -> int:
        """How many of the frames that begin after a change of settings may have the old ones, and are passed over."""
        if self._settle_frames is not None:
            return self._settle_frames
        return _SETTLE_FRAMES + (self._stream.buffers if self._stream is not None else 0)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Set exposure and gain, as near as the camera can; returns what it says is set.

        Frames that may still have the old settings are not handed out.

        Raises
        ------
        DeviceError
            If a value is not positive, the camera refuses it, is gone or closed, or a capture is under way.
        """
        for name, value in (("exposure_ms", settings.exposure_ms), ("gain", settings.gain)):
            if not (math.isfinite(value) and value > 0.0):
                raise DeviceError(f"{self.name}: cannot set {name} to {value}; give a positive number")
        with self._my_turn("configure"):
            self._opened()
            return self._set(settings)

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        """First frame whose exposure began after `after_ns`.

        Raises
        ------
        DeviceError
            If none arrives within `timeout_s`, or none at all for 1 s; if the camera is gone or closed, its frames are
            damaged, or their timestamps cannot be true; if another capture is under way.
        """
        now_ns = time.monotonic_ns()
        with self._my_turn("capture"):
            exposure, stream = self._opened()
            deadline_ns = now_ns + int(timeout_s * 1e9)
            wait = _Wait(timeout_s, deadline_ns, now_ns, int(_STALL_S * 1e9) + 2 * self._slowest_ns)
            while True:
                filled = self._next(stream, wait)
                frame = self._count.next(filled.sequence)
                start_ns = self._start_ns(stream, filled, frame, wait)
                if start_ns is not None and start_ns > after_ns and self._settled(filled, frame, start_ns):
                    pixels = self._pixels(stream, filled)
                    self._require_held(exposure)
                    return Frame(pixels, start_ns, filled.stamped_ns, filled.host_ns, frame)
                stream.drop(filled)

    def frames_to_follow(self, exposure_ms: float = 5.0) -> int | None:
        """How many frames that begin after a change of exposure still have the old one, told by their brightness.

        Leaves the settings as they were.

        Parameters
        ----------
        exposure_ms
            Changes to three times as much.

        Returns
        -------
        int or None
            None where it is too dark or too bright to tell.

        Raises
        ------
        DeviceError
            As of `configure` and `capture`.
        """
        with self._my_turn("configure"):
            before, allowed = self._opened()[0].actual, self._settle_frames
            timeout_s = _FOLLOW_TIMEOUT_S + 2e-9 * _FOLLOWED_FRAMES * self._slowest_ns

        def brightness(frame: Frame) -> float:
            return float(frame.pixels.mean())

        try:
            self._settle_frames = _FOLLOWED_FRAMES
            short = self.configure(CameraSettings(exposure_ms, before.gain))
            old = brightness(self.capture(time.monotonic_ns(), timeout_s))
            self._settle_frames, self._following = 0, True
            self.configure(CameraSettings(3.0 * short.exposure_ms, before.gain))
            frames = [self.capture(0, timeout_s)]
            while len(frames) < _FOLLOWED_FRAMES:
                frames.append(self.capture(frames[-1].exposure_start_ns, timeout_s))
        finally:
            self._settle_frames, self._following = allowed, False
            self.configure(before)
        new = float(np.median([brightness(frame) for frame in frames[-_FOLLOWED_FRAMES // 4 :]]))
        if new - old < 0.02 * self.saturation or new > 0.95 * self.saturation:
            return None
        late = [frame.sequence for frame in frames if brightness(frame) < (old + new) / 2.0]
        return late[-1] - frames[0].sequence + 1 if late else 0

    def close(self) -> None:
        """Stop streaming; wakes a capture that waits."""
        if self._closed.is_set():
            return
        self._closed.set()
        os.eventfd_write(self._wake, 1)
        if self._lock.acquire(timeout=3.0 * _STALL_S):
            try:
                self._let_go()
                os.close(self._wake)
            finally:
                self._lock.release()

    def _open(self) -> None:
        settings = self._settings
        self._node = node = Node(settings.device)
        try:
            if self._card is not None and node.card != self._card:
                raise DeviceError(f'{self.name}: is a "{node.card}" and not the "{self._card}"; plug that one in')
            controls = node.controls()
            self._stream = Stream(node, settings, self._wake)
            self._card = node.card
            self._count.interrupted()
            for name, value in settings.controls.items():
                self._require_taken(node, controls, name, int(value))
            self._exposure = Exposure(node, controls, settings.gain_one)
            self._set(self._asked, anew=True)
        except OSError as error:
            self._let_go()
            raise explained(settings.device, error) from error
        except BaseException:
            self._let_go()
            raise

    def _require_taken(self, node: Node, controls: dict[str, Control], name: str, value: int) -> None:
        if name not in controls:
            raise DeviceError(f"{self.name}: has no control {name!r}; it has {', '.join(controls)}")
        if node.write(controls[name], value) != value:
            raise DeviceError(
                f"{self.name}: control {name} does not take the value {value}; correct camera.controls in the rig file"
            )

    def _opened(self) -> tuple[Exposure, Stream]:
        if self._node is None:
            self._open()
        assert self._stream is not None
        return self._exposure, self._stream

    def _let_go(self) -> None:
        stream, node, self._stream, self._node = self._stream, self._node, None, None
        if stream is not None:
            stream.close()
        if node is not None:
            node.close()

    # Settings

    def _set(self, settings: CameraSettings, anew: bool = False) -> CameraSettings:
        """Set what differs, and from then on expect frames with it; `anew` where the camera was opened just now."""
        before_ns = 0 if anew else self._exposure.changed_ns
        try:
            self._exposure.set(settings)
        finally:  # some of it may have been set where the rest was refused
            if self._exposure.changed_ns != before_ns:
                self._expect_frames()
        self._asked = settings
        return self._exposure.actual

    def _expect_frames(self) -> None:
        """From now on frames count only when they can't have the settings of before, and have the times of these."""
        assert self._stream is not None
        self._settled_from: int | None = None
        self._unproven = True
        before_ns, self._frame_ns = self._frame_ns, max(self._exposure_ns, self._stream.period_ns)
        self._slowest_ns = max(before_ns, self._frame_ns)
        self._times = FrameTimes(self._frame_ns)
        # The end of a frame comes at most a frame's time, in which it is read out, after the end of its exposure.
        readout_ns = max(self._exposure_ns, self._stream.period_ns or _SLOWEST_READOUT_NS)
        self._started_before_ns = 0 if self._marks_start else self._exposure_ns + readout_ns

    def _settled(self, filled: Filled, frame: int, start_ns: int) -> bool:
        """Whether a frame was taken with the settings of now: by the buffer it is in, by its time and by its number."""
        if start_ns <= self._exposure.changed_ns:
            return False
        if self._settled_from is None:
            self._settled_from = frame + self.settle_frames
        fresh = filled.given_ns >= self._exposure.changed_ns
        return frame >= self._settled_from and (fresh or self._following)

    def _require_held(self, exposure: Exposure) -> None:
        """That the settings stay, looked at once after each change."""
        if self._unproven:
            exposure.require_held()
            self._unproven = False

    # Frames

    def _next(self, stream: Stream, wait: _Wait) -> Filled:
        """The next frame that is whole."""
        while True:
            self._require_open()
            if (left_s := wait.left_s) <= 0.0:
                raise self._nothing(wait)
            try:
                filled = stream.next(left_s)
            except StreamBrokenError as broken:
                wait.met(f"its stream broke off ({broken})", "unplug it, plug it in again, and try another cable")
                self._count.interrupted()
                self._closed.wait(_RESTART_PAUSE_S)
                stream.begin_again()
                continue
            if filled is None:
                continue
            if not filled.fault:
                return filled
            self._count.next(filled.sequence)
            wait.met(f"a frame {filled.fault}", "use a shorter cable, or a port that it shares with nothing")
            stream.drop(filled)

    def _start_ns(self, stream: Stream, filled: Filled, frame: int, wait: _Wait) -> int | None:
        """When the exposure of a frame began, at the latest; None when its time stamp can't be true."""
        marked_ns = self._times.began_ns(frame, filled.stamped_ns)
        if marked_ns is None:
            wait.met("a frame is older than the one before", "its timestamps are of no use, so use another camera")
            return None
        start_ns = marked_ns - self._started_before_ns
        known = self._marks_start and not self._following and self._settled(filled, frame, start_ns)
        early_ns = marked_ns + (self._exposure_ns if known else 0) - filled.host_ns
        if early_ns > _CLOCK_TOLERANCE_NS:
            stream.drop(filled)
            raise DeviceError(
                f"{self.name}: a frame arrived {early_ns / 1e6:.1f} ms before its exposure can have ended, so its "
                f"timestamp or exposure is not what the camera says; set camera.timestamps = 'end' or a larger "
                f"camera.settle_frames in the rig file, or use another camera"
            )
        wait.came()
        return start_ns

    def _nothing(self, wait: _Wait) -> DeviceError:
        """Why there was no frame."""
        waited_s = (time.monotonic_ns() - wait.since_ns) / 1e9
        if wait.fault and (wait.stalled or not wait.good):
            return DeviceError(f"{self.name}: gave no good frame for {waited_s:.1f} s: {wait.fault}; {wait.remedy}")
        if wait.stalled:
            self._let_go()
            return DeviceError(
                f"{self.name}: gave no frame for {waited_s:.1f} s; check its cable, and that no other device takes "
                f"up its USB bus"
            )
        return DeviceError(
            f"{self.name}: gave no frame that began late enough within {wait.timeout_s:g} s; allow more time, or a "
            f"shorter exposure"
        )

    def _pixels(self, stream: Stream, filled: Filled) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Turned as the rig file says: an array of their own."""
        settings, format_ = self._settings, FORMATS[self._settings.format]
        clipped = 2**settings.pixel_bits - 1
        counts = stream.read(filled)
        if int(counts.max()) > clipped:
            raise DeviceError(
                f"{self.name}: gave the count {counts.max()} where {clipped} is the highest; correct camera.bits in "
                f"the rig file"
            )
        pixels: NDArray[Any] = np.rot90(format_.grey(counts, settings.bayer, clipped), settings.turn_deg // 90)
        return np.ascontiguousarray(pixels[:, ::-1] if settings.mirror else pixels)

    @property
    def _marks_start(self) -> bool:
        """Whether time stamps mark the start of the exposure."""
        assert self._stream is not None
        told = self._settings.timestamps
        return self._stream.marks_start if told is None else told == "start"

    @property
    def _exposure_ns(self) -> int:
        return round(self._exposure.actual.exposure_ms * 1e6)

    @contextmanager
    def _my_turn(self, what: str) -> Iterator[None]:
        self._require_open()
        if not self._lock.acquire(blocking=False):
            raise DeviceError(f"{self.name}: cannot {what} while a capture is under way; let one owner have the camera")
        try:
            self._require_open()
            yield
        except OSError as error:
            self._let_go()
            if error.errno in GONE:
                raise DeviceError(f"{self.name}: is gone; plug the camera in again") from error
            raise explained(self._settings.device, error) from error
        finally:
            self._lock.release()

    def _require_open(self) -> None:
        if self._closed.is_set():
            raise DeviceError(f"{self.name}: is closed; open it again")

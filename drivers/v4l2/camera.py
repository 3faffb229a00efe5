"""A V4L2 camera: frames by the time at which their exposure began, and never one that only may be right."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from tankrig.devices import CameraSettings, Frame
from tankrig.errors import DeviceError

from .node import Node, Stamp
from .settings import V4l2CameraSettings
from .stream import SELECT_TIMEOUT_S, FrameStream
from .times import FrameCount, FrameTimes

_STALL_S = 1.0
_EXPOSURE_UNIT_MS = 0.1
_MANUAL = 1
_CLOCK_TOLERANCE_NS = 1_000_000
_AUTO_EXPOSURE = ("auto_exposure", "exposure_auto")
_EXPOSURE = ("exposure_time_absolute", "exposure_absolute")
_GAIN = ("gain", "analogue_gain")


class V4l2Camera:
    """Implements `tankrig.devices.Camera`.

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
        self._turn = threading.Lock()
        self._card = settings.card
        self._node: Node | None = None
        self._stream: FrameStream | None = None
        self._configured = CameraSettings(exposure_ms=20.0)
        self._count = FrameCount()
        self._not_before_ns = 0
        self._open()

    @property
    def name(self) -> str:
        """For messages."""
        return str(self._settings.device)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns), as turned."""
        rows, columns = self._settings.shape
        return (columns, rows) if self._settings.turn_deg % 180 else (rows, columns)

    @property
    def saturation(self) -> int:
        """The count at which pixels saturate."""
        return self._settings.saturation

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
            return self._apply(self._opened()[0], settings)

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        """First frame whose exposure began after `after_ns`.

        Raises
        ------
        DeviceError
            If none arrives within `timeout_s`, or none at all for 1 s; if the camera is gone or closed, or its
            timestamps cannot be true; if another capture is under way.
        """
        deadline_ns = time.monotonic_ns() + int(timeout_s * 1e9)
        with self._my_turn("capture"):
            node, stream = self._opened()
            after_ns = max(after_ns, self._not_before_ns)
            while True:
                stamped_ns, host_ns = self._grab(node, stream)
                frame = self._count.next(node.sequence(stamped_ns))
                start_ns = self._start_ns(frame, stamped_ns, host_ns)
                if start_ns > after_ns:
                    return Frame(stream.pixels(), start_ns, stamped_ns, host_ns, frame)
                if host_ns > deadline_ns:
                    raise DeviceError(
                        f"{self.name}: gave no frame that began late enough within {timeout_s:g} s; allow more time, "
                        f"or a shorter exposure"
                    )

    def close(self) -> None:
        """Stop streaming; wakes a capture that waits."""
        self._closed.set()
        if self._turn.acquire(timeout=3.0 * SELECT_TIMEOUT_S):
            try:
                self._let_go()
            finally:
                self._turn.release()

    def _open(self) -> None:
        node = Node(self._settings.device)
        try:
            if self._card is not None and node.card != self._card:
                raise DeviceError(f'{self.name}: is a "{node.card}" and not the "{self._card}"; plug that one in')
            stream = FrameStream(self._settings, node.formats)
            self._count.stream_began()
            self._node, self._stream, self._card = node, stream, node.card
            for name, value in self._settings.controls.items():
                if node.set(name, int(value)) != int(value):
                    raise DeviceError(
                        f"{self.name}: control {name} does not take the value {value}; correct camera.controls in the "
                        f"rig file"
                    )
            self._stamp = node.stamp()
            self._nominal_ns = stream.period_ns
            self._apply(node, self._configured)
        except BaseException:
            node.close()
            self._let_go()
            raise

    def _opened(self) -> tuple[Node, FrameStream]:
        if self._node is None:
            self._open()
        assert self._node is not None
        assert self._stream is not None
        return self._node, self._stream

    def _let_go(self) -> None:
        stream, node, self._stream, self._node = self._stream, self._node, None, None
        if stream is not None:
            stream.close()
        if node is not None:
            node.close()

    def _apply(self, node: Node, settings: CameraSettings) -> CameraSettings:
        auto, exposure, gain = node.first_of(*_AUTO_EXPOSURE), node.first_of(*_EXPOSURE), node.first_of(*_GAIN)
        if exposure is None:
            raise DeviceError(f"{self.name}: its exposure cannot be set; use another camera")
        if auto is not None and node.set(auto, _MANUAL) != _MANUAL:
            raise DeviceError(f"{self.name}: does not let go of automatic exposure; use another camera")
        least, most = node.range(exposure)
        ticks = node.set(exposure, round(min(max(settings.exposure_ms / _EXPOSURE_UNIT_MS, least), most)))
        factor = 1.0
        if gain is not None:
            least, most = node.range(gain)
            one = self._settings.gain_one or max(least, 1)
            factor = node.set(gain, round(min(max(settings.gain * one, least), most))) / one
        self._configured = CameraSettings(round(ticks * _EXPOSURE_UNIT_MS, 6), factor)
        frame_ns = max(self._exposure_ns, self._nominal_ns)
        self._not_before_ns = time.monotonic_ns() + self._settings.settle_frames * frame_ns
        # The end of a frame comes at most a frame's time, in which it is read out, after the end of its exposure.
        self._started_before_ns = 0 if self._stamp is Stamp.START_OF_EXPOSURE else self._exposure_ns + frame_ns
        self._times = FrameTimes(frame_ns)
        return self._configured

    def _grab(self, node: Node, stream: FrameStream) -> tuple[int, int]:
        """Timestamp and arrival of the next frame."""
        asked_ns = time.monotonic_ns()
        while (stamped_ns := stream.grab()) is None:
            self._require_open()
            if not node.present:
                self._let_go()
                raise DeviceError(f"{self.name}: is gone; plug the camera in again")
            waited_s = (time.monotonic_ns() - asked_ns) / 1e9
            if waited_s > _STALL_S + 2e-9 * max(self._exposure_ns, self._nominal_ns):
                self._let_go()
                raise DeviceError(
                    f"{self.name}: gave no frame for {waited_s:.1f} s; check its cable, and that no other device takes "
                    f"up its USB bus"
                )
        self._require_open()
        host_ns = time.monotonic_ns()
        return stamped_ns, host_ns

    def _start_ns(self, frame: int, stamped_ns: int, host_ns: int) -> int:
        """When the exposure of a frame began, at the latest."""
        marked_ns = self._times.began_ns(frame, stamped_ns)
        settled = stamped_ns >= self._not_before_ns
        exposed_ns = self._exposure_ns if settled and self._stamp is Stamp.START_OF_EXPOSURE else 0
        if marked_ns is None:
            how = "is older than the one before"
        elif (early_ns := marked_ns + exposed_ns - host_ns) > _CLOCK_TOLERANCE_NS:
            how = f"arrived {early_ns / 1e6:.1f} ms before its exposure can have ended"
        else:
            return marked_ns - self._started_before_ns
        raise DeviceError(
            f"{self.name}: a frame {how}, so its timestamp or exposure is not what the camera says; use another"
        )

    @property
    def _exposure_ns(self) -> int:
        return round(self._configured.exposure_ms * 1e6)

    @contextmanager
    def _my_turn(self, what: str) -> Iterator[None]:
        self._require_open()
        if not self._turn.acquire(blocking=False):
            raise DeviceError(f"{self.name}: cannot {what} while a capture is under way; let one owner have the camera")
        try:
            yield
        finally:
            self._turn.release()

    def _require_open(self) -> None:
        if self._closed.is_set():
            raise DeviceError(f"{self.name}: is closed; open it again")

"""A camera's stream: buffers shared with the kernel, filled in turn, each judged by what the kernel says of it."""

import ctypes
import errno
import math
import mmap
import select
import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import DeviceError

from . import videodev2 as v4l2
from .node import Node
from .pixels import FORMATS
from .settings import V4l2CameraSettings

_ASKED_BUFFERS = 4
_FEWEST_BUFFERS = 2
_BROKEN = (errno.EIO, errno.EINVAL, errno.EPIPE, errno.EPROTO)


class StreamBrokenError(Exception):
    """The stream gives no more frames until it is begun again."""


@dataclass(frozen=True)
class Filled:
    """A buffer that the kernel has filled.

    Parameters
    ----------
    index
        Of the buffer.
    sequence
        The kernel's count of the frame, 32 bits.
    stamped_ns
        The frame's time stamp, on the monotonic clock.
    host_ns
        When it was taken out of the queue.
    given_ns
        When the buffer had been given to the kernel.
    fault
        Why the frame is no picture; empty where it is one.
    """

    index: int
    sequence: int
    stamped_ns: int
    host_ns: int
    given_ns: int
    fault: str


class Stream:
    """Streams from its making to `close`.

    Parameters
    ----------
    node
        The camera's; stays open when the stream is closed.
    settings
        From the rig file.
    wake
        A file descriptor; when it becomes readable, `next` ends.

    Raises
    ------
    DeviceError
        When the camera does not give what was asked for.
    OSError
        What the kernel refused with.
    """

    def __init__(self, node: Node, settings: V4l2CameraSettings, wake: int) -> None:
        self._node, self._settings, self._wake = node, settings, wake
        self._maps: list[mmap.mmap] = []
        self._given_ns: list[int] = []
        self._line_bytes = self._whole_line()
        self._bytes_per_line = self._set_format()
        self.period_ns = self._set_rate()
        try:
            self._take_buffers()
            self.marks_start = self._require_monotonic()
            self._poll = select.poll()
            self._poll.register(node.fd, select.POLLIN)
            self._poll.register(wake, select.POLLIN)
            self._begin()
        except BaseException:
            self.close()
            raise

    @property
    def buffers(self) -> int:
        """How many frames the kernel's queue holds."""
        return len(self._maps)

    def next(self, timeout_s: float) -> Filled | None:
        """The next filled buffer, to be given back with `read` or `drop`; None after `timeout_s`, or when woken.

        Raises
        ------
        StreamBrokenError
            When there will be none before `begin_again`.
        OSError
            When the camera is gone.
        """
        ready = dict(self._poll.poll(max(0, math.ceil(timeout_s * 1e3))))
        found = ready.get(self._node.fd, 0)
        if self._wake in ready or not found:
            return None
        buffer = _buffer()
        try:
            self._node.ask(v4l2.VIDIOC_DQBUF, buffer)
        except BlockingIOError:
            if found & select.POLLERR:
                raise StreamBrokenError("stopped by the kernel") from None
            return None
        except OSError as error:
            if error.errno in _BROKEN:
                raise StreamBrokenError(error.strerror) from error
            raise
        return Filled(
            index=buffer.index,
            sequence=buffer.sequence,
            stamped_ns=(buffer.timestamp.tv_sec * 1_000_000 + buffer.timestamp.tv_usec) * 1_000,
            host_ns=time.monotonic_ns(),
            given_ns=self._given_ns[buffer.index],
            fault=self._fault(buffer),
        )

    def read(self, filled: Filled) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """The counts of all its pixels, an array of their own; gives the buffer back."""
        settings = self._settings
        size = self._picture_bytes()
        own = np.frombuffer(self._maps[filled.index], np.uint8, size).copy()
        self.drop(filled)
        return FORMATS[settings.format].counts(own, settings.shape, self._bytes_per_line)

    def drop(self, filled: Filled) -> None:
        """Give the buffer back."""
        self._give(filled.index)

    def begin_again(self) -> None:
        """Stop and begin; frames that the queue held are lost."""
        self._node.ask(v4l2.VIDIOC_STREAMOFF, _capture_type())
        self._begin()

    def close(self) -> None:
        """Stop streaming and let go of the buffers, whether or not the camera is still there."""
        with suppress(OSError):  # where it is gone
            self._node.ask(v4l2.VIDIOC_STREAMOFF, _capture_type())
        while self._maps:
            self._maps.pop().close()
        with suppress(OSError):  # the kernel frees no buffers that are mapped
            self._node.ask(v4l2.VIDIOC_REQBUFS, _request(0))

    def _whole_line(self) -> int:
        """Bytes of a line without what pads it."""
        settings, wanted = self._settings, FORMATS[self._settings.format]
        rows, columns = settings.shape
        used = wanted.line_bytes(columns)
        step = max(wanted.packing.pixels, 2 if wanted.mosaic else 1)
        if used is None or columns % step or (wanted.mosaic and rows % 2):
            raise DeviceError(
                f"{settings.device}: pictures in {settings.format} have a multiple of {step} columns"
                f"{' and of 2 rows' if wanted.mosaic else ''}; correct camera.shape in the rig file"
            )
        return used

    def _set_format(self) -> int:
        """Ask for the rig file's format; returns the bytes per line that the camera chose."""
        settings, wanted = self._settings, FORMATS[self._settings.format]
        rows, columns = settings.shape
        asked = v4l2.Format(type=v4l2.V4L2_BUF_TYPE_VIDEO_CAPTURE)
        pix = asked.fmt.pix
        pix.width, pix.height, pix.pixelformat, pix.field = columns, rows, wanted.code, v4l2.V4L2_FIELD_NONE
        self._node.ask(v4l2.VIDIOC_S_FMT, asked)
        if pix.pixelformat != wanted.code:
            raise DeviceError(
                f"{settings.device}: does not give format {settings.format}; it offers "
                f"{', '.join(self._node.formats)}: choose another camera.format in the rig file"
            )
        if (pix.height, pix.width) != settings.shape:
            offered = ", ".join(str(list(shape)) for shape in self._node.shapes(wanted.code))
            raise DeviceError(
                f"{settings.device}: gives {[pix.height, pix.width]} pixels (rows, columns) and not "
                f"{list(settings.shape)}; correct camera.shape in the rig file"
                f"{f': it offers {offered}' if offered else ''}"
            )
        if pix.field != v4l2.V4L2_FIELD_NONE:
            raise DeviceError(
                f"{settings.device}: gives interlaced pictures, whose lines are of two exposures; use another camera"
            )
        return max(int(pix.bytesperline), self._line_bytes)

    def _set_rate(self) -> int:
        """Ask for the rig file's frames per second; returns the period that the camera says, 0 where it says none."""
        settings, parm = self._settings, v4l2.StreamParm(type=v4l2.V4L2_BUF_TYPE_VIDEO_CAPTURE)
        frame = parm.parm.capture.timeperframe
        if settings.fps:
            frame.numerator, frame.denominator = 1_000, round(1_000 * settings.fps)
        try:
            self._node.ask(v4l2.VIDIOC_S_PARM if settings.fps else v4l2.VIDIOC_G_PARM, parm)
        except OSError as error:
            if error.errno not in (errno.ENOTTY, errno.EINVAL):
                raise
        told = parm.parm.capture.capability & v4l2.V4L2_CAP_TIMEPERFRAME and frame.denominator
        period_ns = round(1e9 * frame.numerator / frame.denominator) if told else 0
        fps = 1e9 / period_ns if period_ns else 0.0
        if settings.fps and abs(fps - settings.fps) > 0.02 * settings.fps:
            given = f"gives {fps:g} frames/s" if fps else "does not say how many frames/s it gives"
            raise DeviceError(
                f"{settings.device}: {given}, not {settings.fps:g}; correct camera.fps in the rig file, or leave it out"
            )
        return period_ns

    def _take_buffers(self) -> None:
        request = _request(_ASKED_BUFFERS)
        self._node.ask(v4l2.VIDIOC_REQBUFS, request)
        if request.count < _FEWEST_BUFFERS:
            raise DeviceError(
                f"{self._settings.device}: the kernel gives it {request.count} buffer, too few to stream; choose a "
                f"smaller camera.shape in the rig file"
            )
        for index in range(request.count):
            buffer = _buffer(index)
            self._node.ask(v4l2.VIDIOC_QUERYBUF, buffer)
            if buffer.length < self._picture_bytes():
                raise DeviceError(
                    f"{self._settings.device}: its driver's buffers of {buffer.length} bytes do not hold a picture of "
                    f"{self._picture_bytes()}; use another camera.format, or a newer kernel"
                )
            self._maps.append(mmap.mmap(self._node.fd, buffer.length, mmap.MAP_SHARED, offset=buffer.m.offset))
        self._given_ns = [0] * request.count

    def _require_monotonic(self) -> bool:
        """Whether time stamps mark the start of the exposure; else they mark the end of the frame."""
        buffer = _buffer(0)
        self._node.ask(v4l2.VIDIOC_QUERYBUF, buffer)
        if buffer.flags & v4l2.V4L2_BUF_FLAG_TIMESTAMP_MASK != v4l2.V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC:
            raise DeviceError(
                f"{self._settings.device}: its timestamps are not of the monotonic clock, so no frame can be paired "
                f"with a pattern; use a camera with driver uvcvideo, or a newer kernel"
            )
        return bool(buffer.flags & v4l2.V4L2_BUF_FLAG_TSTAMP_SRC_MASK == v4l2.V4L2_BUF_FLAG_TSTAMP_SRC_SOE)

    def _begin(self) -> None:
        for index in range(self.buffers):
            self._give(index)
        self._node.ask(v4l2.VIDIOC_STREAMON, _capture_type())

    def _give(self, index: int) -> None:
        self._given_ns[index] = time.monotonic_ns()
        self._node.ask(v4l2.VIDIOC_QBUF, _buffer(index))

    def _picture_bytes(self) -> int:
        """From the first pixel of a picture to its last."""
        return (self._settings.shape[0] - 1) * self._bytes_per_line + self._line_bytes

    def _fault(self, buffer: v4l2.Buffer) -> str:
        if buffer.flags & v4l2.V4L2_BUF_FLAG_ERROR:
            return "was marked as damaged by the kernel"
        if buffer.bytesused < self._picture_bytes():
            return f"had {buffer.bytesused} of {self._picture_bytes()} bytes"
        if buffer.timestamp.tv_sec == 0 and buffer.timestamp.tv_usec == 0:
            return "had no time stamp"
        return ""


def _buffer(index: int = 0) -> v4l2.Buffer:
    return v4l2.Buffer(index=index, type=v4l2.V4L2_BUF_TYPE_VIDEO_CAPTURE, memory=v4l2.V4L2_MEMORY_MMAP)


def _request(count: int) -> v4l2.RequestBuffers:
    return v4l2.RequestBuffers(count=count, type=v4l2.V4L2_BUF_TYPE_VIDEO_CAPTURE, memory=v4l2.V4L2_MEMORY_MMAP)


def _capture_type() -> ctypes.c_int32:
    return ctypes.c_int32(v4l2.V4L2_BUF_TYPE_VIDEO_CAPTURE)

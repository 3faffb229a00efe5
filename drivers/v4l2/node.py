"""A camera's device node: the kernel's answers in tankrig's words, and its errors in sentences."""

import ctypes
import errno
import fcntl
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tankrig.errors import DeviceError

from . import videodev2 as v4l2
from .pixels import format_name

GONE = (errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN)
"""Errors of a camera that was unplugged."""

_NUMERIC = (
    v4l2.V4L2_CTRL_TYPE_INTEGER,
    v4l2.V4L2_CTRL_TYPE_BOOLEAN,
    v4l2.V4L2_CTRL_TYPE_MENU,
    v4l2.V4L2_CTRL_TYPE_INTEGER64,
    v4l2.V4L2_CTRL_TYPE_BITMASK,
    v4l2.V4L2_CTRL_TYPE_INTEGER_MENU,
)
_REFUSALS = (errno.EINVAL, errno.ERANGE, errno.EACCES, errno.EBUSY, errno.EPERM)


class NoCameraError(DeviceError):
    """A device node that can't be a rig's camera: metadata, an encoder, or no video device at all."""


@dataclass(frozen=True)
class Control:
    """A number that can be set on a camera.

    Parameters
    ----------
    name
        As rig files give it: the kernel's in small letters, with underscores.
    id
        The kernel's.
    least, most
        Its range.
    wide
        Whether it has 64 bits.
    """

    name: str
    id: int
    least: int
    most: int
    wide: bool


class Node:
    """An open device node.

    Parameters
    ----------
    path
        Of the node.

    Raises
    ------
    DeviceError
        When there is none, this user may not open it, it does not answer, or (`NoCameraError`) it gives no pictures.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        about = v4l2.Capability()
        try:
            self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise explained(path, error) from error
        try:
            self.ask(v4l2.VIDIOC_QUERYCAP, about)
            self.card: str = about.card.decode("utf-8", "replace")
            _require_capture(path, about)
        except OSError as error:
            self.close()
            raise explained(path, error) from error
        except DeviceError:
            self.close()
            raise

    def ask(self, request: int, structure: Any) -> None:
        """One ioctl; the kernel's answer is in `structure`.

        Raises
        ------
        OSError
            What the kernel refused with.
        """
        while True:
            try:
                fcntl.ioctl(self.fd, request, structure)
                return
            except InterruptedError:
                continue

    @property
    def formats(self) -> tuple[str, ...]:
        """Names of the pixel formats it offers."""
        return tuple(
            format_name(entry.pixelformat)
            for entry in self._listed(v4l2.VIDIOC_ENUM_FMT, lambda: v4l2.FmtDesc(type=v4l2.V4L2_BUF_TYPE_VIDEO_CAPTURE))
        )

    def shapes(self, code: int) -> tuple[tuple[int, int], ...]:
        """(rows, columns) that it offers in a pixel format; empty where it offers ranges of them."""
        sizes = self._listed(v4l2.VIDIOC_ENUM_FRAMESIZES, lambda: v4l2.FrmSizeEnum(pixel_format=code))
        return tuple(
            (int(size.discrete.height), int(size.discrete.width))
            for size in sizes
            if size.type == v4l2.V4L2_FRMSIZE_TYPE_DISCRETE
        )

    def controls(self) -> dict[str, Control]:
        """Its numeric controls, by name."""
        found, query = {}, v4l2.QueryExtCtrl(id=v4l2.V4L2_CTRL_FLAG_NEXT_CTRL)
        unusable = v4l2.V4L2_CTRL_FLAG_DISABLED | v4l2.V4L2_CTRL_FLAG_WRITE_ONLY | v4l2.V4L2_CTRL_FLAG_HAS_PAYLOAD
        while self._answers(v4l2.VIDIOC_QUERY_EXT_CTRL, query):
            if query.type in _NUMERIC and not query.flags & unusable:
                name = control_name(query.name.decode("utf-8", "replace"))
                wide = query.type == v4l2.V4L2_CTRL_TYPE_INTEGER64
                found[name] = Control(name, query.id, query.minimum, query.maximum, wide)
            query = v4l2.QueryExtCtrl(id=query.id | v4l2.V4L2_CTRL_FLAG_NEXT_CTRL)
        return found

    def read(self, control: Control) -> int:
        """What a control is now."""
        return self._transfer(v4l2.VIDIOC_G_EXT_CTRLS, control, 0)

    def write(self, control: Control, value: int) -> int:
        """Set a control; returns what it is then, as read back.

        Raises
        ------
        DeviceError
            When it is refused.
        """
        try:
            self._transfer(v4l2.VIDIOC_S_EXT_CTRLS, control, value)
        except OSError as error:
            if error.errno not in _REFUSALS:
                raise
            raise DeviceError(
                f"{self.path}: refuses to set {control.name} to {value} ({error.strerror}); set what it depends on "
                f"first, or leave it out"
            ) from error
        return self.read(control)

    def close(self) -> None:
        """Let go of it."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)

    def _transfer(self, request: int, control: Control, value: int) -> int:
        one = v4l2.ExtControl(id=control.id)
        if control.wide:
            one.value64 = value
        else:
            one.value = value
        self.ask(request, v4l2.ExtControls(count=1, controls=ctypes.pointer(one)))
        return int(one.value64 if control.wide else one.value)

    def _listed(self, request: int, entry: Callable[[], Any]) -> Iterator[Any]:
        index = 0
        while self._answers(request, listed := _numbered(entry(), index)):
            yield listed
            index += 1

    def _answers(self, request: int, structure: Any) -> bool:
        """Whether there is such an entry."""
        try:
            self.ask(request, structure)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return False
            raise
        return True


def control_name(spoken: str) -> str:
    """The name that a rig file gives a control.

    Examples
    --------
    >>> control_name("White Balance, Automatic")
    'white_balance_automatic'
    """
    return re.sub(r"[^a-z0-9]+", "_", spoken.lower()).strip("_")


def explained(path: Path, error: OSError) -> DeviceError:
    """An error of the kernel's as one sentence that says what to do."""
    match error.errno:
        case errno.ENOENT | errno.ENODEV | errno.ENXIO | errno.ESHUTDOWN:
            advice = "is not there; plug the camera in (tankrig devices lists what is connected)"
        case errno.EACCES | errno.EPERM:
            advice = "may not be opened by this user; run: sudo usermod -aG video $USER, then log in again"
        case errno.EBUSY:
            advice = "is used by another program; close that one"
        case errno.ENOSPC:
            advice = (
                "its USB bus has no room for this stream; plug it into another controller, or choose a lower "
                "camera.fps or smaller camera.shape in the rig file"
            )
        case errno.ENOMEM:
            advice = "the kernel has no memory for its buffers; choose a smaller camera.shape in the rig file"
        case errno.EPIPE | errno.ENOLINK:
            advice = "its sensor is not linked to it with this format; link them with media-ctl, as its maker says"
        case errno.ENOTTY | errno.EINVAL | errno.EISDIR | errno.ENOTDIR | errno.ELOOP:
            advice = f"is no camera ({error.strerror}); name another (tankrig devices lists what is connected)"
            return NoCameraError(f"{path}: {advice}")
        case _:
            advice = f"does not answer ({error.strerror}); unplug it, plug it in again, and try another cable"
    return DeviceError(f"{path}: {advice}")


def _numbered(entry: Any, index: int) -> Any:
    entry.index = index
    return entry


def _require_capture(path: Path, about: v4l2.Capability) -> None:
    """Of a node's own capabilities; `capabilities` are those of all nodes of the camera."""
    own = about.device_caps if about.capabilities & v4l2.V4L2_CAP_DEVICE_CAPS else about.capabilities
    if own & v4l2.V4L2_CAP_VIDEO_CAPTURE_MPLANE:
        raise NoCameraError(f"{path}: gives pictures in several planes, which tankrig can't read; use another camera")
    if not own & v4l2.V4L2_CAP_VIDEO_CAPTURE:
        raise NoCameraError(f"{path}: gives no pictures; name another of the camera's nodes (tankrig devices)")
    if not own & v4l2.V4L2_CAP_STREAMING:
        raise NoCameraError(f"{path}: has no streaming of pictures through memory; use another camera")

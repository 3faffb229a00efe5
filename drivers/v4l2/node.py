"""A camera's device node: who it is, what it can do, and its controls by name. Does not stream."""

import errno
from enum import Enum
from pathlib import Path
from typing import Any

from tankrig.errors import DeviceError


class Stamp(Enum):
    """What a frame's timestamp marks."""

    START_OF_EXPOSURE = "start of exposure"
    END_OF_FRAME = "end of frame"


class Node:
    """An open device node.

    Parameters
    ----------
    path
        Of the node.

    Raises
    ------
    DeviceError
        When there is none, this user may not open it, or it is not a camera.
    """

    def __init__(self, path: Path) -> None:
        from linuxpy.video.device import Capability, Device

        self._path = path
        self._device = Device(str(path))
        try:
            self._device.open()
            info = self._device.info
            streams = Capability.VIDEO_CAPTURE in info.device_capabilities
            self.card: str = info.card
            self.bus: str = info.bus_info
        except OSError as error:
            self._device.close()
            raise self._explained(error) from error
        if not streams:
            self._device.close()
            raise DeviceError(f"{path}: gives no pictures; name another of the camera's nodes (tankrig devices)")

    @property
    def formats(self) -> tuple[str, ...]:
        """Four-letter names of the pixel formats it offers."""
        return tuple(_fourcc(format_.pixel_format) for format_ in self._device.info.formats)

    @property
    def controls(self) -> dict[str, tuple[int, int, int]]:
        """(least, most, value now) of its numeric controls, by name."""
        found = {}
        for control in self._device.controls.values():
            least, most = getattr(control, "minimum", 0), getattr(control, "maximum", 1)
            if not (control.is_flagged_disabled or control.is_flagged_write_only):
                found[str(control.config_name)] = (int(least), int(most), int(control.value))
        return found

    @property
    def present(self) -> bool:
        """Whether the camera is still plugged in."""
        from linuxpy.video.device import read_capabilities

        try:
            read_capabilities(self._device.fileno())
        except OSError:
            return False
        return True

    def stamp(self) -> Stamp:
        """What the timestamps of a program that streams from it mark; asks the first of its buffers.

        Raises
        ------
        DeviceError
            When they are not of the monotonic clock.
        """
        from linuxpy.video.device import BufferType, Memory, query_buffer

        try:
            flags = query_buffer(self._device.fileno(), BufferType.VIDEO_CAPTURE, Memory.MMAP, 0).flags
        except OSError as error:
            raise self._explained(error) from error
        if flags & _CLOCK_MASK != _MONOTONIC:
            raise DeviceError(
                f"{self._path}: its timestamps are not of the monotonic clock, so no frame can be paired with a "
                f"pattern; use a camera with driver uvcvideo, or a newer kernel"
            )
        return Stamp.START_OF_EXPOSURE if flags & _SOURCE_MASK == _SOURCE_START else Stamp.END_OF_FRAME

    def sequence(self, stamped_ns: int) -> int:
        """The kernel's count of the frame with this time stamp, which a program that streams holds.

        Raises
        ------
        DeviceError
            When no buffer has that time stamp.
        """
        from linuxpy.video.device import BufferType, Memory, query_buffer

        for index in range(_MOST_BUFFERS):
            try:
                buffer = query_buffer(self._device.fileno(), BufferType.VIDEO_CAPTURE, Memory.MMAP, index)
            except OSError:
                break
            if buffer.timestamp.secs * 1_000_000 + buffer.timestamp.usecs == round(stamped_ns / 1000):
                return int(buffer.sequence)
        raise DeviceError(f"{self._path}: does not say which frame it gave; use a newer kernel")

    def set(self, name: str, value: int) -> int:
        """Set a control to `value`, or what is nearest to it in its range; returns what it is then.

        Raises
        ------
        DeviceError
            When there is no such control, or it is refused.
        """
        control = self._control(name)
        try:
            control.value = value
            return int(control.value)
        except OSError as error:
            if error.errno in _GONE:
                raise self._explained(error) from error
            raise DeviceError(
                f"{self._path}: refuses to set {name} to {value} ({error.strerror}); set what it depends on first, or "
                f"leave it out"
            ) from error

    def range(self, name: str) -> tuple[int, int]:
        """(least, most) of a control."""
        control = self._control(name)
        return int(control.minimum), int(control.maximum)

    def first_of(self, *names: str) -> str | None:
        """The first of these controls that it has."""
        known = {str(control.config_name) for control in self._device.controls.values()}
        return next((name for name in names if name in known), None)

    def close(self) -> None:
        """Let go of it."""
        self._device.close()

    def _control(self, name: str) -> Any:
        for control in self._device.controls.values():
            if control.config_name == name:
                return control
        known = ", ".join(self.controls)
        raise DeviceError(f"{self._path}: has no control {name!r}; it has {known}")

    def _explained(self, error: OSError) -> DeviceError:
        match error.errno:
            case errno.ENOENT | errno.ENODEV | errno.ENXIO:
                advice = "is not there; plug the camera in (tankrig devices lists what is connected)"
            case errno.EACCES | errno.EPERM:
                advice = "may not be opened by this user; run: sudo usermod -aG video $USER, then log in again"
            case errno.EBUSY:
                advice = "is used by another program; close that one"
            case _:
                advice = f"is no camera ({error.strerror}); name another (tankrig devices lists what is connected)"
        return DeviceError(f"{self._path}: {advice}")


_MOST_BUFFERS = 32  # as many as the kernel gives one stream
_CLOCK_MASK, _MONOTONIC = 0xE000, 0x2000
_SOURCE_MASK, _SOURCE_START = 0x70000, 0x10000
_GONE = (errno.ENODEV, errno.ENXIO, errno.EIO)


def _fourcc(number: int) -> str:
    return int(number).to_bytes(4, "little").decode("ascii", "replace").strip()

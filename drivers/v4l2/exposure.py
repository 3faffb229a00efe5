"""Exposure and gain of a camera, in milliseconds and factors: set by its controls, read back, and watched."""

import time

from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError

from .node import Control, Node
from .videodev2 import V4L2_EXPOSURE_MANUAL

_UNIT_MS = 0.1
_AUTO = ("auto_exposure", "exposure_auto")
_EXPOSURE = ("exposure_time_absolute", "exposure_absolute")
_GAIN = ("gain", "analogue_gain")


class Exposure:
    """A camera's controls of exposure and gain.

    Parameters
    ----------
    node
        The camera's.
    controls
        All that it has.
    gain_one
        Value of the gain control that amplifies by 1; None for its least value.

    Raises
    ------
    DeviceError
        When its exposure cannot be set.
    """

    def __init__(self, node: Node, controls: dict[str, Control], gain_one: int | None) -> None:
        def first(names: tuple[str, ...]) -> Control | None:
            return next((controls[name] for name in names if name in controls), None)

        self._node = node
        self._auto, exposure, self._gain = first(_AUTO), first(_EXPOSURE), first(_GAIN)
        if exposure is None:
            raise DeviceError(f"{node.path}: its exposure cannot be set; use another camera")
        self._exposure = exposure
        self._gain_one = gain_one or max(self._gain.least, 1) if self._gain is not None else 1
        self._rounded: dict[Control, tuple[int, int]] = {}
        self.changed_ns = time.monotonic_ns()
        """Since when nothing has been changed."""
        self.actual = self._read_back()
        """What is set, as read back after the last change."""

    def set(self, settings: CameraSettings) -> None:
        """Set what differs, as near as the camera can, automatic exposure off.

        Raises
        ------
        DeviceError
            When it is refused; `actual` then is what has been set of it.
        """
        try:
            if self._auto is not None:
                self._write(self._auto, V4L2_EXPOSURE_MANUAL)
                if self._node.read(self._auto) != V4L2_EXPOSURE_MANUAL:
                    raise DeviceError(f"{self._node.path}: does not let go of automatic exposure; use another camera")
            self._write(self._exposure, _within(self._exposure, settings.exposure_ms / _UNIT_MS))
            if self._gain is not None:
                self._write(self._gain, _within(self._gain, settings.gain * self._gain_one))
        finally:
            self.actual = self._read_back()

    def require_held(self) -> None:
        """Look whether exposure and gain are still what was read back.

        Raises
        ------
        DeviceError
            When they have changed by themselves.
        """
        for control, value in self._held.items():
            now = self._node.read(control)
            if now != value:
                raise DeviceError(
                    f"{self._node.path}: its {control.name} went from {value} to {now} by itself; switch off what is "
                    f"automatic in camera.controls of the rig file, or use another camera"
                )

    def _write(self, control: Control, value: int) -> None:
        """Set a control, unless it is set already, to the value or to what the camera made of it before."""
        now = self._node.read(control)
        if now == value or self._rounded.get(control) == (value, now):
            return
        try:
            self._rounded[control] = (value, self._node.write(control, value))
        finally:
            self.changed_ns = time.monotonic_ns()

    def _read_back(self) -> CameraSettings:
        self._held = {control: self._node.read(control) for control in (self._exposure, self._gain) if control}
        gain = self._held[self._gain] / self._gain_one if self._gain is not None else 1.0
        return CameraSettings(round(self._held[self._exposure] * _UNIT_MS, 6), gain)


def _within(control: Control, value: float) -> int:
    return round(min(max(value, control.least), control.most))

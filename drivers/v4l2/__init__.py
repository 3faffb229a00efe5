"""Cameras under Linux's V4L2 interface (USB and others).

What is known about the interface, and which of it was never seen on a real camera: firmware_notes/v4l2_camera.md.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .camera import V4l2Camera


def open_v4l2_camera(settings: Mapping[str, Any]) -> "V4l2Camera":
    """Driver `v4l2-camera` (settings: `V4l2CameraSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .camera import V4l2Camera
    from .settings import V4l2CameraSettings

    return V4l2Camera(checked(V4l2CameraSettings, dict(settings), "v4l2-camera", SettingsError))

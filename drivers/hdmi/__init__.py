"""A projector at a video output (HDMI, DisplayPort): a window that fills its screen pixel by pixel.

The window lives in a process of its own, so that it needs no Qt in the program that drives it and does not mind one.
What is known about it, and which of it was never seen on a real projector: firmware_notes/hdmi_projector.md.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .projector import HdmiProjector


def open_hdmi_projector(settings: Mapping[str, Any]) -> "HdmiProjector":
    """Driver `hdmi-projector` (settings: `HdmiProjectorSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .projector import HdmiProjector
    from .settings import HdmiProjectorSettings

    return HdmiProjector(checked(HdmiProjectorSettings, dict(settings), "hdmi-projector", SettingsError))

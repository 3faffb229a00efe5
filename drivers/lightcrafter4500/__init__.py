"""TI's DLP LightCrafter 4500: set up over USB so that it shows what comes over HDMI, one 8-bit plane, without gamma.

What is known about it, and which of it was never seen on a real one: firmware_notes/lightcrafter4500.md.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .projector import Lightcrafter


def open_lightcrafter(settings: Mapping[str, Any]) -> "Lightcrafter":
    """Driver `lightcrafter-4500` (settings: `LightcrafterSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import DeviceError

    from .projector import Lightcrafter
    from .settings import LightcrafterSettings

    return Lightcrafter(checked(LightcrafterSettings, dict(settings), "lightcrafter-4500", DeviceError))

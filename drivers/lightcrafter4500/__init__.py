"""TI's DLP LightCrafter 4500: shows what comes over HDMI, 8 bits without gamma, and bursts of patterns from its flash.

What is known about it, and which of it was never seen on a real one: firmware_notes/lightcrafter4500.md.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .projector import Lightcrafter
    from .simulated import SimulatedLightcrafter


def open_lightcrafter(settings: Mapping[str, Any]) -> "Lightcrafter":
    """Driver `lightcrafter-4500` (settings: `LightcrafterSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .projector import Lightcrafter
    from .settings import LightcrafterSettings

    return Lightcrafter(checked(LightcrafterSettings, dict(settings), "lightcrafter-4500", SettingsError))


def open_simulated_lightcrafter(settings: Mapping[str, Any]) -> "SimulatedLightcrafter":
    """Driver `simulated-lightcrafter`: the same on its stand-in (settings: `SimulatedLightcrafterSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .settings import SimulatedLightcrafterSettings
    from .simulated import SimulatedLightcrafter

    table = checked(SimulatedLightcrafterSettings, dict(settings), "simulated-lightcrafter", SettingsError)
    return SimulatedLightcrafter(table)

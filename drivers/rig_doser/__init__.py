"""The rig's own ink doser: its driver, and an emulator that speaks its protocol on a pseudo-terminal.

The protocol is firmware_notes/rig_doser.md. Driver and emulator are written from that page and share no code.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .doser import RigDoser
    from .simulated import SimulatedDoser


def open_rig_doser(settings: Mapping[str, Any]) -> "RigDoser":
    """Driver `rig-doser`: the doser on a serial port (settings: `RigDoserSettings`)."""
    from drivers.registry import checked

    from .doser import RigDoser
    from .settings import RigDoserSettings

    return RigDoser(checked(RigDoserSettings, "rig-doser", settings))


def open_simulated_doser(settings: Mapping[str, Any]) -> "SimulatedDoser":
    """Driver `simulated-doser`: the emulator in a process of its own (settings: `SimulatedDoserSettings`)."""
    from drivers.registry import checked

    from .settings import SimulatedDoserSettings
    from .simulated import SimulatedDoser

    return SimulatedDoser(checked(SimulatedDoserSettings, "simulated-doser", settings))

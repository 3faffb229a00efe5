"""The simulated rig's projector and camera: a digital twin of the tank between them, with the doser's ink in it."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .camera import SimulatedCamera
    from .projector import SimulatedProjector


def open_simulated_projector(settings: Mapping[str, Any]) -> "SimulatedProjector":
    """Driver `simulated-projector`: a frame buffer (settings: `SimulatedProjectorSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .projector import SimulatedProjector
    from .settings import SimulatedProjectorSettings

    return SimulatedProjector(checked(SimulatedProjectorSettings, dict(settings), "simulated-projector", SettingsError))


def open_simulated_camera(settings: Mapping[str, Any]) -> "SimulatedCamera":
    """Driver `simulated-camera`: sees the simulated tank (settings: `SimulatedCameraSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .camera import SimulatedCamera
    from .settings import SimulatedCameraSettings

    return SimulatedCamera(checked(SimulatedCameraSettings, dict(settings), "simulated-camera", SettingsError))

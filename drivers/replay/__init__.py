"""A camera that replays what was recorded: a run, or a folder of images."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .camera import ReplayCamera


def open_replay_camera(settings: Mapping[str, Any]) -> "ReplayCamera":
    """Driver `replay-camera` (settings: `ReplayCameraSettings`)."""
    from tankrig.checked_toml import checked
    from tankrig.errors import SettingsError

    from .camera import ReplayCamera
    from .settings import ReplayCameraSettings

    return ReplayCamera(checked(ReplayCameraSettings, dict(settings), "replay-camera", SettingsError))

"""Whether the tables of a rig file agree on the simulated bench that they describe."""

from collections.abc import Mapping
from typing import Any

from tankrig.bench import Bench
from tankrig.checked_toml import checked
from tankrig.errors import SceneError

from .settings import SimulatedCameraSettings, SimulatedProjectorSettings


def require_agreement(file: str, projector: Mapping[str, Any], camera: Mapping[str, Any], bench: Bench) -> None:
    """Check a bench on which boards are held; other simulated rigs are checked by their own devices.

    Parameters
    ----------
    file
        The rig file, for messages.
    projector, camera
        Its tables, drivers included.
    bench
        What it believes.

    Raises
    ------
    SceneError
        In one sentence, when the bench contradicts itself.
    """
    if camera["driver"] != "simulated-camera" or "boards" not in camera:
        return
    seen = checked(SimulatedCameraSettings, _settings(camera), f"{file}: camera", SceneError)
    if projector["driver"] != "simulated-projector" or seen.boards is None:
        return
    shown = checked(SimulatedProjectorSettings, _settings(projector), f"{file}: projector", SceneError)
    if shown.shape != seen.boards.projector_shape:
        raise SceneError(
            f"{file}: camera.boards.projector_shape = {list(seen.boards.projector_shape)} and projector.shape = "
            f"{list(shown.shape)} are the same projector's; give both alike"
        )
    believed = {"camera": bench.camera.shape, "wall": bench.wall.shape}
    hidden = {"camera": seen.boards.camera_shape, "wall": seen.boards.projector_shape}
    for name, device in (("camera", "camera"), ("wall", "projector")):
        if believed[name] != hidden[name]:
            raise SceneError(
                f"{file}: camera.boards.{device}_shape = {list(hidden[name])} and bench.{name}.shape = "
                f"{list(believed[name])} are the same {device}'s; give both alike"
            )
    if shown.folder.absolute() != seen.folder.absolute():
        raise SceneError(
            f"{file}: projector.folder = {shown.folder} and camera.folder = {seen.folder} are two tanks, and the "
            f"camera would see no light; give both the same"
        )


def _settings(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key != "driver"}

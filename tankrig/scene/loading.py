"""From a scene file (TOML) to a checked `Scene`."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from tankrig import bounded_reading
from tankrig.checked_toml import checked, read_toml
from tankrig.errors import SceneError
from tankrig.scene.description import Scene
from tankrig.scene.optics import SAID
from tankrig.scene.phase_functions import Tabulated


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file; where its camera says `bin`, its pixels are bins of so many.

    Parameters
    ----------
    path
        A TOML file with the tables `tank`, `medium`, `projector` and `camera` (see docs/scene.md).

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        In one sentence: the file, the key, its value, and what to do.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> text = '''
    ... [tank]
    ... size_mm = [240.0, 160.0, 120.0]
    ... surface = "matched"
    ... [medium]
    ... sigma_a = 0.0002
    ... sigma_s = 0.0198
    ... g = 0.5
    ... [projector]
    ... kind = "collimated"
    ... beams = [ { y_mm = [-2.0, 2.0], z_mm = [58.0, 62.0], irradiance = 1.0 } ]
    ... [camera]
    ... kind = "orthographic"
    ... shape = [80, 120]
    ... pixel_mm = 2.0
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "scene.toml")
    ...     _ = file.write_text(text)
    ...     load_scene(file).medium
    Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.5)
    """
    scene = whole_scene(path)
    return replace(scene, camera=scene.camera.binned(scene.camera.bin)) if scene.camera.bin else scene


def whole_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file as `load_scene` does, but with every pixel of its camera."""
    file = Path(path)
    table = read_toml(file, "a scene file", SceneError)
    return replace(scene_from_table(table, str(file)), source=str(file))


def scene_from_table(table: dict[str, Any], name: str) -> Scene:
    """Check a parsed scene file; `name` stands first in every message.

    Raises
    ------
    SceneError
        Naming the first key that is wrong.
    """
    if "source" in table:  # a field of Scene that no file may set
        raise SceneError(f'{name}: key "source" is unknown; remove it')
    if isinstance(table.get("medium"), dict) and table["medium"].keys() == {"sigma_a", "sigma_s"}:
        raise SceneError(f'{name}: key "medium.g" is missing; add it, or a phase')
    table = {**table, "medium": _with_phase_table(table.get("medium"), Path(name).parent, name)}
    projector = table.get("projector")
    image = None
    if isinstance(projector, dict) and "image" in projector:
        image = projector["image"]
        if "beams" in projector:
            raise SceneError(f"{name}: projector has both an image and beams; remove one of them")
        rest = {key: value for key, value in projector.items() if key != "image"}
        table = {**table, "projector": {**rest, "beams": [DARK]}}
    scene = checked(Scene, table, name, SceneError)
    for key, present in _written(table):
        if not present:
            raise SceneError(f'{name}: key "{key}" is missing; add it')
    return scene if image is None else _lit(scene, Path(name).parent / str(image), name)


def _with_phase_table(medium: Any, folder: Path, name: str) -> Any:
    """The table `medium` with the rows of its phase function's file, where it names one."""
    phase = medium.get("phase") if isinstance(medium, dict) else None
    if not (isinstance(phase, dict) and phase.get("kind") == "table" and "file" in phase):
        return medium
    file = folder / str(phase["file"])
    cosines, values = [], []
    try:
        lines = bounded_reading.text(file, MOST_TABLE_BYTES).splitlines()
    except (OSError, ValueError) as error:
        raise SceneError(f'{name}: medium.phase.file = "{phase["file"]}" cannot be read; give a text file') from error
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            cosine, value = (float(word) for word in words)
        except ValueError as error:
            raise SceneError(f'{file}: row {number}, "{line[:40]}", is not "cosine value"; mend it') from error
        cosines.append(cosine)
        values.append(value)
    try:
        Tabulated(tuple(cosines), tuple(values))
    except SceneError as error:  # here, where the file can be named
        raise SceneError(f"{file}: {error}") from error
    rest = {key: value for key, value in phase.items() if key != "file"}
    return {**medium, "phase": {**rest, "cosines": cosines, "values": values}}


MOST_TABLE_BYTES = 2**20
"""Of a table of a phase function; some 30,000 rows."""
DARK = {"y_mm": [-1e-9, 1e-9], "z_mm": [0.0, 1e-9], "irradiance": 0.0}
"""Stands for the beams until the projector's image is read."""


def _lit(scene: Scene, image: Path, name: str) -> Scene:
    """The scene with the image on its projector."""
    import cv2

    from tankrig.scene.projection import lit_by

    try:
        picture = bounded_reading.picture(image, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    except (OSError, ValueError) as error:
        raise SceneError(
            f'{name}: projector.image = "{image}" cannot be read ({bounded_reading.reason(error)}); give the path of a '
            f"PNG beside the file"
        ) from error
    try:
        return lit_by(scene, picture)
    except SceneError as error:
        raise SceneError(f'{name}: projector.image = "{image.name}": {error}') from error


def _written(table: dict[str, Any]) -> Iterator[tuple[str, bool]]:
    """Keys that have a default in Python but not in a file, where forgetting one would change the light unnoticed."""
    for key in ("size_mm", "surface"):
        yield f"tank.{key}", key in table["tank"]
    yield "camera.pixel_mm", table["camera"]["kind"] == "calibrated" or "pixel_mm" in table["camera"]
    for index, beam in enumerate(table["projector"]["beams"]):
        yield f"projector.beams[{index}].irradiance", "irradiance" in beam
    yield from ((f"tank.faces.{face}.reflectance", False) for face in unsaid_reflectances(table["tank"]))


def unsaid_reflectances(tank: dict[str, Any]) -> list[str]:
    """Names of the faces in a file's table of a tank that reflect as much as nobody says.

    Examples
    --------
    >>> unsaid_reflectances({"faces": {"floor": {"kind": "diffuse"}, "far": {"kind": "glass"}}})
    ['floor']
    """
    faces: dict[str, dict[str, Any]] = tank.get("faces", {})
    return [name for name, face in faces.items() if face.get("kind") in SAID and "reflectance" not in face]

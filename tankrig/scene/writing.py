"""From a `Scene` to the text of a scene file."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

from tankrig.extras import needing_extra
from tankrig.scene.description import Camera, Medium, Projector, Scene
from tankrig.scene.free_phase import Shaped
from tankrig.scene.optics import SAID, Face
from tankrig.scene.phase_functions import Mixture, Tabulated
from tankrig.scene.phase_table import sines

_PLAIN_CAMERA = ("matrix", "distortion", "rotation")
_PLAIN_PROJECTOR = (*_PLAIN_CAMERA, "shape", "pixel_power", "gamma", "shading")


def scene_text(scene: Scene, comments: Sequence[str] = (), image: str | None = None) -> str:
    """A scene file that `load_scene` reads as the same scene.

    Parameters
    ----------
    scene
        To be written.
    comments
        Lines that stand above it.
    image
        Name of the PNG beside the file whose picture the projector shows, in place of beams.

    Examples
    --------
    >>> from tankrig.scene import Beam, Medium, Tank
    >>> beams = (Beam((-2.0, 2.0), (58.0, 62.0)),)
    >>> scene = Scene(
    ...     Tank(), Medium(0.0002, 0.0198, 0.5), Projector("collimated", beams), Camera("orthographic", (80, 120), 2.0)
    ... )
    >>> text = scene_text(scene, ["One beam."])
    >>> text.splitlines()[:3]
    ['# One beam.', '', '[tank]']
    >>> import tomllib
    >>> from tankrig.scene.loading import scene_from_table
    >>> scene_from_table(tomllib.loads(text), "text") == scene
    True
    """
    with needing_extra("writing a scene file"):
        import tomlkit

    document = tomlkit.document()
    for line in comments:
        document.add(tomlkit.comment(line))
    if comments:
        document.add(tomlkit.nl())
    tables = {
        "tank": _table(scene.tank, always=("size_mm", "surface")),
        "medium": medium_table(scene.medium),
        "projector": _projector(scene.projector, image),
        "camera": _camera(scene.camera),
    }
    for name, values in tables.items():
        table = tomlkit.table()
        for key, value in values.items():
            table.add(key, value)
        document.add(name, table)
    return tomlkit.dumps(document)


def medium_table(medium: Medium) -> dict[str, Any]:
    """A liquid as files of scenes and rigs have it; phase functions that have no kind there become a table.

    Examples
    --------
    >>> medium_table(Medium(0.0, 0.01, 0.5))
    {'sigma_a': 0.0, 'sigma_s': 0.01, 'g': 0.5}
    """
    if isinstance(medium.phase, Mixture | Shaped):
        cosine = 1.0 - 2.0 * sines()[::-8] ** 2  # from −1 to 1: steps are even in sin(θ/2), dense straight on
        table = Tabulated(tuple(cosine.tolist()), tuple(medium.phase.at(cosine).tolist()))
        medium = Medium(medium.sigma_a, medium.sigma_s, phase=table)
    return _table(medium, left_out=("g",) if medium.phase else ())


def _projector(projector: Projector, image: str | None) -> dict[str, Any]:
    left_out = ("beams",) if projector.kind == "calibrated" else ("beams", *_PLAIN_PROJECTOR)
    table = _table(projector, left_out)
    if image is not None:
        return {**table, "image": image}
    beams = [{"y_mm": list(one.y_mm), "z_mm": list(one.z_mm), "irradiance": one.irradiance} for one in projector.beams]
    return {**table, "beams": beams}


def _camera(camera: Camera) -> dict[str, Any]:
    if camera.kind == "calibrated":  # a scene puts its typical pixel in
        return _table(camera, ("pixel_mm",))
    return _table(camera, _PLAIN_CAMERA)


def _table(part: Any, left_out: Sequence[str] = (), always: Sequence[str] = ()) -> dict[str, Any]:
    """Fields of a part of a scene that say something."""
    if isinstance(part, Face) and part.kind in SAID:
        always = (*always, "reflectance")
    found = {}
    for field in fields(part):
        value = getattr(part, field.name)
        usual = field.default if field.default is not MISSING else None
        if field.name in (*always, "kind") or not (field.name in left_out or value is None or value == usual):
            found[field.name] = _plain(value)
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if hasattr(value, "__dataclass_fields__"):
        return _table(value)
    return value

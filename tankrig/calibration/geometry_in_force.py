"""Calibrated geometry read back from files, for other procedures and for scenes."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tankrig.bench import Bench
from tankrig.calibration.camera import INTRINSICS
from tankrig.calibration.file import Calibration
from tankrig.checked_toml import checked
from tankrig.errors import SceneError, StoreError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, Vector
from tankrig.scene.description import Camera, Projector, Tank

if TYPE_CHECKING:
    from tankrig.geometry.refraction import Window


def require(found: Mapping[str, Calibration], kind: str) -> Calibration:
    """The calibration of a kind that is in force.

    Raises
    ------
    StoreError
        When there is none, or it rests on another one than is in force.
    """
    if kind not in found:
        raise StoreError(f"there is no calibration of the {kind} yet; run tankrig calibrate {kind} first")
    one = found[kind]
    for other, hashed in one.rests_on.items():
        if other in found and found[other].hash != hashed:
            raise StoreError(
                f"{one.path}: rests on another calibration of the {other} than {found[other].path}, which is in force; "
                f"run tankrig calibrate {kind} again"
            )
    return one


def lens_of(calibration: Calibration) -> Lens:
    """Of a camera or projector."""
    return Lens(**{name: float(calibration.result[name]) for name in INTRINSICS})


def camera_pose(tank: Calibration) -> Pose:
    """Of the camera in the tank's frame."""
    return Pose(_vector(tank, "camera_rotation"), _vector(tank, "camera_translation_mm"))


def projector_pose(projector: Calibration) -> Pose:
    """Of the projector in the tank's frame."""
    return Pose(_vector(projector, "rotation"), _vector(projector, "translation_mm"))


def surface_of(tank: Calibration) -> "Window":
    """Of the water."""
    from tankrig.geometry.refraction import water_surface  # numba: half a second that opening a rig need not wait for

    return water_surface(float(tank.result["level_mm"]), float(tank.result["water_index"]))


def scene_tables(found: Mapping[str, Calibration], size_mm: Vector) -> dict[str, dict[str, Any]]:
    """The tables `tank`, `projector` and `camera` of a scene file, as far as geometry goes.

    Parameters
    ----------
    found
        Calibrations of camera, tank and projector, by kind.
    size_mm
        Inside of the tank; the water's level takes the place of its height.

    Raises
    ------
    StoreError
        When one is missing, or they do not belong together.
    """
    camera, tank, projector = (require(found, kind) for kind in ("camera", "tank", "projector"))
    return {
        "tank": {
            "size_mm": [size_mm[0], size_mm[1], float(tank.result["level_mm"])],
            "surface": "fresnel",
            "refractive_index": float(tank.result["water_index"]),
            "entry": "glass",
            "wall_mm": float(projector.result["pane_mm"]),
            "wall_index": float(projector.result["pane_index"]),
        },
        "projector": {
            **_device(projector, projector_pose(projector)),
            "shading": list(projector.result.get("shading", ())),
        },
        "camera": _device(camera, camera_pose(tank)),
    }


def measured(bench: Bench, found: Mapping[str, Calibration]) -> Bench:
    """A bench with geometry as measured; as it was where camera, tank or projector was not.

    Parameters
    ----------
    bench
        As believed; what is not geometry stays.
    found
        Calibrations in force, by kind.

    Raises
    ------
    StoreError
        When they do not belong together.
    """
    if not {"camera", "tank", "projector"} <= found.keys():
        return bench
    tables = scene_tables(found, bench.tank.size_mm)
    radiometry = found.get("radiometry")
    tables["projector"]["gamma"] = radiometry.result["projector"]["gamma"] if radiometry else bench.wall.gamma
    name = str(found["projector"].path)
    tank = checked(Tank, tables["tank"], name, SceneError)
    camera = replace(checked(Camera, tables["camera"], name, SceneError), bin=bench.camera.bin)
    projector = checked(Projector, tables["projector"], name, SceneError)
    return replace(bench, tank=tank, light="calibrated", camera=camera, projector=projector)


def _device(calibration: Calibration, pose: Pose) -> dict[str, Any]:
    lens = lens_of(calibration)
    return {
        "kind": "calibrated",
        "shape": list(calibration.shape),
        "matrix": lens.matrix.tolist(),
        "distortion": lens.distortion.tolist(),
        "rotation": list(pose.rotation),
        "position_mm": pose.centre_mm.tolist(),
    }


def _vector(calibration: Calibration, name: str) -> Vector:
    x, y, z = (float(value) for value in calibration.result[name])
    return x, y, z

"""Calibrated geometry read back from files, for other procedures and for scenes."""

from collections.abc import Mapping

from tankrig.calibration.camera import INTRINSICS
from tankrig.calibration.file import Calibration
from tankrig.errors import StoreError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, Vector
from tankrig.geometry.refraction import Window, water_surface


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


def surface_of(tank: Calibration) -> Window:
    """Of the water."""
    return water_surface(float(tank.result["level_mm"]), float(tank.result["water_index"]))


def scene_tables(found: Mapping[str, Calibration], size_mm: Vector) -> dict[str, dict[str, object]]:
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
        "projector": _device(projector, projector_pose(projector)),
        "camera": _device(camera, camera_pose(tank)),
    }


def _device(calibration: Calibration, pose: Pose) -> dict[str, object]:
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

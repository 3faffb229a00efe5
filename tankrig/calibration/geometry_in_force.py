"""Calibrated geometry read back from files, for other procedures and for scenes."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tankrig.bench import Bench
from tankrig.calibration.camera import INTRINSICS
from tankrig.calibration.file import Calibration
from tankrig.calibration.uncertainty import Named
from tankrig.checked_toml import checked
from tankrig.errors import SceneError, StoreError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, Vector
from tankrig.geometry.shading import shading_terms
from tankrig.scene.description import Camera, Projector, Tank
from tankrig.scene.optics import Blur, Halo, WideLens

if TYPE_CHECKING:
    from tankrig.geometry.refraction import Window

GEOMETRY = ("camera", "tank", "projector")
USED = (*GEOMETRY, "radiometry", "stray")
"""What a fit rests on."""
UNTOLD = 0.05
"""Share by which a blur may be off of which no file says it."""
LEAST_HALO = 5e-4
"""Share of a projector's light below which its halo is left out: drawing it costs as much as a dozen beams."""
DEVICES: Mapping[str, str] = {
    "camera": "camera", "tank": "camera", "radiometry": "camera", "stray": "camera",
    "projector": "projector", "latency": "projector",
}  # fmt: skip
"""What can be calibrated, and the device that it holds for."""


def require(found: Mapping[str, Calibration], kind: str) -> Calibration:
    """The calibration of a kind that is in force.

    Raises
    ------
    StoreError
        When there is none, or it rests on one that is not there or not in force.
    """
    if kind not in found:
        raise StoreError(f"there is no calibration of the {kind} yet; run tankrig calibrate {kind} first")
    one = found[kind]
    for other, hashed in one.rests_on.items():
        if other not in found:
            raise StoreError(
                f"{one.path}: rests on a calibration of the {other} that is not there; put its file back, or run "
                f"tankrig calibrate {other}, then {kind}"
            )
        if found[other].hash != hashed:
            raise StoreError(
                f"{one.path}: rests on another calibration of the {other} than {found[other].path}, which is in force; "
                f"run tankrig calibrate {kind} again"
            )
    return one


def sd_without(calibration: Calibration) -> str:
    """Which errors a calibration's standard deviations leave out, in a sentence; empty where they leave out none."""
    kinds = calibration.result.get("sd_without", ())
    if kinds:
        older = " and ".join(str(one) for one in kinds)
        again = ", ".join(f"tankrig calibrate {one}" for one in (*kinds, calibration.kind))
        return f"the errors of {older}, whose files were written before covariances were kept; run {again}"
    if calibration.kind in ("tank", "projector") and "covariance_of" not in calibration.result:
        return (
            f"the errors of what it rests on, since it was measured before those were carried over; run tankrig "
            f"calibrate {calibration.kind} again"
        )
    return ""


def require_of_one_bench(
    found: Mapping[str, Calibration], rig: str, shapes: Mapping[str, tuple[int, int]] | None = None
) -> None:
    """Refuse calibrations that cannot all be of one rig; nothing has to be open for it.

    Parameters
    ----------
    found
        Calibrations in force, by kind.
    rig
        Name of the rig; those written before names were kept are of any.
    shapes
        (rows, columns) of its "camera" and "projector", where known.

    Raises
    ------
    StoreError
        When one is of another rig, of another device than the rest, or of another resolution; when what it rests on is
        not there or is not what is in force; or when its covariance is damaged.
    """
    used = {kind: one for kind, one in found.items() if kind in USED}
    for kind, one in used.items():
        again = f"put the files of rig {rig} there, or calibrate anew (tankrig calibrate {kind})"
        if one.rig and one.rig != rig:
            raise StoreError(f"{one.path}: was measured on rig {one.rig}, and this is rig {rig}; {again}")
        device = DEVICES[kind]
        for other, those in used.items():
            if DEVICES[other] == device and those.device != one.device:
                raise StoreError(
                    f"{one.path}: was measured with {one.device}, and {those.path} with {those.device}, so they are "
                    f"not of one bench; {again}"
                )
        shape = (shapes or {}).get(device)
        if shape is not None and tuple(one.shape) != tuple(shape):
            raise StoreError(
                f"{one.path}: was measured with {list(one.shape)} pixels (rows, columns), and the rig's {device} has "
                f"{list(shape)}; {again}"
            )
        if kind in GEOMETRY:
            require(found, kind)
            Named.of(one)


def lens_of(calibration: Calibration) -> Lens:
    """Of a camera or projector."""
    return Lens(**{name: float(calibration.result[name]) for name in INTRINSICS})


def camera_pose(tank: Calibration) -> Pose:
    """Of the camera in the tank's frame."""
    return Pose(_vector(tank, "camera_rotation"), _vector(tank, "camera_translation_mm"))


def projector_pose(projector: Calibration) -> Pose:
    """Where the projector stands in the tank's frame."""
    return Pose(_vector(projector, "rotation"), _vector(projector, "translation_mm"))


def surface_of(tank: Calibration) -> "Window":
    """The water's surface, as light passes it."""
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


def _lenses(bench: Bench, found: Mapping[str, Calibration]) -> Bench:
    """With what the lenses do, in mm where the light and the picture are: on the wall, and on the water.

    Models blur by what was measured; what they leave for fits not to look at is by how much that may be off: a blur of
    σ ± δ is one of σ and one of √(2σδ) besides.
    """
    camera, projector = bench.camera, bench.projector
    assert projector is not None
    if "blur_px" in found["camera"].result:
        with _of_file(found["camera"]):
            camera = replace(camera, **_blurs(found["camera"], camera.pixel_mm))
    if "stray" in found:
        with _of_file(found["stray"]):
            told = found["stray"].result
            halo = Halo(float(told["halo_share"]), float(told["halo_sigma_px"]) * camera.pixel_mm)
            camera = replace(camera, halo=halo, veil=float(told["veil"]))
    with _of_file(found["projector"]):
        projector = _projector_lens(found["projector"], projector, bench.tank)
    if "radiometry" in found:
        with _of_file(found["radiometry"]):
            leak = float(found["radiometry"].result["projector"].get("leak", 0.0))
            projector = replace(projector, black_level=max(leak, 0.0) * white_on_wall(projector, bench.tank))
    return replace(bench, camera=camera, projector=projector)


@contextmanager
def _of_file(calibration: Calibration) -> Iterator[None]:
    """What cannot be of a calibration is told with its file."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{calibration.path}: {error}") from error
    except KeyError as error:
        raise StoreError(f"{calibration.path}: has no {error}; restore it, or calibrate anew") from error
    except (AttributeError, TypeError, ValueError) as error:
        raise StoreError(
            f"{calibration.path}: is no calibration of the {calibration.kind} ({str(error)[:200]}); restore it, or "
            "calibrate anew"
        ) from error


def _projector_lens(calibration: Calibration, projector: Projector, tank: Tank) -> Projector:
    """The projector with blur, or a wide lens, and halo as measured."""
    side_mm, told = projector_pixel_mm(projector, tank), calibration.result
    if told.get("lens_mm", 0.0) > 0.0 and "focus_mm" in told:
        projector = replace(projector, **_wide_lens(calibration, projector, tank, side_mm))
    elif "blur_px" in told:
        projector = replace(projector, **_blurs(calibration, side_mm))
    if told.get("halo_share", 0.0) > max(LEAST_HALO, 2.0 * calibration.sd.get("halo_share", 0.0)):
        projector = replace(projector, halo=Halo(float(told["halo_share"]), float(told["halo_sigma_px"]) * side_mm))
    return projector


def _blurs(calibration: Calibration, side_mm: float) -> dict[str, Any]:
    """The keys `blur` and `blur_mm` of a camera or a projector whose pixels have such sides."""
    told, sd = calibration.result, calibration.sd
    middle_px, corner_px = told.get("blur_middle_px", told["blur_px"]), told.get("blur_corner_px")
    widest_px = max(middle_px, corner_px or 0.0)
    off_px = float(sd.get("blur_px", UNTOLD * widest_px))
    blur = Blur(float(middle_px) * side_mm, None if corner_px is None else float(corner_px) * side_mm)
    return {"blur": blur, "blur_mm": float(np.sqrt(2.0 * widest_px * off_px)) * side_mm}


def _wide_lens(calibration: Calibration, projector: Projector, tank: Tank, side_mm: float) -> dict[str, Any]:
    """The keys `wide_lens`, `blur` and `blur_mm` of a projector that is sharp at one distance only.

    In an empty tank that distance is nearer, by what the water has of it. By how much the blur may be off, it may be at
    the wall or at the far end, whichever is worse.
    """
    told, sd = calibration.result, calibration.sd
    index, wall_mm, wall_index = tank.entry_bends
    focus_mm = float(told["focus_mm"]) * index / float(told["in_tank_index"])
    lens_mm, blur_px = float(told["lens_mm"]), float(told["blur_focus_px"])
    before_mm = -projector.pose.centre_mm[0] - wall_mm + wall_mm / wall_index
    ends, focus = (1.0 / (before_mm + np.asarray(x) / index) for x in ((0.0, tank.size_mm[0]), focus_mm))
    per_mm = 0.25 * projector.lens.fx * (ends - focus)
    per_focus = 0.25 * projector.lens.fx * lens_mm * focus**2 / index
    off_px2 = [
        2.0 * blur_px * float(sd["blur_focus_px"]) * np.ones(2),
        2.0 * per_mm**2 * lens_mm * float(sd["lens_mm"]),
        2.0 * per_mm * lens_mm * per_focus * float(sd["focus_mm"]),
    ]
    most_px2 = float(np.sqrt(np.sum(np.square(off_px2), axis=0)).max())
    return {
        "wide_lens": WideLens(lens_mm, float(np.clip(focus_mm, 0.0, tank.size_mm[0]))),
        "blur": Blur(blur_px * side_mm),
        "blur_mm": float(np.sqrt(most_px2)) * side_mm,
    }


def projector_pixel_mm(projector: Projector, tank: Tank) -> float:
    """Side of a square as large as the median of the patches that pixels light on the wall x = 0 of the tank."""
    areas, _ = _patches(projector, tank)
    return float(np.sqrt(np.median(areas)))


def white_on_wall(projector: Projector, tank: Tank) -> float:
    """Mean irradiance of the wall x = 0 by a white picture, W/mm², less what glass reflects of upright light."""
    areas, pixels = _patches(projector, tank)
    light = np.exp(shading_terms(pixels, projector.shape or (1, 1)) @ np.array(projector.shading or np.zeros(6)))
    index, _, glass = tank.entry_bends
    lost = [((one - other) / (one + other)) ** 2 for one, other in ((1.0, glass), (glass, index))]
    through = float(np.prod(1.0 - np.array(lost))) if tank.entry == "glass" else 1.0
    return float(projector.pixel_power * light.sum() / areas.sum() * through)


def _patches(projector: Projector, tank: Tank) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) areas in mm² that pixels light on the wall x = 0 of the tank, and (n, 2) those pixels, on a grid."""
    from tankrig.geometry.refraction import entry_wall
    from tankrig.geometry.view import rays_of

    assert projector.shape is not None
    rows, columns = projector.shape
    corners = np.stack(np.meshgrid(np.linspace(0, columns - 1, 33), np.linspace(0, rows - 1, 25)), axis=-1)
    at = rays_of(projector.lens, projector.pose, corners, entry_wall(*tank.entry_bends))[0][..., 1:]
    across, along = at[1:, 1:] - at[:-1, :-1], at[1:, :-1] - at[:-1, 1:]
    cell = (columns - 1) / 32 * (rows - 1) / 24
    areas = 0.5 * np.abs(across[..., 0] * along[..., 1] - across[..., 1] * along[..., 0]) / cell
    middle = 0.25 * (at[1:, 1:] + at[:-1, :-1] + at[1:, :-1] + at[:-1, 1:])
    _, width, height = tank.size_mm
    inside = (np.abs(middle[..., 0]) < width / 2) & (middle[..., 1] > 0.0) & (middle[..., 1] < height)
    if not (inside & np.isfinite(areas)).any():
        raise SceneError("no pixel of the projector lights the tank's wall; check matrix, rotation and position_mm")
    good = inside & np.isfinite(areas)
    middles = 0.25 * (corners[1:, 1:] + corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:])
    return areas[good], middles[good]


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
    tank = replace(checked(Tank, tables["tank"], name, SceneError), faces=bench.tank.faces)
    camera = replace(checked(Camera, tables["camera"], name, SceneError), bin=bench.camera.bin)
    projector = checked(Projector, tables["projector"], name, SceneError)
    return _lenses(replace(bench, tank=tank, light="calibrated", camera=camera, projector=projector), found)


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

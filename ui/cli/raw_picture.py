"""A picture as it is fitted: read as it is, or made of a raw frame by what is known of the bench that took it."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tankrig.errors import StoreError

if TYPE_CHECKING:
    from tankrig.calibration.radiometry import Radiometry
    from tankrig.live.one_picture import Picture
    from tankrig.scene import Camera, Scene

_SAME_MM, _SAME_RAD = 1e-3, 1e-6
"""By which a camera may stand and be turned otherwise in two files and be the same: what a person's editing rounds."""


@dataclass(frozen=True)
class Measured:
    """What is in force of a rig that a raw frame was taken with."""

    rig: Path
    radiometry: "Radiometry"
    radiometry_file: str
    camera: "Camera"

    @classmethod
    def of(cls, rig: Path) -> "Measured":
        """Of a rig file."""
        from drivers.rig import calibrated_bench, load_rig_file
        from tankrig.calibration.file import in_force
        from tankrig.calibration.radiometry import Radiometry

        description = load_rig_file(rig)
        bench = calibrated_bench(description)
        found = in_force(Path(description.calibration_folder), description.calibration)
        if "radiometry" not in found:
            raise StoreError(
                f"{rig}: the camera's radiometry is not calibrated; run tankrig calibrate radiometry, or leave --rig "
                "out"
            )
        return cls(rig, Radiometry.of(found["radiometry"]), str(found["radiometry"].path), bench.camera)


@dataclass(frozen=True)
class RawPicture:
    """How a raw frame was taken, and what is known of the bench that it was taken on."""

    exposure_ms: float
    gain: float
    dark: Path | None
    measured: Measured | None
    of_pattern: bool
    """Whether the dark frame is of the projector's dark picture."""

    @property
    def radiometry(self) -> "Radiometry | None":
        """Of its camera, where that is known."""
        return None if self.measured is None else self.measured.radiometry

    def notes(self, scene: "Scene", scene_file: Path) -> list[str]:
        """What does not stop a fit and may spoil it, in a sentence each."""
        notes = self._about_camera(scene.camera, scene_file)
        if scene.projector.black_level > 0.0 and self.dark is not None:
            notes.append(
                f"{scene_file} says what light dark parts of the projector's picture have, and the fit counts it; if "
                f"{self.dark} was taken with the projector's dark picture, give it as --dark-pattern"
            )
        return notes

    def _about_camera(self, camera: "Camera", scene_file: Path) -> list[str]:
        if camera.kind != "calibrated":
            return []
        if self.measured is None:
            return [
                "the camera's radiometry is not applied, so its fall-off towards the corners passes for the liquid's; "
                "give --rig"
            ]
        there = self.measured.camera
        if there.kind != "calibrated" or there.position_mm is None or camera.position_mm is None:
            return []
        apart = math.dist(there.position_mm, camera.position_mm)
        turned = max(abs(a - b) for a, b in zip(there.rotation or (), camera.rotation or (), strict=True))
        if apart <= _SAME_MM and turned <= _SAME_RAD:
            return []
        return [
            f"the camera of {scene_file} stands {apart:.2g} mm from where {self.measured.rig} has it and is turned by "
            f"{1e3 * turned:.2g} mrad; unless the frame is older than the calibrations in force, export the scene "
            "anew (tankrig scene)"
        ]


def picture_for_fit(
    image_file: Path, scene_file: Path, array: str | None, scale: float, raw: RawPicture | None, edges: float | None,
    mask_file: Path | None,
) -> "Picture":  # fmt: skip
    """The image as it is fitted.

    Parameters
    ----------
    image_file, scene_file, mask_file
        Files of the picture, of what it shows, and of what is left out.
    array, scale
        Which array of an .npz, and radiance per count.
    raw
        How a raw frame was taken; None where the picture is of radiance.
    edges
        How far from the sides of beams what lenses blur is left out, mm; None as the scene says.
    """
    from tankrig.devices import CameraSettings
    from tankrig.image.reading import read_frame, read_image, read_mask
    from tankrig.live.one_picture import picture_of, radiance_of, require_no_board
    from tankrig.scene.loading import whole_scene

    scene, hot, full = whole_scene(scene_file), None, None
    if raw is None:
        image = read_image(image_file, array, scale)
    else:
        settings = CameraSettings(raw.exposure_ms, raw.gain)
        dark = None if raw.dark is None else read_frame(raw.dark)
        frame = read_frame(image_file, array)
        require_no_board(frame, scene.camera)
        image, hot, full = radiance_of(frame, settings, raw.radiometry, dark)
        image = scale * image
        if raw.of_pattern:
            scene = replace(scene, projector=replace(scene.projector, black_level=0.0))
    mask = None if mask_file is None else read_mask(mask_file)
    return picture_of(image, scene, hot, full, edges, mask)

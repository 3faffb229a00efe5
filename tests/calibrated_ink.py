"""A simulated bench that the calibration commands have measured, and pictures of ink that its true camera takes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from drivers.rig import SIMULATED, calibrated_bench, load_rig_file
from drivers.simulated.bench_ink import true_scene
from drivers.simulated.bench_optics import vignetting
from drivers.simulated.bench_truth import TrueBench, random_bench
from drivers.simulated.sensor import counts
from drivers.simulated.settings import SimulatedCameraSettings
from tankrig.calibration.file import in_force
from tankrig.calibration.radiometry import Radiometry
from tankrig.checked_toml import checked
from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError
from tankrig.montecarlo import simulate
from tankrig.pattern import Pattern
from tankrig.scene import Medium, Scene
from ui.cli import main

CAMERA, PROJECTOR = (540, 960), (384, 512)
BINNING = 6
FRAMES = 8
FILLED = 0.7


def spots() -> Pattern:
    """Three squares of 9 mm of different levels, at different heights."""
    picture = np.zeros(PROJECTOR, np.uint8)
    for row, column, level in ((120, 130, 255), (190, 256, 200), (260, 380, 150)):
        picture[row - 12 : row + 12, column - 12 : column + 12] = level
    return Pattern("spots", picture)


def rig_file(folder: Path, seed: int) -> Path:
    """That of the bench that ships, fifty times as fast, with another truth and a camera with faults."""
    text = SIMULATED.with_name("bench.toml").read_text(encoding="utf-8")
    path = folder / "rig.toml"
    for old, new in (
        ("time_scale = 0.2", "time_scale = 0.01"),
        ("[camera.sensor]\n", "[camera.sensor]\nuneven = 0.01\nhot = 0.001\nnonlinear = 0.04\n"),
        ("seed = 0\n", f"seed = {seed}\n"),
    ):
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


@dataclass(frozen=True, eq=False)
class CalibratedInk:
    """What the program knows of a bench, and what is true of it."""

    rig: Path
    truth: TrueBench

    @classmethod
    def of(cls, folder: Path, seed: int) -> "CalibratedInk":
        """By the commands, in the order of docs/calibration.md."""
        rig = rig_file(folder, seed)
        for kind in ("radiometry", "camera", "tank", "projector"):
            assert main(["calibrate", kind, "--rig", str(rig), "--json"]) == 0, kind
        return cls(rig, random_bench(seed, CAMERA, PROJECTOR))

    def believed(self) -> Scene:
        """From the calibration files and what the rig file says of wall and water; the medium does not matter."""
        scene = calibrated_bench(load_rig_file(self.rig)).scene(spots(), Medium(0.0005, 0.01, 0.5))
        return replace(scene, camera=scene.camera.binned(BINNING))

    def photographed(self, medium: Medium, photons: int, **otherwise: Any) -> np.ndarray:
        """(rows, columns) as corrected by the measured radiometry, of a bench that may be otherwise than calibrated.

        The Monte Carlo is blind to detail within the blocks of camera pixels that are put together; vignetting, blur,
        shot noise, non-linearity, read noise and rounding are each pixel's own.
        """
        truth = replace(self.truth, **otherwise)
        seen = simulate(true_scene(truth, spots(), medium, BINNING), photons).image
        sensor, radiometry = self._sensor(), self._radiometry()
        rows, columns = CAMERA
        y, x = np.mgrid[:rows, :columns].astype(float)
        radiance = cv2.GaussianBlur(np.kron(seen, np.ones((BINNING, BINNING))), (0, 0), truth.camera.blur_px)
        radiance *= vignetting(truth.camera, x, y)
        settings = CameraSettings(round(FILLED * sensor.full_well / (sensor.response * radiance.max()), 1))
        random = np.random.default_rng(1)
        light = np.mean(
            [radiometry.corrected(counts(radiance, sensor, settings, random), settings) for _ in range(FRAMES)], axis=0
        )
        return np.asarray(light.reshape(rows // BINNING, BINNING, columns // BINNING, BINNING).mean(axis=(1, 3)))

    def _sensor(self) -> Any:
        settings: Mapping[str, Any] = {k: v for k, v in load_rig_file(self.rig).camera.items() if k != "driver"}
        return checked(SimulatedCameraSettings, dict(settings), "simulated-camera", DeviceError).sensor

    def _radiometry(self) -> Radiometry:
        return Radiometry.of(in_force(Path(load_rig_file(self.rig).calibration_folder))["radiometry"])


def quality(rig: Path) -> dict[str, dict[str, float]]:
    """Of each calibration in force, in its own words."""
    found = in_force(Path(load_rig_file(rig).calibration_folder))
    return {kind: dict(one.how_well) for kind, one in found.items()}

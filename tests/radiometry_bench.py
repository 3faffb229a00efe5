"""A simulated bench for radiometric calibration, two hundred times as fast as a real one; a seed decides its truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.simulated.camera import SimulatedCamera
from drivers.simulated.projector import SimulatedProjector
from drivers.simulated.sensor import gain_and_offset, transferred
from drivers.simulated.settings import TRUE_BENCH, Sensor, SimulatedCameraSettings, SimulatedProjectorSettings, Truth
from tankrig.devices import CameraSettings

FAST = 0.005


@dataclass(frozen=True, eq=False)
class RadiometryBench:
    projector: SimulatedProjector
    camera: SimulatedCamera
    sensor: Sensor
    truth: Truth

    def dn_per_e(self, gain: float) -> float:
        return gain_and_offset(self.sensor, CameraSettings(1.0, gain))[0] / self.sensor.response

    def counts(self, electrons: np.ndarray, gain: float) -> np.ndarray:
        """Counts above the dark, without noise."""
        return self.dn_per_e(gain) * transferred(electrons, self.sensor)

    def close(self) -> None:
        self.projector.close()
        self.camera.close()


def random_bench(folder: Path, seed: int, **sensor: float) -> RadiometryBench:
    """Lens, sensor, gain, projector's primaries, black light: all drawn."""
    draw = np.random.default_rng(seed)
    level = np.arange(256) / 255.0
    primaries = zip(draw.dirichlet((4.0, 6.0, 2.0)), draw.uniform(1.8, 2.6, 3), strict=True)
    curve = sum(part * level**gamma for part, gamma in primaries)
    bits, full_well = int(draw.choice([12, 14, 16])), float(draw.uniform(1e4, 4e4))
    drawn = {
        "vignetting": draw.uniform(0.05, 0.4),
        "uneven": draw.uniform(0.0, 0.02),
        "hot": 0.002,
        "nonlinear": draw.uniform(0.0, 0.08),
        "read_noise": max(draw.uniform(2.0, 8.0), 0.6 * full_well / 2**bits),
        "dark_current": draw.uniform(0.0, 0.05),
        "gain_error": draw.uniform(-0.05, 0.05),
    }
    # As cameras are set: black far enough above 0 for the noise at gain 4.
    drawn["black"] = max(100.0, 24.0 * (drawn | sensor)["read_noise"] * 2**bits / full_well)
    true_sensor = Sensor(bits=bits, full_well=full_well, pattern_seed=seed, **(drawn | sensor))
    shape = (30, 40)
    wall = replace(TRUE_BENCH.wall, shape=shape, response=tuple(np.asarray(curve).tolist()))
    truth = Truth(
        bench=replace(TRUE_BENCH, wall=wall),
        diffuser=draw.uniform(1.5e-4, 6e-4),
        diffuser_tilt=draw.uniform(0.0, 0.04),
        leak=draw.uniform(0.0, 5e-4),
    )
    fast = {"folder": folder, "seed": seed, "time_scale": FAST}
    camera = SimulatedCameraSettings(truth=truth, sensor=true_sensor, most_per_s=1000.0, **fast)
    return RadiometryBench(
        SimulatedProjector(SimulatedProjectorSettings(shape=shape, **fast)), SimulatedCamera(camera), true_sensor, truth
    )

"""What the simulated camera looks at is what the reference says a tank of that medium looks like."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import tankrig
from drivers.simulated.settings import Truth
from drivers.simulated.tank import SimulatedTank
from tankrig.bench import Bench
from tankrig.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.scene import Scene

REFERENCE = Path(__file__).parent / "data" / "reference"
WALL = Wall(shape=(60, 80), y_mm=(-80.0, 80.0), z_mm=(0.0, 120.0))
"""Pixels of 2 mm, whose edges are those of all beams of the reference but pub13's."""
CASES = [f"pub{number:02d}" for number in range(1, 13)]


def pattern_of(scene: Scene) -> Pattern:
    """The picture whose pixels light exactly the scene's beams."""
    pixels = np.zeros(WALL.shape, np.uint8)
    for beam in scene.projector.beams:
        across = (WALL.y_centres_mm > beam.y_mm[0]) & (WALL.y_centres_mm < beam.y_mm[1])
        upright = (WALL.z_centres_mm > beam.z_mm[0]) & (WALL.z_centres_mm < beam.z_mm[1])
        pixels[np.ix_(upright, across)] = 255
    return Pattern(scene.source, pixels)


def rms_z(case: str, tolerance: float, folder: Path) -> float:
    """Root mean square over the pixels of (twin − reference) / standard error of the difference."""
    scene = tankrig.load_scene(REFERENCE / f"{case}.toml")
    light = scene.projector
    bench = Bench(scene.tank, WALL, light.kind, scene.camera, light.position_mm)
    pattern = pattern_of(scene)
    assert Counter(bench.scene(pattern, scene.medium).projector.beams) == Counter(light.beams)
    truth = Truth(bench=bench, water=scene.medium, tolerance=tolerance)
    tank = SimulatedTank(truth, folder / "no doser", seed=0)
    image, stderr = tank.seen({pattern: 1.0}, now_ns=0), tank.radiance(pattern, tank.medium).stderr
    with np.load(REFERENCE / f"{case}.npz") as data:
        z = (image - data["total"]) / np.hypot(data["stderr"], stderr)
    return float(np.sqrt((z**2).mean()))


@pytest.mark.parametrize(("case", "tolerance"), [("pub02", 0.005), ("pub09", 0.02)])
def test_the_twin_shows_what_the_reference_shows(case: str, tolerance: float, tmp_path: Path) -> None:
    assert rms_z(case, tolerance, tmp_path) <= 1.1


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_the_twin_shows_what_the_reference_shows_at_one_percent(case: str, tmp_path: Path) -> None:
    """Prints RMS z (pytest -m long -s tests/test_simulated_reference.py)."""
    found = rms_z(case, 0.01, tmp_path)
    print(f"{case}: twin against reference, RMS z {found:.3f}")
    assert found <= 1.1

"""A calibration that is deliberately wrong does not go unnoticed: a fit's verdict says so, and what it looks like."""

from typing import Any

import numpy as np
import pytest

import tankrig
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

MEDIUM = Medium(0.0005, 0.01, 0.6)


def bench(camera_x_mm: float = 60.0, level_mm: float = 60.0, gamma: float = 1.0) -> Scene:
    """Three beams of the levels 255, 128 and 64 in a small tank."""
    levels = zip((-20.0, 0.0, 20.0), (255, 128, 64), strict=True)
    beams = tuple(Beam((y - 2.0, y + 2.0), (28.0, 32.0), (level / 255.0) ** gamma) for y, level in levels)
    camera = Camera("pinhole", (20, 30), 4.0, position_mm=(camera_x_mm, 0.0, 260.0))
    return Scene(Tank((120.0, 80.0, level_mm)), MEDIUM, Projector("collimated", beams), camera)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    true = tankrig.predict(bench(), model="montecarlo", tolerance=0.01, seed=3).image
    return true + 0.003 * true.max() * np.random.default_rng(0).standard_normal(true.shape)


@pytest.mark.long
@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({}, "The residual is noise, as expected"),
        ({"gamma": 2.2}, "beams of another brightness than described"),
        ({"camera_x_mm": 65.0}, "a misaligned beam or camera"),
        ({"level_mm": 70.0}, "a misaligned beam or camera"),
    ],
    ids=["as it is", "gamma ignored", "camera bumped by 5 mm", "water 10 mm lower"],
)
def test_the_verdict_says_whether_the_bench_is_as_believed(
    image: np.ndarray, wrong: dict[str, Any], reason: str
) -> None:
    found = tankrig.estimate(image, bench(**wrong))
    print(found.verdict)
    assert reason in found.verdict
    assert ("holds structure" in found.verdict) is bool(wrong)

"""What frames come to: photographs with their noise, and which frames are left out of them."""

import numpy as np
import pytest

from tankrig.live.exposures import Exposures
from tests.live_plan import PATTERNS, dosed, frame, plan


def test_photographs_are_the_mean_less_the_dark_with_the_noise_that_frames_differ_by() -> None:
    """A wrong noise would make every error bar wrong, and a dark that stays in looks like scattered light."""
    exposures = Exposures(plan())
    rng = np.random.default_rng(0)
    exposures.take(dosed(100.0), None)
    for _ in range(2):
        exposures.take(frame(PATTERNS["dark"], 1), rng.normal(100.0, 3.0, (40, 60)).round().astype(np.uint16))
    light = np.linspace(50.0, 5000.0, 2400).reshape(40, 60)
    for _ in range(8):
        assert exposures.take(frame(PATTERNS["sheet"], 2), rng.poisson(100.0 + light).astype(np.uint16))
    (one,) = exposures.photographs()
    assert (one.pattern, one.dose_ml, one.frames, one.offset) == ("sheet", 0.1, 8, 0.0)
    assert one.dose_sd_ml == pytest.approx(0.002 / np.sqrt(12.0))
    off = (one.image - light / 10.0) / one.noise
    assert off.std() == pytest.approx(1.0, abs=0.15)
    exposures.take(dosed(200.0), None)
    assert exposures.photographs(1) == []
    assert exposures.dose_ml == 0.2


def test_frames_of_ink_that_had_not_mixed_are_left_out_and_a_flickering_lamp_is_not() -> None:
    """A plume in the first frames would bend every later estimate of the dose."""
    exposures, (rows, columns) = Exposures(plan()), np.mgrid[:40, :60]
    tank = 3000.0 * np.exp(-columns / 30.0)
    plume = 1500.0 * np.exp(-((columns - 20.0) ** 2 + (rows - 20.0) ** 2) / 100.0)
    exposures.take(dosed(100.0), None)
    rng, settling = np.random.default_rng(2), []
    for strength, lamp in ((1.0, 1.0), (0.5, 1.0), (0.0, 1.0), (0.0, 1.03), (0.0, 0.98)):
        exposures.take(frame(PATTERNS["sheet"], 2), rng.poisson(lamp * (tank + strength * plume)).astype(np.uint16))
        settling.append(exposures.settling(0))
    assert settling == [False, True, True, False, False]
    assert (exposures.left_out(0), exposures.photographs(0)[0].frames) == (2, 3)

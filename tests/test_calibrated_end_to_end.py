"""From a bench's hidden truth through the calibration commands to the ink in its tank, and back to the truth."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tankrig
from tankrig.image.prepare import Prepared
from tankrig.light.prepared.box import Box
from tankrig.scene import Medium
from tankrig.scene.outline import edges_of_light

from .calibrated_ink import CalibratedInk, quality

SEED = 3
MEDIA = {
    "thin": Medium(0.0003, 0.004, 0.3),
    "medium": Medium(0.0006, 0.018, 0.6),
    "thick": Medium(0.001, 0.05, 0.8),
}
PHOTONS = 1_500_000

pytestmark = pytest.mark.timeout(3600)  # calibrates a bench and prepares a model: ten minutes of a quiet machine


@pytest.fixture(scope="module")
def ink(tmp_path_factory: pytest.TempPathFactory) -> CalibratedInk:
    return CalibratedInk.of(tmp_path_factory.mktemp("bench"), SEED)


@pytest.fixture(scope="module")
def model(ink: CalibratedInk) -> Prepared:
    """For anything like ink in water."""
    return tankrig.prepare(ink.believed(), box=Box((0.002, 0.08), (0.85, 0.9999), (0.0, 0.9)))


def fitted(ink: CalibratedInk, model: Prepared, image: np.ndarray) -> tankrig.Estimate:
    scene = ink.believed()
    return tankrig.estimate(image, scene, gain="free", offset=0.0, mask=edges_of_light(scene), model=model)


@pytest.mark.long
@pytest.mark.parametrize("name", MEDIA)
def test_ink_is_found_with_nothing_but_what_the_program_measured(
    ink: CalibratedInk, model: Prepared, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    true = MEDIA[name]
    found = fitted(ink, model, ink.photographed(true, PHOTONS))
    sd = np.sqrt(np.diag(found.covariance))
    with capsys.disabled():
        print(
            f"\n{name:>6}: σs {found.medium.sigma_s:.5f} ± {sd[1]:.5f} (truth {true.sigma_s:.5f}, "
            f"{100 * (found.medium.sigma_s / true.sigma_s - 1):+.2f} %), g {found.medium.g:.4f} ± {sd[2]:.4f} "
            f"({found.medium.g - true.g:+.4f}), σa {found.medium.sigma_a:.5f} ± {sd[0]:.5f} ({true.sigma_a:.5f})\n"
            f"        {found.verdict}",
            flush=True,
        )
    assert found.medium.sigma_s == pytest.approx(true.sigma_s, rel=0.02)
    assert found.medium.g == pytest.approx(true.g, abs=0.02)


@pytest.mark.long
def test_calibrations_that_are_wrong_are_named(
    ink: CalibratedInk, model: Prepared, capsys: pytest.CaptureFixture[str]
) -> None:
    """What happened to the bench after it was calibrated; the fit believes the files."""
    truth, medium = ink.truth, MEDIA["medium"]
    bumped = truth.camera.translation_mm - truth.camera.rotation @ np.array([5.0, 0.0, 0.0])
    wrong: dict[str, dict[str, Any]] = {
        "as calibrated": {},
        "camera bumped by 5 mm": {"camera": replace(truth.camera, translation_mm=bumped)},
        "water 10 mm lower": {"level_mm": truth.level_mm - 10.0},
        "gamma another": {"gamma": 1.0},
    }
    percent = {}
    for name, otherwise in wrong.items():
        verdict = fitted(ink, model, ink.photographed(medium, PHOTONS // 3, **otherwise)).verdict
        told = re.search(r"holds structure of ([\d.e+-]+) %", verdict)
        percent[name] = float(told[1]) if told else 0.0
        with capsys.disabled():
            print(f"\n{name}: {verdict}", flush=True)
    right = percent.pop("as calibrated")
    assert min(percent.values()) > 2.0 * right, (right, percent)


@pytest.mark.long
def test_how_well_the_bench_was_calibrated(ink: CalibratedInk) -> None:
    well = quality(ink.rig)
    print(well)
    assert well["projector"]["light_scatter_percent"] < 1.0
    assert well["radiometry"]["linearity_error_percent"] < 0.5

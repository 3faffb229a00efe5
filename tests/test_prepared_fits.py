"""Fits by a prepared model of light and sight that slant: light paths tell at the end what all its training lacks."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import tankrig
from tankrig.estimation.estimate import fit_models
from tankrig.estimation.forward import models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.scaling import Scaling
from tankrig.image.prepare import Prepared
from tankrig.light.prepared.box import Box
from tankrig.light.tangent import tank_accurate
from tankrig.scene import Medium
from tests.stress_scenes import scene_of

SCENE = scene_of(Medium(0.001, 0.02, 0.5), "pinhole")
MEDIA = [Medium(0.0008, 0.021, 0.45), Medium(0.0015, 0.026, 0.55)]
NOISE = 0.002
ACCURATE_PATHS = 400_000


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prepared]:
    """Rough, so that what it errs by is more than noise."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield tankrig.prepare(SCENE, 0.1, box=Box((0.015, 0.035), (0.9, 0.99), (0.35, 0.65)))


@pytest.mark.parametrize("medium", MEDIA, ids=lambda one: f"g {one.g:g}")
def test_what_a_prepared_model_is_off_by_is_seen_and_taken_off(prepared: Prepared, medium: Medium) -> None:
    """The paths' errors are less than the rough model's, and values are off by no more than either says."""
    scene = replace(SCENE, medium=medium)
    clean = tank_accurate(scene, ACCURATE_PATHS, seed=11).image
    noise = NOISE * float(clean.max())
    image = clean + np.random.default_rng(3).normal(0.0, noise, clean.shape)
    seen, known = observe(image, clean.shape, noise), Scaling(1.0, 0.0)
    found, alone = (
        fit_models(seen, scene, known, models_of(scene, prepared, None, checked=checked), lambda _: None)
        for checked in (True, False)
    )
    (off, sd), (off_alone, sd_alone) = (
        (np.array(one.medium.coefficients) - np.array(medium.coefficients), np.sqrt(np.diag(one.covariance)))
        for one in (found, alone)
    )
    assert (np.abs(off) < 3.5 * sd).all()
    assert (np.abs(off_alone) < 3.5 * sd_alone).all()
    assert (sd < 0.9 * sd_alone).all()
    assert found.model == "prepared"

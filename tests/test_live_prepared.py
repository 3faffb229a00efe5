"""Live fits by prepared models: when these will be there, what they find, and what becomes of liquids beyond them."""

import queue
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tankrig.estimation import series_forward
from tankrig.image.prepare import Prepared
from tankrig.light.prepared.about import box_for
from tankrig.light.tank import tank_image
from tankrig.live import fits
from tankrig.live import preparing as preparing_module
from tankrig.live.exposures import Photograph
from tankrig.live.fits import fit_dose_prepared
from tankrig.live.preparing import Preparation, Preparing
from tankrig.scene.description import Beam, Camera, Medium, Projector, Scene, Tank
from tests.live_plan import PATTERNS, plan

LIQUID = Medium(0.001, 0.02, 0.55)


def test_the_time_that_models_still_take_is_told_by_those_that_are_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """A person who sees 40 s left waits; one who sees nothing ends the run."""
    now_s, told, go_on = [0.0], queue.Queue[None](), queue.Queue[float]()

    def prepare(_scene: Scene, _tolerance: float, progress: Callable[[float], None], *_: object, **__: object) -> str:
        while (share := go_on.get(timeout=10)) < 1.0:
            progress(share)
            told.put(None)
        return "model"

    monkeypatch.setattr(preparing_module, "prepare", prepare)
    preparing = Preparing(lambda _: told.put(None), lambda: now_s[0])
    scenes = [
        replace(scene, medium=Medium(0.0, 0.01 * (1 + k), 0.5))
        for k, scene in enumerate([plan().scenes[PATTERNS["sheet"].hash]] * 3)
    ]
    preparing.want([(scenes, box_for(LIQUID))])
    go_on.put(0.0)
    told.get(timeout=10)
    assert preparing.left == Preparation(3, None)  # nothing tells yet
    now_s[0] = 10.0
    go_on.put(0.25)
    told.get(timeout=10)
    assert preparing.left.seconds_left == pytest.approx(0.75 * 40.0 + 2 * 40.0)
    now_s[0] = 20.0
    go_on.put(1.0)
    told.get(timeout=10)
    assert preparing.left == Preparation(2, pytest.approx(40.0))
    for _ in range(2):
        go_on.put(1.0)
        told.get(timeout=10)
    assert preparing.left == Preparation(0, 0.0)
    preparing.close()


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Prepared]:
    """A model of a small tank, prepared by the thread that a run has for it."""
    tank = Tank((80.0, 60.0, 40.0))
    light = Projector("collimated", (Beam((-20.0, 20.0), (18.0, 22.0)),))
    scene = Scene(tank, Medium(0.001, 0.02, 0.5), light, Camera("orthographic", (15, 20), 4.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.mktemp("cache")))
        done = threading.Event()
        preparing = Preparing(lambda _: done.set())
        box = preparing.box(LIQUID)
        preparing.want([([scene], box)])
        assert done.wait(120.0)
        models = preparing.models([scene], box)
        preparing.close()
    assert models is not None
    return scene, models[0]


def test_the_prepared_fit_finds_the_liquid_with_errors_that_hold_and_says_when_it_is_elsewhere(
    prepared: tuple[Scene, Prepared],
) -> None:
    """Digits that the next frame doesn't repeat, or a liquid held at the edge of what was prepared, would mislead."""
    scene, model = prepared
    truth = tank_image(replace(scene, medium=LIQUID), seed=7, batches=16)
    radiance = np.sum(list(truth.orders.values()), axis=0)
    noise = np.full(radiance.shape, 0.002 * 5e5 * radiance.max())
    off = []
    for seed in range(20):
        image = 5e5 * radiance + np.random.default_rng(seed).normal(0.0, noise)
        photograph = Photograph("sheet", 0.1, 0.0, scene, image, noise, 0.0, 4)
        found = fit_dose_prepared([photograph] * 2, [model] * 2, Medium(0.0015, 0.018, 0.6))
        assert found is not None
        values = np.array([found.medium.sigma_a, found.medium.sigma_s, found.medium.g])
        off.append((values - [LIQUID.sigma_a, LIQUID.sigma_s, LIQUID.g]) / np.array(found.sd))
    assert np.abs(np.mean(off, axis=0)).max() < 2.0
    assert 0.05 < np.std(off, axis=0).min() <= np.std(off, axis=0).max() < 1.5
    elsewhere = tank_image(replace(scene, medium=Medium(0.001, 0.04, 0.55)), seed=7, batches=4)
    image = 5e5 * np.sum(list(elsewhere.orders.values()), axis=0)
    assert fit_dose_prepared([replace(photograph, image=image)], [model], LIQUID) is None


def test_a_series_that_steps_beyond_its_models_does_not_follow_light_paths(
    prepared: tuple[Scene, Prepared], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of its search without absorption, which no prepared model holds, took minutes on a bench."""
    scene, model = prepared
    followed: list[Medium] = []
    monkeypatch.setattr(series_forward, "tank_model", lambda *_: followed.append)
    answer = fits.nearly_within([model])(scene, 2, 0)
    clear, dense = Medium(0.0, 0.021, 0.55), Medium(0.001, 0.027, 0.66)
    for beyond in (clear, dense):
        assert not model.box.holds(beyond)
        image = model.predict(model.box.nearest(beyond))
        assert np.allclose(answer(beyond).image, image)
    assert followed == []
    answer(Medium(0.001, 0.2, 0.0))  # far from all that it was prepared for
    assert len(followed) == 1


def test_a_series_that_ends_beyond_its_models_is_as_right_as_one_within(prepared: tuple[Scene, Prepared]) -> None:
    """Ink thinner than models are prepared for was shown as at their edge, by 16 % too bright: nothing came out."""
    scene, model = prepared
    ink, photographs = Medium(0.001, 0.02, 0.55), []
    for dose_ml in (0.65, 1.0, 1.1):
        medium = Medium(dose_ml * ink.sigma_a, dose_ml * ink.sigma_s, ink.g)
        assert model.box.holds(medium) == (dose_ml > 0.8)
        radiance = tank_image(replace(scene, medium=medium), seed=5, batches=8).image
        noise = np.full(radiance.shape, 0.003 * 5e5 * radiance.max())
        image = 5e5 * radiance + np.random.default_rng(1).normal(0.0, noise)
        photographs.append(Photograph("sheet", dose_ml, 0.0, scene, image, noise, 0.0, 4))
    found = fits.fit_all(photographs, ink, [model])
    off = np.array([found.ink.sigma_s - ink.sigma_s, found.ink.g - ink.g]) / np.array(found.sd)[1:3]
    assert np.abs(off).max() < 3.0
    assert found.ink.sigma_s == pytest.approx(ink.sigma_s, rel=0.02)

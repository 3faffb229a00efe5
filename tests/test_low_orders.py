"""Orders 1 and 2 of all liquids, prepared before there is ink, are those of each, and models read them there."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tankrig
from tankrig.light.prepared import low_orders, preparation
from tankrig.light.prepared.about import box_for
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.low_orders import LowOrders, prepare_low_orders
from tankrig.light.tank import tank_image
from tankrig.live import preparing
from tankrig.live.preparing import LOOK, foreseen, model_for
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import Face, Faces
from tests.stress_scenes import relative

GLASS = Face("glass")
LIGHT = Projector("pinhole", (Beam((-4.0, 4.0), (38.0, 42.0)),), (-400.0, 5.0, 40.0))
TANK = Tank((120.0, 80.0, 60.0), "fresnel", 1.33, faces=Faces(entry=GLASS, far=GLASS))
SCENE = Scene(TANK, Medium(0.0004, 0.005, 0.45), LIGHT, Camera("pinhole", (16, 24), 5.0, (60.0, 0.0, 500.0)))
BOX = box_for(SCENE.medium)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def cached(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))


@pytest.fixture(scope="module")
def low(folder: Path) -> Iterator[LowOrders]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(folder))
        prepare_low_orders(SCENE, BOX)
        found = LowOrders.kept_for(SCENE, BOX, 0.01)
        assert found is not None
        yield found


@pytest.mark.parametrize(
    ("sigma_t", "g"), [(0.0003, 0.2), (0.0019, 0.66), (0.0057, 0.45), (0.022, 0.8), (0.02, 0.93), (0.055, 0.1)]
)
def test_they_are_the_tank_models(low: LowOrders, sigma_t: float, g: float) -> None:
    ((first, second),) = low.images([(sigma_t, g)])
    scene = replace(SCENE, medium=Medium(0.0, sigma_t, g))
    truth = tank_image(scene, 0.01, max_order=1).orders[1]
    assert relative(first.reshape(16, 24), truth) < 0.002
    # What walls send back of order 2 comes along light paths.
    dark = tank_image(replace(scene, tank=replace(TANK, faces=Faces())), 0.01, max_order=2).orders[2]
    assert np.linalg.norm(second - dark.ravel()) < 0.005 * np.linalg.norm(truth + dark)


def test_what_they_are_off_by_is_told(low: LowOrders) -> None:
    off = np.sqrt(np.mean(np.sum(np.square(low.off, dtype=float), axis=1)))
    assert 1e-6 < off < 0.002


def test_a_models_orders_1_and_2_are_read_there(low: LowOrders, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever waits for a dose's first fit waits for light paths alone."""
    with monkeypatch.context() as patch:
        patch.setattr(preparation, "exact_images", None)
        model = tankrig.prepare(SCENE, 0.05, box=BOX)
    with monkeypatch.context() as patch:
        patch.setattr(LowOrders, "kept_for", classmethod(lambda *_: None))
        patch.setenv("TANKRIG_CACHE", str(model.path.parent.parent / "by itself"))
        by_itself = tankrig.prepare(SCENE, 0.05, box=BOX)
    assert relative(model.predict(SCENE.medium), by_itself.predict(SCENE.medium)) < 0.002
    missed = np.sum(np.square(model.answer.misses, dtype=float)) / len(model.answer.misses)
    own = np.sum(np.square(by_itself.answer.misses, dtype=float)) / len(by_itself.answer.misses)
    beside = np.sum(np.square(low.off, dtype=float)) / len(low.off)
    assert missed == pytest.approx(own + beside, rel=0.3)


@pytest.mark.parametrize(
    ("box", "tolerance"),
    [
        (replace(BOX, g=(-0.1, 0.3)), 0.01),
        (replace(BOX, sigma_t=(0.04, 0.07)), 0.01),
        (BOX, 0.005),
    ],
    ids=["light that turns back", "denser ink", "finer models"],
)
@pytest.mark.usefixtures("low")
def test_models_of_other_liquids_and_finer_ones_compute_their_own(box: Box, tolerance: float) -> None:
    assert LowOrders.kept_for(SCENE, box, tolerance) is None


def test_what_was_interrupted_is_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    scene = replace(SCENE, camera=replace(SCENE.camera, shape=(4, 6), pixel_mm=20.0))
    computed: list[str] = []

    def counted(name: str) -> None:
        compute = getattr(low_orders, name)
        monkeypatch.setattr(low_orders, name, lambda *given: (computed.append(name), compute(*given))[1])

    counted("first_images")
    counted("second_images")

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare_low_orders(scene, BOX, interrupt, threads=1)
    assert 1 <= len(computed) < 5
    prepare_low_orders(scene, BOX)
    assert sorted(computed) == ["first_images"] + 4 * ["second_images"]
    prepare_low_orders(scene, BOX)
    assert len(computed) == 5


def test_a_damaged_file_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    scene = replace(SCENE, camera=replace(SCENE.camera, shape=(4, 6), pixel_mm=20.0))
    prepare_low_orders(scene, BOX)
    (kept,) = (tmp_path / "prepared").glob("*.npz")
    kept.write_bytes(kept.read_bytes()[:-100])
    assert LowOrders.kept_for(scene, BOX, 0.01) is None
    prepare_low_orders(scene, BOX)
    assert LowOrders.kept_for(scene, BOX, 0.01) is not None


@pytest.mark.usefixtures("low")
def test_a_run_has_them_of_all_its_patterns_before_there_is_ink(monkeypatch: pytest.MonkeyPatch) -> None:
    other = replace(SCENE, projector=replace(LIGHT, beams=(Beam((8.0, 12.0), (38.0, 42.0)),)))
    assert foreseen([SCENE, other], (0.1, 0.5), None) == [([SCENE, other], LOOK)]
    dark = replace(SCENE, tank=replace(TANK, faces=Faces()))
    assert foreseen([dark, dark], (0.1, 0.5), None) == [([dark], LOOK)]
    assert not low_orders.prepare_low_orders(dark, BOX)
    shares: list[float] = []
    model_for(other, LOOK, shares.append)
    assert shares == sorted(shares)
    monkeypatch.setattr(preparation, "exact_images", None)
    monkeypatch.setattr(preparing, "SLANTED_TOLERANCE", 0.05)
    assert model_for(other, BOX).box == BOX

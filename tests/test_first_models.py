"""First models, by a share of the light paths, and whole ones that go on from them."""

import queue
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tankrig.image.prepare import Prepared, prepare
from tankrig.light.prepared.about import box_for
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.sampling import PathImages
from tankrig.live import preparing as preparing_module
from tankrig.live.preparing import LOOK, Preparing
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

LIGHT = Projector("pinhole", (Beam((-4.0, 4.0), (38.0, 42.0)),), (-400.0, 5.0, 40.0))
SCENE = Scene(
    Tank((120.0, 80.0, 60.0), "fresnel", 1.33), Medium(0.0004, 0.01, 0.45), LIGHT,
    Camera("pinhole", (16, 24), 5.0, (60.0, 0.0, 500.0)),
)  # fmt: skip
BOX = box_for(SCENE.medium)
OTHER, THIRD = (box_for(Medium(0.0004, sigma_s, 0.45)) for sigma_s in (0.02, 0.04))


@pytest.fixture
def followed(monkeypatch: pytest.MonkeyPatch) -> list[range]:
    """Lattices that are followed from now on, of each medium."""
    seen: list[range] = []
    sample = PathImages.sample

    def noted(self: PathImages, medium: Medium, seed: int, lattices: range) -> np.ndarray:
        seen.append(lattices)
        return sample(self, medium, seed, lattices)

    monkeypatch.setattr(PathImages, "sample", noted)
    return seen


def test_the_whole_model_goes_on_with_what_the_first_has_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, followed: list[range]
) -> None:
    """A fit that comes early must not make the whole one late, nor another one."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "two stages"))
    early = prepare(SCENE, 0.01, box=BOX, first=True)
    by_first = sum(map(len, followed))
    assert early.first
    assert not list(tmp_path.rglob("*/prepared/*.npz")), "the next run would take it for the whole one"
    whole = prepare(SCENE, 0.01, box=BOX)
    by_both = sum(map(len, followed))
    assert not whole.first
    assert not prepare(SCENE, 0.01, box=BOX, first=True).first
    assert 0.2 < by_first / by_both < 0.35
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "at once"))
    at_once = prepare(SCENE, 0.01, box=BOX)
    assert sum(map(len, followed)) == 2 * by_both
    np.testing.assert_array_equal(whole.predict(SCENE.medium), at_once.predict(SCENE.medium))


def test_a_first_model_states_what_it_errs_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its fit is shown and recorded, with the errors that it has by then."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    early, whole = prepare(SCENE, 0.01, box=BOX, first=True), prepare(SCENE, 0.01, box=BOX)
    places = np.random.default_rng(3).uniform(-0.9, 0.9, (20, 3))
    shares = []
    for place in places:
        sigma_t, albedo, g = early.answer.coordinates.back(place)
        medium = Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, g)
        truth = whole.predict(medium)
        off = float(np.linalg.norm(early.predict(medium) - truth) / np.linalg.norm(truth))
        shares.append(off / early.error_at(medium))
        assert 1.0 < early.error_at(medium) / whole.error_at(medium) < 3.0
    assert 0.4 < float(np.sqrt(np.mean(np.square(shares)))) < 1.3


def test_first_models_of_all_that_is_wanted_come_before_whole_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next dose's first fit would else wait for models that only make the one before better."""
    made, go_on = queue.Queue[tuple[Box, bool, str]](), queue.Queue[None]()

    def model_for(
        _scene: Scene, box: Box, progress: Callable[[float], object], _phases: str, first: bool = False
    ) -> tuple[Box, bool]:
        try:
            go_on.get(timeout=10.0)
            progress(0.5)
        except Exception:
            made.put((box, first, "let go"))
            raise
        made.put((box, first, "made"))
        return box, first

    monkeypatch.setattr(preparing_module, "model_for", model_for)
    monkeypatch.setattr(preparing_module, "is_kept", lambda *_: False)
    monkeypatch.setattr(preparing_module, "unlike_learned", lambda *_: "")
    told = queue.Queue[str]()
    preparing = Preparing(told.put, first=True)
    preparing.want([([SCENE], BOX), ([SCENE], LOOK)])

    def next_made() -> tuple[Box, bool, str]:
        go_on.put(None)
        return made.get(timeout=10.0)

    assert next_made() == (BOX, True, "made")
    told.get(timeout=10.0)
    assert preparing.models([SCENE], BOX) is None
    assert preparing.model_so_far(SCENE, BOX) == (BOX, True)
    assert next_made() == (LOOK, False, "made")
    told.get(timeout=10.0)
    preparing.want([([SCENE], OTHER), ([SCENE], BOX)])
    while (one := next_made()) != (OTHER, True, "made"):
        assert one == (BOX, False, "let go")
    assert {next_made() for _ in range(2)} == {(BOX, False, "made"), (OTHER, False, "made")}
    for _ in range(3):
        told.get(timeout=10.0)
    assert preparing.models([SCENE], BOX) == [(BOX, False)]
    assert preparing.model_so_far(SCENE, BOX) == (BOX, False)
    assert preparing.left.models == 0
    preparing.want([([SCENE], THIRD)])
    preparing.want([])
    assert preparing.left.models == 0, "nobody wants it any more"
    preparing.close()


def test_where_light_runs_straight_a_first_model_is_the_whole_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There a model takes seconds, and two stages would take longer."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    straight = Scene(
        Tank((80.0, 60.0, 40.0)), Medium(0.001, 0.02, 0.5),
        Projector("collimated", (Beam((-20.0, 20.0), (18.0, 22.0)),)), Camera("orthographic", (15, 20), 4.0),
    )  # fmt: skip
    model = prepare(straight, 0.02, box=box_for(straight.medium), first=True)
    assert isinstance(model, Prepared)
    assert model.path is not None
    assert model.path.exists()

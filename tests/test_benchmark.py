"""`tankrig benchmark`: what it measures is written down, and what it cannot measure is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.benchmark.contestant import Contestant
from tankrig.benchmark.race import variations
from tankrig.benchmark.trial import run_trial
from tankrig.benchmark.truth import Case, cases_of, own_cases
from tankrig.errors import ImageError, SceneError
from tankrig.montecarlo import simulate
from tankrig.scene import Medium
from tests.stress_scenes import medium_of, scene_of, with_camera
from ui.cli import main

TOML = """
[tank]
size_mm = [72.0, 48.0, 36.0]
surface = "matched"
[medium]
sigma_a = 0.003
sigma_s = 0.027
g = 0.5
[projector]
kind = "collimated"
beams = [ { y_mm = [-8.0, -3.0], z_mm = [15.0, 20.0], irradiance = 1.0 } ]
[camera]
kind = "orthographic"
shape = [12, 18]
pixel_mm = 4.0
"""


@pytest.fixture
def reference(tmp_path: Path) -> Path:
    """A folder with one case."""
    folder = tmp_path / "reference"
    folder.mkdir()
    (folder / "small.toml").write_text(TOML)
    import tankrig

    tally = simulate(tankrig.load_scene(folder / "small.toml"), 20_000, seed=1)
    np.savez(folder / "small.npz", total=tally.image, stderr=tally.stderr)
    return folder


def test_a_quick_run_writes_what_it_measured(
    reference: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its figures are what claims about speed rest on."""
    out = tmp_path / "out"
    assert main(["benchmark", "--quick", "--reference", str(reference), "--out", str(out), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "benchmark.json").read_text())
    assert (out / "benchmark.png").stat().st_size > 10_000
    by_label = {one["label"]: one for one in printed["results"]}
    assert set(by_label) == {"tank, 10.00%", "tank, 1.00%", "single", "montecarlo, 1e+04 photons"}
    assert by_label["single"]["error"] > 0.3 > 0.02 > by_label["tank, 1.00%"]["error"]
    assert all(one["seconds"] > 0.0 and one["peak_mib"] > 50.0 for one in printed["results"])


@pytest.mark.parametrize("arguments", [["--reference", "nowhere"], ["--cases", "pub99"]])
def test_a_wrong_reference_is_refused(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing may be left behind that looks like a measurement."""
    assert main(["benchmark", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith("tankrig: ")
    assert not (tmp_path / "out").exists()


def test_a_reference_that_does_not_fit_its_scene_is_named(reference: Path) -> None:
    np.savez(reference / "small.npz", total=np.ones((2, 2)), stderr=np.ones((2, 2)))
    with pytest.raises(ImageError, match=r"small\.npz: its arrays don't fit"):
        cases_of(reference)
    (reference / "small.npz").write_bytes(b"no zip")
    with pytest.raises(ImageError, match=r"small\.npz: cannot be read"):
        cases_of(reference)


def test_our_own_reference_is_made_once(tmp_path: Path) -> None:
    """Without a folder the command would otherwise simulate for minutes each time; a torn file is made again."""
    (case,) = own_cases(tmp_path, ("thin-beam",), noise=0.05)
    (kept,) = tmp_path.glob("*.npz")
    made = kept.stat().st_mtime_ns
    assert np.array_equal(own_cases(tmp_path, ("thin-beam",), noise=0.05)[0].image, case.image)
    assert kept.stat().st_mtime_ns == made
    kept.write_bytes(kept.read_bytes()[:500])
    assert np.array_equal(own_cases(tmp_path, ("thin-beam",), noise=0.05)[0].image, case.image)


def test_the_reference_s_noise_is_taken_off_the_error() -> None:
    scene = with_camera(scene_of(medium_of(1.0, 0.1, 0.5)), (12, 18), 4.0)
    case = Case("flat", scene, np.ones((12, 18)), np.full((12, 18), 0.03))
    assert case.excess(np.full((12, 18), 1.05)) == pytest.approx(0.04)
    assert case.excess(np.full((12, 18), 1.02)) == 0.0


def test_what_a_model_cannot_treat_is_told_from_its_process() -> None:
    scene = with_camera(scene_of(Medium(0.0, 0.01, 0.5)), (12, 18), 4.0)
    with pytest.raises(SceneError, match=r"medium\.sigma_a = 0"):
        run_trial(Contestant("convolution", 0.5), scene)


def test_costs_vary_one_thing_at_a_time() -> None:
    scene = scene_of(medium_of(1.0, 0.1, 0.5))
    for what, _, changed, contestant, threads in variations(scene):
        same = replace(
            changed,
            **{
                "pixels": {"camera": scene.camera},
                "beams": {"projector": scene.projector},
                "tank size": {"tank": scene.tank, "projector": scene.projector, "camera": scene.camera},
            }.get(what, {}),
        )
        assert same == scene, what
        assert (contestant.max_order is not None) == (what == "orders")
        assert (threads is not None) == (what == "processors")

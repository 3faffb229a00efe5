"""`tankrig benchmark`: what it measures is written down, and what it cannot measure is refused."""

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig import predict
from tankrig.benchmark import race as race_module
from tankrig.benchmark.contestant import Contestant
from tankrig.benchmark.equal import at_equal_error
from tankrig.benchmark.mitsuba_tank import mitsuba_image
from tankrig.benchmark.plain import plain_image
from tankrig.benchmark.race import race, variations
from tankrig.benchmark.result import Result
from tankrig.benchmark.trial import Trial, measure, run_trial
from tankrig.benchmark.truth import Case, cases_of, own_cases
from tankrig.benchmark.wide import CLASSES, Truths, measured, squares_over_stated, summary, truths_of, wide_scene
from tankrig.errors import ImageError, SceneError, TankrigError
from tankrig.montecarlo import simulate
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.writing import scene_text
from tests.stress_scenes import medium_of, relative, scene_of, with_camera
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
    reference: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its figures are what claims about speed rest on; one of its trials in a process of its own, the others here."""

    def trial_here(contestant: Contestant, scene: Scene, threads: int | None = None, limit_s: float = 600.0) -> Trial:
        if contestant.model == "single" or threads is not None:
            return run_trial(contestant, scene, threads, limit_s)
        said, image = measure(contestant, scene, threads)
        return Trial(**said, image=image)  # type: ignore[arg-type]

    monkeypatch.setattr(race_module, "run_trial", trial_here)
    out = tmp_path / "out"
    assert (
        main(["benchmark", "--quick", "--limit", "280", "--reference", str(reference), "--out", str(out), "--json"])
        == 0
    )
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "benchmark.json").read_text())
    assert (out / "benchmark.png").stat().st_size > 10_000
    by_label = {one["label"]: one for one in printed["results"]}
    photons = {"montecarlo, 1e+04 photons", "plain, 1e+05 photons"}
    assert set(by_label) == {"tank, 10.00%", "tank, 1.00%", "single"} | photons
    assert by_label["single"]["error"] > 0.3 > 0.02 > by_label["tank, 1.00%"]["error"]
    assert all(one["seconds"] > 0.0 and one["peak_mib"] > 50.0 for one in printed["results"])
    assert {one["model"] for one in printed["equal"]} == {"montecarlo", "plain"}
    assert not printed["missing"]


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


@pytest.mark.parametrize(
    ("kind", "surface"), [("parallel", "matched"), ("pinhole", "matched"), ("parallel", "fresnel")]
)
def test_the_plain_monte_carlo_has_no_bias(kind: str, surface: str) -> None:
    """A wrong image would make any other model look fast at equal error."""
    scene = scene_of(medium_of(1.5, 0.1, 0.5), kind, surface=surface)
    truth = simulate(scene, 100_000)
    image = plain_image(scene, 400_000)
    assert float(image.sum() / truth.image.sum()) == pytest.approx(1.0, abs=0.02)
    assert relative(image, truth.image) < 0.15


@pytest.mark.parametrize(
    ("kind", "surface"), [("parallel", "matched"), ("pinhole", "matched"), ("parallel", "fresnel")]
)
def test_mitsuba_sees_the_same_tank(kind: str, surface: str) -> None:
    """Another pattern, another way round or another unit would make its comparison worthless."""
    pytest.importorskip("mitsuba")
    beams = (Beam((-20.0, 2.0), (10.0, 30.0)), Beam((6.0, 12.0), (4.0, 20.0), 0.5))
    scene = scene_of(medium_of(1.5, 0.1, 0.5), kind, beams, surface)
    if kind == "pinhole":
        scene = replace(scene, camera=replace(scene.camera, position_mm=(36.0, 0.0, 200.0)))
    scene = with_camera(scene, (6, 9), 8.0)
    truth = simulate(scene, 100_000).image
    image = mitsuba_image(scene, 8000)
    assert float(image.sum() / truth.sum()) == pytest.approx(1.0, abs=0.03)
    assert relative(image, truth) < 0.15


def test_a_trial_beyond_its_limit_ends_and_is_stated(reference: Path) -> None:
    """It would hold the whole run up, or be missing from its table without a word."""
    photons = Contestant("plain", samples=10**9)
    with pytest.raises(TankrigError, match="not done in 1 s"):
        run_trial(photons, cases_of(reference)[0].scene, limit_s=1.0)
    told: list[str] = []
    measured = race(cases_of(reference), (photons,), 1, False, 1.0, lambda what, _: told.append(what))
    assert [(one.label, one.why) for one in measured.missing] == [("plain, 1e+09 photons", "not done in 1 s")]
    assert told[-1].endswith("not done in 1 s")


def test_a_trial_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    """A benchmark that is killed would leave its trial at work for as long as that takes."""
    scene = scene_of(medium_of(1.0, 0.1, 0.5))
    (tmp_path / "job").write_bytes(pickle.dumps((Contestant("plain", samples=10**9), scene, None)))
    command = [sys.executable, "-m", "tankrig.benchmark.trial", str(tmp_path / "job"), str(tmp_path / "result.npz")]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as trial:
        assert trial.stdin is not None
        trial.stdin.close()
        assert trial.wait(30.0) == 1


def test_time_to_an_equal_error_follows_the_root_of_the_samples() -> None:
    """100 times the samples for a tenth of the error, at the longest run's pace; a long enough run is not extended."""

    def result(model: str, samples: int | None, error: float, seconds: float) -> Result:
        tolerance = 0.01 if model == "tank" else None
        return Result("one", model, model, tolerance, samples, error, 0.004, 1.0, seconds, 2.0 * seconds, 100.0)

    runs = [result("plain", 100, 0.4, 1.1), result("plain", 10_000, 0.04, 11.0), result("montecarlo", 100, 0.002, 3.0)]
    plain, quick = at_equal_error([result("tank", None, 0.004, 0.5), *runs])
    assert (plain.error, quick.error) == (0.004, 0.004)
    assert plain.extrapolated == pytest.approx(100.0)
    assert plain.seconds == pytest.approx(1001.0, rel=1e-3)
    assert plain.slower == pytest.approx(2002.0, rel=1e-3)
    assert quick.extrapolated == pytest.approx(0.25)


def test_two_noisy_truths_tell_an_error_far_below_their_noise() -> None:
    """An error that held the truths' own noise would call every prediction wrong."""
    wide = wide_scene(0)
    rng, truth = np.random.default_rng(0), np.ones((80, 120))
    noisy = [truth + rng.normal(0.0, 0.02, truth.shape) for _ in range(2)]
    truths = Truths(wide, noisy[0], noisy[1], np.zeros_like(truth))
    known = Truths(wide, noisy[0], noisy[0], np.full_like(truth, 0.02**2))
    for each in (truths, known):
        error = np.sqrt(each.squares(1.005 * truth).sum()) / each.size
        assert error == pytest.approx(0.005, rel=0.2)


@pytest.mark.parametrize("noise", [0.5, 2.5, 3.5])
def test_errors_as_large_as_stated_are_told_so_beside_noisy_truths(noise: float) -> None:
    """Blocks that count for their own small noise told 1.25 (squared) where truths have 3.5 times what is stated."""
    found = []
    for seed in range(40):
        numbers, shape = np.random.default_rng(seed), (80, 120)
        error = numbers.normal(0.0, 1.0, shape)
        one, other = (noise * (numbers.gamma(0.2, 0.2**-0.5, shape) - 0.2**0.5) for _ in range(2))  # skew, as of paths
        squares = (error - one) * (error - other)
        found.append(squares_over_stated(squares, np.ones(shape), 0.5 * np.square(one - other)))
    assert sum(blocks for _, blocks in found) > 1000
    whole = sum(squares * blocks for squares, blocks in found if blocks) / sum(blocks for _, blocks in found)
    assert whole == pytest.approx(1.0, abs=0.1)


def test_a_folder_that_tells_more_is_asked_for_classes_and_times(tmp_path: Path) -> None:
    """The truths' program takes 1/error² as long: without its own noise in that, any factor could be claimed."""
    wide = wide_scene(6)  # one of thin ink
    prediction = predict(wide.scene, tolerance=0.03)
    orders = {key: np.asarray(image) for key, image in prediction.orders.items()}
    size = float(np.linalg.norm(prediction.image))
    off = np.zeros(orders[2].shape)
    off[40, 60] = 0.05 * size  # one class is off by 5 % of the image, and another makes up for it
    told = {CLASSES[key]: image for key, image in orders.items()}
    told |= {CLASSES[2]: orders[2] + off, CLASSES[3]: orders[3] - off, "total": prediction.image}
    twice = told | {f"{name}_2": image for name, image in told.items()}
    metadata = json.dumps({"cpu_seconds": 8.0, "l2_noise": 0.01})
    np.savez(tmp_path / "one.npz", **twice, stderr=np.zeros_like(off), metadata=np.array(metadata))
    (tmp_path / "one.toml").write_text(scene_text(wide.scene))
    found = measured(truths_of(tmp_path, 1), [0.03], 60.0, lambda _: None)[0]
    assert found.error < 1e-3
    assert found.classes == pytest.approx(0.05, rel=0.02)
    assert found.slower == pytest.approx(8.0 * (0.01 / (0.5 * found.stated)) ** 2 / found.cpu_seconds, rel=1e-6)
    assert summary([found], 0.03).classes == 0.0


def test_random_scenes_are_of_all_kinds_and_stay_what_they_are() -> None:
    scenes = [wide_scene(number) for number in range(60)]
    kinds = [each.kind for each in scenes]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {"parallel": 40, "pinholes": 10, "bent": 10}
    assert scenes == [wide_scene(number) for number in range(60)]
    media = np.array([each.scene.medium.coefficients for each in scenes])
    assert media[:, 2].min() < -0.2 < 0.8 < media[:, 2].max()
    assert {each.scene.tank.surface for each in scenes} == {"matched", "fresnel"}


def test_how_tolerances_are_kept_is_told(reference: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["--wide", "1", "--reference", str(reference), "--tolerances", "0.1,0.03", "--out", str(out), "--json"]
    assert main(["benchmark", *arguments]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "wide.json").read_text())
    assert [one["tolerance"] for one in printed["summary"]] == [0.1, 0.03]
    assert all(one["kept"] == 1.0 and one["worst_unsaid"] < 1.0 for one in printed["summary"])
    assert all(one["cpu_worst"] > 0.0 for one in printed["summary"])


def test_senseless_tolerances_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["benchmark", "--wide", "1", "--tolerances", "one", "--out", str(tmp_path)]) == 2
    assert "no list of relative errors" in capsys.readouterr().err

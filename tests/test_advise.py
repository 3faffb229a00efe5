"""Advice: what another photograph is expected to tell is what a fit then finds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.advice.expected import Known, Shot, expected
from tankrig.advice.ranking import Candidate, ranked
from tankrig.estimation.series import estimate_series
from tankrig.estimation.series_forward import prepared_model
from tankrig.image.prepare import Prepared, prepare
from tankrig.light.prepared.box import Box
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.phase_functions import phase_function
from ui.cli import main

SCENE = Scene(
    Tank((80.0, 60.0, 40.0)),
    Medium(0.001, 0.02, 0.5),
    Projector("collimated", (Beam((-20.0, 20.0), (18.0, 22.0)),)),
    Camera("orthographic", (15, 20), 4.0),
)
INK, WATER, GAIN = Medium(0.001, 0.02, 0.6), 2e-4, 1e5


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Prepared:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.mktemp("cache")))
        return prepare(SCENE, 0.05, box=Box((0.004, 0.03), (0.6, 0.9999), (0.45, 0.75)))


def radiance(medium: Medium) -> np.ndarray:
    """A beam and a glow about it that widens: what a tank does to light, in closed form."""
    x, y = np.arange(20) * 4.0 + 2.0, (np.arange(15) * 4.0 - 28.0)[:, None]
    transport = medium.sigma_s * (1.0 - medium.g)
    beam = medium.sigma_s * phase_function(np.array(0.0), medium.g) * np.exp(-medium.sigma_t * (x + 20.0))
    width = 4.0 + 8.0 * transport * x
    glow = np.exp(-(medium.sigma_a + 0.5 * transport) * (x + 20.0) - 0.5 * (y / width) ** 2)
    image: np.ndarray = beam * (np.abs(y) < 20.0) + 10.0 * (medium.g * medium.sigma_s) ** 2 * glow / width
    return image


def answer(_: Scene, medium: Medium) -> tuple[np.ndarray, np.ndarray]:
    steps = {"sigma_a": 1e-5, "sigma_s": 1e-5, "g": 1e-4}
    image = radiance(medium)
    slopes = [
        (radiance(replace(medium, **{name: getattr(medium, name) + step})) - image) / step
        for name, step in steps.items()
    ]
    return image, np.stack(slopes)


class InClosedForm:
    def predict(self, medium: Medium, derivatives: bool) -> tuple[np.ndarray, np.ndarray]:
        assert derivatives
        return answer(SCENE, medium)


def known(peak_share: float, model_error: float) -> Known:
    peaks = 2000.0 * peak_share
    return Known(INK, WATER, GAIN, False, lambda image: np.full(image.shape, peaks**2), model_error)


def shot(dose_ml: float, frames: int = 4) -> Shot:
    return Shot("sheet", SCENE, dose_ml, 0.005 * dose_ml, frames)


@pytest.mark.long
def test_the_errors_foretold_are_those_of_fits_with_the_photograph_taken(model: Prepared) -> None:
    """A person doses ink, which nobody takes out again, on the word of this."""

    def answer(_: Scene, medium: Medium) -> tuple[np.ndarray, np.ndarray]:
        return model.predict(medium, derivatives=True)

    state = known(0.002, 0.0)
    shots = [shot(0.25), shot(0.5), shot(1.0)]
    foretold = expected(state, shots, answer)
    rng, found, stated = np.random.default_rng(0), [], []
    for _ in range(40):
        doses = np.array([one.dose_ml for one in shots])
        true = doses * (1.0 + 0.005 * rng.normal(size=3))
        sd = np.sqrt(state.noise(np.zeros(SCENE.camera.shape)) / 4)
        images = [GAIN * model.predict(state.liquid(dose)) + rng.normal(0.0, sd) for dose in true]
        fit = estimate_series(
            images, SCENE, doses, 0.005 * doses, offset=0.0, noise=[sd] * 3, start=INK, model_of=prepared_model([model])
        )  # fmt: skip
        found.append([fit.ink.sigma_a, fit.ink.sigma_s, fit.ink.g])
        stated.append(np.sqrt(np.diag(fit.covariance))[:3])
    sd = np.sqrt(np.diag(foretold.covariance))
    print("\nscatter of 40 fits over what was foretold:", (np.std(found, axis=0) / sd).round(2))
    assert np.std(found, axis=0) / sd == pytest.approx(1.0, abs=0.25)  # of 40 draws by chance ± 0.11
    with_error = replace(state, model_error=model.error_at(state.liquid(0.5)))
    stated_then = np.sqrt(np.diag(expected(with_error, shots, answer).covariance))
    print("stated by those fits over what was foretold:", (np.median(stated, axis=0) / stated_then).round(2))
    assert np.median(stated, axis=0) / stated_then == pytest.approx(1.0, abs=0.2)


def test_more_ink_ranks_by_what_it_tells_for_its_time_and_volume() -> None:
    """The best for the time need not be the best for the ink."""
    state, taken = known(0.002, 0.001), [shot(0.25), shot(0.5)]
    candidates = [
        Candidate(shot(0.5), 0.01, 0.0),
        Candidate(shot(1.0), 0.5, 500.0),
        Candidate(shot(1.0, frames=16), 0.51, 500.0),
    ]
    before, by_time = ranked(state, taken, candidates, answer, "minute")
    _, by_bits = ranked(state, taken, candidates, answer, "all")
    assert before is not None
    assert all(advice.bits > 0.0 for advice in by_bits)
    assert by_time[0].candidate is candidates[0]
    assert by_bits[0].candidate is candidates[2]
    assert by_bits[0].bits_per_ul == pytest.approx(by_bits[0].bits / 500.0)
    assert by_time[0].bits_per_ul is None
    frames = [expected(state, [*taken, shot(0.5, frames)], answer) for frames in (4, 10**9)]
    assert before.bits_to(frames[0]) > 0.0
    assert frames[1].relative_sd["sigma_s"] > 0.0002  # the model's error is in every frame alike
    _, for_absorption = ranked(state, taken, candidates, answer, "all", "sigma_a")
    best = for_absorption[0]
    assert best.bits == pytest.approx(np.log2(before.relative_sd["sigma_a"] / best.after.relative_sd["sigma_a"]))
    _, blind = ranked(state, [], candidates, answer, "all")
    assert blind[0].candidate.shot.dose_ml == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give the folder of a run, or --sequence and --ink"),
        (["--sequence", "s.toml"], "--sequence needs --ink"),
        (["nowhere"], "does not exist"),
        (["nowhere", "--until", "sigma_s", "1%"], "--until is about pictures that are designed; give --design FILE"),
        (["nowhere", "--cells", "24"], "--cells is about pictures that are designed"),
        (["--sequence", "s.toml", "--ink", "0.001", "0.01", "0.7", "--dose-ul", "1e9"], "may hold"),
    ],
)
def test_what_cannot_be_advised_on_is_one_sentence(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    text = 'name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    assert main(["advise", *arguments]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert len(said.splitlines()) == 1


def test_the_command_ranks_a_sequences_patterns_for_a_guess_of_the_ink(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the first dose there is no run yet, and the question is how much to begin with."""
    monkeypatch.setattr("tankrig.advice.ranking.prepare", lambda *_: InClosedForm())
    monkeypatch.chdir(tmp_path)
    rig = Path(main.__code__.co_filename).parents[2] / "drivers" / "simulated" / "rig.toml"
    text = rig.read_text(encoding="utf-8")
    for before, after in (
        ("[240.0, 160.0, 120.0]", "[80.0, 60.0, 40.0]"), ("[80, 120]", "[15, 20]"),
        ("pixel_mm = 2.0", "pixel_mm = 4.0"),
        ("y_mm = [-80.0, 80.0]", "y_mm = [-30.0, 30.0]"), ("z_mm = [0.0, 120.0]", "z_mm = [0.0, 40.0]"),
    ):  # fmt: skip
        assert before in text
        text = text.replace(before, after)
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    sequence = 'name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\n'
    (tmp_path / "s.toml").write_text(sequence, encoding="utf-8")
    common = ["advise", "--sequence", "s.toml", "--rig", "rig.toml", "--ink", "0.001", "0.02", "0.6"]
    common += ["--dose-ul", "300", "--dose-ul", "1000", "--for", "sigma_s", "--by", "all"]
    assert main([*common, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["now"] is None
    assert [row["dose_ul"] for row in told["candidates"]] == [1000.0, 300.0]
    assert told["candidates"][0]["relative_sd"]["sigma_s"] < told["candidates"][1]["relative_sd"]["sigma_s"]
    assert main(common) == 0
    assert "full × 4" in capsys.readouterr().out

"""The benchmark of estimates: its short cuts are right, it goes on where it was, and its page says what was missed."""

import json
from pathlib import Path

import numpy as np
import pytest

from tankrig.benchmark_estimates.page import write_page
from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.benchmark_estimates.surrogate import near
from tankrig.prediction import Prediction
from tankrig.scene import Medium
from ui.cli import main

CASE = """
[tank]
size_mm = [60.0, 40.0, 40.0]
surface = "matched"
[medium]
sigma_a = 0.001
sigma_s = 0.003
g = 0.3
[projector]
kind = "collimated"
beams = [ { y_mm = [-4.0, 4.0], z_mm = [16.0, 24.0], irradiance = 1.0 } ]
[camera]
kind = "orthographic"
shape = [10, 15]
pixel_mm = 4.0
"""


def test_the_polynomial_that_stands_for_a_model_is_the_model_nearby() -> None:
    """A thousand fits use it: a wrong term would be a bias that no estimate has."""
    way = np.linspace(5.0, 50.0, 12).reshape(3, 4)

    def predict(medium: Medium) -> Prediction:
        return Prediction(medium.sigma_s * np.exp(-medium.sigma_t * way) * (1.0 + medium.g * way / 50.0), "toy")

    centre = Medium(0.002, 0.02, 0.5)
    models = near(predict, centre, np.array([0.05, 0.1, 0.05]))
    beside = Medium(0.00205, 0.0203, 0.51)
    assert models.coarse(beside).image == pytest.approx(predict(beside).image, rel=2e-5)
    assert models.slopes is not None
    step = 1e-7
    for k, moved in enumerate((Medium(0.00205 + step, 0.0203, 0.51), Medium(0.00205, 0.0203 + step, 0.51))):
        slope = (predict(moved).image - predict(beside).image) / step
        assert models.slopes(beside)[k] == pytest.approx(slope, rel=0.01, abs=0.01 * np.abs(slope).max())


def test_an_interrupted_benchmark_goes_on_where_it_was(tmp_path: Path) -> None:
    """It takes an hour; what was measured must not be measured again."""
    asked = []
    records = Records(tmp_path / "kept", asked.append)
    first = records.numbers("part/one", lambda: {"value": 1.5})
    assert records.numbers("part/one", lambda: {"value": 2.5}) == first == {"value": 1.5}
    array = records.arrays("two", lambda: {"image": np.eye(2)})
    assert np.array_equal(records.arrays("two", dict)["image"], array["image"])
    assert asked == ["part/one", "two"]


def test_the_page_shows_what_was_missed(tmp_path: Path) -> None:
    """A figure outside its bound that looks like the others would be overlooked."""
    rows = ((Cell("pub01"), Cell("+0.1 %", True)), (Cell("<pub02>"), Cell("+9 %", False)))
    write_page([Section("Reference", "About it.", ("case", "σs off"), rows, "1 of 2.")], tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert '<td class="missed">+9 %</td>' in page
    assert '<td class="met">+0.1 %</td>' in page
    assert "1 figures outside" in page
    assert "&lt;pub02&gt;" in page


def small_case(folder: Path) -> list[str]:
    """A reference case, and the command that measures it."""
    import tankrig

    (folder / "tiny.toml").write_text(CASE)
    np.savez(folder / "tiny.npz", total=tankrig.predict(tankrig.load_scene(folder / "tiny.toml"), "single").image)
    return ["benchmark-estimates", "--parts", "reference", "--reference", str(folder), "--out", str(folder / "out")]


def test_the_command_writes_the_page_from_what_was_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bounds: σs 1 % off is within, g 0.02 off is not, and σa may be off by two Cramér–Rao standard deviations."""
    truth = {"sigma_a": 0.001, "sigma_s": 0.003, "g": 0.3}
    fit = {
        "case": "tiny", "fresnel": False, "truth": truth, "found": {"sigma_a": 0.0012, "sigma_s": 0.00302, "g": 0.32},
        "sd": [1e-4, 1e-5, 0.01], "cramer_rao": [1.5e-4, 1e-5, 0.001], "verdict": "", "cpu_s": 1.0,
        "determined": {"sigma_a": False, "sigma_s": True, "g": True},
    }  # fmt: skip
    kept = tmp_path / "out" / "full" / "reference"
    kept.mkdir(parents=True)
    for gain in ("known", "free"):
        (kept / f"tiny-{gain}.json").write_text(json.dumps({**fit, "gain": gain}))
    assert main([*small_case(tmp_path), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out).values()
    assert found["missed"] == 2  # g, twice
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert '<td class="missed">+0.0200</td>' in page
    assert '<td class="met">+0.67 %</td>' in page
    assert '<td class="met">+20.0 %</td>' in page


@pytest.mark.long
def test_the_command_measures_a_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From an image to numbers and a page, by one command."""
    import tankrig

    command = small_case(tmp_path)
    np.savez(tmp_path / "tiny.npz", total=tankrig.predict(tankrig.load_scene(tmp_path / "tiny.toml")).image)
    assert main([*command, "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out).values()
    assert [one["gain"] for one in found["numbers"]] == ["known", "free"]
    for one in found["numbers"]:
        assert one["found"]["sigma_s"] == pytest.approx(0.003, abs=5.0 * one["sd"][1])
        assert one["cramer_rao"][1] <= one["sd"][1] * 1.05


@pytest.mark.parametrize("options", [["--parts", "magic"], ["--cases", "pub99"]])
def test_what_cannot_be_measured_is_said(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An hour later would be too late."""
    assert main(["benchmark-estimates", *options, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()

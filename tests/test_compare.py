"""Models compared: one table in which the model that made the picture comes out best."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tankrig
from tankrig.estimation.comparison import Contender, compare_models
from tankrig.image.predict import predict
from tankrig.scene import load_scene
from ui.cli import main

SCENE = """
[tank]
size_mm = [80.0, 60.0, 40.0]
surface = "matched"
[medium]
sigma_a = 0.002
sigma_s = 0.02
g = 0.4
[projector]
kind = "collimated"
beams = [ { y_mm = [-4.0, 4.0], z_mm = [18.0, 22.0], irradiance = 1.0 } ]
[camera]
kind = "orthographic"
shape = [15, 20]
pixel_mm = 4.0
"""
QUICK = (Contender("single scattering", "single"), Contender("diffuse limit", "diffuse"), Contender("none", "none"))


def estimate(*given, phase: str | None):
    """The real one for single scattering; a diffuse limit that leaves a smooth pattern over, without its minutes."""
    *seen, model, max_order = given
    if model != "diffuse":
        return tankrig.estimate(*seen, model=model, max_order=max_order, phase=phase)
    found = tankrig.estimate(*seen, model="single")
    residual = found.residual + 3.0 * found.rmse * np.sin(np.arange(20) / 4.0)
    return replace(found, residual=residual, rmse=float(np.sqrt(np.mean(residual**2))), model="diffuse")


@pytest.fixture
def picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    monkeypatch.setattr("tankrig.estimation.comparison.estimate", estimate)
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    scene = load_scene(tmp_path / "scene.toml")
    image = predict(scene, "single").image
    image = image + np.random.default_rng(0).normal(0.0, 0.002 * image.max(), image.shape)
    np.save(tmp_path / "tank.npy", image)
    return tmp_path / "tank.npy", tmp_path / "scene.toml"


def test_the_model_that_made_the_picture_has_the_lowest_criterion(picture: tuple[Path, Path]) -> None:
    """A comparison that preferred another model would be worth nothing."""
    image, scene = np.load(picture[0]), load_scene(picture[1])
    found = compare_models(image, scene, 1.0, 0.0, contenders=QUICK)
    right, diffuse, none = found.rows
    assert (right.aic, right.bic) == (0.0, 0.0)
    assert diffuse.bic > 100.0
    assert right.estimate is not None
    assert diffuse.estimate is not None
    assert right.estimate.rmse < diffuse.estimate.rmse
    assert "unknown" in none.refusal
    assert none.bic == float("inf")
    assert 150 < found.effective <= found.pixels == 300


def test_one_command_tells_it_as_a_table_and_as_numbers(
    picture: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "tankrig.estimation.comparison.compare_models.__defaults__", ("free", "free", None, QUICK, None)
    )
    common = ["compare", str(picture[0]), "--scene", str(picture[1]), "--gain", "1", "--offset", "0"]
    assert main([*common, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in told["models"]] == [one.name for one in QUICK]
    assert told["models"][1]["rmse"] > told["models"][0]["rmse"] > 0.0
    assert set(told["models"][1]["interval"]) == {"level", "sigma_a", "sigma_s", "g"}
    assert "unknown" in told["models"][2]["error"]
    assert main(common) == 0
    text = capsys.readouterr().out
    assert "ΔBIC" in text
    assert text.startswith(str(picture[0]))
    assert "RMSE in the image's unit" in text
    assert f"{QUICK[0].name}, by this image alone: The " in text  # why coefficients are in brackets, or are not
    assert "diffuse limit" in text


def test_more_coordinates_cost_what_they_could_explain_by_chance(picture: tuple[Path, Path]) -> None:
    """Else the family with the most parameters would always be ranked first."""
    image, scene = np.load(picture[0]), load_scene(picture[1])
    plain = Contender("hg", "single", phase="hg")
    more = Contender("two-term", "single", phase="two-term")
    found = compare_models(image, scene, 1.0, 0.0, contenders=(plain, more))
    assert (plain.more, more.more) == (0, 2)
    assert found.rows[0].bic == 0.0
    assert found.rows[1].bic == pytest.approx(2.0 * np.log(found.effective), abs=1.5)
    assert found.rows[1].aic == pytest.approx(4.0, abs=1.5)


@pytest.mark.parametrize(("change", "message"), [("no scene", "needs --scene"), ("dark", "all dark")])
def test_what_cannot_be_compared_is_refused_in_one_sentence(
    picture: tuple[Path, Path], change: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["compare", str(picture[0])]
    if change == "dark":
        np.save(picture[0], np.zeros((15, 20)))
        arguments += ["--scene", str(picture[1])]
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert message in said
    assert len(said.strip().splitlines()) == 1

"""Models compared: one table in which the model that made the picture comes out best."""

import json
from pathlib import Path

import numpy as np
import pytest

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
QUICK = (Contender("single scattering", "single"), Contender("orders 1–2", "tank", 2), Contender("diffuse", "diffuse"))


@pytest.fixture
def picture(tmp_path: Path) -> tuple[Path, Path]:
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    scene = load_scene(tmp_path / "scene.toml")
    image = predict(scene, max_order=2).image
    image = image + np.random.default_rng(0).normal(0.0, 0.002 * image.max(), image.shape)
    np.save(tmp_path / "tank.npy", image)
    return tmp_path / "tank.npy", tmp_path / "scene.toml"


def test_the_model_that_made_the_picture_has_the_lowest_criterion(picture: tuple[Path, Path]) -> None:
    """A comparison that preferred another model would be worth nothing."""
    image, scene = np.load(picture[0]), load_scene(picture[1])
    found = compare_models(image, scene, 1.0, 0.0, contenders=QUICK)
    single, right, diffuse = found.rows
    assert (right.aic, right.bic) == (0.0, 0.0)
    assert min(single.bic, diffuse.bic) > 100.0
    assert right.estimate is not None
    assert right.estimate.medium.sigma_s == pytest.approx(0.02, rel=0.05)
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
    assert told["models"][0]["rmse"] > told["models"][1]["rmse"] > 0.0
    assert told["models"][1]["interval"]["g"][0] < 0.4 < told["models"][1]["interval"]["g"][1]
    assert main(common) == 0
    text = capsys.readouterr().out
    assert "ΔBIC" in text
    assert "orders 1–2" in text


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

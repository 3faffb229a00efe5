"""`tankrig fit`: numbers, picture and verdict from a file, or one sentence and nothing written."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import tankrig
from tankrig.figures.tank_image import FALSE_COLOUR, brightness
from tankrig.image.prediction_file import error_of_prediction
from tankrig.scene import Medium, Scene, load_scene
from ui.cli import main

from .seen_pictures import likeness

SCENE = """
[tank]
size_mm = [240.0, 160.0, 120.0]
surface = "matched"
[medium]
sigma_a = 0.01
sigma_s = 0.01
g = 0.0
[projector]
kind = "pinhole"
position_mm = [-400.0, 0.0, 60.0]
beams = [ { y_mm = [-20.0, 20.0], z_mm = [50.0, 70.0], irradiance = 1.0 } ]
[camera]
kind = "pinhole"
position_mm = [120.0, 0.0, 620.0]
shape = [20, 30]
pixel_mm = 8.0
"""
TRUTH = Medium(0.001, 0.006, 0.4)


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def tank_photograph(scene: Scene) -> np.ndarray:
    """Counts of a 16-bit camera with 400 counts of dark level and some noise."""
    radiance = tankrig.predict(replace(scene, medium=TRUTH), "single").image
    counts = 400.0 + 50000.0 * radiance / radiance.max()
    return np.round(counts + np.random.default_rng(1).normal(0.0, 20.0, counts.shape)).astype(np.uint16)


def test_a_photograph_becomes_numbers_a_verdict_and_a_picture(
    tmp_path: Path, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The main job: without any one of these a person has nothing to show for the photograph."""
    photograph = tank_photograph(load_scene(scene_file))
    cv2.imwrite(str(tmp_path / "tank.png"), photograph)
    out = tmp_path / "fitted"
    assert (
        main(["fit", str(tmp_path / "tank.png"), "--scene", str(scene_file), "--model", "single", "--out", str(out)])
        == 0
    )
    printed = capsys.readouterr().out
    for word in ("sigma_a", "sigma_s", "g ", "determined", "RMSE", "tank-fit.png"):
        assert word in printed
    assert sorted(path.name for path in out.iterdir()) == ["tank-fit.json", "tank-fit.npz", "tank-fit.png"]
    assert likeness(out / "tank-fit.png", photograph, FALSE_COLOUR, brightness(photograph)) > 0.93
    numbers = json.loads((out / "tank-fit.json").read_text())
    sigma_t = numbers["medium"]["sigma_a"] + numbers["medium"]["sigma_s"]
    assert sigma_t == pytest.approx(TRUTH.sigma_t, rel=0.02)
    assert numbers["offset"] == pytest.approx(400.0, abs=5.0)
    assert numbers["noise"] == pytest.approx(20.0, rel=0.15)
    with np.load(out / "tank-fit.npz") as arrays:
        assert arrays["fitted"].shape == arrays["residual"].shape == (20, 30)


def test_a_mirrored_picture_is_named_before_it_is_fitted(
    tmp_path: Path, scene_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No liquid explains it, and the search for one takes minutes."""
    monkeypatch.setattr(tankrig, "estimate", refuse)
    photograph = tank_photograph(load_scene(scene_file))
    for name, pixels, named in (("as_seen", photograph, False), ("mirrored", photograph[:, ::-1], True)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), pixels)
        command = ["fit", str(tmp_path / f"{name}.png"), "--scene", str(scene_file), "--out", str(tmp_path)]
        assert main([*command]) == 2
        assert ("times as bright at the far end as where light enters" in capsys.readouterr().err) is named


def refuse(*_: object, **__: object) -> None:
    """Stands for the fit, which has been warned of."""
    raise tankrig.ImageError("not fitted")


def test_json_is_one_line_that_says_it_all(
    tmp_path: Path, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Scripts read this; a stray line of text would break them."""
    cv2.imwrite(str(tmp_path / "tank.tif"), tank_photograph(load_scene(scene_file)))
    command = ["fit", str(tmp_path / "tank.tif"), "--scene", str(scene_file), "--model", "single", "--json"]
    assert main([*command, "--scale", "1e-8", "--noise", "2e-7", "--out", str(tmp_path / "out")]) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["offset"] == pytest.approx(4e-6, abs=5e-8)
    assert numbers["interval"]["sigma_s"][0] <= numbers["medium"]["sigma_s"] <= numbers["interval"]["sigma_s"][1]
    assert Path(numbers["picture"]).is_file()


def test_what_is_left_out_counts_what_the_fit_leaves_out(
    tmp_path: Path, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Specks were not among them, so that the share was 0 beside a verdict that spoke of three pixels."""
    photograph = tank_photograph(load_scene(scene_file)).astype(float)
    photograph[[3, 9, 15], [22, 8, 17]] += photograph.max()
    mask = np.zeros(photograph.shape, np.uint8)
    mask[:2] = 1
    np.save(tmp_path / "tank.npy", photograph)
    np.save(tmp_path / "mask.npy", mask)
    command = ["fit", str(tmp_path / "tank.npy"), "--scene", str(scene_file), "--model", "single"]
    assert main([*command, "--mask", str(tmp_path / "mask.npy"), "--json", "--out", str(tmp_path)]) == 0
    found = json.loads(capsys.readouterr().out)
    with np.load(tmp_path / "tank-fit.npz") as arrays:
        residual = arrays["residual"]
    assert np.isnan(residual[[3, 9, 15], [22, 8, 17]]).all()
    assert found["left_out"]["all"] == pytest.approx(np.isnan(residual).mean())
    assert found["left_out"]["by_fit"] == pytest.approx(np.isnan(residual[2:]).sum() / residual.size)
    assert found["rmse"] == pytest.approx(np.sqrt(np.nanmean(residual**2)))
    assert found["rmse_by_order"]["all"] == pytest.approx(found["rmse"], rel=0.05)
    assert main([*command, "--out", str(tmp_path)]) == 0
    assert "left out 0.5 % of the image" in capsys.readouterr().out


def test_what_may_be_off_is_fitted_and_told(
    tmp_path: Path, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A person whose camera may have moved gives that as an option, and wants to see by how much it had."""
    np.save(tmp_path / "tank.npy", tank_photograph(load_scene(scene_file)).astype(float))
    command = ["fit", str(tmp_path / "tank.npy"), "--scene", str(scene_file), "--model", "single"]
    command += ["--nuisance", "y_mm=0.5", "--nuisance", "z_mm=0.5", "--out", str(tmp_path / "out")]
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["nuisance_found"]
    assert set(found) == {"y_mm", "z_mm"}
    assert abs(found["y_mm"]["value"]) < 4.0 * found["y_mm"]["sd"] < 0.5
    with np.load(tmp_path / "out" / "tank-fit.npz") as arrays:
        assert arrays["structure"].shape == (20, 30)


GOOD = np.linspace(1.0, 2.0, 600).reshape(20, 30)


@pytest.mark.parametrize(
    ("image", "options", "words"),
    [
        (None, [], "No such file"),
        (GOOD[:, :20], [], "shape"),
        (GOOD * 0.0, [], "dark"),
        (GOOD * 1e-300, [], "the image is dark: its brightest pixel is"),
        (GOOD, ["--nuisance", "z_mm=nan"], "NAME=SD"),
        (GOOD, ["--gain-setting", "nan"], "'nan' is not a finite number"),
        (np.where(GOOD > 1.9, np.nan, GOOD), [], "NaN"),
        ((GOOD * 100).astype(np.uint8), [], "8 bits"),
        (GOOD, ["--model", "magic"], "magic"),
        (GOOD, ["--gain", "much"], "much"),
        (GOOD, ["--gain", "-1"], "gain"),
        (GOOD, ["--noise", "0"], "noise"),
        (GOOD, ["--scale", "0"], "scale"),
        (GOOD, ["--array", "total"], "array"),
        (GOOD, ["--max-order", "0"], "max-order"),
        (GOOD, ["--nuisance", "much"], "NAME=SD"),
        (GOOD, ["--nuisance", "x_mm=1"], "x_mm"),
        (GOOD, ["--nuisance", "foo=1"], "use one of z_mm, y_mm, tilt_mrad, scale, halo, veil, blur_mm2, floor, pane,"),
        (GOOD, ["--model", "foo"], 'model = "foo" is unknown; use one of prepared, tank, single,'),
        (GOOD, ["--rig", "rig.toml"], "--rig belongs to a raw frame; give its --exposure-ms too"),
        (GOOD, ["--dark", "dark.png"], "--dark belongs to a raw frame; give its --exposure-ms too"),
    ],
)
def test_bad_input_is_one_sentence_exit_2_and_nothing_written(
    tmp_path: Path,
    scene_file: Path,
    capsys: pytest.CaptureFixture[str],
    image: np.ndarray | None,
    options: list,
    words: str,
) -> None:
    """Half a folder, or a traceback, would be taken for a result."""
    if image is not None:
        np.save(tmp_path / "tank.npy", image)
    out = tmp_path / "out"
    assert main(["fit", str(tmp_path / "tank.npy"), "--scene", str(scene_file), "--out", str(out), *options]) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert not out.exists()


def test_a_folder_that_cannot_be_written_is_said_before_the_fit(
    tmp_path: Path, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Minutes of fitting must not end in a disk error."""
    np.save(tmp_path / "tank.npy", GOOD)
    (tmp_path / "file").write_text("in the way")
    command = ["fit", str(tmp_path / "tank.npy"), "--scene", str(scene_file), "--out", str(tmp_path / "file" / "out")]
    assert main(command) == 2
    assert "not a folder" in capsys.readouterr().err


def test_a_predicted_images_own_error_is_no_sign_of_another_liquid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the pages for newcomers do it: another phase function "explained 44 %" of that, with σa 3 standard deviations
    off."""
    scene = tmp_path / "scene.toml"
    plain = SCENE.replace('kind = "pinhole"\nposition_mm = [-400.0, 0.0, 60.0]', 'kind = "collimated"')
    plain = plain.replace('kind = "pinhole"\nposition_mm = [120.0, 0.0, 620.0]', 'kind = "orthographic"')
    scene.write_text(
        plain.replace("sigma_a = 0.01\nsigma_s = 0.01\ng = 0.0", "sigma_a = 0.0005\nsigma_s = 0.015\ng = 0.7")
    )
    assert main(["predict", str(scene), "--tolerance", "0.005", "--out", str(tmp_path)]) == 0
    capsys.readouterr()
    asked = ["fit", str(tmp_path / "scene.npz"), "--scene", str(scene), "--json", "--out", str(tmp_path / "fitted")]
    assert main(asked) == 0
    found = json.loads(capsys.readouterr().out)
    assert "phase function" not in found["verdict"]
    for name, true in (("sigma_a", 0.0005), ("sigma_s", 0.015), ("g", 0.7)):
        assert abs(found["medium"][name] - true) < 2.5 * found["standard_deviation"][name]


def test_another_programs_noise_is_no_error_of_a_prediction(tmp_path: Path) -> None:
    written = tmp_path / "reference.npz"
    np.savez(written, total=np.ones((2, 3)), stderr=np.ones((2, 3)), metadata=np.array('{"photons": 1000}'))
    assert error_of_prediction(written) is None
    assert error_of_prediction(tmp_path / "tank.png") is None
    assert error_of_prediction(tmp_path / "missing.npz") is None

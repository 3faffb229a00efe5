"""Somebody else's frames become a run that is fitted, reported and archived like any other."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tankrig.archive.importing import Picture, import_run, pictures_in
from tankrig.archive.table import table_of
from tankrig.light.tank import tank_image
from tankrig.live.exposures import exposures_of
from tankrig.run.reading import open_run
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.writing import scene_text
from ui.cli import main

INK = Medium(0.002, 0.02, 0.6)
PROJECTOR = Projector("collimated", (Beam((-40.0, -36.0), (56.0, 64.0)), Beam((-4.0, 4.0), (56.0, 64.0))))
SCENE = Scene(Tank(), Medium(0.0, 0.001, 0.0), PROJECTOR, Camera("orthographic", (20, 30), 8.0))


@pytest.fixture(scope="module")
def light() -> np.ndarray:
    scene = Scene(SCENE.tank, INK, SCENE.projector, SCENE.camera)
    image = np.asarray(sum(tank_image(scene, seed=5, batches=4).orders.values()))
    return image / image.max()


@pytest.fixture
def folder(tmp_path: Path, light: np.ndarray) -> Path:
    """Three photographs and a dark one, 16-bit PNG, and the scene."""
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    rng = np.random.default_rng(0)
    for name, level in (("dark", 0.0), ("one", 2e4), ("two", 2e4), ("three", 2e4)):
        picture = 200.0 + rng.poisson(level * light)
        assert cv2.imwrite(str(photographs / f"{name}.png"), picture.astype(np.uint16))
    (tmp_path / "rays.toml").write_text(scene_text(SCENE))
    return photographs


def table(folder: Path, *rows: str, head: str = "file,pattern,dose_ml,exposure_ms") -> None:
    (folder / "table.csv").write_text("\n".join([head, *rows]) + "\n")


def test_a_folder_of_pictures_is_imported_fitted_and_reported_by_two_commands(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    table(folder, "dark.png,dark,1,20", *(f"{name}.png,,1,20" for name in ("one", "two", "three")))
    run = tmp_path / "runs" / "theirs"
    words = ["--scene", str(tmp_path / "rays.toml"), "--material", "milk", "--out", str(run)]
    assert main(["import", str(folder), *words]) == 0
    assert main(["report", str(run)]) == 0
    (row,) = table_of(run.parent)
    assert row["material"] == "milk"
    assert row["sigma_s"] == pytest.approx(INK.sigma_s, rel=0.03)
    assert row["g"] == pytest.approx(INK.g, abs=0.03)
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "none: imported" in page
    capsys.readouterr()
    results = tmp_path / "results"
    assert main(["refit", str(run.parent), "--out", str(results), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["made"] == 1
    assert main(["run", "--resume", str(run)]) == 2
    assert "nothing to resume" in capsys.readouterr().err
    assert main(["advise", "--run", str(run)]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_frames_doses_and_exposures_are_kept_as_they_were_given(folder: Path, tmp_path: Path) -> None:
    rays = str(tmp_path / "rays.toml")
    head = "file,pattern,dose_ml,dose_sd_ml,exposure_ms,gain"
    table(folder, "dark.png,dark,0.5,,10,", "one.png,rays,0.5,0.01,10,2", "two.png,rays,0.9,,20,", head=head)
    run_folder = tmp_path / "run"
    assert main(["import", str(folder), "--scene", rays, "--out", str(run_folder)]) == 0
    run = open_run(run_folder)
    for number, name in enumerate(("dark", "one", "two")):
        np.testing.assert_array_equal(run.frames[number].values, cv2.imread(str(folder / f"{name}.png"), -1))
    assert run.frames.delivered_ul.values.tolist() == [500.0, 500.0, 900.0]
    assert run.frames.exposure_ms.values.tolist() == [10.0, 10.0, 20.0]
    assert run.frames.gain.values.tolist() == [1.0, 2.0, 1.0]
    assert run.frames.pattern.values.tolist() == ["dark", "rays", "rays"]
    held = {one.dose_ml: one.dose_sd_ml for one in exposures_of(run).photographs()}
    assert sorted(held) == [0.5, 0.9]
    assert held[0.5] == pytest.approx(0.01)
    assert not (run_folder / "patterns").exists()


@settings(max_examples=20, deadline=None)
@given(kind=st.sampled_from(["uint8", "uint16", "float32", "float64"]), seed=st.integers(0, 2**16))
def test_pixels_of_any_kind_come_back_as_they_were(kind: str, seed: int, tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.mktemp("any")
    rng = np.random.default_rng(seed)
    pixels = (rng.random((20, 30)) * 255).astype(kind)
    np.save(folder / "one.npy", pixels)
    run = import_run(folder / "run", [Picture(folder / "one.npy", "rays", 1.0)], {"rays": SCENE})
    stored = open_run(run).frames[0].values
    assert stored.dtype == (np.float32 if pixels.dtype.kind == "f" else pixels.dtype)
    np.testing.assert_array_equal(stored, pixels.astype(stored.dtype))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (["one.png,rays,,10"], "nothing says dose_ml of one.png"),
        (["one.png,rays,1,"], "nothing says exposure_ms of one.png"),
        (["one.png,rays,much,10"], 'dose_ml = "much" is no volume'),
        (["one.png,rays,1,0"], 'exposure_ms = "0" is no positive number'),
        (["one.png,stripes,1,10"], 'the scene of pattern "stripes" of one.png is not known'),
        (["gone.png,rays,1,10"], "there is no file"),
        (["one.png,rays,1,10", "small.npy,rays,1,10"], "has 4 × 6 pixels"),
        (["one.png,rays,1,10", "real.npy,rays,1,10"], "is float32 and one.png is uint16"),
        (["broken.png,rays,1,10"], "cannot be read"),
        (["hole.npy,rays,1,10"], "pixels that are no number"),
        ([], "has no rows"),
    ],
)
def test_what_cannot_be_imported_is_one_sentence_and_leaves_nothing(
    rows: list[str], told: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(folder / "small.npy", np.ones((4, 6), np.uint16))
    np.save(folder / "real.npy", np.ones((20, 30)))
    np.save(folder / "hole.npy", np.full((20, 30), np.nan))
    (folder / "broken.png").write_bytes(b"not a picture")
    table(folder, *rows)
    out = tmp_path / "runs" / "run"
    assert main(["import", str(folder), "--scene", str(tmp_path / "rays.toml"), "--out", str(out)]) == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not out.parent.exists() or not list(out.parent.iterdir())


def test_without_a_table_all_pictures_are_alike(folder: Path) -> None:
    given = pictures_in(folder, ["rays"], None, 0.3, 12.0)
    assert [one.file.name for one in given] == ["dark.png", "one.png", "three.png", "two.png"]
    assert {(one.pattern, one.dose_ml, one.exposure_ms) for one in given} == {("rays", 0.3, 12.0)}

"""The demo: from nothing to a report, through the code that drives the bench, with coefficients close to the truth."""

import json
from pathlib import Path

import pytest

import tankrig
from ui.cli import main


def run_demo(doses: int, path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert main(["demo", "--doses", str(doses), "--out", str(path), "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def check(found: dict, doses: int, path: Path) -> None:
    ink, truth = found["ink_per_ml"], found["truth_per_ml"]
    assert ink["sigma_s"] == pytest.approx(truth["sigma_s"], rel=0.05)
    assert ink["g"] == pytest.approx(truth["g"], abs=0.03)
    assert len(found["doses"]) == doses
    assert all(abs(row["single_sigma_t_ratio"] - 1.0) > 0.01 for row in found["doses"])
    assert Path(found["report"]).stat().st_size > 100_000
    run = tankrig.open_run(path)
    assert run.end is not None
    assert run.end["reason"] == "completed"
    assert run.frames.sizes["frame"] == 14 * doses
    assert any(event.get("fit") == "dose" for event in run.fits)


@pytest.mark.long
def test_a_short_demo_finds_the_simulated_ink(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Projector, doser, camera, store, live fit and report must work together on a machine without a rig or screen."""
    path = tmp_path / "demo"
    check(run_demo(2, path, capsys), 2, path)


@pytest.mark.long
def test_the_demo_finds_the_simulated_ink(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The README's first command, whole."""
    path = tmp_path / "demo"
    check(run_demo(5, path, capsys), 5, path)


def test_a_run_that_is_there_already_is_not_written_into(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A demo that wrote over an earlier run would destroy data."""
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "keep").write_text("this")
    assert main(["demo", "--out", str(tmp_path / "demo")]) == 2
    assert str(tmp_path / "demo") in capsys.readouterr().err
    assert [file.name for file in (tmp_path / "demo").iterdir()] == ["keep"]

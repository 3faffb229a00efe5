"""The demo: from nothing to a report, through the code that drives the bench, with coefficients close to the truth."""

import json
from pathlib import Path

import pytest

import tankrig
from ui.cli import main

from .seen_pictures import report_shows


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
    assert Path(found["report"]) == path / "report.html"
    report_shows(Path(found["report"]).read_text(encoding="utf-8"), path)
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


@pytest.mark.long
def test_a_demo_of_beads_says_passed_only_where_it_found_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tank scatters as Mie says; what a fit makes of that must not be called the reference unless it is."""
    path = tmp_path / "beads"
    assert main(["demo", "--material", "polystyrene-1.0", "--doses", "3", "--out", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    row = found["rows"]["σs per ml"]
    assert row["reference"] * 4608.0 == pytest.approx(35.2, rel=0.01)
    apart = abs(row["found"] - row["reference"]) / row["reference"]
    assert not found["passed"] or apart < 0.1
    assert row["says"] != "agrees" or apart < 0.2
    assert Path(found["report"]).name == "validation.html"


def test_a_reference_liquid_in_the_demos_tank_is_the_librarys(tmp_path: Path) -> None:
    """A twin with Henyey–Greenstein of the same g would show what no bead does."""
    from drivers.rig import true_liquids
    from ui.cli.demo import liquid_planned, rig_beside, truth_of

    for name in ("polystyrene-1.0", "intralipid-20", "milk-regular"):
        plan = liquid_planned(name, 540.0)
        liquids = true_liquids(rig_beside(tmp_path / name, truth_of(plan)))
        assert liquids is not None
        ink, reference = liquids[1], plan.optics.medium
        assert ink.sigma_s * plan.tank_ml * plan.dilution == pytest.approx(reference.sigma_s)
        assert ink.phase_function.moments(3) == pytest.approx(reference.phase_function.moments(3), abs=1e-4)
        assert ink.phase_function.at(0.0) == pytest.approx(reference.phase_function.at(0.0), rel=2e-3)


def test_an_unknown_liquid_for_the_demo_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--material", "polystirene-1.0", "--out", str(tmp_path / "demo")]) == 2
    assert "polystyrene-1.0" in capsys.readouterr().err
    assert main(["demo", "--material", "water", "--out", str(tmp_path / "demo")]) == 2
    assert "which no photograph shows; choose another liquid" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["milk-regular", "milk-lowfat", "polystyrene-0.2", "polystyrene-2.0", "intralipid-20"])
@pytest.mark.parametrize("doses", [2, 3, 5])
def test_the_demos_doses_of_any_liquid_keep_to_its_pump(name: str, doses: int) -> None:
    """Its last three doses began above the largest that the pump may take at once, so that the demo refused itself."""
    from drivers.rig import SIMULATED, load_rig_file
    from ui.cli.demo import liquid_planned, sequence_of
    from ui.cli.run import planned

    plan = liquid_planned(name, 540.0)
    sequence = sequence_of(plan.totals_ul[1:][-doses:], plan.totals_ul[1:][:-doses])
    found = planned(sequence, load_rig_file(SIMULATED), fit=False)
    assert found.ink_ul == pytest.approx(plan.totals_ul[-1])
    assert sum(step.ink_ul > 0.0 for step in found.steps) == len(plan.totals_ul) - 1

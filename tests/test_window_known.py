"""One confidence: ± is 95 % wherever the window shows what is known, and commands say that theirs is a deviation."""

from dataclasses import replace
from pathlib import Path

import click
import pytest

from drivers.calibration_health import KINDS, calibration_checks
from drivers.rig import load_rig_file
from drivers.simulated import __file__ as simulated
from tankrig.calibration.file import Calibration, save
from tankrig.calibration.pump import calibrate_pump, load_pump_calibration, save_pump_calibration
from tankrig.live.formatting import with_error
from tankrig.scene import Camera
from tests.window_rig import write_rig
from ui.calibration_way import calibration_steps
from ui.cli.calibrating import tell
from ui.window.calibration_known import known_of
from ui.window.words import calibrated


def test_a_weighed_pump_is_known_with_the_windows_confidence(tmp_path: Path) -> None:
    """It was one standard deviation, unlabelled, beside results with 95 %."""
    rig, file = write_rig(tmp_path), tmp_path / "pump-2026-11-20T10-00-00.toml"
    weighed = ((20.0, 80.0, 20.0, 80.0), (20.3, 81.5, 20.2, 81.4))
    found = calibrate_pump(*weighed, doser="d", basis={"steps_per_ul": 10.0}, nominal_increment_ul=0.1)
    save_pump_calibration(found, file)
    one = load_pump_calibration(file)
    (value,) = (known.value for known in known_of(load_rig_file(rig), rig, tmp_path) if known.what == "pump, weighed")
    assert value.startswith(f"{with_error(one.correction, 1.96 * one.correction_sd)} true µl per nominal µl (95 %)")
    assert value.endswith("µl (standard deviation)")


def test_a_simulated_pump_needs_no_weighing_wherever_that_is_said(tmp_path: Path) -> None:
    """The list said "not yet" beside a tick on the tab that leads through it."""
    file = write_rig(tmp_path)
    rig = load_rig_file(file)
    (known,) = (one for one in known_of(rig, file, tmp_path) if one.what == "pump, weighed")
    step = calibration_steps(rig, [])["pump"]
    assert (known.value, known.note) == ("not needed", step.finding)
    assert step.done


@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
def test_what_a_telecentric_lens_makes_needless_is_missing_nowhere(tmp_path: Path, camera: str) -> None:
    """ "Not yet" and "has not been measured" stood beside a tick for the same camera."""
    file = write_rig(tmp_path)
    rig = replace(load_rig_file(file), camera={"driver": "v4l2-camera"})
    if camera == "pinhole":
        seen = Camera("pinhole", (20, 30), 8.0, (120.0, 0.0, 600.0))
        rig = replace(rig, bench=replace(rig.bench, camera=seen))
    checks = list(calibration_checks(rig, {}))
    known = {one.what: one for one in known_of(rig, file, tmp_path)}
    found = {check.part: check for check in checks}
    steps = calibration_steps(rig, checks)
    for kind in KINDS:
        needless = camera == "orthographic" and kind in ("camera", "tank", "projector", "stray")
        assert (known[f"{calibrated(kind)}, measured"].value == "not needed") == needless
        assert found[kind].finding.startswith("not needed: ") == needless == (not found[kind].remedy)
        assert bool(steps[kind].done) == needless == ("needs no calibration" in steps[kind].what)


def test_how_well_something_was_measured_is_said_in_words(tmp_path: Path) -> None:
    """The list of what is measured had the names of a file's keys: "rms_px 0.21, tilt_deg 31"."""
    rig = replace(load_rig_file(write_rig(tmp_path)), camera={"driver": "v4l2-camera"})
    rig = replace(rig, bench=replace(rig.bench, camera=Camera("pinhole", (20, 30), 8.0, (120.0, 0.0, 600.0))))
    well = {"rms_px": 0.21, "coverage": 0.75, "tilt_deg": 31.4, "views": 15.0}
    one = save(
        Calibration("camera", "camera A", (20, 30), {}, rig=rig.name, how_well=well), Path(rig.calibration_folder)
    )
    words = "corners off by 0.21 px (rms), 75 % of the picture covered, views of the board up to 31° apart, 15 views of"
    (step,) = (step for kind, step in calibration_steps(rig, calibration_checks(rig, {})).items() if kind == "camera")
    known = {one.what: one.value for one in known_of(rig, tmp_path / "rig.toml", tmp_path)}
    assert step.finding == f"{one.path and one.path.name}: {words} the board"
    assert known["camera, measured"] == f"{words} the board"


def test_a_simulated_rig_that_hides_nothing_wants_no_calibration(tmp_path: Path) -> None:
    """Its first step was to calibrate the radiometry, for ever: what the command measured was another bench."""
    rig = load_rig_file(file := write_rig(tmp_path))
    checks = list(calibration_checks(rig, {}))
    steps, known = calibration_steps(rig, checks), {one.what: one for one in known_of(rig, file, tmp_path)}
    assert all(step.done for step in steps.values())
    assert all(not check.remedy for check in checks)
    assert all(known[f"{calibrated(kind)}, measured"].value == "not needed" for kind in KINDS)
    bench = load_rig_file(Path(simulated).with_name("bench.toml"), beside=tmp_path / "bench")
    wanted = calibration_steps(bench, calibration_checks(bench, {}))
    assert not any(wanted[kind].done for kind in KINDS)


def test_commands_say_that_each_of_their_errors_is_a_standard_deviation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = save(Calibration("latency", "simulated projector", (30, 40), {"median_ms": 9.0}), tmp_path)
    tell(kept, {"median": "9.00 ± 0.10 ms"}, as_json=False)
    assert "each ±" in click.unstyle(said := capsys.readouterr().out)
    assert "is a standard deviation" in said
    tell(kept, {"frames": "100"}, as_json=False)
    assert "each ±" not in capsys.readouterr().out

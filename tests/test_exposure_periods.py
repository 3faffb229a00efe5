"""Exposures are whole numbers of the projector's periods, or a person has said why not; latencies that are too long."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import drivers.rig
from drivers.rig import load_rig_file
from tankrig.calibration.latency import Latency, latency_calibration
from tankrig.errors import SequenceError
from tankrig.run.reading import open_run
from tankrig.run.start import new_run, resumed_run
from tankrig.sequence import Capture, ExposureRule, Sequence, dry_run
from ui.cli import main

from .memory_rig import memory_rig
from .test_sequence import LIMITS

PERIOD_MS = 1000.0 / 60.0


def rig_file(folder: Path, exposure: str) -> Path:
    """The simulated rig, with another table [exposure]."""
    text = re.sub(r"\[exposure\]\nperiod_ms[^\n]*\n", exposure, drivers.rig.SIMULATED.read_text())
    (folder / "rig.toml").write_text(text)
    return folder / "rig.toml"


def sequence_file(folder: Path, exposure_ms: float, more: str = "") -> Path:
    text = f'name = "one"\nexposure_ms = {exposure_ms}\n{more}\n[[steps]]\ndo = "capture"\npattern = "full"\n'
    (folder / "sequence.toml").write_text(text)
    return folder / "sequence.toml"


@given(st.integers(1, 60), st.floats(2.0, 50.0), st.floats(-0.5, 0.5))
def test_an_exposure_is_allowed_exactly_when_it_is_half_a_percent_from_whole_periods(number, period_ms, off):
    rule = ExposureRule(period_ms)
    exposure_ms = (number + off) * period_ms
    miss = min(abs(exposure_ms - max(1, n) * period_ms) for n in (number - 1, number, number + 1))
    if abs(miss / exposure_ms - 0.005) > 1e-9:
        assert rule.allows(exposure_ms) == (miss / exposure_ms <= 0.005)
    assert all(rule.allows(nearest) for nearest in rule.nearest_ms(exposure_ms)), "what it advises is refused"
    assert rule.allows(exposure_ms) == (rule.refusal(exposure_ms) == "")
    assert ExposureRule(period_ms, "an LED").allows(exposure_ms)
    assert ExposureRule(0.0).allows(exposure_ms)


def test_the_dry_run_refuses_and_names_the_nearest(tmp_path, capsys):
    rig = rig_file(tmp_path, f"[exposure]\nperiod_ms = {PERIOD_MS}\n")
    sequence = sequence_file(tmp_path, 20.0)
    assert main(["run", str(sequence), "--rig", str(rig), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert "sequence.toml: capture full: exposure_ms = 20 is 1.20 periods of the projector's light (16.667 ms)" in said
    assert "give 16.667 or 33.333, or say why it does not matter (any_exposure in the sequence" in said
    assert main(["run", str(sequence_file(tmp_path, 33.333)), "--rig", str(rig), "--dry-run"]) == 0


@pytest.mark.parametrize("where", ["rig", "sequence"])
def test_a_persons_reason_is_enough_and_is_kept_with_the_run(tmp_path, capsys, where):
    reason = "three LEDs that are always on"
    accept = f'accept = "{reason}"\n' if where == "rig" else ""
    rig = rig_file(tmp_path, f"[exposure]\nperiod_ms = {PERIOD_MS}\n{accept}")
    sequence = sequence_file(tmp_path, 20.0, f'any_exposure = "{reason}"' if where == "sequence" else "")
    out = tmp_path / "run"
    assert main(["run", str(sequence), "--rig", str(rig), "--dry-run"]) == 0
    assert main(["run", str(sequence), "--rig", str(rig), "--out", str(out), "--no-fit"]) == 0, capsys.readouterr()
    settings = open_run(out).settings
    kept = settings["sequence"]["any_exposure"] if where == "sequence" else settings["exposure"]["accept"]
    assert kept == reason


def test_the_refresh_rate_of_a_projector_is_its_period_unless_the_rig_file_says_another(tmp_path):
    text = drivers.rig.SIMULATED.read_text()
    own = re.sub(r"\[exposure\]\nperiod_ms[^\n]*\n", "", text)
    hdmi = own.replace('driver = "simulated-projector"', 'driver = "hdmi-projector"\nrefresh_hz = 50')
    for name, content, period_ms in (("own", own, None), ("hdmi", hdmi, 20.0), ("steady", text, 0.0)):
        (tmp_path / f"{name}.toml").write_text(content)
        assert load_rig_file(tmp_path / f"{name}.toml").exposure_rule.period_ms == period_ms


def test_what_the_camera_makes_of_an_exposure_counts_at_the_start_of_a_run(tmp_path):
    sequence = Sequence("one", (Capture("full", exposure_ms=33.333),))
    rig = replace(memory_rig(tmp_path), exposure=ExposureRule(PERIOD_MS))
    configure = rig.camera.configure
    rig.camera.configure = lambda settings: configure(type(settings)(round(settings.exposure_ms, -1), settings.gain))
    with pytest.raises(SequenceError, match=r"makes 30 ms of exposure_ms = 33\.333: exposure_ms = 30 is 1\.80 periods"):
        new_run(sequence, rig, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_that_was_begun_with_other_exposures_is_resumed_all_the_same(tmp_path):
    sequence = Sequence("one", (Capture("full", exposure_ms=20.0), Capture("full", exposure_ms=20.0)))
    runner = new_run(sequence, memory_rig(tmp_path), tmp_path / "run")
    runner.abort()
    runner.run()
    again = resumed_run(tmp_path / "run", replace(memory_rig(tmp_path), exposure=ExposureRule(PERIOD_MS)))
    assert again.run().reason.value == "completed"
    assert len(open_run(tmp_path / "run").events("frame")) == 2


def test_a_dry_run_checks_what_mixing_is_watched_with_too():
    from tankrig.sequence import Mix, Pace

    sequence = Sequence("one", (Mix(exposure_ms=25.0),))
    with pytest.raises(SequenceError, match=r"wait until mixed: exposure_ms = 25 is 1\.50 periods"):
        dry_run(sequence, LIMITS, Pace(), 2, exposure=ExposureRule(PERIOD_MS))


@pytest.mark.parametrize(
    ("exposure", "passed", "words"),
    [
        ("", None, "nobody has said what the period of its light is"),
        ("[exposure]\nperiod_ms = 0.0\n", True, "its light is steady"),
        ("[exposure]\nperiod_ms = 20.0\n", True, "the camera makes 20.000, 40.000, 60.000, 80.000 ms of one to four"),
        ('[exposure]\nperiod_ms = 20.0\naccept = "an LED"\n', True, "the rig file accepts any: an LED"),
    ],
)
def test_the_doctor_says_whether_exposures_can_be_whole(tmp_path, capsys, exposure, passed, words):
    main(["doctor", str(rig_file(tmp_path, exposure)), "--no-light", "--json"])
    checks = {check["what"]: check for check in json.loads(capsys.readouterr().out)["checks"]}
    check = checks["exposures are whole numbers of the projector's periods"]
    assert check["passed"] is passed
    assert words in check["finding"]


def test_a_camera_that_cannot_expose_whole_periods_is_not_fit(tmp_path, capsys):
    rig = rig_file(tmp_path, "[exposure]\nperiod_ms = 16.667\n")
    camera = 'driver = "simulated-camera"\n'
    rig.write_text(rig.read_text().replace(camera, f"{camera}exposure_range_ms = [0.1, 10.0]\n"))
    assert main(["doctor", str(rig), "--no-light"]) == 1
    assert "✗ exposures are whole numbers of the projector's periods: of 16.667 ms: the camera makes 10.000" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(("measured_ms", "passed"), [(16.683, True), (16.667, True), (16.95, False), (8.333, False)])
def test_the_doctor_compares_the_refreshes_that_were_measured_with_the_rig_file(measured_ms, passed):
    from types import SimpleNamespace

    from drivers.health import exposure_checks

    projector = SimpleNamespace(swap_ms=(measured_ms,) * 32)
    check = next(exposure_checks(ExposureRule(PERIOD_MS), {"projector": projector}))
    assert (check.what, check.passed) == ("the projector's period is what the rig file says", passed)
    assert f"refresh_hz = {1000.0 / measured_ms:.2f}" in check.remedy


class Slow:
    """A projector, for its name and shape."""

    name, shape = "slow", (4, 4)


@given(st.floats(1.0, 200.0), st.floats(0.0, 40.0), st.floats(1.0, 300.0))
def test_a_latency_beyond_what_frames_are_kept_back_for_is_a_doubt(believed_ms, period_ms, p99_ms):
    measured = Latency(tuple([p99_ms - 0.5, p99_ms] * 50))
    doubts = latency_calibration(measured, Slow(), believed_ms, period_ms).doubts
    assert bool(doubts) == (p99_ms > believed_ms + period_ms)
    assert latency_calibration(measured, Slow()).doubts == ()


def test_calibrating_a_latency_far_above_the_rig_files_needs_a_persons_decision(tmp_path, capsys, monkeypatch):
    rig = rig_file(tmp_path, "[exposure]\nperiod_ms = 0.0\n")
    projector = 'driver = "simulated-projector"\n'
    rig.write_text(rig.read_text().replace(projector, f"{projector}latency_ms = [20.0, 35.0]\n"))
    monkeypatch.setattr(drivers.rig.RigFile, "latency_ms", 5.0)  # a rig file that is wrong about its projector
    command = ["calibrate", "latency", "--rig", str(rig), "--flips", "20", "--json"]
    assert main(command) == 3
    told = json.loads(capsys.readouterr().out)
    assert not told["in_use"]
    assert "the rig file says latency_ms = 5" in told["doubts"][0]

"""One confidence: ± is 95 % wherever the window shows what is known, and commands say that theirs is a deviation."""

from pathlib import Path

import click
import pytest

from drivers.rig import load_rig_file
from tankrig.calibration.file import Calibration, save
from tankrig.calibration.pump import calibrate_pump, load_pump_calibration, save_pump_calibration
from tankrig.live.formatting import with_error
from tests.window_rig import write_rig
from ui.cli.calibrating import tell
from ui.window.calibration_known import known_of


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


def test_commands_say_that_each_of_their_errors_is_a_standard_deviation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = save(Calibration("latency", "simulated projector", (30, 40), {"median_ms": 9.0}), tmp_path)
    tell(kept, {"median": "9.00 ± 0.10 ms"}, as_json=False)
    assert "each ±" in click.unstyle(said := capsys.readouterr().out)
    assert "is a standard deviation" in said
    tell(kept, {"frames": "100"}, as_json=False)
    assert "each ±" not in capsys.readouterr().out

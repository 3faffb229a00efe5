"""`tankrig calibrate radiometry` and `latency`, from the command line to the file that the rig then uses."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.rig import load_rig_file, open_light, open_rig
from drivers.simulated import __file__ as simulated
from drivers.simulated.light import FrameBuffer, frame_buffer
from tankrig.calibration.file import SET_ASIDE, load
from tankrig.calibration.latency import Latency, latency_calibration, measure_latency
from tankrig.calibration.radiometry import Radiometry
from tankrig.errors import DeviceError
from ui.cli import main

FAST = "time_scale = 0.005\nmost_per_s = 1000.0\n[camera.sensor]\nvignetting = 0.2\nhot = 0.001\nnonlinear = 0.05\n"


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    """The rig that ships, two hundred times as fast, with a camera as real ones are."""
    text = Path(simulated).with_name("rig.toml").read_text(encoding="utf-8")
    text = text.replace('driver = "simulated-projector"\n', 'driver = "simulated-projector"\ntime_scale = 0.005\n')
    camera = '[camera]\ndriver = "simulated-camera"\nfolder = "./simulated/tank"\n'
    file = tmp_path / "rig.toml"
    file.write_text(text.replace(camera, camera + FAST), encoding="utf-8")
    return file


def test_radiometry_from_the_command_line_is_what_the_rig_uses(rig_file: Path, capsys) -> None:
    assert main(["calibrate", "radiometry", "--rig", str(rig_file), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    kept = load(Path(told["path"]))
    assert (told["in_use"], told["sha256"]) == (True, kept.hash)
    assert kept.path.with_suffix(".png").stat().st_size > 10_000
    assert Radiometry.of(kept).flat.min() == pytest.approx(0.8, abs=0.02)
    rig = open_rig(load_rig_file(rig_file))
    try:
        assert rig.calibrations["radiometry"].hash == kept.hash
        kept.require_for(rig.camera.name, rig.camera.shape)
    finally:
        rig.close()


def test_a_bad_option_is_told_before_anything_is_opened(rig_file: Path, capsys) -> None:
    for option, reason in (("--gains=1,many", "is not numbers"), ("--longest-ms=20", "are no sweep")):
        assert main(["calibrate", "radiometry", "--rig", str(rig_file), option]) == 2
        assert reason in capsys.readouterr().err
    assert not rig_file.with_name("calibration").exists()


@pytest.mark.parametrize("by_window", [False, True])
def test_exposures_that_do_not_suit_the_light_are_named_for_who_can_change_them(
    rig_file: Path, capsys, monkeypatch, by_window: bool
) -> None:
    """A window that led through it told its person of an option of a command line."""
    if by_window:
        monkeypatch.setenv("TANKRIG_GUIDED", "1")
    exposures = ("--shortest-ms=0.2", "--longest-ms=8", "--period-ms=0")
    assert main(["calibrate", "radiometry", "--rig", str(rig_file), *exposures]) == 1
    said = capsys.readouterr().err
    assert "or let the longest exposure be longer" in said
    assert ("(--longest-ms)" in said) is not by_window
    assert ("--" in said.partition("tankrig: ")[2]) is not by_window


def test_latency_is_found_within_a_millisecond(tmp_path: Path) -> None:
    """The bound from which frames count is made of it."""
    file = tmp_path / "rig.toml"
    file.write_text(Path(simulated).with_name("rig.toml").read_text(encoding="utf-8"), encoding="utf-8")
    rig = load_rig_file(file)
    with open_light(rig) as (projector, camera):
        camera.put("diffuser")
        true_ms = watched_latencies(projector, frame_buffer(Path(rig.camera["folder"])))
        found = measure_latency(projector, camera, flips=20)
    off = np.array(found.samples_ms) - np.array(true_ms[-20:])
    assert np.abs(np.median(off)) < 1.0


def watched_latencies(projector, light: FrameBuffer) -> list[float]:
    """Fills with the true latency of each flip from now on, ms."""
    lit_ns: list[int] = []
    true_ms: list[float] = []
    lit, show = light.show, projector.show

    def lights(pattern, when_ns):
        lit_ns.append(when_ns)
        lit(pattern, when_ns)

    def shows(pattern):
        flip = show(pattern)
        true_ms.append((lit_ns[-1] - flip.settled_ns) / 1e6)
        return flip

    light.show, projector.show = lights, shows
    return true_ms


def test_a_camera_that_is_saturated_or_sees_nothing_measures_no_latency(rig_file: Path) -> None:
    with open_light(load_rig_file(rig_file)) as (projector, camera):
        camera.put("cap")
        with pytest.raises(DeviceError, match="sees no difference"):
            measure_latency(projector, camera, flips=2)
        camera.put("diffuser")
        with pytest.raises(DeviceError, match="is saturated by"):
            measure_latency(projector, camera, flips=2, exposure_ms=8000.0)


def test_flips_that_hang_raise_a_doubt_and_the_good_latency_stays(rig_file: Path, tmp_path: Path) -> None:
    from tankrig.calibration.file import newest, save

    with open_light(load_rig_file(rig_file)) as (projector, _):
        good = save(latency_calibration(Latency(tuple(np.linspace(20.0, 35.0, 60))), projector), tmp_path / "c")
        slow = latency_calibration(Latency((25.0,) * 50 + (120.0,) * 10), projector)
    kept = save(slow, tmp_path / "c")
    assert "10 of 60 flips took 50 ms longer" in kept.doubts[0]
    assert kept.path.parent.name == SET_ASIDE
    assert newest(tmp_path / "c", "latency").hash == good.hash

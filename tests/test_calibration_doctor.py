"""`tankrig doctor` names what is missing, stale, or does not fit together before a run rests on it."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.calibration_health import STALE_DAYS, calibration_checks, level_check
from drivers.check import Check
from drivers.rig import RigFile, calibrated_bench, load_rig_file, open_light
from drivers.simulated import __file__ as simulated
from tankrig.calibration.file import Calibration, save
from tankrig.calibration.radiometry import Amplified, Radiometry
from tankrig.calibration.response import Response
from tankrig.errors import StoreError
from tankrig.scene import Camera

CAMERA = Calibration("camera", "camera A", (80, 120), {"f_px": 1.0}, how_well={"rms_px": 0.2})


class Device:
    def __init__(self, name: str, shape: tuple[int, int]) -> None:
        self.name, self.shape = name, shape


DEVICES = {"camera": Device("camera A", (80, 120)), "projector": Device("projector A", (480, 640))}


@pytest.fixture
def rig(tmp_path: Path) -> RigFile:
    file = tmp_path / "rig.toml"
    file.write_text(Path(simulated).with_name("rig.toml").read_text(encoding="utf-8"), encoding="utf-8")
    return replace(
        load_rig_file(file), camera={"driver": "v4l2-camera"}
    )  # of a simulated one nothing is to be measured


def looked(rig: RigFile, **devices: Device) -> dict[str, Check]:
    return {check.what: check for check in calibration_checks(rig, DEVICES | devices)}


def test_what_is_missing_is_named_with_the_command_that_measures_it(rig: RigFile) -> None:
    checks = looked(rig)
    assert [check.passed for check in checks.values()] == [None] * 6
    assert checks["radiometry is calibrated"].remedy.startswith("tankrig calibrate radiometry")


def test_what_is_good_passes_and_what_is_not_says_why(rig: RigFile) -> None:
    folder = Path(rig.calibration_folder)
    good = save(CAMERA, folder)
    name = "camera is calibrated"
    assert looked(rig)[name].passed
    assert "corners off by 0.2 px (rms)" in looked(rig)[name].finding
    assert "has camera B" in looked(rig, camera=Device("camera B", (80, 120)))[name].finding
    assert "has [40, 60]" in looked(rig, camera=Device("camera A", (40, 60)))[name].finding
    old = (datetime.now(UTC) - timedelta(days=STALE_DAYS + 2)).isoformat(timespec="seconds")
    stale = looked(replace(rig, calibration_folder=str(save(replace(CAMERA, date=old), folder / "old").path.parent)))
    assert (stale[name].passed, "days old" in stale[name].finding) == (False, True)
    save(replace(CAMERA, kind="tank", rests_on={"camera": good.hash}), folder)
    assert looked(rig)["tank is calibrated"].passed
    save(replace(CAMERA, how_well={"rms_px": 0.19}), folder)
    assert "another camera calibration" in looked(rig)["tank is calibrated"].finding
    named = replace(rig, calibration={"camera": good.hash[:12]})
    assert looked(named)["tank is calibrated"].passed
    assert "is newer" in looked(named)[name].finding
    missing = looked(replace(rig, calibration={"camera": "0123"}))
    assert any('calibration.camera = "0123"' in check.finding for check in missing.values())
    (folder / "latency-2026-01-01T00-00-00.toml").write_text("sha256 = ''\n")
    assert any("changed" in check.finding and check.passed is False for check in looked(rig).values())


@pytest.mark.parametrize(
    ("kind", "name", "measured", "passed"),
    [
        ("tank", "level_mm", 120.9, True),
        ("tank", "level_mm", 110.0, False),
        ("tank", "camera_position_mm", [125.0, 0.0, 620.0], False),
        ("projector", "position_mm", [-400.0, 0.5, 60.0], True),
        ("latency", "p99_ms", 48.0, False),
        ("latency", "p99_ms", 21.0, True),
    ],
)
def test_a_bench_that_is_not_the_one_measured_is_named(
    rig: RigFile, kind: str, name: str, measured: object, passed: bool
) -> None:
    """Camera bumped by 5 mm, water 10 mm lower, a projector that got slower: since the rig file was written."""
    camera = Camera("pinhole", (80, 120), 2.0, position_mm=(120.0, 0.0, 620.0))
    bench = replace(rig.bench, camera=camera, light="pinhole", light_position_mm=(-400.0, 0.0, 60.0))
    rig = replace(rig, bench=bench, projector=rig.projector | {"latency_ms": 40.0})
    device = DEVICES["projector" if kind in ("projector", "latency") else "camera"]
    save(Calibration(kind, device.name, device.shape, {name: measured}), Path(rig.calibration_folder))
    (check,) = (check for check in looked(rig).values() if name in check.finding)
    assert check.passed is passed


def radiometry(gamma: float) -> Calibration:
    response = Response((np.arange(256) / 255.0) ** gamma, np.zeros(256), 0.0)
    zero, one = np.zeros((80, 120)), np.ones((80, 120))
    found = Radiometry((Amplified(1.0, 100.0, 0.0, 0.5, 3.0, 1e4, (0.0,)),), one, zero, zero, zero > 0, response)
    result, arrays = found.table()
    return Calibration(
        "radiometry", "camera A", (80, 120), result, {"projector": {"response": response.curve_sd}}, arrays=arrays
    )


def test_a_gamma_that_is_ignored_is_seen_in_the_light(tmp_path: Path) -> None:
    """The rig file says gamma 1, the projector has 2.2: every pattern but black and white would be taken wrongly."""
    text = Path(simulated).with_name("rig.toml").read_text(encoding="utf-8")
    settings = 'driver = "simulated-camera"\n'
    truth = (
        'truth.bench = { light = "collimated", tank = {}, wall = { shape = [480, 640], y_mm = [-80.0, 80.0], '
        "z_mm = [0.0, 120.0], gamma = 2.2 }, camera = { kind = 'orthographic', shape = [80, 120], pixel_mm = 2.0 } }\n"
    )
    file = tmp_path / "rig.toml"
    fast = "time_scale = 0.1\n"
    text = text.replace(settings, settings + fast + truth)
    file.write_text(text.replace('"simulated-projector"\n', '"simulated-projector"\n' + fast), encoding="utf-8")
    rig = load_rig_file(file)
    with open_light(rig) as (projector, camera):
        camera.put("diffuser")
        ignored = level_check(projector, camera, calibrated_bench(rig).wall)
        assert ignored.passed is False
        assert "as with gamma 2.2" in ignored.finding
        assert "calibrate radiometry" in ignored.remedy
        save(radiometry(2.2), Path(rig.calibration_folder))
        assert level_check(projector, camera, calibrated_bench(rig).wall).passed
        camera.put("cap")
        assert level_check(projector, camera, rig.bench.wall).passed is None


def test_a_run_carries_its_radiometry_and_its_frames_are_fitted_as_radiance(tmp_path: Path) -> None:
    """Non-linear, vignetted, hot: what the fit sees is the tank all the same, also when the run is read elsewhere."""
    import shutil

    import tankrig
    from drivers.rig import open_rig
    from drivers.simulated.sensor import gain_and_offset
    from drivers.simulated.settings import Sensor
    from tankrig.calibration.radiometry_plan import RadiometryPlan
    from tankrig.calibration.radiometry_procedure import measure_radiometry
    from tankrig.calibration.radiometry_result import calibration_of
    from tankrig.devices import CameraSettings
    from tankrig.live.brackets import merged_of_run
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.pattern.kinds import Sheet
    from tankrig.run.start import new_run
    from tankrig.sequence import Capture, Dose, Wait
    from tankrig.sequence import Sequence as Steps

    from .window_rig import write_rig

    worn = {"vignetting": 0.3, "nonlinear": 0.08, "hot": 0.01, "uneven": 0.02, "dark_current": 0.05}
    written = ", ".join(f"{name} = {value}" for name, value in worn.items())
    fast = "time_scale = 0.005"
    file = write_rig(
        tmp_path, projector=fast, camera=f"{fast}\nmost_per_s = 500.0\nsensor = {{ {written} }}", doser="rate = 20000.0"
    )
    rig = load_rig_file(file)
    with open_light(rig) as (projector, camera):
        measured = measure_radiometry(projector, camera, RadiometryPlan(), camera.put)
    save(calibration_of(measured), Path(rig.calibration_folder))
    sheet = {"sheet": Sheet((-60.0, 60.0), (40.0, 80.0))}
    long = Capture("sheet", frames=6, exposure_ms=30.0)
    steps = Steps(
        "one", steps=(Dose(500.0), Wait(1.0), Capture("sheet", frames=8), long), patterns=sheet, exposure_ms=8.0
    )
    opened = open_rig(rig)
    outcome = new_run(steps, opened, tmp_path / "run").run()
    assert outcome.error is None
    shutil.rmtree(rig.calibration_folder)
    run = tankrig.open_run(tmp_path / "run")
    plan = PhotographPlan.of_run(run)
    assert plan.radiometry is not None
    frames = [frame for frame in run.frames if frame.pattern == "sheet"][:8]
    seen = np.mean([plan.radiometry.corrected(frame.values, CameraSettings(8.0)) for frame in frames], axis=0)
    pattern = run.patterns[frames[0].pattern_hash.item()]
    tank = opened.camera.tank
    true = tank.radiance(pattern, tank.medium).image
    raw = np.mean([frame.values for frame in frames], axis=0) - 100.0
    errors = [
        np.linalg.norm(one / (one * true).sum() * (true**2).sum() - true) / np.linalg.norm(true) for one in (seen, raw)
    ]
    assert errors[0] < 0.01 < 0.03 < errors[1]
    dn_per_radiance, _ = gain_and_offset(Sensor(**worn), CameraSettings(1.0))
    assert (seen * true).sum() / (true**2).sum() == pytest.approx(dn_per_radiance, rel=0.03)
    merged = merged_of_run(run, "sheet", float(frames[0].delivered_ul))
    assert max(frame.values.max() for frame in run.frames) > 16_000, "the long exposures are saturated"
    assert np.linalg.norm(merged.image / dn_per_radiance - true) / np.linalg.norm(true) < 0.03
    dim = true < np.quantile(true, 0.2)
    alone = np.sqrt(plan.radiometry.variance(seen, CameraSettings(8.0)) / 8.0)
    assert np.median((merged.sd / alone)[dim]) < 0.75, "where it is dim the long exposures help"
    with pytest.raises(StoreError, match='no frames of pattern "rays"'):
        merged_of_run(run, "rays", 500.0)

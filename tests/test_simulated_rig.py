"""A whole small experiment on the simulated rig: its own rig file, the runner, three devices, one of them a process."""

import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import tankrig
from drivers.rig import RigFile, open_rig, simulated_rig
from drivers.simulated.sensor import gain_and_offset
from drivers.simulated.settings import Sensor, Truth
from drivers.simulated.tank import mixture
from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError
from tankrig.pattern.kinds import Rays, Sheet
from tankrig.run.start import new_run
from tankrig.run.state import FinishReason
from tankrig.scene.description import Camera
from tankrig.sequence import Capture, Mix, Sequence, Series

PATTERNS = {"sheet": Sheet((-60.0, 60.0), (58.0, 62.0)), "rays": Rays((-40.0, 0.0, 40.0), z_mm=(58.0, 62.0))}
SEQUENCE = Sequence(
    "two doses",
    steps=(
        Series(
            (400.0, 1000.0),
            (
                Mix("sheet", tolerance=0.05, every_s=0.02, at_least_s=0.4),
                Capture("sheet", frames=2),
                Capture("rays", frames=2),
            ),
        ),
    ),
    patterns=PATTERNS,
    exposure_ms=20.0,
)


def small(folder: Path) -> RigFile:
    """The shipped rig, ten times as fast, with a camera of few pixels; a watchdog ten times as fast would trip."""
    shipped = simulated_rig(folder)
    bench = replace(shipped.bench, camera=Camera("orthographic", (20, 30), pixel_mm=8.0))
    fast = {"time_scale": 0.1}
    truth = {"bench": asdict(bench), "mixing_s": 0.3, "tolerance": 0.02}
    return replace(
        shipped,
        bench=bench,
        projector=shipped.projector | fast,
        camera=shipped.camera | fast | {"truth": truth, "most_per_s": 2.0},
        doser=shipped.doser | {"rate": 20_000.0, "acceleration": 200_000.0},
    )


def test_the_shipped_rig_is_calibrated_to_what_its_tank_truly_is(tmp_path: Path) -> None:
    rig = open_rig(simulated_rig(tmp_path))
    try:
        assert rig.bench == rig.camera.tank.truth.bench  # type: ignore[attr-defined]
        assert rig.doser.delivered().volume_ul == rig.camera.tank.ink_ml == 0.0  # type: ignore[attr-defined]
    finally:
        rig.close()


def test_a_run_records_what_the_tank_shows_at_each_dose(tmp_path: Path) -> None:
    description = small(tmp_path)
    outcome = new_run(SEQUENCE, open_rig(description), tmp_path / "run").run()
    assert outcome.reason is FinishReason.COMPLETED, outcome.error
    run = tankrig.open_run(tmp_path / "run")
    assert run.frames.pattern.values.tolist() == ["sheet", "sheet", "rays", "rays"] * 2
    assert run.frames.delivered_ul.values.tolist() == [400.0] * 4 + [1000.0] * 4
    assert not run.events("gap")
    gain, offset = gain_and_offset(Sensor(), CameraSettings(20.0))
    truth = Truth()
    for frame in run.frames[::2]:
        medium = mixture(truth.water, truth.ink, float(frame.delivered_ul) / 1000.0)
        scene = description.bench.scene(run.patterns[frame.pattern_hash.item()], medium)
        expected = gain * tankrig.predict(scene, model="montecarlo", tolerance=0.02).image + offset
        error = np.linalg.norm(frame.values - expected) / np.linalg.norm(expected - offset)
        assert error < 0.1, f"{frame.pattern.item()} at {frame.delivered_ul.item()} µl: {error:.1%} off"


@pytest.mark.parametrize(
    ("device", "faults", "reason"),
    [
        ("camera", {"unplugged_from": 12}, "is gone; plug it in"),
        ("camera", {"stale_from": 0}, "began .* ms too early"),
        ("camera", {"misshapen_from": 9}, r"gave a frame of shape \[19, 30\]"),
        ("projector", {"unplugged_from": 1}, "the output is gone"),
        ("projector", {"stuck_from": 1}, "did not swap within 1 s"),
        ("doser", {"stall_after": 300}, "stopped at|between"),
    ],
)
def test_a_device_that_fails_ends_the_run_in_a_clear_state(
    tmp_path: Path, device: str, faults: dict, reason: str
) -> None:
    description = small(tmp_path)
    description = replace(description, **{device: getattr(description, device) | {"faults": faults}})
    steps = Mix("sheet", tolerance=0.5, every_s=0.02, at_least_s=0.1), Capture("rays", frames=20)
    rig = open_rig(description)
    outcome = new_run(replace(SEQUENCE, steps=(Series((100.0,), steps),)), rig, tmp_path / "run").run()
    assert outcome.reason is FinishReason.FAILED
    assert isinstance(outcome.error, DeviceError)
    assert re.search(reason, str(outcome.error)), str(outcome.error)
    assert tankrig.open_run(tmp_path / "run").end["reason"] == "failed"
    with pytest.raises(DeviceError):
        rig.camera.capture(0, 1.0)  # it was let go of

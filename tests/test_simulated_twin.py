"""The simulated tank behaves like one: ink brightens it, plumes fade, light adds up, noise is a camera's."""

import struct
import threading
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from drivers.emulation.faults import Faults as DoserFaults
from drivers.registry import open_device
from drivers.simulated.camera import SimulatedCamera
from drivers.simulated.light import frame_buffer
from drivers.simulated.projector import SimulatedProjector
from drivers.simulated.sensor import counts, gain_and_offset
from drivers.simulated.settings import (
    CameraFaults,
    ProjectorFaults,
    Sensor,
    SimulatedCameraSettings,
    SimulatedProjectorSettings,
    Truth,
)
from drivers.simulated.tank import Radiance, SimulatedTank
from tankrig.bench import Bench
from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern
from tankrig.pattern.kinds import Dark, Full, Rays, Sheet, draw
from tankrig.pattern.wall import Wall
from tankrig.scene.description import Camera, Tank

BENCH = Bench(
    Tank(), Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (20, 30), pixel_mm=8.0)
)
TRUTH = Truth(bench=BENCH, tolerance=0.05, mixing_s=0.5)
DARK, FULL, SHEET = (draw(kind, BENCH.wall) for kind in (Dark(), Full(), Sheet((-60.0, 60.0), (52.0, 68.0))))
SCALE = 0.1
DIM = Sensor(response=300.0)
"""A full picture of a tank with 2 ml does not saturate in three seconds."""


def ink(folder: Path, volume_ul: float, moved_ns: int = 0) -> None:
    """Let the plunger have pushed out so much, as the doser's process writes it."""
    (folder / "state").write_bytes(struct.pack("@QQ", round(volume_ul * TRUTH.steps_per_ul), moved_ns))


@pytest.fixture
def tank(tmp_path: Path) -> SimulatedTank:
    return SimulatedTank(TRUTH, tmp_path / "state", seed=0)


@pytest.fixture
def rig(tmp_path: Path):
    """A projector and a camera on the same tank, which holds 2 ml."""
    ink(tmp_path, 2000.0)
    common = {"folder": tmp_path, "time_scale": SCALE}
    projector = open_device("simulated-projector", common | {"shape": BENCH.wall.shape})
    camera = SimulatedCamera(SimulatedCameraSettings(**common, truth=TRUTH, sensor=DIM))
    yield projector, camera
    camera.close()
    projector.close()


# -- the tank --------------------------------------------------------------------------------------------------------


def test_the_medium_is_linear_in_what_the_plunger_has_really_delivered(tank: SimulatedTank, tmp_path: Path) -> None:
    assert tank.medium == TRUTH.water
    for volume_ul in (1000.0, 3000.0):
        ink(tmp_path, volume_ul)
        medium, ml = tank.medium, volume_ul / 1000.0
        assert medium.sigma_s == pytest.approx(TRUTH.water.sigma_s + ml * TRUTH.ink.sigma_s)
        assert medium.sigma_a == pytest.approx(TRUTH.water.sigma_a + ml * TRUTH.ink.sigma_a)
        assert medium.g == pytest.approx(TRUTH.ink.g, abs=0.001)


def test_a_dark_pattern_shows_nothing_and_more_ink_shows_more(tank: SimulatedTank, tmp_path: Path) -> None:
    assert not tank.seen({DARK: 1.0}, 0).any()
    means = []
    for volume_ul in (0.0, 500.0, 1000.0):
        ink(tmp_path, volume_ul)
        means.append(tank.seen({SHEET: 1.0}, 0).mean())
    assert 0.0 < 100.0 * means[0] < means[1] < 0.7 * means[2]


def test_light_of_two_patterns_adds_up(tank: SimulatedTank, tmp_path: Path) -> None:
    ink(tmp_path, 2000.0)
    z_mm = (52.0, 68.0)
    left, right, both = (
        tank.radiance(draw(Rays(y_mm=y_mm, z_mm=z_mm, width_mm=8.0), BENCH.wall), tank.medium)
        for y_mm in ((-40.0,), (40.0,), (-40.0, 40.0))
    )
    noise = np.sqrt(left.stderr**2 + right.stderr**2 + both.stderr**2)
    assert np.sqrt(np.mean(((left.image + right.image - both.image) / noise) ** 2)) < 1.2


def test_a_pattern_that_was_shown_for_a_part_of_the_exposure_gives_that_part_of_its_light(
    tank: SimulatedTank, tmp_path: Path
) -> None:
    ink(tmp_path, 2000.0)
    mixed = tank.seen({SHEET: 0.25, FULL: 0.75}, 0)
    np.testing.assert_allclose(mixed, 0.25 * tank.seen({SHEET: 1.0}, 0) + 0.75 * tank.seen({FULL: 1.0}, 0))


def test_a_plume_fades_to_the_mixed_tank_at_its_time_scale(tank: SimulatedTank, tmp_path: Path) -> None:
    dosed_ns = 10**12
    ink(tmp_path, 2000.0, dosed_ns)
    mixed = tank.radiance(SHEET, tank.medium).image
    structure = []
    for since_s in (0.0, 0.5, 1.0, 20.0):
        image = tank.seen({SHEET: 1.0}, dosed_ns + round(since_s * 1e9))
        structure.append(np.linalg.norm(image - mixed) / np.linalg.norm(mixed))
    assert structure[0] > 0.3
    assert structure[1] == pytest.approx(structure[0] / np.e, rel=1e-6)
    assert structure[2] == pytest.approx(structure[0] / np.e**2, rel=1e-6)
    assert structure[3] < 1e-12


def test_only_new_ink_is_a_plume(tank: SimulatedTank, tmp_path: Path) -> None:
    first_ns, second_ns = 10**12, 10**12 + 60 * 10**9
    ink(tmp_path, 2000.0, first_ns)
    fresh = tank.seen({SHEET: 1.0}, first_ns)
    strong = np.ptp(fresh / tank.radiance(SHEET, tank.medium).image)
    ink(tmp_path, 2200.0, second_ns)
    again = tank.seen({SHEET: 1.0}, second_ns)
    assert np.ptp(again / tank.radiance(SHEET, tank.medium).image) == pytest.approx(strong / 11.0, rel=1e-6)


# -- the sensor ------------------------------------------------------------------------------------------------------


def test_counts_are_gain_times_radiance_plus_offset_with_a_cameras_noise() -> None:
    sensor, settings, random = Sensor(read_noise=4.0), CameraSettings(50.0, gain=2.0), np.random.default_rng(1)
    radiance = np.full((400, 500), 2e-4)
    gain, offset = gain_and_offset(sensor, settings)
    pixels = counts(radiance, sensor, settings, random).astype(float)
    assert pixels.mean() == pytest.approx(gain * 2e-4 + offset, rel=1e-3)
    counts_per_electron = gain / (sensor.response * settings.exposure_ms)
    electrons = (gain * 2e-4 + offset - sensor.black) / counts_per_electron
    assert pixels.var() == pytest.approx(counts_per_electron**2 * (electrons + 16.0) + 1 / 12, rel=0.02)


def test_bright_light_saturates_at_the_highest_count_and_clears_again() -> None:
    random = np.random.default_rng(1)
    for bits in (12, 14, 16):
        sensor = Sensor(bits=bits, read_noise=0.0)
        assert (counts(np.full((4, 4), 1.0), sensor, CameraSettings(100.0), random) == 2**bits - 1).all()
        assert counts(np.zeros((4, 4)), sensor, CameraSettings(100.0), random).max() < 2**bits / 8


# -- projector and camera together -------------------------------------------------------------------------------------


def test_frames_after_the_bound_show_the_new_pattern_alone(rig) -> None:
    projector, camera = rig
    gain, offset = gain_and_offset(DIM, camera.configure(CameraSettings(500.0)))
    for pattern in (SHEET, DARK, FULL, SHEET, DARK, FULL):
        flip = projector.show(pattern)
        frame = camera.capture(flip.bound_ns, 5.0)
        expected = gain * camera.tank.seen({pattern: 1.0}, frame.exposure_start_ns).mean() + offset
        assert frame.pixels.mean() == pytest.approx(expected, rel=0.01)


def test_a_frame_exposed_during_a_flip_has_the_new_pattern_for_the_rest_of_its_exposure(rig, tmp_path: Path) -> None:
    _, camera = rig
    exposure_ns = 300_000_000
    gain, offset = gain_and_offset(DIM, camera.configure(CameraSettings(exposure_ns / SCALE / 1e6)))
    first = camera.capture(time.monotonic_ns(), 5.0)
    lit_ns = first.exposure_start_ns + 5 * exposure_ns // 2
    frame_buffer(tmp_path).show(FULL, lit_ns)
    frame = camera.capture(lit_ns - exposure_ns, 5.0)
    part = (frame.exposure_start_ns + exposure_ns - lit_ns) / exposure_ns
    assert 0.2 < part < 0.8
    full = gain * camera.tank.seen({FULL: 1.0}, frame.exposure_start_ns).mean()
    assert frame.pixels.mean() - offset == pytest.approx(part * full, rel=0.01)


def test_the_camera_is_dark_once_the_projector_is_closed(rig) -> None:
    projector, camera = rig
    camera.capture(projector.show(FULL).bound_ns, 5.0)
    projector.close()
    _, offset = gain_and_offset(DIM, CameraSettings(20.0))
    assert camera.capture(time.monotonic_ns(), 5.0).pixels.mean() == pytest.approx(offset, abs=1.0)


def test_the_same_seed_gives_the_same_frames(tmp_path: Path) -> None:
    ink(tmp_path, 1000.0)
    frames = []
    for seed in (3, 3, 4):
        tank = SimulatedTank(TRUTH, tmp_path / "state", seed)
        camera = CameraSettings(20.0)
        frames.append(counts(tank.seen({FULL: 1.0}, 0), Sensor(), camera, np.random.default_rng((seed, 3, 0))))
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[0] != frames[2]).any()


class SlowView:
    """Whose pictures take longer than several exposures to compute."""

    shape, computed = BENCH.camera.shape, 0

    def radiance(self, *_: object) -> Radiance:
        self.computed += 1
        time.sleep(0.3)
        return Radiance(np.ones(self.shape), np.zeros(self.shape))

    def blob(self, *_: object) -> np.ndarray:
        return np.ones(self.shape)


def test_no_frame_is_lost_to_the_time_that_computing_a_picture_takes(rig, tmp_path: Path) -> None:
    projector, camera = rig
    slow = SlowView()
    camera.tank = SimulatedTank(TRUTH, tmp_path / "state", 0, slow)
    camera.configure(CameraSettings(1000.0))
    flip = projector.show(SHEET)
    frames = [camera.capture(flip.bound_ns, 5.0)]
    assert slow.computed == 1
    frames.append(camera.capture(frames[0].exposure_start_ns, 5.0))
    assert frames[1].sequence == frames[0].sequence + 1


# -- faults ------------------------------------------------------------------------------------------------------------


def test_a_silent_camera_times_out_by_name(rig) -> None:
    _, camera = rig
    camera.faults = CameraFaults(silent_from=1)
    camera.capture(time.monotonic_ns(), 5.0)
    with pytest.raises(DeviceError, match=r"simulated camera of .* gave no frame within 0.1 s"):
        camera.capture(time.monotonic_ns(), 0.1)
    camera.faults = CameraFaults()
    assert camera.capture(time.monotonic_ns(), 5.0).sequence > 0


def test_dropped_frames_are_jumps_of_the_sequence_at_the_chance_asked_for(rig) -> None:
    _, camera = rig
    camera.configure(CameraSettings(100.0))
    camera.faults = CameraFaults(dropped=0.5)
    after_ns, numbers = time.monotonic_ns(), []
    for _ in range(40):
        frame = camera.capture(after_ns, 5.0)
        after_ns = frame.exposure_start_ns
        numbers.append(frame.sequence)
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert numbers == sorted(set(numbers))
    assert 10 < missing < 120


def test_stale_frames_have_their_old_times(rig) -> None:
    _, camera = rig
    camera.faults = CameraFaults(stale_from=1)
    camera.capture(time.monotonic_ns(), 5.0)
    time.sleep(0.2)
    asked = time.monotonic_ns()
    assert camera.capture(asked, 5.0).exposure_start_ns < asked


def test_a_frozen_camera_repeats_its_last_pixels_with_new_times(rig) -> None:
    projector, camera = rig
    camera.faults = CameraFaults(frozen_from=1)
    frames = [camera.capture(projector.show(pattern).bound_ns, 5.0) for pattern in (DARK, FULL)]
    np.testing.assert_array_equal(frames[0].pixels, frames[1].pixels)
    assert frames[1].exposure_start_ns > frames[0].exposure_start_ns


def test_a_saturated_camera_shows_the_highest_count_only(rig) -> None:
    _, camera = rig
    camera.faults = CameraFaults(saturated_from=0)
    assert (camera.capture(time.monotonic_ns(), 5.0).pixels == camera.saturation).all()


def test_a_misshapen_frame_lacks_a_row(rig) -> None:
    _, camera = rig
    camera.faults = CameraFaults(misshapen_from=0)
    assert camera.capture(time.monotonic_ns(), 5.0).pixels.shape == (camera.shape[0] - 1, camera.shape[1])


def test_an_unplugged_camera_says_so(rig) -> None:
    _, camera = rig
    camera.faults = CameraFaults(unplugged_from=1)
    camera.capture(time.monotonic_ns(), 5.0)
    for action in (lambda: camera.capture(0, 5.0), lambda: camera.configure(CameraSettings(20.0))):
        with pytest.raises(DeviceError, match="is gone; plug it in"):
            action()


def test_a_late_flip_is_told_with_its_late_time_and_its_light_comes_after_that(rig) -> None:
    projector, camera = rig
    projector.show(DARK)
    projector.faults = ProjectorFaults(late=1.0, late_ms=3000.0)
    asked = time.monotonic_ns()
    flip = projector.show(FULL)
    assert flip.settled_ns - asked > 3000e6 * SCALE
    gain, offset = gain_and_offset(DIM, camera.configure(CameraSettings(500.0)))
    expected = gain * camera.tank.radiance(FULL, camera.tank.medium).image.mean() + offset
    assert camera.capture(flip.bound_ns, 5.0).pixels.mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("faults", [ProjectorFaults(stuck_from=1), ProjectorFaults(late=1.0, late_ms=1e6)])
def test_a_flip_that_does_not_come_times_out_by_name(rig, faults: ProjectorFaults) -> None:
    projector, _ = rig
    projector.show(DARK)
    projector.faults = faults
    with pytest.raises(DeviceError, match=r"simulated projector of .* did not swap within 1 s"):
        projector.show(FULL)


def test_closing_wakes_a_projector_that_waits_for_a_flip(rig) -> None:
    projector, _ = rig
    projector.faults = ProjectorFaults(stuck_from=0)
    errors = []

    def show() -> None:
        try:
            projector.show(FULL)
        except DeviceError as error:
            errors.append(str(error))

    showing = threading.Thread(target=show)
    showing.start()
    time.sleep(0.1)
    projector.close()
    showing.join(5.0)
    assert ["is closed" in error for error in errors] == [True]


def test_an_unplugged_projector_is_dark_and_says_so(rig) -> None:
    projector, camera = rig
    projector.show(FULL)
    projector.faults = ProjectorFaults(unplugged_from=1)
    with pytest.raises(DeviceError, match="the output is gone"):
        projector.show(FULL)
    _, offset = gain_and_offset(DIM, CameraSettings(20.0))
    assert camera.capture(time.monotonic_ns(), 5.0).pixels.mean() == pytest.approx(offset, abs=1.0)


def test_an_unsteady_refresh_is_refused_on_opening(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"ms apart where its refresh rate says 16\.7 ms"):
        open_device("simulated-projector", {"folder": tmp_path, "faults": {"unsteady_ms": 5.0}})
    assert isinstance(open_device("simulated-projector", {"folder": tmp_path}), SimulatedProjector)


@pytest.mark.parametrize(
    ("driver", "settings", "reason"),
    [
        ("simulated-camera", {}, 'key "folder" is missing'),
        ("simulated-camera", {"folder": ".", "fault": {}}, 'key "fault" is unknown; did you mean "faults"?'),
        ("simulated-camera", {"folder": ".", "faults": {"dropped": 2.0}}, "faults.dropped = 2.0"),
        ("simulated-camera", {"folder": ".", "truth": {"mixing_s": 0.0}}, "truth.mixing_s = 0.0"),
        ("simulated-projector", {"folder": ".", "shape": [60]}, "shape"),
    ],
)
def test_wrong_settings_are_refused_in_one_sentence(driver: str, settings: dict, reason: str) -> None:
    with pytest.raises(DeviceError) as caught:
        open_device(driver, settings)
    assert reason in str(caught.value)
    assert str(caught.value).startswith(driver)


def test_patterns_are_shown_by_what_they_are_not_by_their_name(rig) -> None:
    projector, camera = rig
    impostor = Pattern("dark", np.full(BENCH.wall.shape, 255, np.uint8))
    _, offset = gain_and_offset(DIM, camera.configure(CameraSettings(500.0)))
    assert camera.capture(projector.show(impostor).bound_ns, 5.0).pixels.mean() > 2 * offset


def test_all_faults_and_settings_are_in_the_documentation() -> None:
    page = (Path(__file__).parents[1] / "docs" / "simulated_rig.md").read_text()
    models = (CameraFaults, ProjectorFaults, SimulatedCameraSettings, SimulatedProjectorSettings, Sensor, Truth)
    named = {name for model in models for name in model.model_fields} | {field.name for field in fields(DoserFaults)}
    assert [name for name in sorted(named - {"truth", "sensor"}) if f"`{name}`" not in page] == []

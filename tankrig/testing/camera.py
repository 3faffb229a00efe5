"""What every camera promises, real or simulated."""

import math
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from tankrig.devices import CameraDevice, CameraSettings, Frame
from tankrig.errors import DeviceError

ReopenCamera = Callable[[], CameraDevice]

TIMEOUT_S = 10.0


def now() -> int:
    """Monotonic, ns."""
    return time.monotonic_ns()


class CameraContract:
    """Subclass it and give it the fixture `reopen`: a function that opens the camera, and again after `close`.

    `exposure_ms` is one that the camera can do; set another in the subclass where 20 ms is not.
    """

    exposure_ms = 20.0

    @pytest.fixture
    def camera(self, reopen: ReopenCamera) -> CameraDevice:
        """Open, and closed by `reopen`'s own end."""
        return reopen()

    def test_is_a_camera_with_a_name_a_shape_and_a_highest_count(self, camera: CameraDevice) -> None:
        assert isinstance(camera, CameraDevice)
        assert camera.name
        assert len(camera.shape) == 2
        assert 255 <= camera.saturation <= 65535

    def test_a_frame_is_what_the_camera_says_it_is(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        frame = camera.capture(now(), TIMEOUT_S)
        assert isinstance(frame, Frame)
        assert frame.pixels.shape == camera.shape
        assert frame.pixels.dtype == (np.uint8 if camera.saturation < 256 else np.uint16)
        assert frame.pixels.max() <= camera.saturation

    def test_the_exposure_began_after_it_was_asked_for_and_ended_before_it_arrived(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        for _ in range(5):
            asked = now()
            frame = camera.capture(asked, TIMEOUT_S)
            assert asked < frame.exposure_start_ns < frame.host_ns <= now()

    def test_after_idling_no_stale_frame_is_handed_out(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        camera.capture(now(), TIMEOUT_S)
        time.sleep(0.5)
        asked = now()
        assert camera.capture(asked, TIMEOUT_S).exposure_start_ns > asked

    def test_a_time_to_come_is_waited_for(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        later = now() + 300_000_000
        assert camera.capture(later, TIMEOUT_S).exposure_start_ns > later

    def test_a_series_has_every_frame_once_and_in_order(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        frames = [camera.capture(now(), TIMEOUT_S)]
        for _ in range(5):
            frames.append(camera.capture(frames[-1].exposure_start_ns, TIMEOUT_S))
        for clock in ("sequence", "exposure_start_ns", "device_ns"):
            times = [getattr(frame, clock) for frame in frames]
            assert times == sorted(set(times)), clock

    def test_frames_are_copies(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        first = camera.capture(now(), TIMEOUT_S)
        kept = first.pixels.copy()
        second = camera.capture(first.exposure_start_ns, TIMEOUT_S)
        assert not np.shares_memory(first.pixels, second.pixels)
        second.pixels[:] = 0
        np.testing.assert_array_equal(first.pixels, kept)

    def test_settings_are_told_as_they_are(self, camera: CameraDevice) -> None:
        actual = camera.configure(CameraSettings(self.exposure_ms))
        assert actual.exposure_ms == pytest.approx(self.exposure_ms, rel=0.05)
        assert actual.gain > 0.0
        assert camera.configure(actual) == actual
        extreme = camera.configure(CameraSettings(exposure_ms=1e9, gain=1e9))
        assert extreme.exposure_ms < 1e9
        assert extreme.gain < 1e9

    @pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
    def test_settings_that_cannot_be_are_refused(self, camera: CameraDevice, value: float) -> None:
        with pytest.raises(DeviceError):
            camera.configure(CameraSettings(exposure_ms=value))
        with pytest.raises(DeviceError):
            camera.configure(CameraSettings(exposure_ms=self.exposure_ms, gain=value))

    def test_no_frame_in_time_is_an_error_that_names_the_camera_and_the_next_capture_works(
        self, camera: CameraDevice
    ) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        with pytest.raises(DeviceError, match=camera.name[:12]):
            camera.capture(now() + 3_600_000_000_000, timeout_s=0.2)
        asked = now()
        assert camera.capture(asked, TIMEOUT_S).exposure_start_ns > asked

    def test_it_has_one_owner(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        errors: list[DeviceError] = []
        waiting = threading.Thread(target=_expect_error, args=(camera, 2.0, []))
        waiting.start()
        time.sleep(0.2)
        intruder = threading.Thread(target=_expect_error, args=(camera, 1.0, errors))
        intruder.start()
        intruder.join(TIMEOUT_S)
        assert len(errors) == 1
        waiting.join(TIMEOUT_S)

    def test_close_may_be_called_again_and_ends_everything(self, camera: CameraDevice) -> None:
        camera.close()
        camera.close()
        with pytest.raises(DeviceError, match=camera.name[:12]):
            camera.capture(now(), TIMEOUT_S)
        with pytest.raises(DeviceError):
            camera.configure(CameraSettings(self.exposure_ms))

    def test_close_wakes_a_capture_that_waits(self, camera: CameraDevice) -> None:
        camera.configure(CameraSettings(self.exposure_ms))
        errors: list[DeviceError] = []
        waiting = threading.Thread(target=_expect_error, args=(camera, 3600.0, errors))
        waiting.start()
        time.sleep(0.2)
        assert waiting.is_alive()
        camera.close()
        waiting.join(TIMEOUT_S)
        assert not waiting.is_alive()
        assert len(errors) == 1

    def test_it_can_be_opened_again(self, camera: CameraDevice, reopen: ReopenCamera) -> None:
        shape = camera.shape
        camera.close()
        again = reopen()
        assert again.shape == shape
        assert again.capture(now(), TIMEOUT_S).pixels.shape == shape


def _expect_error(camera: CameraDevice, timeout_s: float, errors: list[DeviceError]) -> None:
    """Wait for a frame of the next hour."""
    try:
        camera.capture(now() + 3_600_000_000_000, timeout_s)
    except DeviceError as error:
        errors.append(error)

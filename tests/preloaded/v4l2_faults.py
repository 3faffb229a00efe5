"""What a V4L2 camera does wrong is noticed, said in one sentence, and outlived."""

import threading
import time

import numpy as np
import pytest

from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError

from .fake_v4l2 import END_OF_FRAME, UNKNOWN_CLOCK, lights


def now() -> int:
    return time.monotonic_ns()


def captures(camera, count: int) -> list:
    return [camera.capture(now(), 2.0) for _ in range(count)]


def test_after_a_pause_only_frames_of_the_new_light_are_handed_out(camera, device):
    camera.configure(CameraSettings(5.0))
    device.light(now(), 0xA5A5)
    camera.capture(now(), 2.0)
    time.sleep(0.3)  # the queue is full of frames of the old light
    lit_ns = now()
    device.light(lit_ns, 0x1234)
    assert lights(camera.capture(lit_ns, 2.0).pixels, 12) == (0x1234, 0x1234)


def test_dropped_frames_show_as_gaps_and_nothing_else(camera, device):
    """Beside other programs the stand-in stamps a frame late now and then, as no kernel does; from some frames on a
    late stamp is known for one, and of the first two it is not."""
    camera.configure(CameraSettings(5.0))
    frames = [camera.capture(now(), 2.0)]
    for _ in range(8):
        frames = [camera.capture(frames[0].exposure_start_ns, 2.0)]
    device.set("dropped_per_1000", 300)
    for _ in range(40):
        frames.append(camera.capture(frames[-1].exposure_start_ns, 2.0))
    jumps = np.diff([frame.sequence for frame in frames])
    periods = np.diff([frame.exposure_start_ns for frame in frames]) / 10e6
    assert jumps.min() == 1
    assert jumps.max() > 1
    np.testing.assert_array_equal(jumps, np.round(periods))


def test_a_stamp_that_is_late_is_no_loss_and_makes_no_frame_begin_too_late(camera, device):
    device.set("latency_ns", 9_000_000)
    device.set("late_every", 10)
    device.set("late_ns", 8_000_000)
    camera.configure(CameraSettings(5.0))
    frames = [camera.capture(now(), 2.0)]
    for number in range(1, 40):
        lit_ns = now()
        device.light(lit_ns, number)
        frames.append(camera.capture(lit_ns, 2.0))
        assert lights(frames[-1].pixels, 12) == (number, number)
    jumps = np.diff([frame.sequence for frame in frames])
    np.testing.assert_array_equal(jumps, np.round(np.diff([frame.exposure_start_ns for frame in frames]) / 10e6))


def test_a_camera_that_becomes_slower_loses_no_frames(camera, device):
    device.set("patient", 1)
    camera.configure(CameraSettings(5.0))
    frames = [camera.capture(now(), 2.0)]
    device.set("period_ns", 30_000_000)
    for _ in range(20):
        frames.append(camera.capture(frames[-1].exposure_start_ns, 2.0))
    assert [frame.sequence - frames[0].sequence for frame in frames] == list(range(21))


def test_a_stall_is_noticed_after_a_second_and_the_next_capture_works(camera, device):
    camera.configure(CameraSettings(5.0))
    camera.capture(now(), 2.0)
    device.set("stalled", 1)
    began = time.monotonic()
    with pytest.raises(DeviceError, match=r"video0: gave no frame for \d\.\d s; check its cable"):
        camera.capture(now(), 60.0)
    assert time.monotonic() - began < 5.0  # OpenCV's own limit is 10 s
    device.set("stalled", 0)
    assert camera.capture(now(), 2.0).pixels.any()


def test_unplugged_it_says_so_and_plugged_in_it_goes_on_as_configured(camera, device):
    actual = camera.configure(CameraSettings(7.0))
    before = camera.capture(now(), 2.0)
    device.unplug()
    for reason in ("is gone; plug the camera in", "is not there; plug the camera in"):
        with pytest.raises(DeviceError, match=reason):
            camera.capture(now(), 2.0)
    device.plug_in()
    device.light(now(), 0x00FF)
    after = camera.capture(now(), 2.0)
    assert after.sequence > before.sequence
    assert lights(after.pixels, 12) == (0x00FF, 0x00FF)
    assert camera.configure(actual) == actual


def test_unplugged_while_a_capture_waits(camera, device):
    camera.configure(CameraSettings(5.0))
    threading.Timer(0.2, device.unplug).start()
    with pytest.raises(DeviceError, match="is gone"):
        camera.capture(now() + 10**13, 60.0)


def test_an_exposure_that_is_not_what_the_camera_says_is_found_out(device, reopen):
    device.set("lies", 1)  # half of what it reads back
    camera = reopen()
    assert camera.configure(CameraSettings(20.0)).exposure_ms == 20.0
    with pytest.raises(DeviceError, match=r"arrived \d+\.\d ms before its exposure can have ended"):
        captures(camera, 50)  # a frame that a busy computer takes late proves nothing


def test_timestamps_of_another_clock_are_refused(device, reopen):
    device.set("stamp", UNKNOWN_CLOCK)
    with pytest.raises(DeviceError, match="timestamps are not of the monotonic clock"):
        reopen()


def test_timestamps_of_the_frames_end_are_set_back_to_before_its_start(device, reopen):
    device.set("stamp", END_OF_FRAME)
    device.set("latency_ns", 3_000_000)
    camera = reopen()
    camera.configure(CameraSettings(5.0))
    for number in range(1, 20):
        lit_ns = now()
        device.light(lit_ns, number)
        frame = camera.capture(lit_ns, 2.0)
        assert lights(frame.pixels, 12) == (number, number)
        assert frame.device_ns - frame.exposure_start_ns >= 15_000_000  # exposure and one period


def test_frames_with_the_exposure_of_before_are_not_handed_out(camera):
    camera.configure(CameraSettings(50.0))
    camera.capture(now(), 2.0)
    asked = now()
    camera.configure(CameraSettings(5.0))
    frame = camera.capture(asked, 2.0)
    assert frame.exposure_start_ns > asked + 2 * 10_000_000


def test_automatic_exposure_is_switched_off_and_the_gain_is_a_factor(camera):
    assert camera.configure(CameraSettings(12.34, gain=4.0)) == CameraSettings(12.3, gain=4.0)
    assert camera.configure(CameraSettings(1e6, gain=1e6)) == CameraSettings(500.0, gain=255 / 16)


def test_controls_of_the_rig_file_are_set_by_name(reopen):
    reopen(controls={"white_balance_automatic": False, "brightness": 0})


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"format": "Y10", "bits": None}, "does not give format Y10; it offers YUYV, GREY, Y16"),
        ({"shape": [480, 640]}, r"gives \[48, 64\] pixels \(rows, columns\) and not \[480, 640\]"),
        ({"fps": 30.0}, "gives 100 frames/s, not 30"),
        ({"card": "Good Camera"}, 'is a "Fake Camera" and not the "Good Camera"'),
        ({"controls": {"contrast": 3}}, "has no control 'contrast'; it has brightness"),
        ({"controls": {"brightness": 3}}, "control brightness does not take the value 3"),
        ({"device": "/dev/video99"}, "/dev/video99: is not there; plug the camera in"),
        ({"device": "/dev/null"}, "/dev/null: is no camera"),
        ({"format": "MJPG"}, "camera|format"),
        ({"bits": 4}, "bits"),
    ],
)
def test_what_it_cannot_give_is_refused_before_anything_is_captured(reopen, settings, reason):
    with pytest.raises(DeviceError, match=reason):
        reopen(**settings)


def test_counts_beyond_the_bits_of_the_rig_file_are_refused(reopen, device):
    camera = reopen(bits=10)
    device.light(now(), 0xFFFF)
    with pytest.raises(DeviceError, match=r"gave the count 4095 where 1023 is the highest; correct camera\.bits"):
        camera.capture(now(), 2.0)


def test_a_camera_that_another_program_streams_from_is_refused(reopen, device):
    device.set("busy", 1)
    with pytest.raises(DeviceError, match="used by another program"):
        reopen()


def test_without_permission_the_group_is_named(reopen, device):
    device.set("forbidden", 1)
    with pytest.raises(DeviceError, match="usermod -aG video"):
        reopen()


def test_a_turned_picture_is_turned(reopen, device):
    device.light(0, 0x0001)  # its only bright bit is at the left of the upper half
    seen = []
    for settings in ({}, {"turn_deg": 90}, {"mirror": True}):
        camera = reopen(**settings)
        seen.append(camera.capture(now(), 2.0).pixels > 2000)
        assert seen[-1].shape == camera.shape
        camera.close()
    upright, turned, mirrored = seen
    numbered = slice(1, -1)  # the first and the last row show the frame's number
    np.testing.assert_array_equal(np.rot90(turned, -1)[numbered], upright[numbered])
    np.testing.assert_array_equal(np.fliplr(mirrored)[numbered], upright[numbered])
    assert not np.array_equal(upright[numbered], mirrored[numbered])


@pytest.mark.parametrize("format_", ["GREY", "YUYV"])
def test_eight_bits_stay_eight_bits(reopen, device, format_):
    device.light(0, 0xFFFF)
    camera = reopen(format=format_, bits=None)
    pixels = camera.capture(now(), 2.0).pixels
    assert camera.saturation == 255
    assert pixels.dtype == np.uint8
    assert pixels.shape == (48, 64)
    assert lights(pixels, 8) == (0xFFFF, 0xFFFF)

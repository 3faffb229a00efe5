"""What kernels may do to a program that streams, as their documentation has it, and what must not come of it."""

import errno
import time

import numpy as np
import pytest

from drivers.v4l2 import health
from drivers.v4l2.settings import V4l2CameraSettings
from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError

from .fake_v4l2 import shown


def now() -> int:
    return time.monotonic_ns()


def series(camera, count: int) -> list:
    frames = [camera.capture(now(), 5.0)]
    while len(frames) < count:
        frames.append(camera.capture(frames[-1].exposure_start_ns, 5.0))
    return frames


def gaps(frames) -> np.ndarray:
    return np.diff([frame.sequence for frame in frames])


def reopen_with(reopen, camera, **settings):
    camera.close()
    return reopen(**settings)


@pytest.mark.parametrize("damage", ["error_every", "short_every"])
def test_a_frame_that_the_kernel_calls_damaged_or_half_filled_is_a_gap_and_no_picture(reopen, device, damage):
    device.set("patient", 1)
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    device.set(damage, 4)
    frames = series(camera, 30)
    assert not any(shown(frame.pixels, 12).torn for frame in frames)
    assert gaps(frames).max() == 2


def test_a_camera_that_gives_damaged_frames_only_says_so(reopen, device):
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    device.set("error_every", 1)
    with pytest.raises(DeviceError, match=r"marked as damaged.*; use a shorter cable"):
        camera.capture(now(), 5.0)
    device.set("error_every", 0)
    assert camera.capture(now(), 5.0).pixels.any()


@pytest.mark.parametrize("format_", ["GREY", "Y16", "YUYV", "Y10P"])
def test_padded_lines_do_not_shear_the_picture(reopen, device, format_):
    device.set("all_formats", 1)
    device.set("line_padding", 24)
    device.light(0, 0x1357)
    camera = reopen(format=format_, bits=12 if format_ == "Y16" else None)
    frame = camera.capture(now(), 2.0)
    bits = int(camera.saturation).bit_length()
    assert (shown(frame.pixels, bits).start, shown(frame.pixels, bits).end) == (0x1357, 0x1357)
    assert len(np.unique(frame.pixels[30:40])) == 1


@pytest.mark.parametrize(
    ("format_", "bits"),
    [("Y16", 12), ("Y16_BE", 12), ("Y10", 10), ("Y12", 12), ("Y10P", 10), ("Y12P", 12), ("Y10B", 10)],
)
def test_each_grey_format_has_its_counts(reopen, device, format_, bits):
    device.set("all_formats", 1)
    device.light(0, 0xA5F1)
    camera = reopen(format=format_, bits=bits if format_.startswith("Y16") else None)
    frame = camera.capture(now(), 2.0)
    assert camera.saturation == 2**bits - 1
    assert frame.pixels.dtype == np.uint16
    assert frame.pixels.shape == camera.shape == (48, 64)
    assert (shown(frame.pixels, bits).start, shown(frame.pixels, bits).end) == (0xA5F1, 0xA5F1)
    assert set(np.unique(frame.pixels)) == {2**bits - 1, (2**bits - 1) // 8, int((2**bits - 1) * 0.9)}


@pytest.mark.parametrize(
    ("format_", "bits"),
    [
        ("SBGGR8", 8),
        ("SRGGB8", 8),
        ("SGRBG10", 10),
        ("SGBRG12", 12),
        ("SRGGB16", 12),
        ("SRGGB10P", 10),
        ("SGBRG12P", 12),
    ],
)
@pytest.mark.parametrize("bayer", ["green", "all"])
def test_colour_sensors_give_grey_by_adding_the_pixels_of_each_cell(reopen, device, format_, bits, bayer):
    """In the picture of the stand-in red pixels count half, and blue ones a quarter, of the green ones."""
    device.set("all_formats", 1)
    device.light(0, 2)  # dark: the lower half has 10 % of the highest count
    camera = reopen(format=format_, bayer=bayer, bits=bits if format_.endswith("16") else None)
    frame = camera.capture(now(), 2.0)
    most = 2**bits - 1
    level = int(most * 0.1)
    assert camera.shape == frame.pixels.shape == (24, 32)
    assert camera.saturation == most * (2 if bayer == "green" else 4)
    assert set(np.unique(frame.pixels[13:22])) == {
        2 * level if bayer == "green" else 2 * level + level // 2 + level // 4
    }
    assert (
        frame.pixels[4, 3] == camera.saturation
    )  # the light's bit: where one pixel of a cell is clipped, all of it is


def test_a_compressed_format_is_refused_with_the_reason(reopen, device):
    device.set("all_formats", 1)
    with pytest.raises(DeviceError, match=r"MJPG.*loses counts"):
        reopen(format="MJPG", bits=None)


def test_a_burst_of_frames_is_taken_by_their_times(reopen, device):
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    device.set("burst", 3)
    for number in range(1, 15):
        lit_ns = now()
        device.light(lit_ns, number)
        seen = shown(camera.capture(lit_ns, 2.0).pixels, 12)
        assert (seen.start, seen.end) == (number, number)


@pytest.mark.parametrize("every", [3, 10])
def test_frames_without_a_time_stamp_are_passed_over(reopen, device, every):
    device.set("patient", 1)
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    device.set("zero_every", every)
    frames = series(camera, 20)
    assert min(frame.device_ns for frame in frames) > 0
    assert gaps(frames).max() == 2


def test_a_count_that_wraps_is_no_loss_and_one_that_jumps_is_one(reopen, device):
    device.set("patient", 1)
    device.set("first_sequence", 2**32 - 12)
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    assert gaps(series(camera, 20)).tolist() == [1] * 19
    device.set("jump_every", 10)
    device.set("jump_by", 3)
    jumps = gaps(series(camera, 25)).tolist()
    assert set(jumps) == {1, 4}


def test_a_driver_that_does_not_count_gives_every_frame_a_number(reopen, device):
    device.set("patient", 1)
    device.set("stuck", 1)
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    assert gaps(series(camera, 10)).tolist() == [1] * 9


def test_an_io_error_costs_a_frame_and_is_a_gap(reopen, device):
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    device.set("eio_every", 7)
    frames = series(camera, 40)  # far more errors than there are buffers to lose
    assert not any(shown(frame.pixels, 12).torn for frame in frames)
    assert gaps(frames).max() > 1


def test_a_stream_that_breaks_is_begun_again(reopen, device):
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    before = camera.capture(now(), 2.0)
    device.set("broken", 1)
    device.light(now(), 0x0F0F)
    after = camera.capture(now(), 5.0)
    assert shown(after.pixels, 12).start == 0x0F0F
    assert after.sequence > before.sequence + 1


def test_a_buffer_that_is_not_there_yet_is_waited_for(reopen, device):
    device.set("patient", 1)
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    device.set("eagain_every", 3)
    assert gaps(series(camera, 30)).tolist() == [1] * 29


@pytest.mark.parametrize(("least", "most"), [(9, 32), (0, 2)])
def test_more_or_fewer_buffers_than_asked_do(reopen, device, least, most):
    device.set("buffers_least", least)
    device.set("buffers_most", most)
    camera = reopen()
    camera.configure(CameraSettings(2.0))
    camera.capture(now(), 2.0)
    time.sleep(0.2)
    lit_ns = now()
    device.light(lit_ns, 77)
    assert shown(camera.capture(lit_ns, 2.0).pixels, 12).start == 77
    camera.close()
    assert device.get("mapped") == 0


def test_one_buffer_is_too_few(reopen, device):
    device.set("buffers_most", 1)
    with pytest.raises(DeviceError, match="buffer"):
        reopen()


@pytest.mark.parametrize("idle_s", [0.0, 0.3])
@pytest.mark.parametrize("latency", [0, 2, 5])
def test_no_frame_has_the_settings_of_before(reopen, device, latency, idle_s):
    """Whether the queue is full of old frames or not, and the camera takes some frames to follow."""
    device.set("control_latency", latency)
    camera = reopen()
    for gain, exposure_ms in ((2.0, 4.0), (4.0, 2.0), (4.0, 8.0), (1.0, 8.0)):
        actual = camera.configure(CameraSettings(exposure_ms, gain))
        seen = shown(camera.capture(now(), 2.0).pixels, 12)
        assert (
            (seen.gain, seen.exposure_ms) == (round(16 * actual.gain), actual.exposure_ms) == (16 * gain, exposure_ms)
        )
        time.sleep(idle_s)


def test_no_frame_has_the_settings_of_before_in_a_camera_that_became_slower(reopen, device):
    """The frames that may be old are counted: at a third of the frame rate they take three times as long."""
    device.set("control_latency", 3)
    camera = reopen()
    camera.configure(CameraSettings(4.0, 2.0))
    device.set("period_ns", 40_000_000)
    series(camera, 3)
    camera.configure(CameraSettings(4.0, 4.0))
    assert shown(camera.capture(now(), 5.0).pixels, 12).gain == 64


def frames_until_settled(camera, settings: CameraSettings) -> int:
    """From one frame to the first after `configure`; up to five are of the queue and the exposure under way."""
    before = camera.capture(now(), 2.0)
    camera.configure(settings)
    return camera.capture(now(), 2.0).sequence - before.sequence


def test_settings_that_are_already_set_cost_no_frame(reopen, device):
    device.set("patient", 1)
    camera = reopen()
    actual = camera.configure(CameraSettings(5.0, 2.0))
    assert frames_until_settled(camera, actual) <= 6
    assert frames_until_settled(camera, CameraSettings(6.0)) > 6


@pytest.mark.parametrize("latency", [0, 2, 9])
def test_the_frames_that_a_camera_takes_to_follow_are_counted(reopen, device, latency):
    device.set("patient", 1)
    device.set("responds", 1)
    device.set("control_latency", latency)
    camera = reopen()
    was = camera.configure(CameraSettings(3.0, 2.0))
    assert abs(camera.frames_to_follow() - latency) <= 1  # of the frame that begins at the change nobody knows
    assert camera.configure(was) == was
    (check,) = [check for check in health.checks({"device": "/dev/v4l/by-id/x"}, camera) if "follows" in check.what]
    assert check.passed is (latency < 7)
    advised = int(check.remedy.removeprefix("set settle_frames = ").removesuffix(" in [camera]"))
    assert latency < advised <= latency + 2
    fit = reopen_with(reopen, camera, settle_frames=advised)
    fit.configure(CameraSettings(4.0))
    fit.capture(now(), 2.0)
    fit.configure(CameraSettings(8.0))
    assert shown(fit.capture(now(), 2.0).pixels, 12).exposure_ms == 8.0


def test_in_the_dark_nobody_can_tell_how_fast_a_camera_follows(reopen):
    assert reopen().frames_to_follow() is None


def test_a_camera_that_clamps_and_rounds_tells_what_it_has(reopen, device):
    device.set("patient", 1)
    device.set("clamps", 1)
    camera = reopen()
    actual = camera.configure(CameraSettings(1.66))
    assert actual == CameraSettings(2.0)
    assert shown(camera.capture(now(), 2.0).pixels, 12).exposure_ms == 2.0
    assert frames_until_settled(camera, CameraSettings(1.66)) <= 6  # what it made of this before is no change
    assert camera.configure(CameraSettings(1.66)) == actual
    assert camera.configure(CameraSettings(3.1)).exposure_ms == 3.0
    assert shown(camera.capture(now(), 2.0).pixels, 12).exposure_ms == 3.0


def test_automatic_exposure_that_stays_on_is_refused(reopen, device):
    device.set("auto_stays", 1)
    with pytest.raises(DeviceError, match="does not let go of automatic exposure"):
        reopen()


def test_an_exposure_that_moves_by_itself_is_noticed(reopen, device):
    device.set("creeps", 3)
    camera = reopen()
    camera.configure(CameraSettings(3.0))
    with pytest.raises(DeviceError, match=r"exposure.*by itself"):
        camera.capture(now(), 5.0)


@pytest.mark.parametrize(
    ("what", "value", "reason"),
    [
        ("open_error", errno.EIO, "does not answer.*input/output error"),
        ("open_error", errno.EBUSY, "used by another program"),
        ("open_error", errno.ENXIO, "is not there"),
        ("query_error", errno.EIO, "does not answer.*input/output error"),
        ("query_error", errno.ENODEV, "is not there"),
        ("query_error", errno.ENOTTY, "is no camera"),
        ("capabilities", 0x04A00000, "gives no pictures"),  # a camera's metadata
        ("capabilities", 0x04001000, "several planes"),
        ("capabilities", 0x00000001, "no streaming"),
        ("interlaced", 1, "interlaced"),
        ("no_room", 1, "bus has no room"),
        ("buffers_most", 1, "buffer"),
    ],
)
def test_each_trouble_has_its_sentence(reopen, device, what, value, reason):
    device.set(what, value)
    with pytest.raises(DeviceError, match=f"(?i)video0: .*{reason}"):
        reopen().capture(now(), 2.0)
    device.set(what, 0)
    assert reopen().capture(now(), 2.0).pixels.any()


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"format": "Y10P", "bits": None, "shape": [48, 62]}, "multiple of 4 columns; correct camera.shape"),
        ({"format": "SRGGB8", "bits": None, "shape": [47, 64]}, "multiple of 2 columns and of 2 rows"),
        ({"format": "SRGGB16", "bits": None}, "does not fit 16 bits; give camera.bits"),
        ({"format": "Y9"}, "Y9 is not known; choose one of Y16"),
        ({"shape": [96, 128]}, r"it offers \[48, 64\], \[96, 128\]"),
    ],
)
def test_what_a_format_cannot_have_is_refused(reopen, device, settings, reason):
    device.set("all_formats", 1)
    with pytest.raises(DeviceError, match=reason):
        reopen(**settings)


def test_what_time_stamps_mark_can_be_said_where_the_kernel_says_it_wrong(reopen, device):
    device.set("lies", 1)  # as if the stamp were of the transfer, which begins before such an exposure can have ended
    camera = reopen(timestamps="end")
    camera.configure(CameraSettings(20.0))
    frame = camera.capture(now(), 2.0)
    assert frame.device_ns - frame.exposure_start_ns >= 40_000_000  # the exposure, and as much to read it out


def test_a_camera_is_found_with_lines_that_a_rig_file_takes(device):
    import tomllib

    device.set("all_formats", 1)
    found = health.found(device.node, device.node)
    assert "camera Fake Camera at" in found.what
    table = tomllib.loads(found.lines)["camera"]
    assert table.pop("driver") == "v4l2-camera"
    assert V4l2CameraSettings(**table).shape == (96, 128)
    assert table["format"] == "Y16"
    device.set("query_error", errno.EIO)
    with pytest.raises(DeviceError, match="does not answer"):
        health.found(device.node, device.node)


def test_controls_of_kinds_that_only_newer_kernels_have_are_passed_over(reopen, device):
    device.set("new_kind", 1)
    assert reopen(controls={"white_balance_automatic": 0}).capture(now(), 2.0).pixels.any()


def test_closing_leaves_nothing_mapped_and_may_come_in_any_state(reopen, device):
    for number in range(30):
        camera = reopen()
        if number % 3:
            camera.capture(now(), 2.0)
        if number % 5 == 4:
            device.unplug()
        camera.close()
        if number % 5 == 4:
            device.plug_in()
        assert device.get("mapped") == 0

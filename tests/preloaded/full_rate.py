"""As many frames as stand-in and driver can move, with every fault that leaves frames: none may be another's."""

import os
import time

import cv2
import numpy as np

from tankrig.devices import CameraSettings

from .fake_v4l2 import shown

FRAMES = int(os.environ.get("FRAMES", "2000"))
EXPOSURE_NS = 100_000  # the stand-in's shortest, and its period: 10,000 frames/s
FRAMES_PER_LIGHT = 5


def now() -> int:
    return time.monotonic_ns()


def test_no_frame_of_many_is_mispaired_or_torn(device, reopen):
    """Light changes every few frames, which are torn, half filled, late, lost, come in bursts or have no stamp."""
    for name, value in (
        ("period_ns", EXPOSURE_NS),
        ("latency_ns", 400_000),
        ("jitter_ns", 100_000),
        ("dropped_per_1000", 20),
        ("error_every", 13),
        ("short_every", 17),
        ("zero_every", 19),
        ("late_every", 11),
        ("late_ns", 300_000),
        ("jump_every", 1009),
        ("jump_by", 3),
        ("eagain_every", 23),
        ("line_padding", 8),
    ):
        device.set(name, value)
    camera = reopen()
    camera.configure(CameraSettings(EXPOSURE_NS / 1e6))
    mispaired = torn = unnumbered = 0
    began, cpu, last = time.monotonic(), time.thread_time(), 0
    for taken in range(FRAMES):
        number = taken // FRAMES_PER_LIGHT % 65536
        if taken % FRAMES_PER_LIGHT == 0:
            after_ns = now()
            device.light(after_ns, number)
        if taken % 5000 == 2500:
            device.set("burst", 1 + taken // 5000 % 4)
        frame = camera.capture(after_ns, 10.0)
        after_ns = frame.exposure_start_ns
        seen = shown(frame.pixels, 12)
        torn += seen.torn
        mispaired += (seen.start, seen.end) != (number, number)
        unnumbered += frame.sequence <= last
        last = frame.sequence
    seconds, cpu = time.monotonic() - began, time.thread_time() - cpu
    exposed, dropped = device.get("exposed"), device.get("dropped")
    print(
        f"{FRAMES} frames, {FRAMES_PER_LIGHT} of each light: {mispaired} mispaired, {torn} torn, {unnumbered} out of "
        f"order; {exposed} exposed, {dropped} found no buffer; {FRAMES / seconds:.0f} frames/s, "
        f"{1e6 * cpu / FRAMES:.0f} µs of the processor each, lights and checks included"
    )
    assert (mispaired, torn, unnumbered) == (0, 0, 0)


def test_frames_a_second_beside_opencv(device, reopen):
    """The same frames through the driver and through OpenCV, in turns: no assertion on time."""
    device.set("patient", 1)
    device.set("period_ns", EXPOSURE_NS)
    for rows, columns, frames in ((48, 64, 2000), (1024, 1280, 60)):
        device.set("height", rows)
        device.set("width", columns)
        rates = {"driver": [], "OpenCV": []}
        for _ in range(5):
            camera = reopen(shape=[rows, columns])
            camera.configure(CameraSettings(EXPOSURE_NS / 1e6))
            rates["driver"].append(timed(frames, series(camera)))
            camera.close()
            capture = opencv(device.node, rows, columns)
            rates["OpenCV"].append(timed(frames, opencv_series(capture)))
            capture.release()
        for way, found in rates.items():
            per_second, cpu_us = np.median(found, axis=0)
            print(f"{columns}×{rows} Y16 by {way}: {per_second:.0f} frames/s, {cpu_us:.0f} µs of processor time each")
        assert np.median(rates["driver"], axis=0)[0] > 0


def timed(frames: int, source) -> tuple[float, float]:
    """Frames a second, and µs of this thread's processor time a frame."""
    for _ in range(20):
        next(source)
    began, cpu = time.perf_counter(), time.thread_time()
    for _ in range(frames):
        next(source)
    return frames / (time.perf_counter() - began), (time.thread_time() - cpu) / frames * 1e6


def series(camera):
    after_ns = now()
    while True:
        frame = camera.capture(after_ns, 10.0)
        after_ns = frame.exposure_start_ns
        yield frame


def opencv(node, rows: int, columns: int):
    capture = cv2.VideoCapture(str(node), cv2.CAP_V4L2)
    assert capture.isOpened()
    for name, value in (
        ("FOURCC", cv2.VideoWriter.fourcc(*"Y16 ")),
        ("FRAME_WIDTH", columns),
        ("FRAME_HEIGHT", rows),
        ("BUFFERSIZE", 4),
        ("CONVERT_RGB", 0),
    ):
        capture.set(getattr(cv2, f"CAP_PROP_{name}"), value)
    return capture


def opencv_series(capture):
    """What the driver did when it streamed through OpenCV: stamp, counts, their highest, a copy."""
    while True:
        assert capture.grab()
        stamped_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        there, raw = capture.retrieve()
        assert there
        assert raw.dtype == np.uint16
        assert raw.max() < 4096
        yield stamped_ns, raw.copy()

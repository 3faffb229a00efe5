"""Pattern and frame: a real window on a real X server, seen by the real OpenCV backend through a stand-in for light.

Each pattern carries a number. When the window's frame is swapped, the number is read back from the X server's frame
buffer, and after a random latency it is the light that the fake camera exposes; so a frame tells by itself which
pattern it shows, at the start and at the end of its exposure.
"""

import os
import time

import numpy as np
import pytest

from drivers.hdmi.projector import HdmiProjector
from drivers.hdmi.settings import HdmiProjectorSettings
from tankrig.calibration.latency import measure_latency
from tankrig.devices import CameraSettings
from tankrig.pattern import Pattern
from tests.xserver import PROJECTOR, XServer

from .fake_v4l2 import lights

PATTERNS = int(os.environ.get("PATTERNS", "100"))
REFRESH_HZ = 60.0
LATENCY_NS, EXPOSURE_NS, CAMERA_PERIOD_NS = 10_000_000, 1_500_000, 4_000_000
SHAPE = (240, 320)


class Light:
    """The swap clock of a screen at `REFRESH_HZ`, and the way of the light from there to the camera."""

    def __init__(self, server, device) -> None:
        self._server, self._device = server, device
        self._random = np.random.default_rng(7)
        self._measured = 0
        self.period_ns = round(1e9 / REFRESH_HZ)
        self.swapped_ns = 0
        self.latencies_ns: list[int] = []

    def __call__(self, swapped_ns: int) -> int:
        self._measured += 1
        self.swapped_ns = swapped_ns
        if self._measured <= 41:
            return self._measured * self.period_ns
        number = self.on_screen()
        on_output_ns = (swapped_ns // self.period_ns + 1) * self.period_ns
        self.latencies_ns.append(int(self._random.uniform(0, LATENCY_NS)))
        self._device.light(on_output_ns + self.latencies_ns[-1], number)
        time.sleep(max(0, on_output_ns - time.monotonic_ns()) / 1e9)
        return on_output_ns

    def on_screen(self) -> int:
        row = self._server.seen(800, 100, 320, 1)[0, 10::20, 1]
        return int(sum(1 << bit for bit, level in enumerate(row) if level > 127))


def numbered(number: int) -> Pattern:
    bits = (number >> np.arange(16)) & 1
    return Pattern(f"number {number}", np.tile(np.repeat(bits, 20).astype(np.uint8) * 255, (240, 1)))


@pytest.fixture
def server(tmp_path):
    server = XServer(tmp_path)
    yield server
    server.close()


@pytest.fixture
def bench(server, device, reopen, monkeypatch):
    device.set("period_ns", CAMERA_PERIOD_NS)
    monkeypatch.setenv("DISPLAY", server.display)
    monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
    monkeypatch.setenv("vblank_mode", "0")  # Mesa's made-up refreshes of a screen that has none
    light = Light(server, device)
    settings = HdmiProjectorSettings(
        screen={"output": PROJECTOR}, shape=SHAPE, refresh_hz=REFRESH_HZ, latency_ms=LATENCY_NS / 1e6, timeout_s=10.0
    )
    projector = HdmiProjector(settings, light)
    camera = reopen()
    camera.configure(CameraSettings(EXPOSURE_NS / 1e6))
    yield projector, camera, light
    projector.close()


def test_every_frame_belongs_to_its_pattern(bench, device):
    """With random latency, dropped frames, late frames and pauses after which the queue is full of old ones."""
    projector, camera, _ = bench
    device.set("dropped_per_1000", 100)
    device.set("jitter_ns", 3_000_000)
    random, last, frames, mispaired = np.random.default_rng(3), 0, 0, 0
    for _ in range(PATTERNS):
        number = (last + int(random.integers(1, 65536))) % 65536
        flip = projector.show(numbered(number))
        after_ns = flip.bound_ns
        for _ in range(int(random.integers(1, 3))):
            frame = camera.capture(after_ns, 5.0)
            after_ns = frame.exposure_start_ns
            frames += 1
            mispaired += lights(frame.pixels, 12) != (number, number)
        if random.random() < 0.05:
            time.sleep(0.03)
        last = number
    print(f"{PATTERNS} patterns, {frames} frames, {mispaired} mispaired, {device.get('exposed')} exposed")
    assert mispaired == 0


def test_without_the_bound_frames_are_mispaired(bench):
    """So the test above could fail: frames taken right after the swap show the pattern before."""
    projector, camera, _ = bench
    mispaired = 0
    for number in range(1, 30):
        flip = projector.show(numbered(number))
        mispaired += lights(camera.capture(flip.settled_ns, 5.0).pixels, 12) != (number, number)
    assert mispaired > 5


def test_overhead_of_a_step(bench):
    """What a step takes beyond flip, latency and exposure: no assertion on time, for this computer may be busy."""
    projector, camera, light = bench
    parts_ms = []
    for number in range(max(PATTERNS, 20)):
        pattern = numbered(number)
        assert pattern.hash
        called_ns = time.monotonic_ns()
        flip = projector.show(pattern)
        shown_ns = time.monotonic_ns()
        frame = camera.capture(flip.bound_ns, 5.0)
        returned_ns = time.monotonic_ns()
        to_swap_ns = light.swapped_ns - called_ns
        missed_ns = max(0, frame.exposure_start_ns - flip.bound_ns - CAMERA_PERIOD_NS)
        after_exposure_ns = returned_ns - frame.exposure_start_ns - EXPOSURE_NS
        parts_ms.append([part / 1e6 for part in (to_swap_ns, shown_ns - flip.settled_ns, missed_ns, after_exposure_ns)])
    parts = np.median(parts_ms, axis=0)
    total = np.sum(parts_ms, axis=1)
    print(
        f"overhead of {len(total)} steps: median {np.median(total):.2f} ms, 95 % {np.percentile(total, 95):.2f} ms; "
        f"to the swap {parts[0]:.2f}, from it {parts[1]:.2f}, frames missed {parts[2]:.2f}, "
        f"to the caller {parts[3]:.2f}"
    )
    assert len(total) >= 20


def test_latency_is_measured_by_flips_seen_through_the_camera(bench):
    """It is never found too early, and to the point where a frame saw the change; lost frames may make it late."""
    projector, camera, light = bench
    found_ms = np.array(measure_latency(projector, camera, flips=50, exposure_ms=EXPOSURE_NS / 1e6).samples_ms)
    late_ms = found_ms - np.array(light.latencies_ns[-50:]) / 1e6
    # Half of the fake camera's picture shows the light's number at the two ends of the exposure and no mean over it.
    close_ms = 0.3 * EXPOSURE_NS / 1e6
    assert late_ms.min() > -close_ms
    assert (late_ms < close_ms).any()

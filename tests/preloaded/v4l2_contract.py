"""A V4L2 camera keeps the promises of every camera."""

import pytest

from tankrig.testing import CameraContract


class TestV4l2Camera(CameraContract):
    pass


class TestTimestampsOfTheFramesEnd(CameraContract):
    @pytest.fixture
    def camera(self, device, reopen):
        device.set("stamp", 1)
        return reopen()


class TestKernelThatMisbehaves(CameraContract):
    """Frames are damaged, half filled, late, without stamp or lost; lines are padded; controls clamp and act late."""

    @pytest.fixture
    def camera(self, device, reopen):
        for name, value in (
            ("error_every", 5),
            ("short_every", 7),
            ("zero_every", 9),
            ("late_every", 11),
            ("late_ns", 8_000_000),
            ("latency_ns", 9_000_000),
            ("jitter_ns", 3_000_000),
            ("dropped_per_1000", 50),
            ("eagain_every", 4),
            ("line_padding", 16),
            ("buffers_least", 6),
            ("clamps", 1),
            ("control_latency", 3),
            ("first_sequence", 2**32 - 20),
        ):
            device.set(name, value)
        return reopen()

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

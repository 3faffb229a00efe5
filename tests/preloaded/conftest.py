"""A fake camera at FAKE_V4L2, and the driver on it."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.registry import open_device
from drivers.v4l2.camera import V4l2Camera

from .fake_v4l2 import FakeDevice

os.environ.pop("LD_PRELOAD", None)  # it is for this process, and for none that it starts


@pytest.fixture
def device() -> FakeDevice:
    return FakeDevice(Path(os.environ["FAKE_V4L2"]))


@pytest.fixture
def reopen(device: FakeDevice) -> Iterator[Callable[..., V4l2Camera]]:
    opened: list[V4l2Camera] = []

    def open_again(**settings: Any) -> V4l2Camera:
        asked = {"device": str(device.node), "format": "Y16", "bits": 12, "shape": [48, 64], **settings}
        opened.append(open_device("v4l2-camera", asked))
        return opened[-1]

    yield open_again
    for camera in opened:
        camera.close()


@pytest.fixture
def camera(reopen: Callable[..., V4l2Camera]) -> V4l2Camera:
    return reopen()

"""The contract suites on the devices of the rig file that TANKRIG_RIG names: `pytest -m hardware`.

The doser's moves real ink, some 3000 increments in all, into whatever its tube hangs in: give it a vessel, not the
tank. The projector flickers. firmware_notes/ says for each device what has to be done before, and what a pass proves.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.registry import open_device
from drivers.rig import load_rig_file
from tankrig.devices import CameraDevice, Doser, Projector
from tankrig.testing import CameraContract, DoserContract
from tankrig.testing.projector import ProjectorContract

pytestmark = [
    pytest.mark.hardware,
    pytest.mark.skipif("TANKRIG_RIG" not in os.environ, reason="name a rig file in TANKRIG_RIG"),
]


@pytest.fixture
def reopen(request: pytest.FixtureRequest) -> Iterator[Callable[[], Any]]:
    """Opens the device that the test class is about."""
    settings = dict(getattr(load_rig_file(Path(os.environ["TANKRIG_RIG"])), request.cls.device))
    driver, opened = settings.pop("driver"), []

    def open_again() -> Any:
        opened.append(open_device(driver, settings))
        return opened[-1]

    yield open_again
    for device in opened:
        device.close()


class TestProjectorOfTheRig(ProjectorContract):
    device = "projector"

    @pytest.fixture
    def projector(self, reopen: Callable[[], Projector]) -> Projector:
        return reopen()


class TestCameraOfTheRig(CameraContract):
    device = "camera"

    @pytest.fixture
    def camera(self, reopen: Callable[[], CameraDevice]) -> CameraDevice:
        return reopen()


class TestDoserOfTheRig(DoserContract):
    device = "doser"

    @pytest.fixture
    def doser(self, reopen: Callable[[], Doser]) -> Doser:
        doser = reopen()
        assert not doser.unknown, "it does not know what it has delivered; settle that first"
        if doser.stopped:
            doser.clear_stop()
        return doser

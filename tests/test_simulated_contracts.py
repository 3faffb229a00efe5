"""The simulated projector and camera keep the promises of every projector and camera."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.registry import open_device
from tankrig.devices import CameraDevice, Projector
from tankrig.testing import CameraContract, ReopenCamera
from tankrig.testing.projector import ProjectorContract, ReopenProjector


class TestSimulatedProjector(ProjectorContract):
    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[ReopenProjector]:
        opened: list[Projector] = []

        def open_again() -> Projector:
            opened.append(open_device("simulated-projector", {"folder": tmp_path, "shape": [60, 80]}))
            return opened[-1]

        yield open_again
        for projector in opened:
            projector.close()

    @pytest.fixture
    def projector(self, reopen: ReopenProjector) -> Projector:
        return reopen()


class TestSimulatedCamera(CameraContract):
    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[ReopenCamera]:
        opened: list[CameraDevice] = []

        def open_again() -> CameraDevice:
            opened.append(open_device("simulated-camera", {"folder": tmp_path}))
            return opened[-1]

        yield open_again
        for camera in opened:
            camera.close()

    @pytest.fixture
    def camera(self, reopen: ReopenCamera) -> CameraDevice:
        return reopen()

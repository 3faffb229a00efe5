"""A recorded run or a folder of images can stand in for the camera, frame by frame and count by count."""

import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

import tankrig
from drivers.registry import open_device
from tankrig.errors import DeviceError
from tankrig.run.start import new_run
from tankrig.sequence import Capture, Sequence
from tankrig.testing import CameraContract, ReopenCamera

from .memory_rig import memory_rig


@pytest.fixture
def images(tmp_path):
    """Frame i is full of i; its name does not sort as its number does."""
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(12):
        cv2.imwrite(str(folder / f"frame{number}.png"), np.full((6, 8), 1000 + number, np.uint16))
    (folder / "notes.txt").write_text("not an image")
    return folder


class Contract(CameraContract):
    pace: str

    @pytest.fixture
    def reopen(self, images) -> Iterator[ReopenCamera]:
        opened = []

        def open_again():
            settings = {"source": str(images), "pace": self.pace, "interval_ms": 25.0, "loop": True}
            opened.append(open_device("replay-camera", settings))
            return opened[-1]

        yield open_again
        for camera in opened:
            camera.close()

    @pytest.fixture
    def camera(self, reopen):
        return reopen()


class TestRecordedPace(Contract):
    pace = "recorded"


class TestFullPace(Contract):
    pace = "full"


def test_at_full_pace_each_image_comes_once_and_then_it_says_that_there_are_no_more(images):
    camera = open_device("replay-camera", {"source": str(images), "pace": "full", "bits": 12})
    counts = [int(camera.capture(time.monotonic_ns(), 1.0).pixels[0, 0]) for _ in range(12)]
    assert counts == list(range(1000, 1012))
    assert camera.saturation == 4095
    with pytest.raises(DeviceError, match="all its 12 frames have been handed out"):
        camera.capture(time.monotonic_ns(), 1.0)


def test_at_the_recorded_pace_images_keep_their_interval_and_who_is_late_misses_some(images):
    camera = open_device("replay-camera", {"source": str(images), "interval_ms": 40.0})
    first = camera.capture(0, 1.0)
    second = camera.capture(first.exposure_start_ns, 1.0)
    assert second.exposure_start_ns - first.exposure_start_ns == 40_000_000
    late = camera.capture(first.exposure_start_ns + 100_000_000, 1.0)
    assert (int(late.pixels[0, 0]), late.sequence) == (1003, 3)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda folder: [file.unlink() for file in folder.glob("*.png")], "neither a run nor a folder of PNG or TIFF"),
        (lambda folder: (folder / "frame0.png").write_bytes(b"no"), r"frame0\.png: is no image that can be read"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_one_sentence(images, spoil, reason):
    spoil(images)
    with pytest.raises(DeviceError, match=reason):
        open_device("replay-camera", {"source": str(images)})


def test_an_image_of_another_size_is_named(images):
    cv2.imwrite(str(images / "frame1.png"), np.zeros((2, 2), np.uint16))
    camera = open_device("replay-camera", {"source": str(images), "pace": "full"})
    camera.capture(0, 1.0)
    with pytest.raises(DeviceError, match=r"frame1\.png: differs from the first image"):
        camera.capture(0, 1.0)


def test_a_run_comes_back_as_it_was_recorded(tmp_path):
    sequence = Sequence("replayed", (Capture("dark", frames=2), Capture("full", frames=3)), exposure_ms=1.0)
    new_run(sequence, memory_rig(tmp_path), tmp_path / "run").run()
    recorded = tankrig.open_run(tmp_path / "run").frames.values
    camera = open_device("replay-camera", {"source": str(tmp_path / "run"), "pace": "full"})
    assert camera.shape == recorded.shape[1:]
    for pixels in recorded:
        np.testing.assert_array_equal(camera.capture(time.monotonic_ns(), 1.0).pixels, pixels)

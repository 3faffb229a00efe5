"""The test's side of fake_v4l2.c: builds it, and switches what the camera sees and suffers."""

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).parent / "fake_v4l2.c"
NAMES = """width height bits period_ns latency_ns jitter_ns dropped_per_1000 stalled unplugged busy stamp lies seed
exposed lights forbidden late_every late_ns zero_every error_every short_every jump_every jump_by eio_every eagain_every
broken burst line_padding interlaced first_sequence stuck no_room buffers_least buffers_most clamps auto_stays creeps
control_latency all_formats open_error query_error capabilities mapped dropped new_kind responds patient""".split()  # noqa: SIM905
"""As in the enumeration of the C source."""
FIRST_LIGHT, RING = 64, 1024
START_OF_EXPOSURE, END_OF_FRAME, UNKNOWN_CLOCK = range(3)


def build(folder: Path) -> Path:
    """Compile the camera; returns what LD_PRELOAD wants."""
    library = folder / "fake_v4l2.so"
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl", "-lpthread"], check=True)
    return library


class FakeDevice:
    """The device node `node` (put its path into FAKE_V4L2 before the first open) and what is behind it."""

    def __init__(self, node: Path, width: int = 64, height: int = 48, bits: int = 12, period_ms: float = 10.0) -> None:
        self.node = node
        length = FIRST_LIGHT + 2 * RING
        node.unlink(missing_ok=True)
        os.mknod(node)  # not opened, for the camera would answer
        self._state = np.memmap(f"{node}.state", np.int64, "w+", shape=(length,))
        for name, value in (("width", width), ("height", height), ("bits", bits), ("period_ns", period_ms * 1e6)):
            self.set(name, int(value))
        self.set("seed", 1)

    def set(self, name: str, value: int) -> None:
        self._state[NAMES.index(name)] = value

    def get(self, name: str) -> int:
        return int(self._state[NAMES.index(name)])

    def light(self, lit_ns: int, number: int) -> None:
        """From `lit_ns` on, light `number` (16 bits) is on; odd ones are bright."""
        count = self.get("lights")
        place = FIRST_LIGHT + 2 * (count % RING)
        self._state[place : place + 2] = lit_ns, number
        self.set("lights", count + 1)

    def unplug(self) -> None:
        self.set("unplugged", 1)
        self.node.unlink()

    def plug_in(self) -> None:
        self.set("unplugged", 0)
        os.mknod(self.node)


def lights(pixels: np.ndarray, bits: int) -> tuple[int, int]:
    """Numbers of the lights that were on at the start and at the end of a frame's exposure."""
    rows, columns = pixels.shape
    centres = (np.arange(16) * 2 + 1) * columns // 32
    bright = pixels[[rows // 8, 3 * rows // 8]][:, centres] > 2 ** (bits - 1)
    start, end = (int(sum(1 << i for i, bit in enumerate(row) if bit)) for row in bright)
    return start, end


@dataclass(frozen=True)
class Shown:
    """What a frame tells about itself: numbers of the lights, frame's number in its first and last row, settings."""

    start: int
    end: int
    first: int
    last: int
    gain: int
    exposure_ms: float

    @property
    def torn(self) -> bool:
        """Whether its halves are of two frames."""
        return self.first != self.last


def shown(pixels: np.ndarray, bits: int) -> Shown:
    """All that a frame tells about itself."""
    rows, columns = pixels.shape
    at = [0, rows // 8, 3 * rows // 8, rows - 3, rows - 2, rows - 1]
    bright = pixels[at][:, (np.arange(16) * 2 + 1) * columns // 32] > 2 ** (bits - 1)
    first, start, end, ticks, gain, last = (bright @ (1 << np.arange(16))).tolist()
    return Shown(start, end, first, last, gain, round(ticks / 10, 6))


def preloaded(library: Path, node: Path) -> dict[str, str]:
    """The environment of a process that finds the camera at `node`."""
    return {**os.environ, "LD_PRELOAD": str(library), "FAKE_V4L2": str(node)}

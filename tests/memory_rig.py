"""A small honest rig in memory: what the projector shows, the camera sees, darkened by what the doser delivered.

Faults can be switched on; the doser's count lives in a file, outside of the process, as a real doser's does.
"""

import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tankrig.bench import Bench
from tankrig.devices import CameraSettings, Delivered, Flip, Frame
from tankrig.dosing import DoseLimits
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.run.rig import Rig
from tankrig.scene.description import Camera, Tank
from tankrig.sequence import Pace

SHAPE = (24, 36)
BENCH = Bench(
    Tank(), Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", SHAPE, pixel_mm=6.0)
)


@dataclass
class MemoryProjector:
    latency_s: float = 0.0
    name: str = "projector in memory"
    shape: tuple[int, int] = BENCH.wall.shape
    shown: list[tuple[int, Pattern]] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    closed: bool = False

    def show(self, pattern: Pattern) -> Flip:
        self.log.append(f"show {pattern.name}")
        now = time.monotonic_ns()
        bound = now + int(self.latency_s * 1e9)
        self.shown.append((bound, pattern))
        return Flip(now, bound, pattern.hash)

    def level_at(self, time_ns: int) -> float:
        lit = [pattern for since, pattern in self.shown if since < time_ns]
        return float(lit[-1].pixels.mean()) if lit else 0.0

    def close(self) -> None:
        self.closed = True


@dataclass
class MemoryCamera:
    """Its frames' mean tells the pattern; exposures follow each other without a break."""

    projector: MemoryProjector
    doser: "FileDoser"
    name: str = "camera in memory"
    shape: tuple[int, int] = SHAPE
    saturation: int = 4095
    mixing_s: float = 0.0
    frame_s: float = 0.0
    drop: set[int] = field(default_factory=set)
    early: bool = False
    hang: threading.Event | None = None
    sequence: int = 0
    configured: list[CameraSettings] = field(default_factory=list)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self.configured.append(settings)
        return settings

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        if self.hang is not None and not self.hang.wait(timeout_s):
            raise DeviceError(f"{self.name}: gave no frame for {timeout_s:g} s; check its cable")
        start = max(after_ns + 1, time.monotonic_ns())
        time.sleep(max(0.0, (start - time.monotonic_ns()) / 1e9) + self.frame_s)
        while self.sequence in self.drop:
            self.sequence += 1
        frame = Frame(self.picture(start), start - 10**9 * self.early, start + 7, time.monotonic_ns(), self.sequence)
        self.sequence += 1
        return frame

    def picture(self, time_ns: int) -> np.ndarray:
        level = 100 + 10 * self.projector.level_at(time_ns)
        ramp = np.linspace(1.0, 0.5, SHAPE[1])
        picture = level * ramp * np.ones(SHAPE)
        if self.mixing_s and self.doser.moved_ns:
            x, y = np.linspace(-2, 2, SHAPE[1]), np.linspace(-2, 2, SHAPE[0])[:, None]
            since_s = (time_ns - self.doser.moved_ns) / 1e9
            picture *= 1 + np.exp(-(x**2) - y**2 - since_s / self.mixing_s)
        return np.round(picture).astype(np.uint16)

    def close(self) -> None:
        if self.hang is not None:
            self.hang.set()


class FileDoser:
    """Counts µl in a file, one by one; the file is what really went into the tank."""

    def __init__(self, file: Path, ul_per_s: float = 1e5) -> None:
        self.name, self.identity, self.increment_ul = "doser in a file", "file-doser 1", 1.0
        self._file, self._pause_s = file, 1.0 / ul_per_s
        self._stop = threading.Event()
        self.log: list[str] = []
        self.fault: str | None = None
        self.moved_ns = 0
        self.moving = threading.Event()
        if not file.exists():
            file.write_text("0")

    @property
    def count_ul(self) -> int:
        return int(self._file.read_text() or 0)

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    @property
    def unknown(self) -> bool:
        return self.fault == "unknown"

    def dose_to(self, total_ul: float) -> Delivered:
        self.log.append(f"dose {total_ul:g}")
        handle = os.open(self._file, os.O_WRONLY)
        try:
            while self.count_ul < int(total_ul):
                if self._stop.is_set() or self.fault:
                    raise DeviceError(
                        f"{self.name}: stopped at {self.count_ul} µl on the way to {total_ul:g} µl; clear it"
                    )
                os.pwrite(handle, str(self.count_ul + 1).encode(), 0)
                self.moved_ns = time.monotonic_ns()
                self.moving.set()
                if self._pause_s > 1e-4:
                    self._stop.wait(self._pause_s)
        finally:
            os.close(handle)
            self.moving.clear()
        return self.delivered()

    def delivered(self) -> Delivered:
        return Delivered(*[float(self.count_ul)] * 3)

    def stop(self) -> None:
        self.log.append("stop")
        self._stop.set()

    def clear_stop(self) -> None:
        self.log.append("clear")
        self._stop.clear()

    def resolve(self, volume_ul: float) -> None:
        self.log.append(f"resolve {volume_ul:g}")
        self.fault = None

    def close(self) -> None:
        self.log.append("close")
        self._stop.set()


def memory_rig(folder: Path, ul_per_s: float = 1e5, **limits: float) -> Rig:
    """A rig whose doser and ledger live in `folder`."""
    projector, doser = MemoryProjector(), FileDoser(folder / "doser.count", ul_per_s)
    return Rig(
        "memory",
        projector,
        MemoryCamera(projector, doser),
        doser,
        BENCH,
        DoseLimits(**({"dose_ul": 500.0, "run_ul": 2000.0, "tank_ul": 3000.0} | limits)),
        folder / "tank.ledger",
        Pace(flip_s=0.0, dose_ul_per_s=ul_per_s, mixing_s=1.0),
    )

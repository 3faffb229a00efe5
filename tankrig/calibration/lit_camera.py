"""A camera looking at even light of the projector: frames at a level, an exposure and a gain, with a look at each."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tankrig.devices import CameraDevice, CameraSettings, Pixels, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

_PATIENCE_S = 5.0


@dataclass(frozen=True, eq=False)
class Look:
    """How a calibration is getting on; for people.

    Parameters
    ----------
    doing
        In words.
    done
        Part of all.
    filled
        Brightest part of the last frame over saturation, hot pixels left aside.
    saturated
        Part of its pixels.
    pixels
        Of the last frame; None where it was not looked at.
    """

    doing: str
    done: float
    filled: float = 0.0
    saturated: float = 0.0
    pixels: Pixels | None = None


class LitCamera:
    """Takes frames and tells of each.

    Parameters
    ----------
    projector, camera
        Open.
    tell
        Called after each frame; what it raises ends the calibration.
    """

    def __init__(self, projector: Projector, camera: CameraDevice, tell: Callable[[Look], object]) -> None:
        self.camera, self._projector, self._tell = camera, projector, tell
        self._level: int | None = None
        self._after_ns = 0
        self._asked = self._settings = CameraSettings(0.0)
        self.doing, self.done = "", 0.0

    def show(self, level: int) -> None:
        """Fill the projector's picture with a level."""
        if level != self._level:
            pattern = Pattern(f"level {level}", np.full(self._projector.shape, level, np.uint8))
            self._after_ns = self._projector.show(pattern).bound_ns
            self._level = level

    def look_anew(self) -> None:
        """What was before the lens has changed: no frame counts that was exposed before now."""
        self._after_ns = time.monotonic_ns()

    def settings(self, exposure_ms: float, gain: float) -> CameraSettings:
        """Set the camera; as read back.

        Raises
        ------
        DeviceError
            When it cannot be set to within 5 %.
        """
        wanted = CameraSettings(exposure_ms, gain)
        if self._asked != wanted:
            self._settings = self.camera.configure(wanted)
            for name in ("exposure_ms", "gain"):
                asked, got = getattr(wanted, name), getattr(self._settings, name)
                if abs(got / asked - 1.0) > 0.05:
                    raise DeviceError(
                        f"{self.camera.name}: set {name} to {got:g} rather than {asked:g}; ask for others"
                    )
        return self._settings

    def frames(self, level: int, exposure_ms: float, gain: float, count: int) -> tuple[list[Pixels], CameraSettings]:
        """Take frames; and their settings as read back."""
        settings = self.settings(exposure_ms, gain)
        self.show(level)
        taken: list[Pixels] = []
        for _ in range(count):
            frame = self.camera.capture(self._after_ns, 2e-3 * settings.exposure_ms + _PATIENCE_S)
            self._after_ns = max(self._after_ns, frame.exposure_start_ns)
            taken.append(frame.pixels)
            filled, saturated = self.filled(frame.pixels), self._saturated(frame.pixels)
            self._tell(Look(self.doing, self.done, filled, saturated, frame.pixels))
        return taken, settings

    def filled(self, pixels: Pixels) -> float:
        """Brightest part of a frame over saturation, the brightest hundredth of the pixels left aside."""
        return float(np.quantile(pixels, 0.99)) / self.camera.saturation

    def _saturated(self, pixels: Pixels) -> float:
        return float((pixels >= self.camera.saturation).mean())

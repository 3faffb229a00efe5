"""Pictures of a board: exposed to suit it, and one of each pattern that is thrown on it."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from tankrig.devices import CameraDevice, CameraSettings, Confirming, Pixels, Projector
from tankrig.pattern import Pattern

_FILLED = 0.75
"""Of the range, where a picture's brightest part should be."""
_PATIENCE_S = 5.0
_LONGEST_MS = 500.0


class Pictures:
    """Takes pictures with a camera, none of them older than what it was asked for.

    Parameters
    ----------
    camera
        Open.
    exposure_ms
        Of all pictures; None: what suits the first one after each `suit`.

    Attributes
    ----------
    settings
        Of the next picture, as read back.
    """

    def __init__(self, camera: CameraDevice, exposure_ms: float | None = None) -> None:
        self.camera, self._fixed = camera, exposure_ms is not None
        self.settings = camera.configure(CameraSettings(exposure_ms or 20.0))

    def take(self, after_ns: int | None = None) -> Pixels:
        """A picture exposed after a time, or after now."""
        timeout_s = 2e-3 * self.settings.exposure_ms + _PATIENCE_S
        return self.camera.capture(time.monotonic_ns() if after_ns is None else after_ns, timeout_s).pixels

    def suit(self) -> Pixels:
        """Set the exposure so that the brightest part is bright and not saturated, and take a picture with it."""
        picture = self.take()
        for _ in range(6):
            filled = float(np.quantile(picture, 0.995)) / self.camera.saturation
            exposure_ms = self.settings.exposure_ms
            wanted_ms = min(exposure_ms * (_FILLED / max(filled, 0.02) if filled < 0.97 else 0.3), _LONGEST_MS)
            if self._fixed or abs(wanted_ms / exposure_ms - 1.0) < 0.15:
                break
            self.settings = self.camera.configure(CameraSettings(wanted_ms))
            if self.settings.exposure_ms == exposure_ms:
                break  # as far as it goes
            picture = self.take()
        return picture

    def of_patterns(
        self, projector: Projector, patterns: Sequence[Pattern], tell: Callable[[int], object] = lambda _: None
    ) -> list[Pixels]:
        """One picture of each pattern; `tell` hears how many there are."""
        taken = []
        for pattern in patterns:
            flip = projector.show(pattern)
            taken.append(self.take(flip.bound_ns))
            if isinstance(projector, Confirming):
                projector.confirm()
            tell(len(taken))
        return taken

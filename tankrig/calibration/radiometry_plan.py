"""What the radiometric calibration photographs, and how long that takes."""

from dataclasses import dataclass

import numpy as np

from tankrig.calibration.response import LEVELS
from tankrig.errors import CalibrationError, DeviceError

CHECKED_LEVELS = (22, 38, 92, 140, 188, 236)
"""Measured besides, and left out of the fit of the response: what it predicts there is its error."""
REFERENCE_EVERY = 8
"""Levels between two looks at level 255, which tell how the lamp drifts."""
HANDLING_S = 30.0
"""To put a cap or a diffuser before the lens."""


class ExposuresError(DeviceError):
    """Light that a plan's exposures do not suit: the sentence says in words which should be others.

    Parameters
    ----------
    sentence
        What is wrong, and what to do.
    settings
        Names of those exposures in `RadiometryPlan`, for whoever lets a person set them.
    """

    def __init__(self, sentence: str, *settings: str) -> None:
        super().__init__(sentence)
        self.settings = settings


@dataclass(frozen=True)
class RadiometryPlan:
    """Exposures and numbers of frames.

    Parameters
    ----------
    gains
        Of the camera; the first is that of the flat and of the projector's response.
    shortest_ms, longest_ms
        Exposures of the sweep, whose ratio should be 100 and more.
    period_ms
        Exposures are whole numbers of it, since a projector's light is steady only over whole periods; 0 for any.
    steps
        Exposures of the sweep.
    sweep_frames, dark_frames, flat_frames
        At each; the sweep goes up with half of its frames and down with the other.
    """

    gains: tuple[float, ...] = (1.0,)
    shortest_ms: float = 1000.0 / 60.0
    longest_ms: float = 2000.0
    period_ms: float = 1000.0 / 60.0
    steps: int = 24
    sweep_frames: int = 4
    dark_frames: int = 8
    flat_frames: int = 16

    def __post_init__(self) -> None:
        if not (0.0 < self.shortest_ms < self.longest_ms and self.longest_ms >= 20.0 * self.shortest_ms):
            raise CalibrationError(
                f"exposures from {self.shortest_ms:g} to {self.longest_ms:g} ms are no sweep; let the longest be 100 "
                f"times the shortest"
            )
        if not self.gains or min(self.gains) <= 0.0:
            raise CalibrationError(f"gains {list(self.gains)} cannot be set; give positive numbers")

    @property
    def exposures_ms(self) -> tuple[float, ...]:
        """Of the sweep, rising.

        >>> RadiometryPlan(shortest_ms=10.0, longest_ms=1000.0, period_ms=10.0, steps=5).exposures_ms
        (10.0, 30.0, 100.0, 320.0, 1000.0)
        """
        times = np.geomspace(self.shortest_ms, self.longest_ms, self.steps)
        if self.period_ms > 0.0:
            times = np.maximum(np.round(times / self.period_ms), 1.0) * self.period_ms
        return tuple(np.unique(np.round(times, 6)).tolist())

    @property
    def dark_exposures_ms(self) -> tuple[float, ...]:
        """Some of them: the shortest, the longest, and between."""
        times = self.exposures_ms
        return tuple(times[round(part * (len(times) - 1))] for part in (0.0, 0.5, 0.75, 0.9, 1.0))

    @property
    def seconds(self) -> float:
        """On the bench, handling included.

        >>> round(RadiometryPlan().seconds / 60.0)
        6
        """
        each_gain = self.dark_frames * sum(self.dark_exposures_ms) + self.sweep_frames * sum(self.exposures_ms)
        levels = len(LEVELS) + len(CHECKED_LEVELS)
        response = 2 * levels * (1.0 + 1.0 / REFERENCE_EVERY) * 0.6 * self.longest_ms
        flats = 2 * self.flat_frames * 0.1 * self.longest_ms
        return 4 * HANDLING_S + (len(self.gains) * each_gain + response + flats) / 1000.0

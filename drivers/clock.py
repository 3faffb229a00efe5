"""Time as the drivers of pumps know it, so that another clock can stand in for this computer's."""

import threading
import time
from dataclasses import dataclass
from typing import Protocol


class Clock(Protocol):
    """What a driver that waits needs to know of time; all in seconds of the device."""

    @property
    def scale(self) -> float:
        """Seconds of this computer in a second of the device (tests with a fast stand-in)."""

    def monotonic(self) -> float:
        """Time since some moment."""

    def sleep(self, duration_s: float) -> None:
        """Let so much time pass."""

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait for `event`, no longer than that; whether it is set."""


@dataclass(frozen=True)
class SystemClock:
    """The clock of this computer.

    Parameters
    ----------
    scale
        All waits are multiplied by this.

    Examples
    --------
    >>> clock = SystemClock(scale=0.01)
    >>> begun = clock.monotonic()
    >>> clock.sleep(1.0)
    >>> 1.0 <= clock.monotonic() - begun
    True
    """

    scale: float = 1.0

    def monotonic(self) -> float:
        """Time since some moment, s."""
        return time.monotonic() / self.scale

    def sleep(self, duration_s: float) -> None:
        """Let so much time pass."""
        time.sleep(duration_s * self.scale)

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait for `event`, no longer than that; whether it is set."""
        return event.wait(timeout_s * self.scale)

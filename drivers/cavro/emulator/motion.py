"""How a plunger moves: start speed, ramp, top speed, ramp, cutoff speed (manual 733085-B, appendix B.2)."""

import math
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Stroke:
    """One plunger move, in the pulses that the speeds count.

    Parameters
    ----------
    start_s
        When it sets off.
    pulses
        How far.
    start, top, cutoff
        Speeds, pulses/s. Start and cutoff above the top speed are as good as equal to it.
    slope
        Of both ramps, pulses/s².
    """

    start_s: float
    pulses: float
    start: float
    top: float
    cutoff: float
    slope: float

    @property
    def _first(self) -> float:
        return min(self.start, self.top)

    @property
    def _last(self) -> float:
        return min(self.cutoff, self._peak)

    @cached_property
    def _peak(self) -> float:
        """The fastest that this move becomes; the manual's cases 1 and 2, 4, and 3."""
        first, cutoff = self._first, min(self.cutoff, self.top)
        ramps = (2 * self.top**2 - first**2 - cutoff**2) / (2 * self.slope)
        if ramps <= self.pulses:
            return self.top
        both = math.sqrt(self.slope * self.pulses + (first**2 + cutoff**2) / 2)
        return both if both > cutoff else max(first, math.sqrt(2 * self.slope * self.pulses + first**2))

    @property
    def ramped(self) -> bool:
        """Whether its speed changes on the way."""
        return not self._first == self._peak == self._last

    @property
    def duration_s(self) -> float:
        """From rest to rest.

        The manual's examples of its cases 1 to 4:

        >>> round(Stroke(0, 6000, 900, 900, 900, 35000).duration_s, 2)
        6.67
        >>> round(Stroke(0, 6000, 50, 5800, 500, 35000).duration_s, 3)  # the manual adds rounded parts to 1.18
        1.185
        >>> round(Stroke(0, 10, 50, 5800, 900, 35000).duration_s, 3)
        0.023
        >>> round(Stroke(0, 700, 50, 5800, 900, 35000).duration_s, 2)
        0.26
        """
        up_s, flat_s, down_s = self._phases
        return up_s + flat_s + down_s

    @cached_property
    def _phases(self) -> tuple[float, float, float]:
        peak = self._peak
        up_s, down_s = (peak - self._first) / self.slope, (peak - self._last) / self.slope
        ramps = ((peak + self._first) * up_s + (peak + self._last) * down_s) / 2
        return up_s, max(0.0, self.pulses - ramps) / peak, down_s

    def made(self, now_s: float) -> float:
        """Pulses made by `now_s`."""
        up_s, flat_s, down_s = self._phases
        t = now_s - self.start_s
        if t <= 0.0:
            return 0.0
        if t >= up_s + flat_s + down_s:
            return self.pulses
        up = min(t, up_s)
        down = max(0.0, t - up_s - flat_s)
        flat = t - up - down
        peak = self._peak
        return min(
            self.pulses,
            up * (self._first + 0.5 * self.slope * up) + flat * peak + down * (peak - 0.5 * self.slope * down),
        )

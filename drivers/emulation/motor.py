"""A stepper on its way from rest to rest."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Move:
    """So many steps from rest to rest, speeding up and slowing down steadily, no faster than `rate`.

    Parameters
    ----------
    start_s
        When it sets off.
    steps
        How far.
    rate
        Highest speed, steps/s.
    acceleration
        Steps/s², both ways.
    """

    start_s: float
    steps: int
    rate: float
    acceleration: float

    def made(self, now_s: float) -> int:
        """Steps commanded by `now_s`.

        >>> move = Move(start_s=0.0, steps=100, rate=100.0, acceleration=1000.0)
        >>> [move.made(t) for t in (0.0, 0.1, 0.5, 1.0, 1.1, 9.0)]
        [0, 5, 45, 95, 100, 100]
        """
        peak = min(self.rate, math.sqrt(self.steps * self.acceleration))
        ramp_s = peak / self.acceleration
        whole_s = self.steps / peak + ramp_s if peak else 0.0
        t = now_s - self.start_s
        if t <= 0.0:
            return 0
        if t >= whole_s:
            return self.steps
        if t < ramp_s:
            done = 0.5 * self.acceleration * t**2
        elif t < whole_s - ramp_s:
            done = peak * (t - 0.5 * ramp_s)
        else:
            done = self.steps - 0.5 * self.acceleration * (whole_s - t) ** 2
        return min(self.steps, math.floor(done + 1e-9))

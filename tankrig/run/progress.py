"""How far a run is, and how long it will still take."""

import time
from dataclasses import dataclass

from tankrig.sequence import DryRun


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
    step, steps
        Steps done, and in all.
    label
        The step under way, in words.
    waiting_for
        What it waits for, in words.
    remaining_s
        Estimate of what is left.
    """

    step: int
    steps: int
    label: str
    waiting_for: str
    remaining_s: float


class ProgressEstimator:
    """Estimates the time that is left from the dry run, corrected by how long steps of each kind really took."""

    def __init__(self, plan: DryRun, first: int) -> None:
        self._plan = plan
        self._step = first
        self._began_s = time.monotonic()
        self._took_s: dict[type, tuple[float, float]] = {}
        self.waiting_for = ""

    def begin(self, step: int) -> None:
        """Step number `step` begins."""
        self._step, self._began_s = step, time.monotonic()

    def done(self, kind: type) -> None:
        """The step, of this kind, is done."""
        real_s, planned_s = self._took_s.get(kind, (0.0, 0.0))
        planned_s += self._plan.steps[self._step].seconds
        self._took_s[kind] = (real_s + time.monotonic() - self._began_s, planned_s)
        self._step += 1
        self._began_s = time.monotonic()

    def progress(self) -> Progress:
        """How far the run is now."""
        steps = self._plan.steps
        left_s = [step.seconds * self._pace(step.kind) for step in steps[self._step :]]
        if left_s:
            left_s[0] = max(0.0, left_s[0] - (time.monotonic() - self._began_s))
        label = steps[self._step].label if left_s else "all steps are done"
        return Progress(self._step, len(steps), label, self.waiting_for, sum(left_s))

    def _pace(self, kind: type) -> float:
        real_s, planned_s = self._took_s.get(kind, (0.0, 0.0))
        return real_s / planned_s if planned_s > 0.0 else 1.0

"""Time to the same error: what the tank model takes and reaches at 1 %, and what simulators take to get there.

A simulator's error falls with the root of its samples and its time grows in proportion to them, so a few short runs
tell what a long one would take.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tankrig.benchmark.result import Result

CLEAR = 0.25
"""Share of the reference's noise below which an error net of that noise isn't told from 0."""


@dataclass(frozen=True)
class Equal:
    """What a simulator takes for the error that the tank model reaches.

    Parameters
    ----------
    case, model
        Names of the case and of the simulator.
    error
        Relative L2 error that both reach.
    seconds, cpu_seconds
        What the simulator takes.
    slower
        Its CPU seconds over the tank model's at 1 %.
    extrapolated
        Over how many times its longest run this was extrapolated, in samples; 1 or less where a run was as long.
    """

    case: str
    model: str
    error: float
    seconds: float
    cpu_seconds: float
    slower: float
    extrapolated: float


def at_equal_error(results: Sequence[Result], tolerance: float = 0.01) -> tuple[Equal, ...]:
    """Compare every simulator that has run with the tank model at `tolerance`, case by case.

    Notes
    -----
    error = c N^−½ is fitted to a simulator's runs by the mean of their logarithms, and time = t₀ + k N goes through the
    shortest and the longest. The error aimed at is the tank model's, net of the reference's noise, but not less than a
    quarter of that noise.
    """
    found = []
    for case in dict.fromkeys(one.case for one in results):
        here = [one for one in results if one.case == case]
        tank = [one for one in here if one.model == "tank" and one.tolerance == tolerance]
        if not tank:
            continue
        aim = max(tank[0].error, CLEAR * tank[0].noise)
        for model in dict.fromkeys(one.model for one in here if one.samples is not None):
            runs = sorted((one.samples or 0, one) for one in here if one.model == model and one.error > 0.0)
            if not runs:
                continue
            samples = np.array([count for count, _ in runs], float)
            constant = np.exp(np.mean([np.log(one.error) + 0.5 * np.log(count) for count, one in runs]))
            needed = float((constant / aim) ** 2)
            seconds, cpu = (
                _line(samples, np.array([getattr(one, name) for _, one in runs]), needed)
                for name in ("seconds", "cpu_seconds")
            )
            found.append(Equal(case, model, aim, seconds, cpu, cpu / tank[0].cpu_seconds, needed / float(samples[-1])))
    return tuple(found)


def _line(samples: np.ndarray, times: np.ndarray, needed: float) -> float:
    """Time of `needed` samples on the line through the shortest and the longest run; in proportion where there is one.

    Examples
    --------
    >>> _line(np.array([10.0, 100.0]), np.array([1.2, 3.0]), 1000.0)
    21.0
    """
    if samples.size == 1 or times[-1] <= times[0]:
        return float(times[-1] * needed / samples[-1])
    slope = (times[-1] - times[0]) / (samples[-1] - samples[0])
    return float(max(times[0] - slope * samples[0], 0.0) + slope * needed)

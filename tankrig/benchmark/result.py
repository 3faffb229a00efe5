"""What a contestant made of a case: its error, and what it took."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """One contestant on one case.

    Parameters
    ----------
    case
        Its name.
    label, model, tolerance, samples
        Of the contestant.
    error
        Relative L2 error net of the reference's noise.
    noise
        Relative L2 of that noise; errors well below it cannot be told from 0.
    light
        Sum of the image over that of the reference.
    seconds, cpu_seconds
        Median over the repeated trials.
    peak_mib
        Largest resident memory of any trial.
    """

    case: str
    label: str
    model: str
    tolerance: float | None
    samples: int | None
    error: float
    noise: float
    light: float
    seconds: float
    cpu_seconds: float
    peak_mib: float

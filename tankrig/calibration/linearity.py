"""Whether twice the light gives twice the counts, and the correction that makes it so, from an exposure sweep."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.exposed import MOST_SATURATED, Array, Exposed
from tankrig.errors import ImageError

MOST_TERMS = 5
LEAST_POINTS = 8
DECADES = 2.0
"""Range over which the error is stated."""
_GROUPS = 8


@dataclass(frozen=True)
class Linearity:
    """Counts above the dark, made proportional to light: linear = S · (1 + c₁ u + c₂ u² + …), u = S / full.

    Parameters
    ----------
    full
        Highest counts above the dark for which it holds.
    coefficients, coefficients_sd
        c₁, c₂, …
    error
        Largest relative deviation from a straight line, within `DECADES` below `full`, at exposures that were left out
        of the fit.
    decades
        Range of the sweep.

    Examples
    --------
    >>> bent = Linearity(1000.0, (0.1,), (0.0,), 0.0, 2.0)
    >>> bent.linear(np.array([500.0, 1000.0])).tolist()
    [525.0, 1100.0]
    >>> bent.slope(np.array([0.0, 1000.0])).tolist()
    [1.0, 1.2]
    """

    full: float
    coefficients: tuple[float, ...]
    coefficients_sd: tuple[float, ...]
    error: float
    decades: float

    def linear(self, signal: Array) -> Array:
        """Counts above the dark, corrected; beyond `full` by the correction at `full`."""
        filled, factor = np.minimum(signal * (1.0 / self.full), 1.0), np.zeros_like(signal)
        for coefficient in reversed(self.coefficients):  # Horner, in the precision of the signal
            factor += coefficient
            factor *= filled
        factor += 1.0
        factor *= signal
        return factor

    def slope(self, signal: Array) -> Array:
        """Derivative of `linear`, by which noise is stretched."""
        filled = np.clip(signal / self.full, 0.0, 1.0)
        terms = [(power + 1) * value for power, value in enumerate((1.0, *self.coefficients))]
        return np.asarray(np.polynomial.polynomial.polyval(filled, terms))


def fit_linearity(sweep: Sequence[Exposed], good: NDArray[np.bool_]) -> Linearity:
    """Fit an exposure sweep of steady light.

    Pixels are taken together in groups of like brightness, so that vignetting does not blur the curve. For each group
    linear(S) = a · exposure with an unknown brightness a: linear least squares in the coefficients and all a at once.

    Parameters
    ----------
    sweep
        Above the dark; exposures with saturated pixels are left out.
    good
        (rows, columns) pixels to use.

    Raises
    ------
    ImageError
        When fewer than eight exposures are left, or they span less than a factor of ten.
    """
    usable = sorted((one for one in sweep if one.saturated <= MOST_SATURATED), key=lambda one: one.exposure_ms)
    if len(usable) < LEAST_POINTS:
        raise ImageError(
            f"{len(usable)} of {len(sweep)} exposures of the sweep are not saturated, and {LEAST_POINTS} are needed; "
            f"take shorter ones, or darken the light"
        )
    times, signals, sd = _grouped(usable, good)
    decades = float(np.log10(signals[-1].mean() / max(signals[0].mean(), 1e-9)))
    if not decades >= 1.0:
        raise ImageError(f"the sweep spans a factor of {10**decades:.2g} in counts; vary the exposure by 100 and more")
    full = float(signals.max())
    errors = [_left_out_error(times, signals, sd, full, terms) for terms in range(1, MOST_TERMS + 1)]
    # The fewest terms that predict what was left out about as well as any number does.
    terms = 1 + next(index for index, error in enumerate(errors) if error <= 1.25 * min(errors))
    found, covariance = _solve(times, signals, sd, full, terms)
    error = errors[terms - 1]
    spread = np.sqrt(np.diag(covariance))
    return Linearity(full, tuple(found.tolist()), tuple(spread.tolist()), error, decades)


def _grouped(usable: Sequence[Exposed], good: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Exposures, (exposures, groups) mean counts and their standard deviations."""
    order = np.argsort(usable[-1].mean[good])
    groups = np.array_split(order, _GROUPS)
    means = np.array([[one.mean[good][group].mean() for group in groups] for one in usable])
    variances = np.array([[one.variance[good][group].mean() for group in groups] for one in usable])
    frames = np.array([one.frames for one in usable])[:, None]
    sizes = np.array([len(group) for group in groups])
    return np.array([one.exposure_ms for one in usable]), means, np.sqrt(variances / (frames * sizes))


def _solve(times: Array, signals: Array, sd: Array, full: float, terms: int) -> tuple[Array, Array]:
    """Coefficients and their covariance.

    Weighted by what a point is known to, of which 0.05 % is left to the light's own unsteadiness. The unknown
    brightness of each group is eliminated by hand: its best value is a weighted mean.
    """
    weights = 1.0 / np.hypot(sd, 5e-4 * signals)
    design = signals[..., None] * (signals[..., None] / full) ** np.arange(1, terms + 1)
    rows, rests = [], []
    for group in range(signals.shape[1]):
        line = (weights[:, group] * times) / np.linalg.norm(weights[:, group] * times)
        row = design[:, group] * weights[:, group, None]
        rest = signals[:, group] * weights[:, group]
        rows.append(row - np.outer(line, line @ row))
        rests.append(rest - line * (line @ rest))
    matrix, rest = np.concatenate(rows), np.concatenate(rests)
    found = np.linalg.lstsq(matrix, -rest, rcond=None)[0]
    chi2 = float(np.sum((matrix @ found + rest) ** 2)) / max(matrix.shape[0] - terms - signals.shape[1], 1)
    return found, np.linalg.inv(matrix.T @ matrix) * max(chi2, 1.0)


def _left_out_error(times: Array, signals: Array, sd: Array, full: float, terms: int) -> float:
    """Fit every other exposure, and see how the rest deviates from a straight line; then the other way round.

    The longest and the shortest are always fitted: the curve is not asked to hold beyond them.
    """
    worst = 0.0
    numbers = np.arange(len(times))
    for odd in (0, 1):
        left_out = (numbers % 2 == odd) & (numbers > 0) & (numbers < len(times) - 1)
        kept = ~left_out
        found, _ = _solve(times[kept], signals[kept], sd[kept], full, terms)
        curve = Linearity(full, tuple(found.tolist()), (), 0.0, 0.0)
        linear = curve.linear(signals) / times[:, None]
        weights = 1.0 / np.hypot(sd[kept] / signals[kept], 5e-4) ** 2
        brightness = np.sum(weights * linear[kept], axis=0) / weights.sum(axis=0)
        ratio = (linear / brightness).mean(axis=1) - 1.0
        wanted = left_out & (signals.mean(axis=1) > full * 10.0**-DECADES)
        worst = max(worst, float(np.abs(ratio[wanted]).max(initial=0.0)))
    return worst

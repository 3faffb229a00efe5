"""Intervals where the image bends: how far the profile likelihood reaches beyond, or short of, a normal error.

Along the ridge of one coefficient the others follow as the covariance says; the image is computed anew at both ends of
the normal interval, and what the other coefficients, gain, offset and misalignments could still take back of the change
is taken back in the linear model. The root of the profile deviance over its linear value is the factor by which the
interval is too wide. Where the response is straight the factor is 1 and nothing is computed.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.parameters import NAMES
from tankrig.scene import Medium

Array = NDArray[np.float64]

END = 1.96
"""Standard deviations at which the image is computed."""
BENT = (0.1, 0.1, 0.05)
"""Half widths of σa and σs (of themselves) and of g from which on an interval may be bent."""
STRETCH = (0.5, 3.0)
"""Smallest and largest factor believed."""


def stretches(
    medium: Medium,
    spread: Array,
    residual: Array,
    changes: Array,
    changed: Callable[[Medium], Array],
) -> dict[str, tuple[float, float]]:
    """Factors of the half widths below and above each coefficient.

    Parameters
    ----------
    medium
        The optimum.
    spread
        (3, 3) covariance.
    residual
        (n,) at the optimum, in standard deviations.
    changes
        (k, n) derivatives of the fitted image, likewise, less what gain and offset imitate; σa, σs and g come first.
    changed
        (n,) of the same, between another medium and the optimum.
    """
    best = np.array([medium.sigma_a, medium.sigma_s, medium.g])
    sd = np.sqrt(np.diag(spread))
    size = np.array([max(medium.sigma_a, 1e-12), max(medium.sigma_s, 1e-12), 1.0])
    found = {}
    for k, name in enumerate(NAMES):
        if END * sd[k] <= BENT[k] * size[k]:
            continue
        others = np.linalg.qr(np.delete(changes, k, 0).T)[0]
        left = residual - others @ (others.T @ residual)
        straight = changes[k] - others @ (others.T @ changes[k])
        factors = []
        for side in (-1.0, 1.0):
            step = side * END * spread[k] / sd[k]
            by = min(1.0, *_rooms(best, step))
            if by < 0.2:  # the edge is nearer than the interval's end
                factors.append(1.0)
                continue
            change = changed(Medium(*(float(value) for value in best + by * step)))
            change -= others @ (others.T @ change)
            deviance = float(change @ change) - 2.0 * float(change @ left)
            linear = float(np.sum((by * step[k] * straight) ** 2)) - 2.0 * float(by * step[k] * (straight @ left))
            factor = np.sqrt(max(linear, 0.0) / max(deviance, 1e-300)) if linear > 0.0 else 1.0
            factors.append(float(np.clip(factor, *STRETCH)))
        found[name] = (factors[0], factors[1])
    return found


def _rooms(best: Array, step: Array) -> list[float]:
    """Shares of a step after which σa, σs or g leaves what is allowed."""
    low, high = np.array([0.0, 1e-9, -0.98]), np.array([np.inf, np.inf, 0.98])
    rooms = []
    for at, by, least, most in zip(best, step, low, high, strict=True):
        edge = least if by < 0.0 else most
        rooms.append(0.98 * (edge - at) / by if by else 1.0)
    return [max(float(room), 0.0) for room in rooms]

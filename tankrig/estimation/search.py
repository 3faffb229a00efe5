"""Least squares with few evaluations: Levenberg–Marquardt whose Jacobian is updated instead of computed anew.

A forward model costs between milliseconds and seconds and its Jacobian, by differences, three more; after each step
Broyden's rank-one update takes the Jacobian along for nothing, and it is computed anew only when a step fails.
scipy's `least_squares` computes it at every accepted step, about three times the evaluations here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Residual = Callable[[Vector], Vector]
Linearise = Callable[[Vector], tuple[Vector, NDArray[np.float64]]]
"""Coordinates to the residual (n,) and its Jacobian (n, k)."""

LONGEST_STEP = np.array([1.0, 2.0, 0.5])
"""In log σs, logit ϖ, atanh g, of one image."""
MOST_REFUSED = 3
"""Steps in a row that may fail with a Jacobian just computed, each ten times shorter: what is left is roughness."""


@dataclass(frozen=True)
class Optimum:
    """Where a search ended: coordinates and half the sum of squared residuals."""

    coordinates: Vector
    cost: float


def minimise(
    residual: Residual,
    linearise: Linearise,
    start: Vector,
    box: tuple[Vector, Vector],
    enough: float,
    most_steps: int = 30,
    longest_step: Vector = LONGEST_STEP,
) -> Optimum:
    """Minimise half the sum of squares of `residual` inside a box.

    Parameters
    ----------
    residual, linearise
        Residual in standard deviations, without and with its Jacobian.
    start
        Where to begin; moved into the box.
    box
        Lowest and highest coordinates.
    enough
        Stop when the linearised problem promises to lower the cost by less than this; 0.005 is a tenth of a standard
        deviation.
    most_steps
        Steps tried at most.
    longest_step
        Of each coordinate; further than this no linearisation is trusted.

    Examples
    --------
    >>> valley = lambda u: np.array([10 * (u[1] - u[0] ** 2), 1 - u[0], u[2] - 0.5])
    >>> slope = lambda u: (valley(u), np.array([[-20 * u[0], 10, 0], [-1, 0, 0], [0, 0, 1.0]]))
    >>> wide = np.full(3, 5.0)
    >>> minimise(valley, slope, np.array([-1.2, 1.0, 0.0]), (-wide, wide), 1e-9, 200).coordinates.round(3).tolist()
    [1.0, 1.0, 0.5]
    """
    at = np.clip(start, *box)
    value, jacobian = linearise(at)
    fresh, damping, refused = True, 1e-2, 0
    for _ in range(most_steps):
        if _promise(value, jacobian, _step(value, jacobian, 0.0, at, box, longest_step)) < enough:
            if fresh:
                break
            value, jacobian = linearise(at)
            fresh = True
            continue
        step = _step(value, jacobian, damping, at, box, longest_step)
        new = residual(at + step)
        if float(new @ new) < float(value @ value):
            jacobian = jacobian + np.outer(new - value - jacobian @ step, step) / float(step @ step)
            at, value, fresh, refused = at + step, new, False, 0
            damping = max(damping / 5.0, 1e-6)
        elif not fresh:
            value, jacobian = linearise(at)
            fresh = True
        elif refused == MOST_REFUSED:
            break
        else:
            damping, refused = 10.0 * damping, refused + 1
    return Optimum(at, 0.5 * float(value @ value))


def _promise(value: Vector, jacobian: NDArray[np.float64], step: Vector) -> float:
    """How much the linearised cost falls along a step."""
    return -float(step @ (jacobian.T @ value)) - 0.5 * float(np.sum((jacobian @ step) ** 2))


def _step(
    value: Vector,
    jacobian: NDArray[np.float64],
    damping: float,
    at: Vector,
    box: tuple[Vector, Vector],
    longest: Vector,
) -> Vector:
    """Damped Gauss–Newton step that stays in the box; a coordinate that would leave it is held and the rest solved."""
    curvature, downhill = jacobian.T @ jacobian, -(jacobian.T @ value)
    scale = np.diag(curvature) + 1e-12 * float(np.trace(curvature)) + 1e-300
    free = np.ones(at.size, bool)
    step = np.zeros(at.size)
    for _ in range(at.size):
        matrix = curvature + (damping + 1e-9) * np.diag(scale)
        step[:] = 0.0
        step[free] = np.linalg.solve(matrix[np.ix_(free, free)], downhill[free])
        outward = free & ((at <= box[0]) & (step < 0.0) | (at >= box[1]) & (step > 0.0))
        if not outward.any():
            break
        free &= ~outward
    step[~free] = 0.0
    step /= max(1.0, float(np.max(np.abs(step) / longest)))
    return np.clip(at + step, box[0], box[1]) - at

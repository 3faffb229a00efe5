"""To the optimum next to some coordinates, with few evaluations of the model.

Steps are Levenberg–Marquardt's with a Jacobian that is updated instead of computed anew. A forward model costs between
milliseconds and seconds and its Jacobian, by differences, three more; after each step Broyden's rank-one update takes
the Jacobian along for nothing, and it is computed anew only when a step fails. scipy's `least_squares` computes it at
every accepted step, about three times the evaluations here.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.problem import Evaluation, Problem

Vector = NDArray[np.float64]

COARSE_ENOUGH, FINE_ENOUGH, MODEL_ENOUGH = 3.0, 0.02, 0.5
"""Where searches stop, see `solve`: the cheap model's optimum is only a start for the accurate one's, and errors of the
model, which the weights count pixel by pixel, move the optimum by more than the weights say."""
LAST_STEPS, SLOW_STEPS = 100, 4
"""Steps with the accurate model at most; where each computes orders 1 and 2 of many images anew. A bench's series tried
60 that moved nothing any more."""
DAMPED, LEAST_DAMPED = 1e-2, 1e-4
"""Share of the curvature by which a first step is damped, and one after a step that failed at least."""
CREEPING = 0.3
"""Share of what a step promised that it has to gain, or the Jacobian is computed anew: in a bent valley one that is
only taken along leads into the walls."""
LONGER = 3.0
"""Times as far that a step may go after one that led down, and one that did not may have gone."""
MOST_BENT = 0.75
"""Share of a step by which it may be bent."""
MOST_REFUSED = 8
"""Steps in a row that may fail with a Jacobian just computed, each ten times shorter: what is left is roughness."""
NEARLY, NEARLY_REFUSED = 4.0, 2
"""Times what is enough that is nearly enough, and as many failures do then: paths' roughness hides what is promised."""
SHORTER, NO_BETTER = 0.7, 0.85
"""Share of the last failed step's length that a step has at most to tell noise from a bend, and of its error, for its
length, that noise leaves at least."""
EVENLY_TRIED = 3
"""Steps in a row that are also tried evenly in the coefficients when they fail; shorter ones are the same."""


def solve(
    problem: Problem, start: Vector, enough: float = COARSE_ENOUGH, most_steps: int = 30, damping: float = DAMPED,
    share: float = 0.0,
) -> Evaluation:  # fmt: skip
    """Optimum of a problem next to some coordinates, in its box.

    Parameters
    ----------
    problem
        To minimise.
    start
        Where to begin; moved into the box.
    enough
        Stop when the linearised problem promises to lower the cost by less than this, by whole or by damped steps (one
        that is cut because nothing tells two coordinates apart promises little); 0.005 is a tenth of a standard
        deviation.
    most_steps
        Steps tried at most.
    damping
        Of the first step; 0 where the optimum is near.
    share
        Stop also when it promises to lower the cost by less than this share of it.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> @dataclass
    ... class Valley:
    ...     coordinates: Vector
    ...     def __post_init__(self):
    ...         x, y = self.coordinates
    ...         self.residual, self.jacobian = np.array([10 * (y - x**2), 1 - x]), np.array([[-20 * x, 10], [-1, 0]])
    ...         self.cost = 0.5 * self.residual @ self.residual
    >>> wide = np.full(2, 5.0)
    >>> rest = {"longest_step": wide, "quick": False, "slow": False, "least_damping": 0.0, "noisy": False}
    >>> problem = SimpleNamespace(at=Valley, box=(-wide, wide), **rest)
    >>> solve(problem, np.array([-1.2, 1.0]), 1e-9, 200).coordinates.round(3).tolist()
    [1.0, 1.0]
    """
    box, longest_step, least = problem.box, problem.longest_step, problem.least_damping
    anew = problem.quick and not problem.slow  # derivatives at each step, as they cost hardly more than the image
    damping, reach = max(damping, least), longest_step
    here = problem.at(np.clip(start, *box))
    jacobian = here.jacobian
    fresh, refused, bend = True, 0, _Bend(np.zeros_like(here.coordinates), np.zeros_like(here.residual))
    failed: _Failed | None = None
    for _ in range(most_steps):
        at, value = here.coordinates, here.residual
        looks = (_step(value, jacobian, max(least, by), at, box, longest_step) for by in (0.0, DAMPED))
        promised, wanted = max(_promise(value, jacobian, look) for look in looks), max(enough, share * here.cost)
        if promised < wanted:
            if fresh:
                break
            jacobian, fresh = here.jacobian, True
            continue
        straight = _step(value, jacobian, damping, at, box, reach)
        step = np.clip(at + straight + bend.back(straight, jacobian, damping), *box) - at
        ahead = problem.at(at + step)
        if problem.quick and refused < EVENLY_TRIED and not ahead.cost < here.cost:
            even = problem.at(problem.evenly(at, straight))
            if even.cost < here.cost:
                step, ahead = even.coordinates - at, even
        if ahead.cost < here.cost:
            fresh = anew or here.cost - ahead.cost < CREEPING * _promise(value, jacobian, step)
            if fresh:
                jacobian = ahead.jacobian
            else:
                jacobian = jacobian + np.outer(ahead.residual - value - jacobian @ step, step) / float(step @ step)
            bend = bend.after(step, ahead.residual - value - jacobian @ step) if bend.step.any() else bend
            here, refused, reach, failed = ahead, 0, np.minimum(longest_step, LONGER * reach), None
            damping = max(damping / 5.0, 1e-6, least)
        elif not fresh:
            jacobian, fresh = here.jacobian, True
        else:
            before, failed = failed, _Failed.of(here, ahead, jacobian, step)
            nearly = refused >= NEARLY_REFUSED and promised < NEARLY * wanted
            rough = problem.noisy and (failed.promised < wanted or failed.is_no_bend(before))
            if refused == MOST_REFUSED or nearly or rough:
                break
            bend = bend.after(step, ahead.residual - value - jacobian @ step)
            damping, refused, reach = max(10.0 * damping, LEAST_DAMPED), refused + 1, reach / LONGER
    return here


@dataclass(frozen=True)
class _Failed:
    """A step that failed with a Jacobian just computed: how long it was, in standard deviations of the pixels, by how
    much it promised to lower the cost, and by how much that was wrong."""

    length: float
    promised: float
    off: float

    @classmethod
    def of(cls, here: Evaluation, ahead: Evaluation, jacobian: NDArray[np.float64], step: Vector) -> "_Failed":
        """As it was."""
        promised = _promise(here.residual, jacobian, step)
        return cls(float(np.linalg.norm(jacobian @ step)), promised, ahead.cost - here.cost + promised)

    def is_no_bend(self, before: "_Failed | None") -> bool:
        """Whether what was wrong has not fallen faster than the step since another one failed, as a bend's error does.

        Then derivatives are off themselves, or noise of neighbours' images is not alike, and shorter steps lead no
        further down.
        """
        if before is None or self.length > SHORTER * before.length:
            return False
        return self.off * before.length > NO_BETTER * before.off * self.length


@dataclass(frozen=True)
class _Bend:
    """By how much residuals bent along the last step that failed, or since: half their second derivative along it.

    In a bent valley, as single scattering's is, straight steps go a hundredth of the way that bent ones do (geodesic
    acceleration; Transtrum and Sethna 2012). What a failed step has shown costs nothing.
    """

    step: Vector
    bent: Vector

    def after(self, step: Vector, bent: Vector) -> "_Bend":
        """As another step shows it."""
        return _Bend(step, bent)

    def back(self, step: Vector, jacobian: NDArray[np.float64], damping: float) -> Vector:
        """What to add to a step to stay in the valley; nothing where it leads elsewhere or is not small."""
        square = float(self.step @ self.step)
        if square == 0.0:
            return np.zeros_like(step)
        share = float(step @ self.step) / square
        curvature = jacobian.T @ jacobian
        matrix = curvature + (damping + 1e-9) * np.diag(np.diag(curvature)) + 1e-300 * np.eye(step.size)
        back: Vector = np.asarray(-np.linalg.solve(matrix, jacobian.T @ self.bent) * share**2, float)
        size = math.sqrt(float(back @ back) / max(float(step @ step), 1e-300))
        return np.asarray(back * min(1.0, MOST_BENT / size) if size > 0.0 else back)


def _promise(value: Vector, jacobian: NDArray[np.float64], step: Vector) -> float:
    """How much the linearised cost falls along a step."""
    return -float(step @ (jacobian.T @ value)) - 0.5 * float(np.sum((jacobian @ step) ** 2))


def whole_step(here: Evaluation) -> Vector:
    """The undamped Gauss–Newton step, in coordinates."""
    problem = here.problem
    return _step(here.residual, here.jacobian, 0.0, here.coordinates, problem.box, problem.longest_step)


def without_noise(here: Evaluation) -> Vector:
    """What a Gauss–Newton step gains, in coordinates, when noise of the derivatives is not taken for their size.

    The step goes back by as much as noise adds to the derivatives' products, by half where it is as large as they are
    (errors in variables; Fuller 1987). 0 where the noise is not known.
    """
    noise = here.chain.T @ here.sensitivity.noise @ here.chain
    value, jacobian, box = here.residual, here.jacobian, here.problem.box
    short, whole = (
        _step(value, jacobian, 0.0, here.coordinates, box, here.problem.longest_step, less) for less in (0.0, noise)
    )
    return whole - short


def _step(
    value: Vector, jacobian: NDArray[np.float64], damping: float, at: Vector, box: tuple[Vector, Vector],
    longest: Vector | float, less: NDArray[np.float64] | float = 0.0,
) -> Vector:  # fmt: skip
    """Damped Gauss–Newton step that stays in the box and is nowhere too long; with so much less curvature.

    A coordinate that would go further stops there and the rest are solved for again: one that nothing tells from others
    wants to go anywhere, and must not keep these where they are.
    """
    curvature, downhill = jacobian.T @ jacobian - less, -(jacobian.T @ value)
    scale = np.diag(curvature) + 1e-12 * float(np.trace(curvature)) + 1e-300
    matrix = curvature + (damping + 1e-9) * np.diag(scale)
    low, high = np.maximum(box[0] - at, -longest), np.minimum(box[1] - at, longest)
    free, step = np.ones(at.size, bool), np.zeros(at.size)
    while free.any():
        wanted = downhill[free] - matrix[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(matrix[np.ix_(free, free)], wanted)
        beyond = np.where(free, np.maximum(step - high, low - step), 0.0) / np.broadcast_to(longest, at.shape)
        worst = int(np.argmax(beyond))
        if not beyond[worst] > 0.0:
            break
        step[worst], free[worst] = np.clip(step[worst], low[worst], high[worst]), False
    return np.clip(step, low, high)


def polish(problem: Problem, start: Vector, weight: float = 1.0) -> Evaluation:
    """The same, as far as the model's error lets the optimum be known; few steps where images take long. Where images
    seem to tell `weight` times more than they do, costs are as many times larger."""
    by_noise = np.concatenate([view.whitened(view.observation.noise) ** 2 for view in problem.views])
    enough = FINE_ENOUGH + MODEL_ENOUGH * (1.0 - float(np.mean(by_noise)))
    return solve(problem, start, weight * enough, SLOW_STEPS if problem.slow else LAST_STEPS, damping=0.0)

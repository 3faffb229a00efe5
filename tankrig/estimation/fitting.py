"""One image, one forward model: the fit itself, from a coarse look at many media to one optimum."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.forward import Forward, Image, Slopes
from tankrig.estimation.misalignment import Misalignment
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import Range, slopes, to_coordinates, to_medium
from tankrig.estimation.projection import Scaling
from tankrig.estimation.search import LONGEST_STEP, Optimum, minimise
from tankrig.estimation.uncertainty import Sensitivity
from tankrig.scene import Medium

Array = NDArray[np.float64]

MEDIUM = 3
"""Coordinates of the medium; those of what may be misaligned come after them, in standard deviations."""
START_MEAN_FREE_PATHS = (0.6, 2.4, 9.6)
START_ALBEDO = 0.97
START_ASYMMETRY = (0.0, 0.5, 0.85)
"""Media looked at first: every pair of scatterings along the tank and g; the best for each g is a start."""
FIRST_STEPS, LAST_STEPS = 5, 40
"""Steps that every start gets before only the best go on, and steps with the accurate model at most."""
COARSE_ENOUGH, FINE_ENOUGH, MODEL_ENOUGH = 3.0, 0.02, 0.5
"""Where the searches stop, see `minimise`: the cheap model's optimum is only a start for the accurate one's, and errors
of the model, which the weights count pixel by pixel, move the optimum by more than the weights say."""
RIVAL, DISTINCT, EQUAL = 2.0, 0.2, 30.0
"""Starts go on whose cost is less than RIVAL times the best; ends that differ by DISTINCT in a coordinate, and in cost
by less than EQUAL, are left for the accurate model to tell apart."""
MISFIT = 4.0
"""Mean squared residual, in standard deviations that count the cheap model's error, that a good optimum stays below."""
FURTHEST_OFF, LONGEST_MOVE = 6.0, 2.0
"""Standard deviations by which anything may be misaligned, at most and in one step."""


@dataclass(frozen=True)
class Problem:
    """Weighted least squares of an observation and a forward model, gain and offset eliminated.

    Parameters
    ----------
    forward, slopes
        The model and its derivatives.
    observation
        What to explain.
    scaling
        Gain and offset, known or free.
    error
        (rows, columns) standard deviation of the model's error, counted per pixel into the weights only.
    range
        Where to search.
    misalignment
        What may be off in the set-up; None where nothing is.
    firmness
        (k,) how many times its own precision the belief in each misalignment weighs, see `overconfidence`.
    """

    forward: Forward
    slopes: Slopes
    observation: Observation
    scaling: Scaling
    error: Image
    range: Range
    misalignment: Misalignment | None = None
    firmness: Array = field(default_factory=lambda: np.ones(0))

    @property
    def weight(self) -> Array:
        """1/√(noise² + model error²) of the used pixels, (n,)."""
        used = self.observation.used
        weight: Array = 1.0 / np.hypot(self.observation.noise[used], np.asarray(self.error[used], float))
        return weight

    def image(self, coordinates: Array) -> Image:
        """Radiance, (rows, columns)."""
        medium, off = to_medium(coordinates[:MEDIUM]), coordinates[MEDIUM:]
        image = self.forward(medium)
        return image if self.misalignment is None else image + self.misalignment.change(medium, off)

    def scale(self, image: Image) -> tuple[float, float]:
        """Best gain and offset for a model image."""
        used = self.observation.used
        return self.scaling.solve(np.asarray(image[used], float), self.observation.image[used], self.weight)

    def residual(self, coordinates: Array) -> Array:
        """Observed less fitted, and expected less found, in standard deviations, (n + priors,)."""
        return self._residual(self.image(coordinates), coordinates)

    def residual_and_jacobian(self, coordinates: Array) -> tuple[Array, Array]:
        """The same with its derivatives by the coordinates, (n + priors, k)."""
        image = self.image(coordinates)
        found = self.sensitivity(coordinates, image)
        by_coefficients = -np.concatenate([found.changes, found.beliefs], axis=1).T
        off = coordinates.size - MEDIUM
        jacobian = np.zeros((by_coefficients.shape[0] + off, coordinates.size))
        jacobian[: len(by_coefficients)] = by_coefficients
        jacobian[:, :MEDIUM] = jacobian[:, :MEDIUM] @ slopes(to_medium(coordinates[:MEDIUM]))
        jacobian[len(by_coefficients) :, MEDIUM:] = np.diag(np.sqrt(self.firmness))
        return self._residual(image, coordinates), jacobian

    def sensitivity(self, coordinates: Array, image: Image) -> Sensitivity:
        """What the fit responds to at some coordinates, whose image is given: σa, σs, g and the misalignments."""
        used, weight, medium = self.observation.used, self.weight, to_medium(coordinates[:MEDIUM])
        gain, _ = self.scale(image)
        raw = np.asarray(self.slopes(medium)[:, used], float)
        if self.misalignment is not None:
            moves = self.misalignment.slopes(medium, coordinates[MEDIUM:])
            raw = np.concatenate([raw, moves[:, used]])
        changes = self.scaling.unhidden(gain * raw * weight, np.asarray(image[used], float), weight)
        return Sensitivity(changes[:, : weight.size], changes[:, weight.size :], weight, used, self.firmness)

    def _residual(self, image: Image, coordinates: Array) -> Array:
        gain, offset = self.scale(image)
        used = self.observation.used
        residual: Array = (self.observation.image[used] - gain * image[used] - offset) * self.weight
        return np.concatenate(
            [residual, self.scaling.beliefs(gain, offset), coordinates[MEDIUM:] * np.sqrt(self.firmness)]
        )


def first_guess(problem: Problem, length_mm: float) -> tuple[list[Medium], list[Medium]]:
    """Media to start from: the best of a few densities for each of a few g, best first; and the others."""
    looks: dict[float, list[Optimum]] = {g: [] for g in START_ASYMMETRY}
    for g, paths in product(START_ASYMMETRY, START_MEAN_FREE_PATHS):
        sigma_s = paths / length_mm
        medium = Medium(sigma_s * (1.0 / START_ALBEDO - 1.0), sigma_s, g)
        at = np.clip(to_coordinates(medium), problem.range.low, problem.range.high)
        value = problem.residual(at)
        looks[g].append(Optimum(at, 0.5 * float(value @ value)))
    ranked = [sorted(one, key=lambda look: look.cost) for one in looks.values()]
    best, others = [one[0] for one in ranked], [look for one in ranked for look in one[1:]]
    first, rest = (
        [to_medium(look.coordinates) for look in sorted(part, key=lambda look: look.cost)] for part in (best, others)
    )
    return first, rest


def search(
    problem: Problem, starts: Sequence[Medium], seen: Callable[[str], None], reserve: Sequence[Medium] = ()
) -> list[Medium]:
    """Best medium over the whole allowed range, and others that are as good as far as this problem can tell.

    Parameters
    ----------
    problem
        To minimise; a cheap forward model will do.
    starts
        Where to begin.
    seen
        Told in words what is being done.
    reserve
        Where to begin, one after another, as long as the best ended at an edge of the range in σs or g, in a valley
        that leads out of it (measured: up to one in four of single starts from anywhere does), or leaves `MISFIT` and
        nothing else has ended there (a thin liquid's g = 0.25 has a twin at −0.31).
    """
    ends, agreed = _descend(problem, starts, seen), False
    for other in reserve:
        at_edge = {"sigma_s", "g"} & set(problem.range.at_edge(to_medium(ends[0].coordinates)))
        misfit = 2.0 * ends[0].cost > MISFIT * problem.observation.used.sum()
        if not at_edge and (agreed or not misfit):
            break
        more = _descend(problem, [other], seen)
        agreed = not _distinct(more[0], ends[0])
        ends = sorted([*ends, *more], key=lambda end: end.cost)
    return [to_medium(end.coordinates) for end in ends if end.cost < ends[0].cost + EQUAL]


def _descend(problem: Problem, starts: Sequence[Medium], seen: Callable[[str], None]) -> list[Optimum]:
    """Distinct optima below some starts, best first; the least promising starts are given up early."""
    tried = []
    for start in starts:
        seen(f"searching from g = {start.g:.2g}")
        tried.append(_minimise(problem, to_coordinates(start), COARSE_ENOUGH, FIRST_STEPS))
    tried.sort(key=lambda end: end.cost)
    seen("searching from the best")
    ends: list[Optimum] = []
    for one in tried:
        if ends and one.cost > RIVAL * ends[0].cost:
            break
        end = _minimise(problem, one.coordinates, COARSE_ENOUGH)
        if all(_distinct(end, other) for other in ends):
            ends.append(end)
    return sorted(ends, key=lambda end: end.cost)


def _distinct(one: Optimum, other: Optimum) -> bool:
    return bool(np.abs(one.coordinates - other.coordinates).max() > DISTINCT)


def polish(problem: Problem, start: Array) -> Optimum:
    """Optimum next to some coordinates."""
    by_model = float(np.mean((np.asarray(problem.error[problem.observation.used], float) * problem.weight) ** 2))
    return _minimise(problem, start, FINE_ENOUGH + MODEL_ENOUGH * by_model, LAST_STEPS)


def _minimise(problem: Problem, start: Array, enough: float, most_steps: int = 30) -> Optimum:
    wide = np.full(start.size - MEDIUM, FURTHEST_OFF)
    box = np.concatenate([problem.range.low, -wide]), np.concatenate([problem.range.high, wide])
    longest = np.concatenate([LONGEST_STEP, np.full(wide.size, LONGEST_MOVE)])
    return minimise(problem.residual, problem.residual_and_jacobian, start, box, enough, most_steps, longest)

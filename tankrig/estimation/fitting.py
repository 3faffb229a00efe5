"""One image, one forward model: the fit itself, from a coarse look at many media to one optimum."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.forward import Forward, Image, Slopes
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import search_box, slopes, to_coordinates, to_medium
from tankrig.estimation.projection import Scaling
from tankrig.estimation.search import Optimum, minimise
from tankrig.estimation.uncertainty import Sensitivity
from tankrig.scene import Medium

Array = NDArray[np.float64]

START_MEAN_FREE_PATHS = (0.6, 2.4, 9.6)
START_ALBEDO = 0.97
START_ASYMMETRY = (0.0, 0.5, 0.85)
"""Media looked at first: every pair of scatterings along the tank and g; the best for each g is a start."""
FIRST_STEPS, LAST_STEPS = 5, 40
"""Steps that every start gets before only the best go on, and steps with the accurate model at most."""
COARSE_ENOUGH, FINE_ENOUGH, MODEL_ENOUGH = 3.0, 0.02, 2.0
"""Where the searches stop, see `minimise`: the cheap model's optimum is only a start for the accurate one's, and errors
of the model, which the weights count pixel by pixel, move the optimum by more than the weights say."""
RIVAL, DISTINCT, EQUAL = 2.0, 0.2, 30.0
"""Starts go on whose cost is less than RIVAL times the best; ends that differ by DISTINCT in a coordinate, and in cost
by less than EQUAL, are left for the accurate model to tell apart."""


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
    """

    forward: Forward
    slopes: Slopes
    observation: Observation
    scaling: Scaling
    error: Image

    @property
    def weight(self) -> Array:
        """1/√(noise² + model error²) of the used pixels, (n,)."""
        used = self.observation.used
        weight: Array = 1.0 / np.hypot(self.observation.noise[used], np.asarray(self.error[used], float))
        return weight

    def scale(self, image: Image) -> tuple[float, float]:
        """Best gain and offset for a model image."""
        used = self.observation.used
        return self.scaling.solve(np.asarray(image[used], float), self.observation.image[used], self.weight)

    def residual(self, coordinates: Array) -> Array:
        """Observed less fitted, in standard deviations, (n,)."""
        return self._residual(self.forward(to_medium(coordinates)))

    def residual_and_jacobian(self, coordinates: Array) -> tuple[Array, Array]:
        """The same with its derivatives by the coordinates, (n, 3)."""
        medium = to_medium(coordinates)
        changes = self.sensitivity(medium).changes
        return self._residual(self.forward(medium)), -changes.T @ slopes(medium)

    def sensitivity(self, medium: Medium) -> Sensitivity:
        """What the fit responds to at a medium."""
        used, weight, image = self.observation.used, self.weight, self.forward(medium)
        gain, _ = self.scale(image)
        changes = gain * np.asarray(self.slopes(medium)[:, used], float) * weight
        return Sensitivity(self.scaling.unhidden(changes, np.asarray(image[used], float), weight), weight, used)

    def _residual(self, image: Image) -> Array:
        gain, offset = self.scale(image)
        used = self.observation.used
        residual: Array = (self.observation.image[used] - gain * image[used] - offset) * self.weight
        return residual


def first_guess(problem: Problem, length_mm: float) -> list[Medium]:
    """Media to start from, the most likely first: the best of a few densities for each of a few g."""
    starts: dict[float, Optimum] = {}
    for g, paths in product(START_ASYMMETRY, START_MEAN_FREE_PATHS):
        sigma_s = paths / length_mm
        at = to_coordinates(Medium(sigma_s * (1.0 / START_ALBEDO - 1.0), sigma_s, g))
        value = problem.residual(at)
        here = Optimum(at, 0.5 * float(value @ value))
        if g not in starts or here.cost < starts[g].cost:
            starts[g] = here
    return [to_medium(start.coordinates) for start in sorted(starts.values(), key=lambda start: start.cost)]


def search(problem: Problem, starts: Sequence[Medium], length_mm: float, seen: Callable[[str], None]) -> list[Medium]:
    """Best medium over the whole allowed range, and others that are as good as far as this problem can tell.

    Parameters
    ----------
    problem
        To minimise; a cheap forward model will do.
    starts
        Where to begin.
    length_mm
        Longest side of the tank.
    seen
        Told in words what is being done.
    """
    tried = []
    for start in starts:
        seen(f"searching from g = {start.g:.2g}")
        tried.append(_minimise(problem, to_coordinates(start), length_mm, COARSE_ENOUGH, FIRST_STEPS))
    tried.sort(key=lambda end: end.cost)
    seen("searching from the best")
    ends: list[Optimum] = []
    for one in tried:
        if ends and one.cost > RIVAL * ends[0].cost:
            break
        end = _minimise(problem, one.coordinates, length_mm, COARSE_ENOUGH)
        if all(np.abs(end.coordinates - other.coordinates).max() > DISTINCT for other in ends):
            ends.append(end)
    ends.sort(key=lambda end: end.cost)
    return [to_medium(end.coordinates) for end in ends if end.cost < ends[0].cost + EQUAL]


def polish(problem: Problem, medium: Medium, length_mm: float) -> tuple[Medium, float]:
    """Optimum next to `medium`, and half the sum of squares there."""
    by_model = float(np.mean((np.asarray(problem.error[problem.observation.used], float) * problem.weight) ** 2))
    enough = FINE_ENOUGH + MODEL_ENOUGH * by_model
    end = _minimise(problem, to_coordinates(medium), length_mm, enough, LAST_STEPS)
    return to_medium(end.coordinates), end.cost


def _minimise(problem: Problem, start: Array, length_mm: float, enough: float, most_steps: int = 30) -> Optimum:
    box = search_box(length_mm)
    return minimise(problem.residual, problem.residual_and_jacobian, start, box, enough, most_steps)

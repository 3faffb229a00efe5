"""One image, one forward model: the fit itself, from a coarse look at many media to one optimum."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.forward import Forward, Image, Linearised
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
STARTS = 2
FIRST_STEPS = 5
"""How many of those starts are followed, and for how many steps before the best goes on."""
RIVAL = 10.0
"""The second best goes on too where its cost is less than this times the best's."""


@dataclass(frozen=True)
class Problem:
    """Weighted least squares of an observation and a forward model, gain and offset eliminated.

    Parameters
    ----------
    forward, linearise
        The model, without and with derivatives.
    observation
        What to explain.
    scaling
        Gain and offset, known or free.
    error
        (rows, columns) standard deviation of the model's error, counted per pixel into the weights only.
    """

    forward: Forward
    linearise: Linearised
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
        image, derivatives = self.linearise(medium)
        changes = self.sensitivity(image, derivatives).changes
        return self._residual(image), -changes.T @ slopes(medium)

    def sensitivity(self, image: Image, derivatives: Image) -> Sensitivity:
        """What the fit responds to at a model image."""
        used, weight = self.observation.used, self.weight
        gain, _ = self.scale(image)
        changes = gain * np.asarray(derivatives[:, used], float) * weight
        return Sensitivity(self.scaling.unhidden(changes, np.asarray(image[used], float), weight), weight, used)

    def _residual(self, image: Image) -> Array:
        gain, offset = self.scale(image)
        used = self.observation.used
        residual: Array = (self.observation.image[used] - gain * image[used] - offset) * self.weight
        return residual


def search(problem: Problem, length_mm: float, enough: float, seen: Callable[[str], None]) -> Medium:
    """Best medium over the whole allowed range: a look at a few media, then a search from the best for each g.

    Parameters
    ----------
    problem
        To minimise; a coarse forward model will do.
    length_mm
        Longest side of the tank.
    enough
        See `minimise`.
    seen
        Told in words what is being done.
    """
    seen("looking at a few media")
    starts: dict[float, Optimum] = {}
    for g, paths in product(START_ASYMMETRY, START_MEAN_FREE_PATHS):
        sigma_s = paths / length_mm
        at = to_coordinates(Medium(sigma_s * (1.0 / START_ALBEDO - 1.0), sigma_s, g))
        value = problem.residual(at)
        here = Optimum(at, 0.5 * float(value @ value))
        if g not in starts or here.cost < starts[g].cost:
            starts[g] = here
    tried = []
    for start in sorted(starts.values(), key=lambda start: start.cost)[:STARTS]:
        seen(f"searching from g = {math.tanh(start.coordinates[2]):.2g}")
        tried.append(_minimise(problem, start.coordinates, length_mm, enough, FIRST_STEPS))
    best, second = sorted(tried, key=lambda end: end.cost)[:2]
    seen("searching from the best")
    ends = [_minimise(problem, best.coordinates, length_mm, enough)]
    if second.cost < RIVAL * best.cost and np.abs(second.coordinates - ends[0].coordinates).max() > 0.2:
        ends.append(_minimise(problem, second.coordinates, length_mm, enough))
    return to_medium(min(ends, key=lambda end: end.cost).coordinates)


def polish(problem: Problem, medium: Medium, length_mm: float, enough: float) -> Medium:
    """Optimum next to `medium`."""
    return to_medium(_minimise(problem, to_coordinates(medium), length_mm, enough).coordinates)


def _minimise(problem: Problem, start: Array, length_mm: float, enough: float, most_steps: int = 30) -> Optimum:
    box = search_box(length_mm)
    return minimise(problem.residual, problem.residual_and_jacobian, start, box, enough, most_steps)

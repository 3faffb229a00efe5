"""From many starts to one optimum, with few evaluations of the model.

Steps are Levenberg–Marquardt's with a Jacobian that is updated instead of computed anew. A forward model costs between
milliseconds and seconds and its Jacobian, by differences, three more; after each step Broyden's rank-one update takes
the Jacobian along for nothing, and it is computed anew only when a step fails. scipy's `least_squares` computes it at
every accepted step, about three times the evaluations here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.forward import (
    COARSE,
    Forward,
    Model,
    Models,
    Slopes,
    corrected,
    counted_error,
    image_of,
    stated_error,
)
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import Block, Scaling
from tankrig.estimation.problem import Problem, View
from tankrig.estimation.uncertainty import PATTERN, SmoothError, identifiable
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene
from tankrig.threads import THREADS

Vector = NDArray[np.float64]
Image = NDArray[np.floating]
Told = Callable[[str], object]
Residual = Callable[[Vector], Vector]
Linearise = Callable[[Vector], tuple[Vector, NDArray[np.float64]]]
"""Coordinates to the residual (n,) and its Jacobian (n, k)."""

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
SEVERAL_ENOUGH = 20.0
"""The same for the cheap models' fit of several images."""
CORRECTIONS, CORRECTED = 4, 0.3
"""Exact images at most that an optimum is corrected by, each at the last one's, and the gain in χ²/2 below which that
is over."""
SHARPER = 4
"""Times as many light paths in the last exact image, where the model's error hides what the photograph shows."""
CLEANINGS = 3
"""Times at most that a fit is repeated without the pixels that it shows to be outliers."""
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
    longest_step: Vector | float = np.inf,
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
    value: Vector, jacobian: NDArray[np.float64], damping: float, at: Vector, box: tuple[Vector, Vector],
    longest: Vector | float,
) -> Vector:  # fmt: skip
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


def solve(problem: Problem, start: Vector, enough: float = COARSE_ENOUGH, most_steps: int = 30) -> Optimum:
    """Optimum of a problem next to some coordinates; see `minimise`."""
    whole = problem.residual_and_jacobian
    return minimise(problem.residual, whole, start, problem.box, enough, most_steps, problem.longest_step)


def polish(problem: Problem, start: Vector) -> Optimum:
    """The same, as far as the model's error lets the optimum be known."""
    by_noise = np.concatenate([view.whitened(view.observation.noise) ** 2 for view in problem.views])
    return solve(problem, start, FINE_ENOUGH + MODEL_ENOUGH * (1.0 - float(np.mean(by_noise))), LAST_STEPS)


def first_guess(problem: Problem, length_mm: float) -> tuple[list[Optimum], list[Optimum]]:
    """Where to start from: the best of a few densities for each of a few g, best first; and the others."""
    ranked = []
    for g in START_ASYMMETRY:
        looks = []
        for paths in START_MEAN_FREE_PATHS:
            sigma_s = paths / length_mm
            at = np.clip(problem.start(Medium(sigma_s * (1.0 / START_ALBEDO - 1.0), sigma_s, g)), *problem.box)
            looks.append(Optimum(at, 0.5 * float(np.sum(problem.residual(at) ** 2))))
        ranked.append(sorted(looks, key=lambda look: look.cost))
    first, rest = [one[0] for one in ranked], [look for one in ranked for look in one[1:]]
    return sorted(first, key=lambda look: look.cost), sorted(rest, key=lambda look: look.cost)


def search(
    problem: Problem, starts: Sequence[Vector], seen: Told, reserve: Sequence[Vector] = (),
    enough: float = COARSE_ENOUGH,
) -> list[Vector]:  # fmt: skip
    """Best coordinates over the whole allowed range, and others that are as good as far as this problem can tell.

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
    enough
        Where to stop, see `minimise`.
    """
    ends, agreed = _descend(problem, starts, seen, enough), False
    for other in reserve:
        at_edge = {"sigma_s", "g"} & set(problem.at_edge(ends[0].coordinates))
        misfit = 2.0 * ends[0].cost > MISFIT * problem.pixels
        if not at_edge and (agreed or not misfit):
            break
        more = _descend(problem, [other], seen, enough)
        agreed = not _distinct(more[0], ends[0])
        ends = sorted([*ends, *more], key=lambda end: end.cost)
    return [end.coordinates for end in ends if end.cost < ends[0].cost + EQUAL]


def _descend(problem: Problem, starts: Sequence[Vector], seen: Told, enough: float) -> list[Optimum]:
    """Distinct optima below some starts, best first; the least promising starts are given up early."""
    tried = []
    for number, start in enumerate(starts, 1):
        seen(f"searching from start {number} of {len(starts)}")
        tried.append(solve(problem, start, enough, FIRST_STEPS))
    tried.sort(key=lambda end: end.cost)
    seen("searching from the best")
    ends: list[Optimum] = []
    for one in tried:
        if ends and one.cost > RIVAL * ends[0].cost:
            break
        end = solve(problem, one.coordinates, enough)
        if all(_distinct(end, other) for other in ends):
            ends.append(end)
    return sorted(ends, key=lambda end: end.cost)


def _distinct(one: Optimum, other: Optimum) -> bool:
    return bool(np.abs(one.coordinates - other.coordinates).max() > DISTINCT)


@dataclass(frozen=True)
class Shot:
    """An image, what it shows, the versions of its model, and the number of its dose."""

    observation: Observation
    scene: Scene
    models: Models
    dose: int = 0

    @property
    def length_mm(self) -> float:
        """Longest side of the tank."""
        return max(self.scene.tank.size_mm)

    def view(self, forward: Forward, slopes: Slopes, error: Image, observation: Observation | None = None) -> View:
        """It as a problem has it, with a model whose error has a standard deviation, (rows, columns)."""
        return View(observation or self.observation, forward, slopes, self.error(error), self.dose)

    def error(self, sd: Image, counted: float = PATTERN) -> SmoothError:
        """A model's error of a standard deviation, (rows, columns); see `SmoothError`."""
        return SmoothError(sd, self.length_mm / self.scene.camera.pixel_mm, counted)


@dataclass(frozen=True)
class Fit:
    """A problem, its optimum, and each view's model as it was used there."""

    problem: Problem
    optimum: Optimum
    models: tuple[Model, ...]

    @property
    def coordinates(self) -> Vector:
        """Of the optimum."""
        return self.optimum.coordinates

    @property
    def predictions(self) -> list[Prediction]:
        """The models' images there, without what may be misaligned."""
        return _seen(self.problem, self.models, self.coordinates)


def fitted(
    shots: Sequence[Shot],
    blocks: tuple[Block, ...],
    scaling: Scaling,
    progress: Told,
    start: Vector | None = None,
    few: Sequence[int] = (0,),
    settled: float = 0.0,
    sharper: bool = False,
) -> Fit:
    """From images to the optimum: search with the cheap models, go on with accurate ones, correct by exact images.

    Parameters
    ----------
    shots
        The images, and their models.
    blocks
        What is searched for.
    scaling
        Whether gain and offset are free.
    progress
        Told in words what is being done.
    start
        Coordinates to begin from; None to search everywhere.
    few
        Numbers of the images that the search looks at.
    settled
        Move of every coordinate below which exact images need not be computed again.
    sharper
        Whether exact images follow more paths where the model's error hides what the images show.
    """
    models = [shot.models for shot in shots]
    length_mm = max(shot.length_mm for shot in shots)
    coarse = [one.coarse for one in models]
    slopes = [one.slopes_of(one.coarse, length_mm) for one in models]
    light = [_above_ambient(shot.observation, scaling) for shot in shots]

    def rough(share: float) -> Problem:
        views = zip(shots, coarse, slopes, light, strict=True)
        made = tuple(one.view(image_of(a), b, share * c) for one, a, b, c in views)
        return Problem(made, blocks, scaling, 1 if all(one.slopes for one in models) else THREADS)

    problem, found = rough(COARSE), [] if start is None else [start]
    if start is None:
        progress("looking at a few media")
        first, rest = first_guess(problem.of(few), length_mm)
        starts, reserve = [look.coordinates for look in first], [look.coordinates for look in rest]
        if len(few) > 1:  # they have no twins
            rivals = [look.coordinates for look in first[1:2] if look.cost < RIVAL * first[0].cost]
            found = search(problem.of(few), [starts[0], *rivals], progress, enough=SEVERAL_ENOUGH)
        else:
            share = stated_error(_seen(problem.of(few), [coarse[few[0]]], starts[0])[0])
            problem = rough(float(np.clip(share, 0.1 * COARSE, COARSE)))
            found = search(problem.of(few), starts, progress, reserve)
    best = Optimum(found[0], np.inf)
    if start is not None or len(few) < len(shots):
        progress("fitting all images")
        best = min((solve(problem, one, SEVERAL_ENOUGH) for one in found), key=lambda end: end.cost)
        found = [best.coordinates]
    versions = [(one.coarse, one.coarse) for one in models]
    if all(one.refine for one in models):
        progress("refining")
        versions = [one.refined(problem.liquid(found[0], shot.dose)) for one, shot in zip(models, shots, strict=True)]
        seen = _seen(problem, [fine for fine, _ in versions], found[0])
        slopes = [one.slopes_of(slope, length_mm) for one, (_, slope) in zip(models, versions, strict=True)]
        problem = _weighed(problem, shots, [image_of(fine) for fine, _ in versions], slopes, seen)
        best = min((polish(problem, one) for one in found), key=lambda end: end.cost)
    if all(one.exact for one in models):
        return _corrected(problem, best, shots, [slope for _, slope in versions], progress, settled, sharper)
    return Fit(problem, best, tuple(fine for fine, _ in versions))


def _corrected(
    problem: Problem, best: Optimum, shots: Sequence[Shot], models: Sequence[Model], progress: Told, settled: float,
    sharper: bool,
) -> Fit:  # fmt: skip
    """The optimum by exact images, each at the last one's, and smooth changes about them.

    Parameters
    ----------
    problem, best
        That was solved, and where.
    shots
        Whose exact images are asked for.
    models
        That are differentiated; in the end, with the error that they show at the optimum taken off.
    progress
        Told in words what is being done.
    settled
        Move of every coordinate below which that is over.
    sharper
        Whether images follow more paths where the model's error hides what the images show.
    """

    def about(at: Vector, times: int) -> tuple[Problem, list[Prediction]]:
        """The problem with exact images and changes to first order: what is left of paths' noise in it is smooth."""
        media = [problem.liquid(at, shot.dose) for shot in shots]
        seen = [shot.models.exact(one, times) for shot, one in zip(shots, media, strict=True) if shot.models.exact]
        slopes = problem.of_views(lambda view: view.slopes(problem.liquid(at, view.dose)))
        near = [_linear(one.image, medium, slope) for one, medium, slope in zip(seen, media, slopes, strict=True)]
        return _weighed(problem, shots, near, [view.slopes for view in problem.views], seen), seen

    for _ in range(CORRECTIONS):
        progress("correcting by accurate images")
        centre = best.coordinates
        near, seen = about(centre, 1)
        misfit = near.residual(centre)
        best = polish(near, centre)
        moved = float(np.abs(best.coordinates - centre).max())
        if 0.5 * float(misfit @ misfit) - best.cost < CORRECTED or moved < settled:
            break
    if sharper and _held_back(near, best):
        progress("correcting by images as accurate as the photographs")
        near, seen = about(centre, SHARPER)
        best = polish(near, best.coordinates)
    media = [problem.liquid(centre, shot.dose) for shot in shots]
    last = tuple(corrected(model, medium, one) for model, medium, one in zip(models, media, seen, strict=True))
    views = (replace(view, forward=image_of(model)) for view, model in zip(near.views, last, strict=True))
    return Fit(replace(problem, views=tuple(views)), best, last)


def _weighed(
    problem: Problem, shots: Sequence[Shot], forwards: Sequence[Forward], slopes: Sequence[Slopes],
    seen: Sequence[Prediction],
) -> Problem:  # fmt: skip
    """The problem with other models, weighed by the errors that their images state and the noise that these leave."""
    gain, offsets = problem.scale([one.image for one in seen])
    views = []
    for k, (shot, view) in enumerate(zip(shots, problem.views, strict=True)):
        left = view.observation.image - gain * seen[k].image - offsets[k]
        observation = view.observation.with_noise_of(left, by_level=True)
        views.append(shot.view(forwards[k], slopes[k], counted_error(seen[k], gain), observation))
    return replace(problem, views=tuple(views))


def _linear(image: Image, centre: Medium, slopes: Image) -> Forward:
    """An image, and changes of it to first order."""
    at = np.array(centre.coefficients)
    return lambda medium: np.asarray(image + np.tensordot(np.array(medium.coefficients) - at, slopes, 1))


def _seen(problem: Problem, models: Sequence[Model], at: Vector) -> list[Prediction]:
    """What models say of the views at coordinates."""
    return [model(problem.liquid(at, view.dose)) for model, view in zip(models, problem.views, strict=True)]


def _held_back(problem: Problem, best: Optimum) -> bool:
    """Whether the model's error leaves a coefficient undetermined that noise alone would not."""
    sensitivity = problem.sensitivity(best.coordinates, problem.images(best.coordinates))
    noise, medium = [view.observation.noise for view in problem.views], problem.liquid(best.coordinates)
    with_error, without = (
        identifiable(medium, sensitivity.covariance(noise, errors))
        for errors in ([view.error for view in problem.views], [None] * len(noise))
    )
    return with_error != without


def _above_ambient(seen: Observation, scaling: Scaling) -> Image:
    """The light in an image, about, for errors in proportion to it."""
    ambient = float(np.percentile(seen.image[seen.used], 5)) if scaling.offset is None else scaling.offset
    return np.maximum(seen.image - ambient, 0.0)


def without_outliers(fit: Fit) -> Fit:
    """The fit without pixels that it shows to be none of the liquid's light."""
    problem, best = fit.problem, fit.optimum
    for _ in range(CLEANINGS):
        images = problem.images(best.coordinates)
        gain, offsets = problem.scale(images)
        views = tuple(
            replace(view, observation=view.observation.cleaned(gain * image + offset))
            for view, image, offset in zip(problem.views, images, offsets, strict=True)
        )
        cleaned = replace(problem, views=views)
        if cleaned.pixels == problem.pixels:
            break
        problem = cleaned
        best = polish(problem, best.coordinates)
    return replace(fit, problem=problem, optimum=best)

"""From many starts to one optimum, with few evaluations of the model.

Steps are Levenberg–Marquardt's with a Jacobian that is updated instead of computed anew. A forward model costs between
milliseconds and seconds and its Jacobian, by differences, three more; after each step Broyden's rank-one update takes
the Jacobian along for nothing, and it is computed anew only when a step fails. scipy's `least_squares` computes it at
every accepted step, about three times the evaluations here.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.differences import Forward, Slopes, values_of
from tankrig.estimation.forward import COARSE, Model, Models, corrected, counted_error, image_of, stated_error
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import Block
from tankrig.estimation.phase_families import Family
from tankrig.estimation.problem import Evaluation, Problem, View
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.uncertainty import PATTERN, SmoothError, identifiable
from tankrig.prediction import Prediction
from tankrig.scene import Medium, Scene

Vector = NDArray[np.float64]
Image = NDArray[np.floating]
Told = Callable[[str], object]

START_MEAN_FREE_PATHS = (0.6, 2.4, 9.6)
START_ALBEDO = 0.97
START_ASYMMETRY = (0.0, 0.5, 0.85)
"""Media looked at first: every pair of scatterings along the tank and g; the best for each g is a start."""
PROFILE_ASYMMETRY = (-0.7, -0.35, 0.0, 0.3, 0.6, 0.82, 0.94)
"""At which the whole profile of one image is looked at."""
PROFILE_FROM = 0.55
"""g of the liquids that are looked at first."""
PROFILE_ENOUGH, PROFILE_SHARE, PROFILE_STEPS = 10.0, 0.3, 8
"""Where a look stops, in χ²/2 or as a share of what it began with, and its steps at most."""
VALLEYS = 3
"""Of the profile that are searched, at most."""
FIRST_STEPS, LAST_STEPS = 5, 100
"""Steps that every start gets before only the best go on, and steps with the accurate model at most."""
COARSE_ENOUGH, FINE_ENOUGH, MODEL_ENOUGH = 3.0, 0.02, 0.5
"""Where the searches stop, see `solve`: the cheap model's optimum is only a start for the accurate one's, and errors
of the model, which the weights count pixel by pixel, move the optimum by more than the weights say."""
NEAR_ENOUGH, BENT_ENOUGH, MANY_ENOUGH = 0.005, 0.05, 0.1
"""The same about exact images: to first order, where steps cost nothing, and as the models bend; with a phase
function's many coordinates, of which each may be off by less than where there are three."""
RIVAL, DISTINCT, EQUAL = 2.0, 0.2, 30.0
"""Starts go on whose cost is less than RIVAL times the best; ends that differ by DISTINCT in a coordinate, and in cost
by less than EQUAL, are left for the accurate model to tell apart."""
MISFIT = 4.0
"""Mean squared residual, in standard deviations that count the cheap model's error, that a good optimum stays below."""
SEVERAL_ENOUGH = 20.0
"""The same for the cheap models' fit of several images."""
CORRECTIONS, SETTLED = 4, 0.1
"""Exact images at most that an optimum is corrected by, each at the last one's, and the move of every coordinate below
which that is over, see `Block.looseness`."""
FEW_STEPS = 12
"""Steps with the accurate model, and as the models bend, at most, where a phase function's coordinates are fitted."""
SETTLED_SHARE = 0.5
"""Of its standard deviation, by which each value may have moved besides."""
SHARPER = 4
"""Times as many light paths in the last exact image, where the model's error hides what the photograph shows."""
CLEANINGS = 3
"""Times at most that a fit is repeated without the pixels that it shows to be outliers."""
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
    >>> rest = {"longest_step": wide, "quick": False, "least_damping": 0.0}
    >>> problem = SimpleNamespace(at=Valley, box=(-wide, wide), **rest)
    >>> solve(problem, np.array([-1.2, 1.0]), 1e-9, 200).coordinates.round(3).tolist()
    [1.0, 1.0]
    """
    box, longest_step, least = problem.box, problem.longest_step, problem.least_damping
    damping, reach = max(damping, least), longest_step
    here = problem.at(np.clip(start, *box))
    jacobian = here.jacobian
    fresh, refused, bend = True, 0, _Bend(np.zeros_like(here.coordinates), np.zeros_like(here.residual))
    for _ in range(most_steps):
        at, value = here.coordinates, here.residual
        looks = (_step(value, jacobian, max(least, by), at, box, longest_step) for by in (0.0, DAMPED))
        if max(_promise(value, jacobian, look) for look in looks) < max(enough, share * here.cost):
            if fresh:
                break
            jacobian, fresh = here.jacobian, True
            continue
        straight = _step(value, jacobian, damping, at, box, reach)
        step = np.clip(at + straight + bend.back(straight, jacobian, damping), *box) - at
        ahead = problem.at(at + step)
        if problem.quick and not ahead.cost < here.cost:
            even = problem.at(problem.evenly(at, straight))
            if even.cost < here.cost:
                step, ahead = even.coordinates - at, even
        if ahead.cost < here.cost:
            fresh = problem.quick or here.cost - ahead.cost < CREEPING * _promise(value, jacobian, step)
            if fresh:
                jacobian = ahead.jacobian
            else:
                jacobian = jacobian + np.outer(ahead.residual - value - jacobian @ step, step) / float(step @ step)
            bend = bend.after(step, ahead.residual - value - jacobian @ step) if bend.step.any() else bend
            here, refused, reach = ahead, 0, np.minimum(longest_step, LONGER * reach)
            damping = max(damping / 5.0, 1e-6, least)
        elif not fresh:
            jacobian, fresh = here.jacobian, True
        elif refused == MOST_REFUSED:
            break
        else:
            bend = bend.after(step, ahead.residual - value - jacobian @ step)
            damping, refused, reach = max(10.0 * damping, LEAST_DAMPED), refused + 1, reach / LONGER
    return here


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


def _step(
    value: Vector, jacobian: NDArray[np.float64], damping: float, at: Vector, box: tuple[Vector, Vector],
    longest: Vector | float,
) -> Vector:  # fmt: skip
    """Damped Gauss–Newton step that stays in the box and is nowhere too long.

    A coordinate that would go further stops there and the rest are solved for again: one that nothing tells from others
    wants to go anywhere, and must not keep these where they are.
    """
    curvature, downhill = jacobian.T @ jacobian, -(jacobian.T @ value)
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


def polish(problem: Problem, start: Vector) -> Evaluation:
    """The same, as far as the model's error lets the optimum be known."""
    by_noise = np.concatenate([view.whitened(view.observation.noise) ** 2 for view in problem.views])
    enough = FINE_ENOUGH + MODEL_ENOUGH * (1.0 - float(np.mean(by_noise)))
    return solve(problem, start, enough, LAST_STEPS, damping=0.0)


def first_guess(problem: Problem, length_mm: float) -> tuple[list[Evaluation], list[Evaluation]]:
    """Where to start from: the best of a few densities for each of a few g, best first; and the others."""
    first, rest = [], []
    for g in START_ASYMMETRY:
        looks = [problem.at(one) for one in _densities(problem, length_mm, g)]
        best, *others = _by_cost(looks)
        first.append(best)
        rest += others
    return _by_cost(first), _by_cost(rest)


def _densities(problem: Problem, length_mm: float, g: float) -> list[Vector]:
    """Coordinates of liquids of a few densities."""
    scattering = [paths / length_mm for paths in START_MEAN_FREE_PATHS]
    media = [Medium(sigma_s * (1.0 / START_ALBEDO - 1.0), sigma_s, g) for sigma_s in scattering]
    return [np.clip(problem.start(one), *problem.box) for one in media]


def profiled(problem: Problem, start: Vector, seen: Told) -> list[Evaluation]:
    """Places along the whole profile in g that explain an image better than their neighbours, best first.

    One image may have several optima, most of them at a g of their own: light that turns back looks like light that
    goes on and is absorbed. At a given g extinction and albedo have few, mostly one, so each g is begun from the best
    of its neighbour, away from the start and then back.

    Parameters
    ----------
    problem
        Of one image; a cheap forward model will do.
    start
        Coordinates to begin from.
    seen
        Told in words what is being done.
    """
    along = np.arctanh(PROFILE_ASYMMETRY)
    found: list[Evaluation | None] = [None] * along.size

    def look(number: int, begin: Vector) -> None:
        held, best = replace(problem, held=((ASYMMETRY_COORDINATE, float(along[number])),)), found[number]
        here = np.where(np.arange(begin.size) == ALBEDO_COORDINATE, np.minimum(begin, LEAST_ABSORBING), begin)
        ahead = held.at(np.clip(here, *held.box))
        if best is None or begin is start or ahead.cost < (1.0 - PROFILE_SHARE) * best.cost:
            end = solve(held, ahead.coordinates, PROFILE_ENOUGH, PROFILE_STEPS, share=PROFILE_SHARE)
            found[number] = end if best is None or end.cost < best.cost else best

    first = int(np.argmin(np.abs(along - start[ASYMMETRY_COORDINATE])))
    for number in (*range(first, along.size), *range(first - 1, -1, -1)):
        seen(f"looking at g = {PROFILE_ASYMMETRY[number]:g}")
        near = None if number == first else found[number - 1 if number > first else number + 1]
        look(number, start if near is None else near.coordinates)
        if near is not None and abs(near.coordinates[0] - start[0]) > FAR_FROM_START:
            look(number, start)  # where g is wrong, clear water with a gain may be the best, from where none is found
    for number in (*range(along.size - 2, first, -1), *range(1, first + 1)):  # and back
        near = found[number + 1 if number > first else number - 1]
        if near is not None:
            look(number, near.coordinates)
    profile = [one for one in found if one is not None]
    costs = [math.inf, *(one.cost for one in profile), math.inf]
    valleys = [one for k, one in enumerate(profile) if one.cost <= min(costs[k], costs[k + 2])]
    return [problem.at(one.coordinates) for one in _by_cost(valleys)]


ALBEDO_COORDINATE, ASYMMETRY_COORDINATE = 1, 2
"""Numbers of logit ϖ and atanh g among the coordinates of a medium, and of ink."""
FAR_FROM_START = 2.0
"""In log σs: a neighbour's best that is as far from the start is not the only place that a look begins from."""
LEAST_ABSORBING = math.log(0.99 / 0.01)
"""logit ϖ at most, where a look begins: a step may lead to no absorption at all, from where no logarithm leads back."""


def _by_cost(places: Iterable[Evaluation]) -> list[Evaluation]:
    return sorted(places, key=lambda one: one.cost)


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
        Where to stop, see `solve`.
    """
    ends, agreed = _descend(problem, starts, seen, enough), False
    for other in reserve:
        at_edge = {"sigma_s", "g"} & set(ends[0].at_edge)
        misfit = 2.0 * ends[0].cost > MISFIT * problem.pixels
        if not at_edge and (agreed or not misfit):
            break
        more = _descend(problem, [other], seen, enough)
        agreed = not _distinct(more[0], ends[0])
        ends = _by_cost([*ends, *more])
    return [end.coordinates for end in ends if end.cost < ends[0].cost + EQUAL]


def _descend(problem: Problem, starts: Sequence[Vector], seen: Told, enough: float) -> list[Evaluation]:
    """Distinct optima below some starts, best first; the least promising starts are given up early."""
    tried = []
    for number, start in enumerate(starts, 1):
        seen(f"searching from start {number} of {len(starts)}")
        tried.append(solve(problem, start, enough, FIRST_STEPS))
    seen("searching from the best")
    ends: list[Evaluation] = []
    for one in _by_cost(tried):
        if ends and one.cost > RIVAL * ends[0].cost:
            break
        end = solve(problem, one.coordinates, enough)
        if all(_distinct(end, other) for other in ends):
            ends.append(end)
    return _by_cost(ends)


def _distinct(one: Evaluation, other: Evaluation) -> bool:
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

    def looked_at(self) -> "Shot":
        """It as a search looks at it: differences to one side do."""
        if self.models.look is None:
            return replace(self, models=replace(self.models, central=False))
        by, model = self.models.look
        scene = replace(self.scene, camera=self.scene.camera.binned(by))
        return replace(
            self, observation=self.observation.binned(by), scene=scene, models=replace(self.models, coarse=model)
        )

    def slopes_of(self, model: Model) -> Slopes:
        """Derivatives: the model's own, or by differences of one of its versions."""
        return self.models.slopes_of(model, self.length_mm)

    def view(self, forward: Forward, slopes: Slopes, error: Image) -> View:
        """It as a problem has it, with a model whose error has a standard deviation, (rows, columns)."""
        return View(self.observation, forward, slopes, self.error(error), self.dose)

    def error(self, sd: Image, counted: float = PATTERN) -> SmoothError:
        """A model's error of a standard deviation, (rows, columns); see `SmoothError`."""
        return SmoothError.of(self.scene, sd, counted)


@dataclass(frozen=True)
class Fit:
    """Where a fit ended: the problem there, and each view's model as it was used."""

    optimum: Evaluation
    models: tuple[Model, ...]

    @property
    def predictions(self) -> list[Prediction]:
        """The models' images there, without what may be misaligned."""
        return [model(liquid) for model, liquid in zip(self.models, self.optimum.media, strict=True)]


def fitted(
    shots: Sequence[Shot],
    blocks: tuple[Block, ...],
    scaling: Scaling,
    progress: Told,
    start: Vector | None = None,
    few: Sequence[int] = (0,),
    sharper: bool = False,
    starts: Sequence[Vector] | None = None,
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
    sharper
        Whether exact images follow more paths where the model's error hides what the images show.
    starts
        Coordinates that the cheap models' search begins from, in place of a look around.
    """
    if starts is not None:
        problem = _rough(shots, blocks, scaling)
        found = search(problem.of(few), starts, progress, enough=COARSE_ENOUGH if len(few) == 1 else SEVERAL_ENOUGH)
    elif start is None:
        problem, found = _searched(shots, blocks, scaling, progress, few)
    else:
        problem, found = _rough(shots, blocks, scaling), [start]
    if all(shot.models.refine for shot in shots):
        progress("refining")
        media = problem.at(found[0]).media
        versions = [shot.models.refined(liquid) for shot, liquid in zip(shots, media, strict=True)]
        seen = [fine(liquid) for (fine, _), liquid in zip(versions, media, strict=True)]
        forwards = [image_of(fine) for fine, _ in versions]
        slopes = [shot.slopes_of(slope) for shot, (_, slope) in zip(shots, versions, strict=True)]
        problem = _weighed(problem, shots, forwards, slopes, seen)
        many = any(shot.models.family for shot in shots)
        best = _by_cost(
            solve(problem, one, MANY_ENOUGH, FEW_STEPS, damping=0.0) if many else polish(problem, one) for one in found
        )[0]
    else:
        progress("fitting all images")
        versions = [(shot.models.coarse, shot.models.coarse) for shot in shots]
        best = _by_cost(solve(problem, one, SEVERAL_ENOUGH) for one in found)[0]
    if all(shot.models.exact for shot in shots):
        return _corrected(best, shots, [slope for _, slope in versions], progress, sharper)
    return Fit(best, tuple(fine for fine, _ in versions))


def _rough(shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, share: float = COARSE) -> Problem:
    """The problem of the cheap models, with errors of a share of the light, about."""
    views = []
    for shot in shots:
        seen, coarse = shot.observation, shot.models.coarse
        ambient = float(np.percentile(seen.image[seen.used], 5)) if scaling.offset is None else scaling.offset
        error = share * np.maximum(seen.image - ambient, 0.0)
        views.append(shot.view(image_of(coarse), shot.slopes_of(coarse), error))
    return Problem(tuple(views), blocks, scaling, quick=all(shot.models.with_slopes for shot in shots))


def _searched(
    shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, progress: Told, few: Sequence[int]
) -> tuple[Problem, list[Vector]]:
    """The problem of the cheap models, and the ends of a search of it that looks at few images, best first."""
    problem = _rough(shots, blocks, scaling)
    if len(few) > 1:  # they have no twins, and need no reserve
        progress("looking at a few media")
        first, _ = first_guess(problem.of(few), shots[0].length_mm)
        starts = [look.coordinates for look in first[: 2 if first[1].cost < RIVAL * first[0].cost else 1]]
        return problem, search(problem.of(few), starts, progress, enough=SEVERAL_ENOUGH)
    progress("looking at a few media")
    look = [shots[number].looked_at() for number in few]
    seen = _rough(look, blocks, scaling)
    places = [seen.at(one) for one in _densities(seen, look[0].length_mm, PROFILE_FROM)]
    best = min(places, key=lambda one: one.cost)
    share = stated_error(look[0].models.coarse(best.media[0]))
    seen = _rough(look, blocks, scaling, float(np.clip(share, 0.1 * COARSE, COARSE)))
    valleys = profiled(seen, best.coordinates, progress)[:VALLEYS]
    return problem, search(seen, [one.coordinates for one in valleys], progress)


def guessed(
    shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, progress: Told, few: Sequence[int] = (0,)
) -> Medium:
    """About what the liquid of the last of a few images is, by the cheap models alone."""
    if len(few) > 1:
        problem, found = _searched(shots, blocks, scaling, progress, few)
        return problem.of(few).at(found[0]).media[-1]
    problem = _rough(shots, blocks, scaling).of(few)
    progress("looking at a few media")
    first, _ = first_guess(problem, shots[0].length_mm)
    return problem.at(search(problem, [look.coordinates for look in first], progress)[0]).media[0]


def promising(
    shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, ladder: Sequence[Vector],
    few: Sequence[int] = (0,),
) -> list[Vector]:  # fmt: skip
    """Places on a ladder that explain a few images better than their neighbours on it, best first."""
    problem = _rough(shots, blocks, scaling).of(few)
    costs = [problem.at(np.clip(one, *problem.box)).cost for one in ladder]
    around = [math.inf, *costs, math.inf]
    found = [k for k, cost in enumerate(costs) if cost <= min(around[k], around[k + 2])]
    return [ladder[k] for k in sorted(found, key=lambda k: costs[k])]


def _corrected(best: Evaluation, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool) -> Fit:
    """The optimum by exact images, and by how other models change about them.

    To first order at first: what is left of paths' noise in that is smooth. Then as the models bend on the way, which
    says as much as other exact images there would (of what these gained in a dose's fit from afar, 105 %).

    Parameters
    ----------
    best
        Of the problem that was solved.
    shots
        Whose exact images are asked for.
    models
        That are differentiated; in the end, with the error that they show at the optimum taken off.
    progress
        Told in words what is being done.
    sharper
        Whether images follow more paths where the model's error hides what the images show.
    """
    problem = best.problem
    many = any(shot.models.family for shot in shots)
    bent_enough, steps = (MANY_ENOUGH, FEW_STEPS) if many else (BENT_ENOUGH, LAST_STEPS)

    def about(centre: Evaluation, start: Evaluation, times: int) -> Fit:
        media, slopes = centre.media, problem.of_views(lambda view: view.slopes(centre.liquids[view.dose]))
        seen = [shot.models.exact(one, times) for shot, one in zip(shots, media, strict=True) if shot.models.exact]
        families = [shot.models.family for shot in shots]
        straight = [
            _linear(one.image, medium, slope, family)
            for one, medium, slope, family in zip(seen, media, slopes, families, strict=True)
        ]
        near = _weighed(problem, shots, straight, [_always(slope) for slope in slopes], seen)
        end = solve(replace(near, quick=True), start.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        last = tuple(corrected(*one) for one in zip(models, media, seen, strict=True))
        bent = near.by([image_of(model) for model in last])
        return Fit(solve(bent, end.coordinates, bent_enough, steps, damping=0.0), last)

    for _ in range(CORRECTIONS):
        progress("correcting by accurate images")
        centre = best
        fit = about(centre, centre, 1)
        best = fit.optimum
        if _settled(best, centre, SETTLED * problem.looseness):
            break
    if sharper and _held_back(best):
        progress("correcting by images as accurate as the photographs")
        fit = about(centre, best, SHARPER)
    end = fit.optimum
    views = (replace(view, slopes=own.slopes) for view, own in zip(end.problem.views, problem.views, strict=True))
    return replace(fit, optimum=replace(end.problem, views=tuple(views)).at(end.coordinates))


def _settled(best: Evaluation, centre: Evaluation, near: Vector) -> bool:
    """Whether an optimum stayed where the image that it was corrected by was made, or within a share of its errors."""
    if (np.abs(best.coordinates - centre.coordinates) < near).all():
        return True
    views = best.problem.views
    spread = best.sensitivity.covariance([view.observation.noise for view in views], [view.error for view in views])
    pairs = [np.concatenate([one.values[block.name] for block in one.problem.blocks]) for one in (best, centre)]
    return bool((np.abs(pairs[0] - pairs[1]) < SETTLED_SHARE * np.sqrt(np.diag(spread))).all())


def _weighed(
    problem: Problem, shots: Sequence[Shot], forwards: Sequence[Forward], slopes: Sequence[Slopes],
    seen: Sequence[Prediction],
) -> Problem:  # fmt: skip
    """The problem with other models, weighed by the errors that their images state and the noise that these leave."""
    gain, offsets = problem.scale(problem.whitened([one.image for one in seen]))
    views = []
    for shot, view, forward, slope, one, offset in zip(
        shots, problem.views, forwards, slopes, seen, offsets, strict=True
    ):
        left = view.observation.image - gain * one.image - offset
        observation = view.observation.with_noise_of(left, by_level=True)
        error = shot.error(counted_error(one, gain))
        views.append(replace(view, forward=forward, slopes=slope, error=error, observation=observation))
    return replace(problem, views=tuple(views))


def _linear(image: Image, centre: Medium, slopes: Image, family: Family | None) -> Forward:
    """An image, and changes of it to first order."""
    at = values_of(centre, family)
    return lambda medium: np.asarray(image + np.tensordot(values_of(medium, family) - at, slopes, 1))


def _always(slopes: Image) -> Slopes:
    return lambda _: slopes


def _held_back(best: Evaluation) -> bool:
    """Whether the model's error leaves a coefficient undetermined that noise alone would not."""
    views, medium = best.problem.views, best.media[0]
    noise = [view.observation.noise for view in views]
    with_error, without = (
        identifiable(medium, best.sensitivity.covariance(noise, errors))
        for errors in ([view.error for view in views], [None] * len(noise))
    )
    return with_error != without


def without_outliers(fit: Fit) -> Fit:
    """The fit without pixels that it shows to be none of the liquid's light."""
    best = fit.optimum
    for _ in range(CLEANINGS):
        gain, offsets = best.scale
        views = tuple(
            replace(view, observation=view.observation.cleaned(gain * image + offset))
            for view, image, offset in zip(best.problem.views, best.images, offsets, strict=True)
        )
        cleaned = replace(best.problem, views=views)
        if cleaned.pixels == best.problem.pixels:
            break
        best = polish(cleaned, best.coordinates)
    return replace(fit, optimum=best)

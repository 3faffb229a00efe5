"""An optimum corrected by exact images, about which other models say only how images change."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.differences import Forward, Slopes, values_of
from tankrig.estimation.followed import Followed, Model, remembered
from tankrig.estimation.light_beside import is_solved
from tankrig.estimation.nearby import Nearby
from tankrig.estimation.optimiser import LAST_STEPS, solve, without_noise
from tankrig.estimation.phase_block import PhaseBlock
from tankrig.estimation.phase_families import Family
from tankrig.estimation.phase_result import coefficients_by
from tankrig.estimation.prior_weight import believing, weight_of_priors
from tankrig.estimation.problem import Evaluation, Problem
from tankrig.estimation.search import Told, by_cost
from tankrig.estimation.shots import Fit, Shot, weighed_problem
from tankrig.estimation.stated_errors import stated_error
from tankrig.estimation.uncertainty import identifiable
from tankrig.estimation.versions import Exact, corrected, image_of
from tankrig.prediction import Prediction
from tankrig.scene import Medium

Vector = NDArray[np.float64]
Image = NDArray[np.floating]

NEAR_ENOUGH, BENT_ENOUGH, MANY_ENOUGH, SOLVED_ENOUGH = 0.005, 0.05, 0.1, 1.0
"""Where searches about exact images stop, see `solve`: to first order, where steps cost nothing, and as the models
bend; with a phase function's many coordinates, of which each may be off by less than where there are three; where
high orders are solved for, whose source is as rough as that."""
BENT_STEPS = 6
"""Steps as the models bend, at most: the exact image's optimum is near, and what more of them find is roughness."""
FEW_STEPS = 12
"""Steps with the accurate model, and as the models bend, at most, where a phase function's coordinates are fitted
or high orders are solved for."""
CORRECTIONS, SETTLED = 4, 0.1
"""Exact images at most that an optimum is corrected by, each at the last one's, and the move of every coordinate below
which that is over, see `Block.looseness`."""
MOST_CORRECTIONS, MOST_ROUGH, CLOSE = 8, 4, 4.0
"""Where a phase function's coordinates are fitted along light paths: exact images at most, so many of them at most by
fewer paths, and how many times as closely as to 0 coordinates that are expected to be 0 ± 1 stay to where an exact
image was made. What an image hardly tells derivatives' noise does, and without that fits followed it."""
SETTLED_SHARE = 0.5
"""Share of its standard deviation by which each value may have moved besides."""
NOISY = 0.1
"""Share of noise in the derivatives' products from which on only that counts: they say no more how far it is."""
FIRST, ROUGH, NEXT = 0.25, 0.125, 0.25
"""Shares of the light paths, where a phase function's coordinates are fitted: in derivatives and in exact images until
a fit by these has settled, for on the way there coordinates move by several standard deviations, and more would not be
worth it; and in exact images next to one by all of them, see `Nearby`."""
WORSE, HALVINGS, SHORTEST = 3.0, 3, 0.1
"""By how much more the next exact image may cost, in χ²/2, times at most that the way to it is shortened otherwise, by
half or more, and share of it at least that is left each time; where a phase function's coordinates are fitted: of three
numbers steps bend little."""
MUCH = 10.0
"""How much more, in χ²/2, the exact image costs than was promised where a fit of a phase function's coordinates ended
that has not settled."""
SHARPER = 4
"""Times as many light paths in the last exact image, where the model's error hides what the photograph shows."""


def corrected_fit(
    best: Evaluation, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool
) -> Fit:
    """The optimum by exact images, and by how other models change about them.

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
    by_shares = ByShares.of(best.problem, shots, models, progress)
    if by_shares is not None:
        centre, made = by_shares.by_few_paths(best)
        return by_shares.by_all_paths(centre, MOST_CORRECTIONS - made, sharper)
    return _corrected_by_models(best, shots, models, progress, sharper)


def _corrected_by_models(
    best: Evaluation, shots: Sequence[Shot], models: Sequence[Model], progress: Told, sharper: bool
) -> Fit:
    """The optimum by exact images, about which models change as they do by themselves.

    To first order at first: what is left of paths' noise in that is smooth. Then as the models bend on the way, which
    says as much as other exact images there would (of what these gained in a dose's fit from afar, 105 %). Then on by
    what noise of the derivatives has held back.
    """
    problem = best.problem
    many = any(shot.models.family for shot in shots)
    bent_enough, steps = (MANY_ENOUGH, FEW_STEPS) if many else (BENT_ENOUGH, BENT_STEPS)
    solved = any(is_solved(model) for model in models)
    slopes_noise = [shot.slopes_noise_of(model) for shot, model in zip(shots, models, strict=True)]

    def about(centre: Evaluation, seen: Sequence[Prediction], start: Evaluation) -> Fit:
        slopes = problem.of_views(lambda view: view.slopes(centre.liquids[view.dose]))
        here = _about(problem, shots, models, slopes, _at_media(slopes_noise, centre.media), centre, seen)
        end = solve(here.line, start.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        if not solved:  # or steps as the models bend would cost more than another exact image, and say no more
            if many:  # along which moments bend
                end = by_cost(here.bent.at(one.coordinates) for one in (end, start))[0]
            end = solve(here.bent, end.coordinates, bent_enough, steps, damping=0.0)
        return here.fit(end.coordinates + without_noise(here.line.at(centre.coordinates)))

    progress("correcting by accurate images")
    centre = best
    fit = about(centre, exact_images(shots, centre), centre)
    for _ in range(CORRECTIONS - 1):
        if _settled(fit.optimum, centre, SETTLED * problem.looseness):
            break
        progress("correcting by accurate images")
        centre, seen = _borne_out(fit, centre, partial(exact_images, shots), HALVINGS if many else 0)
        fit = about(centre, seen, centre)
    if sharper and _held_back(fit.optimum):
        progress("correcting by images as accurate as the photographs")
        fit = about(centre, exact_images(shots, centre, SHARPER), fit.optimum)
    end = fit.optimum
    views = (replace(view, slopes=own.slopes) for view, own in zip(end.problem.views, problem.views, strict=True))
    whole = replace(end.problem, views=tuple(views)).with_slopes_noise(slopes_noise)
    return replace(fit, optimum=whole.at(end.coordinates))


@dataclass(frozen=True)
class ByShares:
    """A fit about exact images, where a phase function's coordinates change what paths bring by shares of it.

    Orders 1 and 2 are computed as they are, see `Followed.about`. Derivatives along paths are dear, and told twice: by
    few lattices where the search has ended, and where a fit by few paths has settled, or has made `MOST_ROUGH` images.
    There one exact image is made by all paths, and further ones next to it, see `Nearby`. Each image shows how far the
    derivatives that led to it hold, and teaches them; where it bears out nothing, the fit goes on from where it was.

    Parameters
    ----------
    problem
        That was solved.
    shots
        Whose exact images are asked for.
    models
        Of their views.
    progress
        Told in words what is being done.
    """

    problem: Problem
    shots: Sequence[Shot]
    models: Sequence[Followed]
    progress: Told

    @classmethod
    def of(cls, problem: Problem, shots: Sequence[Shot], models: Sequence[Model], progress: Told) -> "ByShares | None":
        """For models that are differentiated; None where no phase function's coordinates are fitted along paths."""
        followed = [model for model in models if isinstance(model, Followed)]
        if any(shot.models.family for shot in shots) and len(followed) == len(models):
            return cls(problem, shots, followed, progress)
        return None

    @property
    def near(self) -> Vector:
        """Standard deviations that a settled value stays within."""
        return SETTLED * self.problem.looseness

    @property
    def each(self) -> float:
        """Share of all paths that each of several images follows: together they tell as much as one by all of them."""
        return 1.0 / len(self.shots)

    @property
    def following(self) -> float:
        """Share of the paths in exact images next to one by all of them: all, where members of the family that are
        apart look alike, for there a fit followed what noise a quarter of them adds (beads of 2 µm, off by 1 %)."""
        family = self.models[0].family
        return NEXT if family is None or not family.ladder.size else 1.0

    def shares_at(self, centre: Evaluation, share: float) -> "_Shares":
        """Derivatives by a share of the lattices, or all that each of several images follows.

        By all of them they are fine, those of orders 1 and 2 too, and told once: these are dear.
        """
        fine = share >= 1.0
        told = [model.with_share(min(share, self.each), fine) for model in self.models]
        of_media = list(zip(told, centre.media, strict=True))
        shares = [model.shares(medium) for model, medium in of_media]
        low = [model.low_shares(medium) if fine else None for model, medium in of_media]
        noise = [shot.slopes_noise_of(model) for shot, model in zip(self.shots, told, strict=True)]
        return _Shares(told, shares, low, _at_media(noise, centre.media))

    def about(self, centre: Evaluation, seen: Sequence[Prediction], told: "_Shares", start: Evaluation) -> Fit:
        """The optimum as models change about the exact images of a place."""
        parts = list(zip(told.models, centre.media, seen, told.shares, told.low, strict=True))
        near = [model.about(medium, one, share) for model, medium, one, share, _ in parts]
        slopes = [model.slopes_about(medium, one.image, share, low) for model, medium, one, share, low in parts]
        close = centre.coordinates, CLOSE
        here = _about(believing(self.problem, 1.0), self.shots, near, slopes, told.noise, centre, seen, close)
        end = solve(here.line, start.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        weight = weight_of_priors(end, seen, [shot.scene for shot in self.shots])
        if weight > 1.0:
            here = here.believing(weight)
            end = solve(here.line, end.coordinates, NEAR_ENOUGH, LAST_STEPS, damping=0.0)
        end = by_cost(here.bent.at(one.coordinates) for one in (end, start))[0]  # along which moments bend
        end = solve(here.bent, end.coordinates, MANY_ENOUGH, few_steps(self.shots), damping=0.0)
        return here.fit(end.coordinates)

    def by_few_paths(self, best: Evaluation) -> tuple[Evaluation, int]:
        """Where images by few paths lead, and how many of them were made."""
        roughly = partial(exact_images, self.shots, times=ROUGH)
        self.progress("correcting by accurate images")
        centre, seen, told = best, roughly(best), self.shares_at(best, FIRST)
        fit = self.about(centre, seen, told, centre)
        for made in range(1, MOST_ROUGH + 1):
            if made > 1 and _settled(fit.optimum, centre, self.near):  # the first is too rough
                return fit.optimum, made
            self.progress("correcting by accurate images")
            further, shown = _borne_out(fit, centre, roughly, HALVINGS)
            gain = _gain(fit, centre, further, shown)
            if made < MOST_ROUGH:
                told = told.taught(centre, seen, further, shown)
            if gain > 0.0:
                centre, seen = further, shown
            if made < MOST_ROUGH:
                fit = self.about(centre, seen, told, centre)
        return centre, MOST_ROUGH

    def by_all_paths(self, centre: Evaluation, most: int, sharper: bool) -> Fit:
        """The optimum about images by all paths, after so many more of them at most."""
        self.progress("correcting by accurate images")
        told, seen = self.shares_at(centre, 1.0), exact_images(self.shots, centre, self.each)
        next_to = self.each * self.following
        parts = [remembered(partial(_by_share, shot.models.exact, next_to)) for shot in self.shots if shot.models.exact]
        by_all = self.following == 1.0
        around = [Nearby(*one, by_all) for one in zip(parts, centre.media, seen, strict=True)]

        def exactly(at: Evaluation) -> list[Prediction]:
            return [one(medium) for one, medium in zip(around, at.media, strict=True)]

        fit = self.about(centre, seen, told, centre)
        for _ in range(most):
            if _settled(fit.optimum, centre, self.near):
                break
            self.progress("correcting by accurate images")
            ahead, shown = _borne_out(fit, centre, exactly, HALVINGS)
            gain = _gain(fit, centre, ahead, shown)
            told = told.taught(centre, seen, ahead, shown)
            if gain > -WORSE:
                centre, seen = ahead, shown
            fit = self.about(centre, seen, told, centre)
        if sharper and _held_back(fit.optimum):
            self.progress("correcting by images as accurate as the photographs")
            fit = self.about(centre, exact_images(self.shots, centre, SHARPER * self.each), told, fit.optimum)
        moved = _still_moved(fit.optimum, centre, exactly, self.near)
        return replace(fit, moved=moved, exact=around[0] if len(around) == 1 else None)


def few_steps(shots: Sequence[Shot]) -> int:
    """Steps at most where each computes orders 1 and 2 of all images anew: fewer of several."""
    return FEW_STEPS if len(shots) == 1 else BENT_STEPS


def _still_moved(
    end: Evaluation, centre: Evaluation, exact: Callable[[Evaluation], list[Prediction]], near: Vector
) -> Vector | None:
    """By how much the last exact image moved the values, where they have not settled and the exact image at their end
    costs much more than was promised; else None."""
    if _settled(end, centre, near):
        return None
    there = end.problem.by([_always(one.image) for one in exact(end)]).at(end.coordinates)
    return end.row - centre.row if there.cost - end.cost > MUCH else None


class _Shares(NamedTuple):
    """Derivatives of the logarithm of each image's parts at a place."""

    models: list[Followed]
    """Models that told them."""
    shares: list[Image]
    """Derivatives of what paths bring, see `Followed.shares`."""
    low: list[Image | None]
    """Those of orders 1 and 2, see `Followed.low_shares`; None where they are told anew at each place."""
    noise: list[Slopes | None]
    """Patterns of the paths' noise in the former."""

    def taught(
        self, centre: Evaluation, seen: Sequence[Prediction], ahead: Evaluation, shown: Sequence[Prediction]
    ) -> "_Shares":
        """The same, but so that they would have foretold exact images ahead of a place.

        Where gain, σs and phase function nearly make up for each other, a step that lowers the cost by little changes
        images by thirty times as much, and derivatives that are 1 % off promise what they do not keep.
        """
        parts = zip(self.models, self.shares, centre.media, seen, ahead.media, shown, strict=True)
        return self._replace(shares=[model.taught(shares, *places) for model, shares, *places in parts])


@dataclass(frozen=True)
class _About:
    """The problem about a place where exact images are known.

    Parameters
    ----------
    weighed
        By the exact images' errors, with models that agree with them at the place.
    bent
        The same with the paths' noise in the exact images taken off what was observed.
    line
        That to first order.
    models
        Of the views of `weighed`.
    apart
        See `Fit`.
    """

    weighed: Problem
    bent: Problem
    line: Problem
    models: tuple[Model, ...]
    apart: tuple[Image | None, ...]

    def believing(self, weight: float) -> "_About":
        """With phase functions expected to be smooth so many times as firmly, see `weight_of_priors`."""
        weighed, bent, line = (believing(one, weight) for one in (self.weighed, self.bent, self.line))
        return replace(self, weighed=weighed, bent=bent, line=line)

    def fit(self, coordinates: Vector) -> Fit:
        """The fit that ends at coordinates, or next to them in the box."""
        return Fit(self.weighed.at(np.clip(coordinates, *self.line.box)), self.models, self.apart)


def _about(
    problem: Problem, shots: Sequence[Shot], models: Sequence[Model], slopes: Sequence[Image],
    noise: Sequence[Slopes | None], centre: Evaluation, seen: Sequence[Prediction],
    close: tuple[Vector, float] | None = None,
) -> _About:  # fmt: skip
    """The problem about a place where exact images are known.

    Parameters
    ----------
    problem
        That is solved.
    shots
        The images.
    models
        That say how images change about the place.
    slopes, noise
        Their derivatives at the place, and patterns of the noise of these.
    centre
        The place.
    seen
        Exact images there.
    close
        See `Problem`.
    """
    media = centre.media
    last = tuple(corrected(*one) for one in zip(models, media, seen, strict=True))
    weighed = weighed_problem(
        problem, shots, [image_of(model) for model in last], [_always(one) for one in slopes], seen, centre.added
    ).with_slopes_noise(noise)
    shown = [model(medium) for model, medium in zip(models, media, strict=True)]
    smooth = [one.image for one in shown]
    calm = _without_noise_in_gain(weighed, smooth, seen, centre.added)
    bent = replace(calm.by([image_of(model) for model in models]), close=close)
    families = [shot.models.family for shot in shots]
    straight = [
        _linear(image, medium, slope, family)
        for image, medium, slope, family in zip(smooth, media, slopes, families, strict=True)
    ]
    apart = (
        exact.image - one.image if stated_error(one) < stated_error(exact) else None
        for one, exact in zip(shown, seen, strict=True)
    )  # fmt: skip
    return _About(weighed, bent, replace(bent.by(straight), quick=True), last, tuple(apart))


def exact_images(shots: Sequence[Shot], at: Evaluation, times: float = 1.0) -> list[Prediction]:
    """Exact images at a place, with so many times the light paths."""
    return [shot.models.exact(one, times) for shot, one in zip(shots, at.media, strict=True) if shot.models.exact]


def _by_share(exact: Exact, share: float, medium: Medium) -> Prediction:
    """An exact image by a share of its light paths."""
    return exact(medium, share)


def _at_media(noise: Sequence[Slopes | None], media: Sequence[Medium]) -> list[Slopes | None]:
    """Patterns of the derivatives' noise as they are at media, wherever they are asked for."""
    return [one and _always(one(medium)) for one, medium in zip(noise, media, strict=True)]


def _borne_out(
    fit: Fit, centre: Evaluation, exact: Callable[[Evaluation], list[Prediction]], halvings: int
) -> tuple[Evaluation, list[Prediction]]:
    """Where exact images explain no less than where a fit went from, on the way to where it went; and these images.

    Models that say how images change about a place do not know how far they hold.
    """
    ahead = fit.optimum
    weighed, here = ahead.problem, ahead.problem.at(centre.coordinates).cost
    promised = max(here - ahead.cost, 0.0)
    for _ in range(halvings):
        seen = exact(ahead)
        worse = _cost_by(weighed, ahead, seen) - here
        if worse <= WORSE:
            return ahead, seen
        # Where a parabola has its lowest point that begins as was promised and ends where the exact image is.
        share = min(max(promised / (2.0 * promised + worse), SHORTEST), 0.5)
        promised *= share * (2.0 - share)
        ahead = weighed.at(centre.coordinates + share * (ahead.coordinates - centre.coordinates))
    return ahead, exact(ahead)


def _gain(fit: Fit, centre: Evaluation, ahead: Evaluation, seen: Sequence[Prediction]) -> float:
    """By how much less a place costs, by exact images of it, than the one that a fit went from."""
    weighed = fit.optimum.problem
    return weighed.at(centre.coordinates).cost - _cost_by(weighed, ahead, seen)


def _cost_by(weighed: Problem, at: Evaluation, seen: Sequence[Prediction]) -> float:
    """What a place costs by exact images of it."""
    return weighed.by([_always(one.image) for one in seen]).at(at.coordinates).cost


def _without_noise_in_gain(
    problem: Problem, smooth: Sequence[Image], seen: Sequence[Prediction], added: Sequence[Image | float]
) -> Problem:
    """The problem with what exact images differ by from smooth ones taken off what was observed, not put on the models.

    Of a free gain the image itself is the derivative. With the paths' noise in it the gain is drawn towards 0 (errors
    in variables; Fuller 1987): for 2·10⁵ paths and a thin liquid by 4 %, and σs by 1.7, where nothing else tells the
    gain from the liquid.
    """
    gain, _ = problem.scale(problem.whitened([one.image + more for one, more in zip(seen, added, strict=True)]))
    views = []
    for view, image, one in zip(problem.views, smooth, seen, strict=True):
        observation = view.observation
        views.append(
            replace(view, observation=replace(observation, image=observation.image - gain * (one.image - image)))
        )
    return replace(problem, views=tuple(views))


def _settled(best: Evaluation, centre: Evaluation, near: Vector) -> bool:
    """Whether an optimum stayed where the image that it was corrected by was made, or within a share of its errors."""
    close = (np.abs(best.coordinates - centre.coordinates) < near).all()
    if close and best.sensitivity.noise_share < NOISY:
        return True
    return bool((np.abs(best.row - centre.row) < SETTLED_SHARE * best.deviations).all())


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
    others = best.problem.blocks[1:]
    count, by = 3, np.eye(3)  # σa, σs and g, whatever comes after them
    if others and isinstance(others[0], PhaseBlock):  # a family's coordinates are not the mean cosine
        by = coefficients_by(others[0].family, best.values[others[0].name])
        count = by.shape[1]
    with_error, without = (
        identifiable(medium, by @ best.sensitivity.covariance(noise, errors)[:count, :count] @ by.T)
        for errors in ([view.error for view in views], [None] * len(noise))
    )
    return with_error != without
